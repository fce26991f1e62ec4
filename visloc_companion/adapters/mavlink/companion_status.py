"""What ground stations are told of the companion: ONBOARD_COMPUTER_STATUS (390), NAMED_VALUE_FLOAT (251) and _INT (252).

SYS_STATUS is left to the autopilot: older versions of QGroundControl take it for the vehicle's own whoever sends it.
"""

from __future__ import annotations

from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.types import ComputerLoad, Report
from visloc_companion.types.reports import NAME_LENGTH

_NS_PER_MS, _NS_PER_US = 1_000_000, 1_000
_MIB = 2**20
_UNKNOWN_PERCENT, _UNKNOWN_CELSIUS, _UNKNOWN_RPM, _UNKNOWN_32 = 255, 127, 32767, 2**32 - 1
_INT32 = 2**31


def named_values(report: Report) -> list[Message]:
    """One message a value: whole numbers as NAMED_VALUE_INT (held within 32 bits), others as NAMED_VALUE_FLOAT."""
    boot_ms = report.t_ns // _NS_PER_MS % 2**32
    messages = []
    for name, value in report.values:
        label = name.encode("ascii", errors="replace")[:NAME_LENGTH]
        if isinstance(value, int):
            messages.append(mav.MAVLink_named_value_int_message(boot_ms, label, min(_INT32 - 1, max(-_INT32, value))))
        else:
            messages.append(mav.MAVLink_named_value_float_message(boot_ms, label, value))
    return messages


def computer_status(load: ComputerLoad, t_ns: int) -> Message:
    """ONBOARD_COMPUTER_STATUS; what the system does not tell, and what we do not look at, is marked as unknown."""
    percents = [_percent(share) for share in load.cores]
    combined = _percent(sum(load.cores) / len(load.cores)) if load.cores else _UNKNOWN_PERCENT
    celsius = _UNKNOWN_CELSIUS if load.temperature_c is None else max(-128, min(126, round(load.temperature_c)))
    return mav.MAVLink_onboard_computer_status_message(
        time_usec=t_ns // _NS_PER_US,
        uptime=0 if load.uptime_s is None else round(load.uptime_s * 1e3) % 2**32,
        type=0,
        cpu_cores=_filled(percents, 8, _UNKNOWN_PERCENT),
        cpu_combined=_filled([combined], 10, _UNKNOWN_PERCENT),
        gpu_cores=[_UNKNOWN_PERCENT] * 4,
        gpu_combined=[_UNKNOWN_PERCENT] * 10,
        temperature_board=_UNKNOWN_CELSIUS,
        temperature_core=_filled([celsius], 8, _UNKNOWN_CELSIUS),
        fan_speed=[_UNKNOWN_RPM] * 4,
        ram_usage=_mib(load.ram_used_bytes),
        ram_total=_mib(load.ram_total_bytes),
        storage_type=_filled([0] if load.storage_total_bytes is not None else [], 4, _UNKNOWN_32),
        storage_usage=_filled([_mib(load.storage_used_bytes)], 4, _UNKNOWN_32),
        storage_total=_filled([_mib(load.storage_total_bytes)], 4, _UNKNOWN_32),
        link_type=[_UNKNOWN_32] * 6,
        link_tx_rate=[_UNKNOWN_32] * 6,
        link_rx_rate=[_UNKNOWN_32] * 6,
        link_tx_max=[_UNKNOWN_32] * 6,
        link_rx_max=[_UNKNOWN_32] * 6,
    )


def _percent(share: float) -> int:
    return max(0, min(100, round(100 * share)))


def _mib(amount_bytes: int | None) -> int:
    return _UNKNOWN_32 if amount_bytes is None else min(_UNKNOWN_32 - 1, amount_bytes // _MIB)


def _filled(values: list[int], length: int, unknown: int) -> list[int]:
    return [*values[:length], *[unknown] * (length - len(values))]
