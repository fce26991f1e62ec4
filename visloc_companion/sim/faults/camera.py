"""What goes wrong with the camera and its pictures."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from visloc_companion.sim.rendering.render_effects import CameraEffects

SHUTTER_S = 0.002
"""Exposure by day: a vehicle at 10 m/s moves by 2 cm meanwhile."""


@dataclass(frozen=True, slots=True)
class CameraFreeze:
    """The camera goes on sending one and the same picture; `anew`: with other noise each time, as an encoder that lost its
    sensor does, which compresses its last picture again and again."""

    start_s: float
    end_s: float = math.inf
    anew: bool = False


@dataclass(frozen=True, slots=True)
class CameraSilence:
    """The camera sends nothing."""

    start_s: float
    end_s: float = math.inf


@dataclass(frozen=True, slots=True)
class GimbalSilence:
    """The gimbal that carries the camera holds it as before, and nobody says how."""

    start_s: float
    end_s: float = math.inf


@dataclass(frozen=True, slots=True)
class FramesLate:
    """Frames reach the daemon `delay_s` after their exposure and up to `spread_s` more, so that they overtake each other.

    Their stamps stay those of the exposure: a buffer between camera and daemon is slow, not the camera's clock wrong.
    """

    start_s: float
    delay_s: float
    spread_s: float
    end_s: float = math.inf


@dataclass(frozen=True, slots=True)
class RollingShutter:
    """The rows of a picture are exposed one after the other, the last `readout_s` after the first."""

    readout_s: float
    start_s: float = 0.0
    end_s: float = math.inf


@dataclass(frozen=True, slots=True)
class Blur:
    """Out of focus by a Gaussian of `focus_px`, and exposed for `exposure_s`, which smears whatever moves meanwhile."""

    start_s: float
    focus_px: float
    exposure_s: float
    end_s: float = math.inf


@dataclass(frozen=True, slots=True)
class Haze:
    """Air that leaves 2 % of the contrast at `visibility_m` (Koschmieder)."""

    start_s: float
    visibility_m: float
    end_s: float = math.inf


@dataclass(frozen=True, slots=True)
class Night:
    """The scene gives the sensor only this share of the light of day; it amplifies up to `max_gain`, its noise alike."""

    start_s: float
    light: float
    max_gain: float = 40.0
    end_s: float = math.inf


OpticsFault = RollingShutter | Blur | Haze | Night
CameraFault = CameraFreeze | CameraSilence | GimbalSilence | FramesLate | OpticsFault


@dataclass(frozen=True, slots=True)
class Optics:
    """How pictures are taken at a time: the sensor's effects, the time from first to last row, and the exposure."""

    effects: CameraEffects = field(default_factory=CameraEffects)
    readout_s: float = 0.0
    exposure_s: float = SHUTTER_S


def optics_of(faults: tuple[OpticsFault, ...], t_s: float) -> Optics:
    """What the faults that act at a time make of a good camera."""
    optics = Optics()
    for fault in faults:
        if not fault.start_s <= t_s < fault.end_s:
            continue
        match fault:
            case RollingShutter():
                optics = replace(optics, readout_s=fault.readout_s)
            case Blur():
                effects = replace(optics.effects, focus_blur_px=fault.focus_px)
                optics = replace(optics, effects=effects, exposure_s=fault.exposure_s)
            case Haze():
                optics = replace(optics, effects=replace(optics.effects, visibility_m=fault.visibility_m))
            case Night():
                optics = replace(optics, effects=replace(optics.effects, light=fault.light, max_gain=fault.max_gain))
    return optics
