"""The flights against real simulators: which circuit, what goes wrong, and when."""

from __future__ import annotations

from dataclasses import replace

from visloc_companion.errors import ConfigError
from visloc_companion.sim.real.flight import Brake, RealScenario
from visloc_companion.sim.real.oracle import OracleSettings
from visloc_companion.sim.real.pilot import Leg, Route
from visloc_companion.sim.real.programs import Simulator

EXTRA_LATENCY_S = 0.3
COPTER_ROUTE = Route(
    (Leg(0, 150, 3), Leg(150, 150), Leg(150, 0, 3), Leg(80, -100), Leg(-60, -60, 3), Leg(0, 0)), height_m=60.0, speed_mps=10.0
)
"""Turns passed by and corners with a stop, 100 to 200 m apart."""
PLANE_ROUTE = Route((Leg(400, 300), Leg(100, 600), Leg(-300, 400), Leg(-200, -200)), height_m=100.0, speed_mps=23.0)
FAULT_S = 60.0
BRAKES = tuple(Brake(float(at_s)) for at_s in range(18, 360, 46))

NAMES = {
    "jam": "GNSS is jammed at 60 s for good; 300 s on vision, then landing.",
    "late": "The same with fixes 300 ms later.",
    "slow_drag": "The receiver's position (not its velocity) is dragged at 1 m/s from 60 s.",
    "gnss_back": "GNSS is jammed from 60 s to 160 s and then good again.",
    "without_daemon": "GNSS is jammed at 60 s for good, and nobody helps.",
}


def real_scenario(name: str, simulator: Simulator, seed: int = 1) -> RealScenario:
    """A flight by its name. Raises ConfigError for one that there is not."""
    plane = simulator is Simulator.ARDUPLANE
    route = PLANE_ROUTE if plane else COPTER_ROUTE
    jam = RealScenario(name, route, 360.0, jam_at_s=FAULT_S, brakes=() if plane else BRAKES, lands=not plane, seed=seed)
    oracle = OracleSettings()
    flights = {
        "jam": jam,
        "late": replace(jam, oracle=replace(oracle, latency_s=oracle.latency_s + EXTRA_LATENCY_S), lands=False),
        "slow_drag": replace(jam, duration_s=200.0, jam_at_s=None, drag_at_s=FAULT_S, lands=False),
        "gnss_back": replace(jam, duration_s=260.0, gnss_back_at_s=FAULT_S + 100.0, lands=False),
        "without_daemon": replace(jam, duration_s=160.0, with_daemon=False, lands=False),
    }
    if name not in flights:
        raise ConfigError(f"there is no flight {name!r} against a real simulator", remedy=f"use one of {', '.join(flights)}")
    return flights[name]
