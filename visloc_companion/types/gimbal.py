"""What a gimbal says of itself."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from visloc_companion.types.basic import Quat


class GimbalFrame(StrEnum):
    """What a gimbal's attitude counts from: the vehicle's own axes; horizon and heading of the vehicle; horizon and north."""

    AIRFRAME = "airframe"
    HEADING = "heading"
    NORTH = "north"


@dataclass(frozen=True, slots=True)
class GimbalAttitude:
    """Where a gimbal points (GIMBAL_DEVICE_ATTITUDE_STATUS): attitude of its axes (forward: where it points, right, down), all
    of them along those of `frame` at zero; so pitch is negative below the horizon.

    `t_boot_ns` is the autopilot's clock, and 0 where the gimbal itself speaks: then `t_own_ns` is the gimbal's own clock.
    `gimbal_id`: 1 to 6 of the autopilot's own gimbals, else the MAVLink component that speaks. `failed`: it says that an encoder,
    its software or its line is broken or that it calibrates, so that its attitude is worth nothing.
    """

    t_rx_ns: int
    t_boot_ns: int
    gimbal_id: int
    q_frame_gimbal: Quat
    frame: GimbalFrame
    failed: bool = False
    t_own_ns: int | None = None
