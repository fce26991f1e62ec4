"""The flights against real simulators: which circuit, what goes wrong, when, and what is asked of each.

Unless a flight says otherwise (`p95_limit_m`) the autopilot's own error stays within 3 m (copters) or 5 m (planes) for 95 % of
the time on vision, without a failsafe (evaluate/real/real_flight.py).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from visloc_companion.errors import ConfigError
from visloc_companion.sim.real.oracle import OracleSettings
from visloc_companion.sim.real.pilot import Leg, Route
from visloc_companion.sim.real.programs import Simulator
from visloc_companion.sim.real.scenario import Brake, Operator, RealScenario
from visloc_companion.sim.vehicles.vehicle_model import Drag

EXTRA_LATENCY_S = 0.3
COPTER_ROUTE = Route(
    (Leg(0, 150, 3), Leg(150, 150), Leg(150, 0, 3), Leg(80, -100), Leg(-60, -60, 3), Leg(0, 0)), height_m=60.0, speed_mps=10.0
)
"""Turns passed by and corners with a stop, 100 to 200 m apart."""
PLANE_ROUTE = Route((Leg(400, 300), Leg(100, 600), Leg(-300, 400), Leg(-200, -200)), height_m=100.0, speed_mps=23.0)
PX4_PLANE_MPS = 15.0
"""Its plane weighs 0.3 kg."""
RENDERED_M = 120.0
"""From 60 m up the procedural world, 0.5 m a pixel, is recognised at 4 of 18 places of the circuit, from here at 15."""
FAULT_S, RETURN_S = 60.0, 120.0
BLIND_LIMIT_M = 25.0
"""Of a minute on accelerations and what the air tells of the velocity."""
RENDERED, RENDERED_LATE, RENDERED_USUAL_DRAG = SEEN = ("rendered", "rendered_late", "rendered_usual_drag")
BRAKES = tuple(Brake(float(at_s)) for at_s in range(18, 360, 46))
ORACLE = OracleSettings()
LATE = replace(ORACLE, latency_s=ORACLE.latency_s + EXTRA_LATENCY_S)
CAMERA_HZ = 15.0
"""Of a usual camera; the daemon asks about the newest of its frames when an answer has come."""
Change = Callable[[RealScenario], RealScenario]

NAMES = {
    "jam": "GNSS is jammed at 60 s for good; 300 s on vision, then a copter lands.",
    "late": "The same with answers 300 ms later (and therefore fewer).",
    "jam_odometry": "As `jam` with a camera of 15 frames a second, and answers bring its motion, as the daemon's localiser's do.",
    "late_odometry": "The same with answers 300 ms later (and therefore fewer).",
    "late_pictures": "Pictures come 300 ms later, as many as ever.",
    "slow_drag": "The receiver's position (not its velocity) is dragged at 1 m/s from 60 s.",
    "gnss_back": "GNSS is jammed from 60 s to 160 s and then good again.",
    "without_daemon": "GNSS is jammed at 60 s for good, and nobody helps.",
    "fixes_0_5_hz": "One fix in 2 s.",
    "fixes_0_5_hz_odometry": "One picture in eight is recognised, about one in 2 s; the others bring the camera's motion.",
    "fixes_1_hz": "One fix a second.",
    "fixes_2_hz": "Two fixes a second.",
    "fixes_5_hz": "Five fixes a second, 150 ms late.",
    "fixes_10_hz": "Ten fixes a second, 80 ms late.",
    "jitter": "Answers take 0 to 500 ms.",
    "jump": "Fixes are 20 m off from 100 s to 150 s.",
    "outages": "Nothing is recognised for 2 s (at 100 s) and for 6 s (at 140 s).",
    "blind_minute": "Nothing is recognised from 120 s to 180 s: neither fixes nor odometry.",
    "no_gnss_at_boot": "There is never any GNSS: origin from the ground station, take-off by hand.",
    "claims_too_little": "Fixes with a sigma of 1 m claim 0.2 m.",
    "claims_nothing": "Fixes with a sigma of 1 m claim a covariance of zero.",
    "restarts": "The daemon dies at 100 s and at 140 s and is started again 3 s later.",
    "restart_after_return": (
        "GNSS is jammed from 60 s to 120 s, the operator switches the source; the daemon dies at 128 s, GNSS being good and the "
        "autopilot still on vision, and is started again 3 s later."
    ),
    RENDERED: "Frames rendered 120 m above the procedural world, localised on its older map (image alone).",
    RENDERED_LATE: "The same with answers 300 ms later (and therefore fewer).",
    RENDERED_USUAL_DRAG: "As `rendered` with the drag of a real quadrotor; PX4's simulated one leans by 45° at 9 m/s.",
}
"""Jammed at 60 s, with 140 s on vision, where nothing else is said."""


def _fixes(rate_hz: float, p95_limit_m: tuple[float, float] | None = None, latency_s: float = ORACLE.latency_s) -> Change:
    def change(short: RealScenario) -> RealScenario:
        limit_m = None if p95_limit_m is None else p95_limit_m[short.route.legs == PLANE_ROUTE.legs]
        return replace(short, oracle=replace(ORACLE, rate_hz=rate_hz, latency_s=latency_s), p95_limit_m=limit_m)

    return change


def _with_fixes(**changed: object) -> Change:
    return lambda flight: replace(flight, oracle=replace(ORACLE, **changed))  # type: ignore[arg-type]


def _as_the_daemon(fixes: OracleSettings) -> OracleSettings:
    return replace(fixes, odometry=True, camera_hz=CAMERA_HZ)


def _rendered(short: RealScenario) -> RealScenario:
    return replace(short, route=replace(short.route, height_m=RENDERED_M))


def _without_gnss(short: RealScenario) -> RealScenario:
    return replace(short, jam_at_s=None, gnss_at_boot=False, duration_s=150.0)


_LONG: dict[str, Change] = {
    "jam": lambda jam: jam,
    "late": lambda jam: replace(jam, oracle=LATE, lands=False),
    "jam_odometry": lambda jam: replace(jam, oracle=_as_the_daemon(ORACLE)),
    "late_odometry": lambda jam: replace(jam, oracle=_as_the_daemon(LATE), lands=False),
    "slow_drag": lambda jam: replace(jam, duration_s=200.0, jam_at_s=None, drag_at_s=FAULT_S, lands=False),
    "gnss_back": lambda jam: replace(jam, duration_s=260.0, gnss_back_at_s=FAULT_S + 100.0, lands=False),
    "without_daemon": lambda jam: replace(jam, with_daemon=False, lands=False),
}
_SHORT: dict[str, Change] = {
    "late_pictures": _with_fixes(frame_delay_s=EXTRA_LATENCY_S),
    "fixes_0_5_hz": _fixes(0.5, (8.0, 10.0)),
    "fixes_0_5_hz_odometry": lambda short: replace(short, oracle=replace(_as_the_daemon(ORACLE), recognised_of=8)),
    "fixes_1_hz": _fixes(1.0, (5.0, 7.0)),
    "fixes_2_hz": _fixes(2.0, (4.0, 5.0)),
    "fixes_5_hz": _fixes(5.0, latency_s=0.15),
    "fixes_10_hz": _fixes(10.0, latency_s=0.08),
    "jitter": _with_fixes(latency_s=0.0, jitter_s=0.5),
    "jump": _with_fixes(moved=((100.0, 150.0, 0.0, 20.0),)),
    "outages": _with_fixes(blind=((100.0, 102.0), (140.0, 146.0))),
    "blind_minute": lambda short: replace(short, oracle=replace(ORACLE, blind=((120.0, 180.0),)), p95_limit_m=BLIND_LIMIT_M),
    "no_gnss_at_boot": _without_gnss,
    "claims_too_little": _with_fixes(sigma_m=1.0, claimed_sigma_m=0.2),
    "claims_nothing": _with_fixes(sigma_m=1.0, claimed_sigma_m=0.0),
    "restarts": lambda short: replace(short, restarts=(100.0, 140.0)),
    "restart_after_return": lambda short: replace(
        short, gnss_back_at_s=RETURN_S, restarts=(RETURN_S + 8.0,), operator=Operator()
    ),
    RENDERED: _rendered,
    RENDERED_LATE: lambda short: replace(_rendered(short), oracle=LATE),
    RENDERED_USUAL_DRAG: lambda short: replace(_rendered(short), drag_per_s=Drag().per_s),
}


def real_scenario(name: str, simulator: Simulator, seed: int = 1) -> RealScenario:
    """A flight by its name. Raises ConfigError for one that there is not or this simulator cannot fly, and for a seed < 0."""
    if seed < 0:
        raise ConfigError(f"seed is {seed}", remedy="give a whole number from 0 on")
    plane = simulator.is_plane
    route = PLANE_ROUTE if plane else COPTER_ROUTE
    if simulator is Simulator.PX4_PLANE:
        route = replace(route, speed_mps=PX4_PLANE_MPS)
    jam = RealScenario(name, route, 360.0, jam_at_s=FAULT_S, brakes=() if plane else BRAKES, lands=not plane, seed=seed)
    if name not in NAMES:
        raise ConfigError(f"there is no flight {name!r} against a real simulator", remedy=f"use one of {', '.join(NAMES)}")
    why = cannot_fly(name, simulator)
    if why:
        raise ConfigError(f"{simulator} cannot fly {name!r}: {why}", remedy="use another simulator or flight")
    if name in _LONG:
        return _LONG[name](jam)
    return _SHORT[name](replace(jam, duration_s=200.0, lands=False))


def cannot_fly(name: str, simulator: Simulator) -> str:
    """Why a simulator cannot fly a flight, empty where it can."""
    if name == "slow_drag" and simulator.is_px4:
        return "nothing moves PX4's simulated receiver"
    if name == "no_gnss_at_boot" and simulator.is_plane:
        return "nobody takes a plane off by hand here"
    if name == RENDERED_USUAL_DRAG and simulator is not Simulator.PX4:
        return "its simulated vehicle has a real one's drag already"
    return ""
