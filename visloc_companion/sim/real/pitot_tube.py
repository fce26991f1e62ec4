"""The pitot tube that SIH leaves out: it tells PX4 the plane's airspeed past the sensor of the dynamic pressure."""

from __future__ import annotations

from visloc_companion.adapters.mavlink.dialect import Message, mav

SEA_LEVEL_KG_M3 = 1.225
"""Density by which an indicated airspeed is reckoned (ICAO Doc 7488)."""
PA_OF_HPA = 100.0


def with_dynamic_pressure(message: Message, indicated_mps: float) -> bytes:
    """SCALED_PRESSURE as PX4 sends it with a tube: `press_diff` is rho v²/2 of the indicated airspeed, hPa."""
    dynamic_hpa = 0.5 * SEA_LEVEL_KG_M3 * indicated_mps * indicated_mps / PA_OF_HPA
    told = mav.MAVLink_scaled_pressure_message(
        message.time_boot_ms, message.press_abs, dynamic_hpa, message.temperature, message.temperature_press_diff
    )
    link = mav.MAVLink(None, message.get_srcSystem(), message.get_srcComponent())
    link.seq = message.get_seq()
    return bytes(told.pack(link))
