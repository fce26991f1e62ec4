"""One injection as the message of any output."""

from __future__ import annotations

from visloc_companion.adapters.mavlink.dialect import Message
from visloc_companion.adapters.mavlink.outputs.external_estimate import external_position_estimate
from visloc_companion.adapters.mavlink.outputs.global_position import global_position_sensor
from visloc_companion.adapters.mavlink.outputs.gps_input import gps_input
from visloc_companion.adapters.mavlink.outputs.kinds import Output, Vehicle
from visloc_companion.adapters.mavlink.outputs.odometry import odometry
from visloc_companion.adapters.mavlink.outputs.soundness import fault
from visloc_companion.adapters.mavlink.outputs.vision_position import vision_position_estimate
from visloc_companion.errors import Reason
from visloc_companion.types import Injection

SECOND_RECEIVER = 1


def encode(output: Output, injection: Injection, vehicle: Vehicle, t_unix_ns: int | None = None) -> Message | Reason:
    """The message, or why it must not be sent: NOT_FINITE, BAD_INPUT, or NOT_SEEDED where it needs a velocity that is not known.

    `t_unix_ns`: the calendar's time of validity where it is known.
    """
    reason = fault(injection)
    if reason is not None:
        return reason
    match output:
        case Output.VISION_POSITION_ESTIMATE:
            return vision_position_estimate(injection, vehicle.kind)
        case Output.ODOMETRY:
            return odometry(injection, vehicle.kind)
        case Output.GLOBAL_POSITION_SENSOR:
            return global_position_sensor(injection, vehicle.system_id, vehicle.sensor_id)
        case Output.GPS_INPUT:
            instance = vehicle.gps_instance
            return gps_input(injection, SECOND_RECEIVER if instance is None else instance, t_unix_ns)
        case Output.EXTERNAL_POSITION_ESTIMATE:
            return external_position_estimate(injection, vehicle.system_id)
