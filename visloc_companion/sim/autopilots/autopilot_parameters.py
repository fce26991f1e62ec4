"""Parameters of the simulated autopilot, as far as positions depend on them, and how MAVLink carries them."""

from __future__ import annotations

import struct
from collections.abc import Mapping

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from visloc_companion.types import AutopilotKind

TOLD: dict[AutopilotKind, dict[str, float]] = {
    AutopilotKind.ARDUPILOT: {
        "MAV_SYSID": 1,
        "MAV_GCS_SYSID": 255,
        "MAV1_EXTRA1": 4,
        "SERIAL1_PROTOCOL": 2,
        "SERIAL1_BAUD": 921,
        "SCHED_LOOP_RATE": 400,
        "AHRS_EKF_TYPE": 3,
        "EK3_ENABLE": 1,
        "EK3_SRC_OPTIONS": 0,
        "COMPASS_ENABLE": 1,
        "COMPASS_USE": 1,
        "GPS1_TYPE": 1,
        "GPS2_TYPE": 0,
        "VISO_POS_X": 0,
        "VISO_POS_Y": 0,
        "VISO_POS_Z": 0,
        "VISO_SCALE": 1,
        "FS_EKF_ACTION": 1,
    },
    AutopilotKind.PX4: {
        "MAV_SYS_ID": 1,
        "MAV_COMP_ID": 1,
        "MAV_PROTO_VER": 2,
        "MAV_0_MODE": 0,
        "MAV_0_RATE": 1200,
        "MAV_1_MODE": 2,
        "MAV_1_RATE": 0,
        "EKF2_BARO_CTRL": 1,
        "EKF2_GPS_CHECK": 2047,
        "EKF2_MAG_TYPE": 0,
        "EKF2_AGP0_CTRL": 0,
        "EKF2_EV_POS_X": 0,
        "EKF2_EV_POS_Y": 0,
        "EKF2_EV_POS_Z": 0,
        "COM_ARM_WO_GPS": 1,
        "COM_POS_FS_EPH": 5,
        "COM_POS_LOW_EPH": -1,
    },
}
"""What it only tells who asks (the makers' defaults, and a port set up for a companion): nothing simulated depends on it."""

REALS = {"EKF2_EV_POS_X", "EKF2_EV_POS_Y", "EKF2_EV_POS_Z", "COM_POS_FS_EPH", "COM_POS_LOW_EPH"}
INTEGERS = {"EKF2_EV_CTRL", "EKF2_GPS_CTRL", "EKF2_HGT_REF", "EKF2_EV_QMIN", "EKF2_EV_NOISE_MD", "EKF2_NOAID_TOUT"}
INTEGERS |= set(TOLD[AutopilotKind.PX4]) - REALS
"""PX4's int32 parameters: their bytes travel in the float field (byte-wise union)."""

PREPARED: dict[AutopilotKind, dict[str, float]] = {
    AutopilotKind.ARDUPILOT: {
        "VISO_TYPE": 1,
        "VISO_DELAY_MS": 10,
        "VISO_POS_M_NSE": 0.2,
        "VISO_YAW_M_NSE": 0.2,
        "VISO_QUAL_MIN": 0,
        "GPS1_TYPE": 1,
        "GPS2_TYPE": 0,
        "ARMING_CHECK": 786430,
        "EK3_SRC1_POSXY": 3,
        "EK3_SRC1_VELXY": 3,
        "EK3_SRC1_POSZ": 1,
        "EK3_SRC1_VELZ": 3,
        "EK3_SRC1_YAW": 1,
        "EK3_SRC2_POSXY": 6,
        "EK3_SRC2_VELXY": 0,
        "EK3_SRC2_POSZ": 1,
        "EK3_SRC2_VELZ": 0,
        "EK3_SRC2_YAW": 1,
        "EK3_SRC3_POSXY": 0,
        "EK3_SRC3_VELXY": 0,
        "EK3_SRC3_POSZ": 1,
        "EK3_SRC3_VELZ": 0,
        "EK3_SRC3_YAW": 0,
        "EK3_POS_I_GATE": 500,
        "EK3_GLITCH_RAD": 25,
        "EK3_OGN_HGT_MASK": 0,
        "EK3_TAU_OUTPUT": 25,
        "FS_EKF_THRESH": 0.8,
    },
    AutopilotKind.PX4: {
        "EKF2_EV_CTRL": 1,
        "EKF2_GPS_CTRL": 7,
        "EKF2_HGT_REF": 0,
        "EKF2_EV_QMIN": 0,
        "EKF2_EV_NOISE_MD": 0,
        "EKF2_EV_DELAY": 0.0,
        "EKF2_EVP_NOISE": 0.1,
        "EKF2_EVP_GATE": 5.0,
        "EKF2_AGP0_ID": 0,
        "EKF2_AGP0_CTRL": 0,
        "EKF2_AGP0_NOISE": 1.0,
        "EKF2_AGP0_GATE": 3.0,
        "EKF2_DELAY_MAX": 200.0,
        "EKF2_NOAID_TOUT": 5000000,
        "EKF2_TAU_POS": 0.1,
        "EKF2_TAU_VEL": 0.1,
    },
}
"""A vehicle prepared for external positions. What differs from the makers' defaults: VISO_TYPE, ARMING_CHECK, EK3_SRC2_*,
EKF2_EV_CTRL, EKF2_HGT_REF (autopilot facts, sections 1.1 and 2.1), and EKF2_TAU_*."""


def prepared_parameters(kind: AutopilotKind, changes: Mapping[str, float]) -> dict[str, float]:
    """The prepared set with changes. Raises ValueError for a name that the simulated autopilot does not have."""
    parameters = PREPARED[kind] | TOLD[kind]
    unknown = sorted(set(changes) - set(parameters))
    if unknown:
        raise ValueError(f"the simulated {kind} has no parameter {', '.join(unknown)}; it has {', '.join(sorted(parameters))}")
    return parameters | dict(changes)


def encode(kind: AutopilotKind, name: str, value: float) -> tuple[float, int]:
    """Field value and MAV_PARAM_TYPE of a parameter as this autopilot sends it."""
    if kind is AutopilotKind.PX4 and name in INTEGERS:
        return float(struct.unpack("<f", struct.pack("<i", int(value)))[0]), mavlink.MAV_PARAM_TYPE_INT32
    return float(value), mavlink.MAV_PARAM_TYPE_REAL32


def decode(kind: AutopilotKind, name: str, field: float) -> float:
    """The value of a received field, the inverse of `encode`."""
    if kind is AutopilotKind.PX4 and name in INTEGERS:
        return float(struct.unpack("<i", struct.pack("<f", field))[0])
    return field
