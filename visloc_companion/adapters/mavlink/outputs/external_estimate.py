"""MAV_CMD_EXTERNAL_POSITION_ESTIMATE (43003): a reset of the position of a plane that dead-reckons.

ArduPilot takes it only when nothing was fused for a second, and only with frame GLOBAL and an altitude of NaN
(GCS_Common.cpp:5443); each one resets the position, so it comes at its own slow period.
"""

from __future__ import annotations

import math

from visloc_companion.adapters.mavlink.dialect import AUTOPILOT_COMPONENT, Message, mav
from visloc_companion.adapters.mavlink.outputs.covariance import sigma_m
from visloc_companion.adapters.mavlink.outputs.global_position import e7
from visloc_companion.types import Injection

WRAP_S = 65_536
"""The time travels as a 32-bit float, which is good for 8 ms below this; it wraps once in 18 hours of the computer's clock."""


def external_position_estimate(injection: Injection, system_id: int) -> Message:
    """The COMMAND_INT of an injection whose numbers are sound.

    param1 is the time of validity on the clock of all that we send (seconds, wrapped), param2 the time since then: none, because
    the state is that of now. param3 is the 1-sigma, for both axes.
    """
    nan = math.nan
    t_s = injection.t_ns % (WRAP_S * 1_000_000_000) * 1e-9
    return mav.MAVLink_command_int_message(
        system_id,
        AUTOPILOT_COMPONENT,
        mav.MAV_FRAME_GLOBAL,
        mav.MAV_CMD_EXTERNAL_POSITION_ESTIMATE,
        0,
        0,
        t_s,
        0.0,
        sigma_m(injection.cov_ne_m2),
        0.0,
        e7(injection.place.lat_deg),
        e7(injection.place.lon_deg),
        nan,
    )
