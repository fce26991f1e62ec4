"""The outputs by name, and what an encoder must know of the vehicle beside the position itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from visloc_companion.types import AutopilotKind

FASTEST_S = 0.02
"""No output comes more often: ArduPilot takes external positions 20 ms apart at the least (NavEKF3.h, extNavIntervalMin_ms)."""

RECEIVER_PERIOD_S = 0.06
"""ArduPilot's filter takes a receiver's positions 50 ms apart at the least (NavEKF3.h, sensorIntervalMin_ms)."""


class Output(StrEnum):
    """A message that carries a position; the values are those of `injection.output`."""

    VISION_POSITION_ESTIMATE = "vision_position_estimate"
    ODOMETRY = "odometry"
    GLOBAL_POSITION_SENSOR = "global_position_sensor"
    GPS_INPUT = "gps_input"
    EXTERNAL_POSITION_ESTIMATE = "external_position_estimate"

    @property
    def announces_steps(self) -> bool:
        """Whether a step needs nothing more to be believed: by a reset counter, or because each message is a reset."""
        return self in (Output.VISION_POSITION_ESTIMATE, Output.ODOMETRY, Output.EXTERNAL_POSITION_ESTIMATE)

    @property
    def needs_velocity(self) -> bool:
        """Whether there is no such message without a velocity."""
        return self in (Output.ODOMETRY, Output.GPS_INPUT)

    @property
    def least_period_s(self) -> float:
        """What comes sooner after the last one is passed over."""
        return RECEIVER_PERIOD_S if self is Output.GPS_INPUT else FASTEST_S


@dataclass(frozen=True, slots=True)
class Vehicle:
    """What decides which output is sent.

    `plane` is None while no heartbeat said what flies. `parameters` are those that were read (parameters.py); once `complete`,
    what is missing there the autopilot does not have. `vision_source_set` and `sensor_id` are our own configuration.
    """

    kind: AutopilotKind = AutopilotKind.UNKNOWN
    system_id: int = 0
    plane: bool | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    complete: bool = False
    vision_source_set: int = 2
    sensor_id: int = 1

    def value(self, *names: str) -> float | None:
        """The first of the parameters that is known."""
        return next((self.parameters[name] for name in names if name in self.parameters), None)

    @property
    def gps_instance(self) -> int | None:
        """Which receiver is of type 14 (MAVLink): 0, 1, or None where none is known to be."""
        kinds = (self.value("GPS1_TYPE", "GPS_TYPE"), self.value("GPS2_TYPE", "GPS_TYPE2"))
        return next((n for n, kind in enumerate(kinds) if kind == GPS_TYPE_MAVLINK), None)


GPS_TYPE_MAVLINK = 14
