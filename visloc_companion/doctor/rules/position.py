"""What the autopilot says of its origin, its position and its receiver."""

from __future__ import annotations

from visloc_companion.doctor.facts import Facts, LinkFacts
from visloc_companion.doctor.finding import Finding, Rule, amber, green, red, skipped
from visloc_companion.doctor.rules.link import link_rule
from visloc_companion.types import FIX_3D

LEAST_SATELLITES = 6


@link_rule(
    "link-origin",
    "GPS_GLOBAL_ORIGIN",
    "Positions are metres from the EKF origin: without one nothing can be injected, and ArduPilot would report latitude and "
    "longitude 0.",
    "wait for a GNSS fix, or set the origin from the ground station (SET_GPS_GLOBAL_ORIGIN) before take-off",
)
def _origin(link: LinkFacts, facts: Facts) -> Finding:
    if link.origin is None and facts.assumed.injection.set_origin:
        return amber("no origin; the daemon will set the middle of the map", "wait for it, and compare it with where you are")
    if link.origin is None:
        return red("no origin")
    return green(f"{link.origin.lat_deg:.6f}, {link.origin.lon_deg:.6f}")


@link_rule(
    "link-vision-before-origin",
    "GLOBAL_POSITION_INT and the EKF's flags",
    "Vision that came before an origin makes ArduPilot claim a position at latitude and longitude 0.",
    "stop whatever sends positions, set the origin, reboot the autopilot",
)
def _before_origin(link: LinkFacts, facts: Facts) -> Finding:
    del facts
    claims = bool(link.claims_position)
    if claims and link.position is None and link.origin is None:
        return red("a position is claimed, and there is no origin")
    return green("position and origin fit" if claims else "no position is claimed")


@link_rule(
    "link-home",
    "HOME_POSITION",
    "Landing and failsafes go there; the map is judged about it.",
    "wait for a GNSS fix, or set home in the ground station",
)
def _home(link: LinkFacts, facts: Facts) -> Finding:
    del facts
    if link.home is None:
        return amber("no home")
    return green(f"{link.home.lat_deg:.6f}, {link.home.lon_deg:.6f}")


@link_rule(
    "link-gnss",
    "GPS_RAW_INT",
    "The filter starts from GNSS while it is good, and everything is learnt against it.",
    "open sky, antenna and cable; or start without GNSS on purpose (docs/start-anywhere.md)",
)
def _gnss(link: LinkFacts, facts: Facts) -> Finding:
    del facts
    if link.fix_type is None:
        return amber("no GPS_RAW_INT")
    read = f"fix type {link.fix_type}, {link.n_satellites} satellites"
    enough = link.n_satellites is None or link.n_satellites >= LEAST_SATELLITES
    return green(read) if link.fix_type >= FIX_3D and enough else amber(read)


@link_rule(
    "link-ekf-position",
    "EKF_STATUS_REPORT or ESTIMATOR_STATUS",
    "The EKF must vouch for a position before the flight.",
    "wait for a GNSS fix; read the autopilot's own messages; calibrate compass and accelerometers",
)
def _ekf(link: LinkFacts, facts: Facts) -> Finding:
    del facts
    if link.claims_position is None:
        return skipped("no state of the EKF arrived", "see link-status-rate")
    return green("the EKF has a position") if link.claims_position else amber("the EKF has no position")


@link_rule(
    "link-ekf-ratio",
    "pos_horiz_variance or pos_horiz_ratio",
    "Above 1 positions are being rejected, while every flag stays good.",
    "find out which source is wrong before arming: GNSS, compass, or a position that is injected",
)
def _ratio(link: LinkFacts, facts: Facts) -> Finding:
    del facts
    if link.position_ratio is None:
        return skipped("no innovation ratio arrived", "see link-status-rate")
    read = f"{link.position_ratio:.2f}"
    return green(read) if link.position_ratio <= 1 else amber(read)


RULES: tuple[Rule, ...] = (_origin, _before_origin, _home, _gnss, _ekf, _ratio)
"""About positions before the flight."""
