"""Which output an autopilot is sent, and why: tables of rules over what is known of it.

What a configuration names is sent unless a refusal fits; `auto` takes the first rule that fits, under the same refusals. What was
not read speaks neither for nor against anything.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from visloc_companion.adapters.mavlink.outputs.kinds import GPS_TYPE_MAVLINK, Output, Vehicle
from visloc_companion.types import AutopilotKind

GPS, NOTHING = 3, 0
"""Values of EK3_SRCn_POSXY."""
MAVLINK_VISION = 1
"""The VISO_TYPE that takes data as they are; 2 and 3 align them with the autopilot's own position first."""
MAX_SLOTS = 4
"""EKF2_AGP0 to EKF2_AGP3."""

Condition = Callable[[Vehicle], bool]
POSES = (Output.VISION_POSITION_ESTIMATE, Output.ODOMETRY)


@dataclass(frozen=True, slots=True)
class Choice:
    """What is sent and why; None: nothing, `why` it cannot be and what to do about it."""

    output: Output | None
    why: str
    remedy: str = ""

    def __str__(self) -> str:
        if self.output is None:
            return f"no positions are sent: {self.why}; {self.remedy}"
        return f"positions are sent as {self.output.value.upper()}: {self.why}"


def choose_output(wanted: Output | None, vehicle: Vehicle) -> Choice:
    """The output for a vehicle; `wanted` None decides by the vehicle (`injection.output = "auto"`)."""
    if wanted is None:
        wanted, why = next((output, why) for output, fits, why in RULES if fits(vehicle))
    else:
        why = "the configuration names it"
    refusals = ((why, remedy) for outputs, fits, why, remedy in REFUSALS if wanted in outputs and fits(vehicle))
    refused = next(refusals, None)
    return Choice(wanted, why) if refused is None else Choice(None, *refused)


def parameter_names(vehicle: Vehicle) -> tuple[str, ...]:
    """The parameters that the rules ask about."""
    match vehicle.kind:
        case AutopilotKind.ARDUPILOT:
            source = f"EK3_SRC{vehicle.vision_source_set}_POSXY"
            return ("VISO_TYPE", "VISO_QUAL_MIN", source, "GPS1_TYPE", "GPS2_TYPE", "GPS_TYPE", "GPS_TYPE2")
        case AutopilotKind.PX4:
            slots = tuple(f"EKF2_AGP{n}_{what}" for n in range(MAX_SLOTS) for what in ("ID", "CTRL"))
            return ("EKF2_EV_CTRL", "EKF2_EV_QMIN", *slots)
        case _:
            return ()


def _is(kind: AutopilotKind) -> Condition:
    return lambda vehicle: vehicle.kind is kind


def _vision_source(vehicle: Vehicle) -> float | None:
    return vehicle.value(f"EK3_SRC{vehicle.vision_source_set}_POSXY")


def _receives_positions(vehicle: Vehicle) -> bool:
    return vehicle.gps_instance is not None and _vision_source(vehicle) == GPS


def _dead_reckons(vehicle: Vehicle) -> bool:
    ardupilot = vehicle.kind is AutopilotKind.ARDUPILOT
    return ardupilot and vehicle.plane is True and NOTHING in (_vision_source(vehicle), vehicle.value("VISO_TYPE"))


def _least_quality(vehicle: Vehicle) -> bool:
    return (vehicle.value("VISO_QUAL_MIN", "EKF2_EV_QMIN") or 0) > 0


def _no_viso(vehicle: Vehicle) -> bool:
    kind = vehicle.value("VISO_TYPE")
    return vehicle.kind is AutopilotKind.ARDUPILOT and kind is not None and kind != MAVLINK_VISION


def _fuses_vision(vehicle: Vehicle) -> bool | None:
    control = vehicle.value("EKF2_EV_CTRL")
    return None if control is None else bool(int(control) & 1)


def _fuses_sensor(vehicle: Vehicle) -> bool:
    slots = ((vehicle.value(f"EKF2_AGP{n}_ID"), vehicle.value(f"EKF2_AGP{n}_CTRL")) for n in range(MAX_SLOTS))
    return any(number == vehicle.sensor_id and int(control or 0) & 1 for number, control in slots)


