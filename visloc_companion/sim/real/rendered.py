"""Eyes that see: frames rendered from the simulator's truth over a scene of another date than the map, localised as in flight."""

from __future__ import annotations

from visloc_companion.app.localiser import configured_localiser
from visloc_companion.app.settings import camera_model, mounting
from visloc_companion.config import Config
from visloc_companion.maps.pack import PackMap
from visloc_companion.sim.camera import SimulatedCamera
from visloc_companion.sim.real.oracle import View
from visloc_companion.sim.real.priority import in_turn
from visloc_companion.sim.real.programs import Running
from visloc_companion.sim.real.scenario import SeenWorld
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.render_effects import CameraEffects
from visloc_companion.sim.scene import Scene
from visloc_companion.types import Fix, LocaliseRequest, NoFix


class RenderedEyes:
    """oracle.Localise: only frames that are asked about are rendered. The simulator is held meanwhile, however long that takes.

    The camera is the configured one, with a global shutter. Raises MapError, ModelError.
    """

    def __init__(self, world: SeenWorld, config: Config, simulator: Running) -> None:
        self._simulator, self._reference = simulator, PackMap.open(world.pack, verify_hashes=False)
        model = camera_model(config.camera)
        scene = Scene.load(world.ortho, world.dsm)
        self._camera = SimulatedCamera(
            CameraSimulator(scene, model, CameraEffects()), model, mounting(config.camera), config.seed
        )
        self._localiser, _ = configured_localiser(config.localiser, model)

    def __call__(self, request: LocaliseRequest, view: View) -> Fix | NoFix:
        """What the localiser says about a frame."""
        with self._simulator.held(), in_turn():
            pixels = self._camera.render(view.place, view.q_ned_frd, request.frame.frame_id)
            return self._localiser.localise(request, pixels, self._reference)
