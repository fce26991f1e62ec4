"""Eyes that see: frames rendered from the simulator's truth over a scene of another date than the map, localised as in flight."""

from __future__ import annotations

from visloc_companion.adapters.camera.calibration import camera_model
from visloc_companion.app.localiser import configured_localiser
from visloc_companion.app.settings import mounting
from visloc_companion.config import Config
from visloc_companion.maps.pack import PackMap
from visloc_companion.protocols import Localiser
from visloc_companion.sim.camera import SimulatedCamera
from visloc_companion.sim.real.oracle import View
from visloc_companion.sim.real.priority import in_turn
from visloc_companion.sim.real.programs import Running
from visloc_companion.sim.real.scenario import SeenWorld
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_effects import CameraEffects
from visloc_companion.sim.scene import Scene
from visloc_companion.types import Fix, LocaliseRequest, NoFix


def opened(world: SeenWorld, config: Config) -> tuple[SimulatedCamera, Localiser, PackMap]:
    """The configured camera over the world as it is now, the configured localiser, and the map. Raises MapError, ModelError."""
    model = camera_model(config.camera)
    seen = CameraSimulator(Scene.load(world.ortho, world.dsm), model, CameraEffects())
    camera = SimulatedCamera(seen, model, mounting(config.camera), config.seed)
    return camera, configured_localiser(config.localiser, model)[0], PackMap.open(world.pack, verify_hashes=False)


class RenderedEyes:
    """oracle.Localise: only frames that are asked about are rendered. The simulator is held meanwhile, however long that takes.

    The camera is the configured one, with a global shutter. Raises MapError, ModelError.
    """

    def __init__(self, world: SeenWorld, config: Config, simulator: Running) -> None:
        self._simulator = simulator
        self._camera, self._localiser, self._reference = opened(world, config)

    def __call__(self, request: LocaliseRequest, view: View) -> Fix | NoFix:
        """What the localiser says about a frame."""
        with self._simulator.held(), in_turn():
            pixels = self._camera.render(view.place, view.q_ned_frd, request.frame.frame_id)
            return self._localiser.localise(request, pixels, self._reference)
