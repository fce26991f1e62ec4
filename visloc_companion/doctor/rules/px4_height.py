"""PX4's height above the sea, which the barometer gives. Sources: VehicleAirData.cpp, baro_height_control.cpp, atmosphere.cpp."""

from __future__ import annotations

from visloc_companion.doctor.facts import Facts
from visloc_companion.doctor.finding import REBOOT, Finding, Rule, amber, green, skipped
from visloc_companion.types import AutopilotKind

OFF_M = 10.0
"""More than a receiver with a 3D fix is off in height, mostly; frames are scaled by the height, and 5 m are good enough."""
_T0_K, _K_PER_M, _EXPONENT = 288.15, 0.0065, 9.80665 / (287.1 * 0.0065)
"""The standard atmosphere as PX4 has it (lib/atmosphere): temperature at sea level, lapse rate, g over gas constant and lapse."""

_WITHOUT_GNSS = (
    "SENS_BARO_QNH = what an airfield nearby reports (QNH, 1 hPa is 8 m), then reboot the autopilot; or give the height with the "
    "place (MAV_CMD_EXTERNAL_POSITION_ESTIMATE, docs/px4.md)"
)


def qnh_hpa(barometer_h_m: float, true_h_m: float, qnh: float) -> float:
    """The QNH with which a barometer says `true_h_m`, where with `qnh` (hPa) it says `barometer_h_m` (metres above sea level)."""
    ratio: float = ((_T0_K - _K_PER_M * barometer_h_m) / (_T0_K - _K_PER_M * true_h_m)) ** _EXPONENT
    return qnh * ratio


def _qnh(facts: Facts) -> Finding:
    qnh, link = facts.parameters.get("SENS_BARO_QNH"), facts.link
    if qnh is None or link is None:
        return skipped("SENS_BARO_QNH was not read", "give --link URL; see link-parameters")
    if link.barometer_h_amsl_m is None:
        return skipped("the barometer's height did not come (ALTITUDE)", "PX4 sends it on links of MAV_n_MODE 2 (onboard)")
    read = f"SENS_BARO_QNH = {qnh:g} hPa, the barometer says {link.barometer_h_amsl_m:.0f} m above the sea"
    if link.gnss_h_amsl_m is None:
        return amber(f"{read}, and there is no GNSS height beside it", _WITHOUT_GNSS)
    read += f", GNSS {link.gnss_h_amsl_m:.0f} m"
    if abs(link.barometer_h_amsl_m - link.gnss_h_amsl_m) <= OFF_M:
        return green(read)
    wanted = qnh_hpa(link.barometer_h_amsl_m, link.gnss_h_amsl_m, qnh)
    return amber(read, f"SENS_BARO_QNH = {wanted:.1f}, {REBOOT}")  # not by --apply: what was measured holds for the old value


RULES: tuple[Rule, ...] = (
    Rule(
        "px4-barometer-qnh",
        "SENS_BARO_QNH, ALTITUDE, GPS_RAW_INT",
        "Without GNSS PX4 takes its height above the sea from the barometer by this pressure, the standard day's unless somebody "
        "sets it: 10 hPa beside the day's it said 405.5 m at 488 m. Frames are scaled by that height.",
        f"SENS_BARO_QNH = the day's QNH, {REBOOT}",
        _qnh,
        AutopilotKind.PX4,
    ),
)
"""About PX4's height."""
