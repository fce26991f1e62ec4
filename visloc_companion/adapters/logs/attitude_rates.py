"""Body rates out of successive attitudes, for logs that do not carry them beside the attitude."""

from __future__ import annotations

from visloc_companion.geo.se3 import body_rates
from visloc_companion.types import Quat, Vec3

_MAX_GAP_S = 1.0


def rates_between(q_before: Quat, q_after: Quat, dt_s: float) -> Vec3:
    """Mean angular velocity (rad/s, body axes) that turns one `q_ned_frd` into the next within `dt_s`.

    Zero where the two are further apart than a second, or not in order.
    """
    if not 0 < dt_s <= _MAX_GAP_S:
        return (0.0, 0.0, 0.0)
    return body_rates(q_before, q_after, dt_s)
