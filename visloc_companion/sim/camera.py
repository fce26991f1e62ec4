"""The camera of a simulated vehicle: a mounting, and a renderer over a scene."""

from __future__ import annotations

from visloc_companion.geo.se3 import quat_inverse, quat_multiply, rotate
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_motion import STILL, Shot
from visloc_companion.types import CameraModel, GeoPoint, Image, Quat

LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)


class SimulatedCamera:
    """Renders what a camera sees that is fixed to the vehicle, or to a gimbal.

    `model` is what the daemon believes the lens to be (the simulator knows what it is), `q_frd_cambody` the true attitude of the
    camera's body in the body of what carries it.
    """

    def __init__(self, simulator: CameraSimulator, model: CameraModel, q_frd_cambody: Quat = LEVEL, seed: int = 1) -> None:
        self._simulator, self.model, self._q_frd_cambody, self._seed = simulator, model, q_frd_cambody, seed

    def render(self, place: GeoPoint, q_ned_frd: Quat, frame_id: int, shot: Shot = STILL) -> Image:
        """The frame from a place of the vehicle, with noise drawn from the seed and the frame's number.

        `q_ned_frd` is the attitude of what carries the camera; `shot` holds the vehicle's velocity and that body's rates.
        """
        rates = rotate(quat_inverse(self._q_frd_cambody), shot.rate_frd_radps)
        turned = Shot(shot.v_ned_mps, rates, shot.readout_s, shot.exposure_s, shot.effects)
        seed = self._seed * 1_000_003 + frame_id
        return self._simulator.frame(place, quat_multiply(q_ned_frd, self._q_frd_cambody), seed, turned)