def _knows_sensors(vehicle: Vehicle) -> bool:
    return any(f"EKF2_AGP{n}_ID" in vehicle.parameters for n in range(MAX_SLOTS))


def _read(vehicle: Vehicle) -> bool:
    """Whether the autopilot answered, so that what is missing it does not have."""
    return vehicle.complete and bool(vehicle.parameters)


RULES: tuple[tuple[Output, Condition, str], ...] = (
    (Output.GPS_INPUT, _receives_positions, "a receiver is of type 14 (MAVLink), and the vision source set uses receivers"),
    (Output.EXTERNAL_POSITION_ESTIMATE, _dead_reckons, "this plane dead-reckons and takes no external positions otherwise"),
    (
        Output.GLOBAL_POSITION_SENSOR,
        lambda v: _fuses_vision(v) is not True and _fuses_sensor(v),
        "EKF2_AGPn fuses our sensor, and EKF2_EV_CTRL no vision",
    ),
    (Output.ODOMETRY, _least_quality, "the autopilot asks for a quality, which only ODOMETRY carries"),
    (Output.VISION_POSITION_ESTIMATE, lambda _: True, "every autopilot reads it alike"),
)
"""What is sent where nobody chose: the first that fits."""

REFUSALS: tuple[tuple[tuple[Output, ...], Condition, str, str], ...] = (
    (
        (Output.GPS_INPUT,),
        lambda v: v.kind is not AutopilotKind.ARDUPILOT,
        "only ArduPilot takes GPS_INPUT",
        'set injection.output = "auto"',
    ),
    (
        (Output.GPS_INPUT,),
        lambda v: _read(v) and v.gps_instance is None,
        "no receiver is of type 14 (MAVLink)",
        f"set GPS2_TYPE {GPS_TYPE_MAVLINK} (before 4.6 GPS_TYPE2) and restart the autopilot",
    ),
    (
        (Output.GLOBAL_POSITION_SENSOR,),
        lambda v: v.kind is not AutopilotKind.PX4,
        "only PX4 takes GLOBAL_POSITION_SENSOR",
        'set injection.output = "auto"',
    ),
    (
        (Output.GLOBAL_POSITION_SENSOR,),
        lambda v: _read(v) and not _knows_sensors(v),
        "this PX4 has no EKF2_AGP0_ID, so it does not take GLOBAL_POSITION_SENSOR",
        'update PX4 (March 2026 or later), or set injection.output = "auto" and EKF2_EV_CTRL 1',
    ),
    (
        (Output.GLOBAL_POSITION_SENSOR,),
        lambda v: _knows_sensors(v) and not _fuses_sensor(v),
        "no EKF2_AGPn_ID is injection.position_sensor_id with EKF2_AGPn_CTRL 1",
        "set EKF2_AGP0_ID to it and EKF2_AGP0_CTRL 1, and restart the autopilot",
    ),
    (
        (Output.EXTERNAL_POSITION_ESTIMATE,),
        lambda v: v.plane is False or v.kind is not AutopilotKind.ARDUPILOT,
        "only a plane of ArduPilot is known to fly on positions between which it dead-reckons; a copter lands all the same",
        'set injection.output = "auto"',
    ),
    ((Output.ODOMETRY,), _is(AutopilotKind.UNKNOWN), "the frame that it takes is not known", 'set injection.output = "auto"'),
    (
        POSES,
        _no_viso,
        "VISO_TYPE is not 1 (MAVLink): 0 takes nothing, 2 and 3 align what they get with a position that may be wrong",
        "set VISO_TYPE 1 and restart the autopilot",
    ),
    (
        POSES,
        lambda v: v.kind is AutopilotKind.PX4 and _fuses_vision(v) is False,
        "EKF2_EV_CTRL does not fuse horizontal positions",
        "set EKF2_EV_CTRL 1",
    ),
    (
        (Output.VISION_POSITION_ESTIMATE,),
        _least_quality,
        "VISO_QUAL_MIN or EKF2_EV_QMIN asks for a quality, which VISION_POSITION_ESTIMATE does not carry",
        'set it to 0, or injection.output = "odometry"',
    ),
)
"""Outputs, when they cannot work, why, and the remedy."""
