"""Does the level hold where several things go wrong at once? `python -m benchmarks.combined_faults [--flights N] [--seed N] ...`.

Whole flights in closed loop with the built-in autopilot, MAVLink, navigator and filter, without pictures (as consistency.py; what
the eyes make of faults: combined_faults_eyes.py). Each flight draws how GNSS goes wrong, `--faults` more faults of FAULTS with
their times and sizes, vehicle, autopilot, how often there are fixes, and whether there is odometry.

Prints each flight with the largest ratio of error to protection level while positions are sent (horizontal, vertical), epochs
beyond the level, hazardously misleading ones, and for how long an error beyond the alert limit went without an alert. `--only`
draws from these faults alone; a flight is the same whatever else is flown.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from random import Random

import numpy as np

from benchmarks.consistency import FRAME_RATE_HZ, HOME, over_hills, pilot_of
from benchmarks.flown.combined_faults_eyes import FaultyEyes, Spell
from benchmarks.flown.consistency_eyes import EyesModel
from visloc_companion.app.journal import Entry
from visloc_companion.core.settings import CoreSettings, InjectionSettings
from visloc_companion.geo import wgs84
from visloc_companion.sim import faults
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.faults import FaultSchedule
from visloc_companion.sim.flight import CLOCK_OFFSET_NS
from visloc_companion.sim.scenarios import Scenario
from visloc_companion.sim.setup import VehicleKind
from visloc_companion.types import AutopilotKind, Status, Vec2

DURATION_S = 140.0
SETTLES_S, LAST_S = 25.0, 60.0
"""GNSS goes wrong between these times."""


@dataclass(frozen=True, slots=True)
class Plan:
    """A flight: what goes wrong with the world (`schedule`) and with what is seen (`spells`), in words, and who flies."""

    words: tuple[str, ...]
    schedule: FaultSchedule
    spells: tuple[Spell, ...]
    vehicle: VehicleKind = "copter"
    kind: AutopilotKind = AutopilotKind.ARDUPILOT
    model: EyesModel = field(default_factory=EyesModel)
    duration_s: float = DURATION_S


@dataclass(slots=True)
class Worst:
    """Of a flight, while positions were sent: the largest ratios with time (s), error and level (m) of the horizontal one,
    epochs, and those beyond the level, hazardously misleading, and available; the longest time without an alert that was due."""

    ratio: float = 0.0
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    vertical_ratio: float = 0.0
    epochs: int = 0
    misleading: int = 0
    hmi: int = 0
    available: int = 0
    unsaid_s: float = 0.0
    _unsaid_since_s: float | None = None

    def take(self, t_s: float, status: Status, off_ned_m: tuple[float, float, float]) -> None:
        """One status with the error of its position."""
        error_m, level_m = math.hypot(*off_ned_m[:2]), status.protection_level_m
        limit_m, vertical_m = status.alert_limit_m, status.vertical_protection_level_m
        if not status.injected or level_m is None or limit_m is None:
            self._unsaid_since_s = None
            return
        self.epochs, self.available = self.epochs + 1, self.available + status.available
        self.misleading += error_m > level_m
        self.hmi += level_m <= limit_m < error_m
        if error_m > self.ratio * level_m:
            self.ratio, self.at = error_m / level_m, (t_s, error_m, level_m)
        if vertical_m is not None:
            self.vertical_ratio = max(self.vertical_ratio, abs(off_ned_m[2]) / vertical_m)
        if error_m <= limit_m or status.alert:
            self._unsaid_since_s = None
            return
        self._unsaid_since_s = t_s if self._unsaid_since_s is None else self._unsaid_since_s
        self.unsaid_s = max(self.unsaid_s, t_s - self._unsaid_since_s)


def flown(plan: Plan, seed: int) -> Worst:
    """One flight."""
    settings = CoreSettings(injection=InjectionSettings(switch_source=True), max_rate_hz=FRAME_RATE_HZ, has_camera=True)
    scenario = Scenario("combined", "", plan.duration_s, plan.schedule)
    pilot = pilot_of(scenario, plan.kind, plan.vehicle, seed)
    sigma_m, start_ns = settings.navigator.map_sigma_m, CLOCK_OFFSET_NS
    eyes = FaultyEyes(plan.model, seed, sigma_m, spells=plan.spells, start_ns=start_ns, home_amsl_m=HOME.h_amsl_m)
    worst = Worst()
    over_hills(pilot, eyes, settings, _judge(worst, pilot)).run(plan.duration_s)
    return worst


def _judge(worst: Worst, pilot: BuiltInAutopilot) -> Callable[[Entry], None]:
    def judge(entry: Entry) -> None:
        if isinstance(entry.command, Status) and entry.command.place is not None:
            worst.take(pilot.t_s, entry.command, wgs84.ned_from_geo(entry.command.place, pilot.truth().place))

    return judge


def drawn(seed: int, n_faults: int, among: Sequence[str]) -> Plan:
    """A flight with so many faults beside that of GNSS."""
    rng = Random(f"combined/{seed}")
    start_s = rng.uniform(SETTLES_S, LAST_S)
    word, schedule = _gnss(rng, start_s)
    words, spells = [f"{word} from {start_s:.0f} s"], list[Spell]()
    for _ in range(n_faults):
        name, begin_s = rng.choice(among), rng.uniform(start_s - 5.0, DURATION_S - 25.0)
        for_s = rng.choice((rng.uniform(1, 6), rng.uniform(5, 20), rng.uniform(15, 45)))
        more = FAULTS[name](rng, begin_s, begin_s + for_s)
        words.append(f"{name} from {begin_s:.0f} s")
        if isinstance(more, Spell):
            spells.append(more)
        else:
            schedule += more
    vehicle: VehicleKind = rng.choice(("copter", "plane"))
    kind = rng.choice((AutopilotKind.ARDUPILOT, AutopilotKind.PX4))
    model = EyesModel(fix_share=rng.choice((0.9, 0.6, 0.25)), odometry=rng.random() < 0.8)
    return Plan(tuple(words), schedule, tuple(spells), vehicle, kind, model)


def _gnss(rng: Random, t_s: float) -> tuple[str, FaultSchedule]:
    drag, later_s = faults.SlowDrag(t_s, (*_drawn_ne(rng, 0.3, 3.0), 0.0)), t_s + rng.uniform(10, 50)
    return rng.choice(
        (
            ("jam", faults.jam(t_s)),
            ("drag", faults.these(drag)),
            ("drag, then jam", faults.these(drag, faults.Jam(later_s))),
            ("step", faults.step_spoof(t_s, (*_drawn_ne(rng, 10, 200), 0.0))),
            ("jam on and off", faults.intermittent(t_s, rng.uniform(4, 20), rng.uniform(4, 20), DURATION_S)),
            ("jam, back at a wrong place", faults.gnss_returns_bad(t_s, later_s, (*_drawn_ne(rng, 6, 100), 0.0))),
            ("jam, then meaconing", faults.meaconed(t_s, t_s + 10, (*_drawn_ne(rng, 50, 400), -10.0))),
            ("jam, back", faults.jam(t_s, later_s)),
        )
    )


def _drawn_ne(rng: Random, least: float, most: float) -> Vec2:
    angle, length = rng.uniform(0, 2 * math.pi), rng.uniform(least, most)
    return length * math.cos(angle), length * math.sin(angle)


def _either(rng: Random, least: float, most: float) -> float:
    return rng.choice((-1, 1)) * rng.uniform(least, most)


def _links(rng: Random, start_s: float) -> FaultSchedule:
    begins = [start_s + 14 * k for k in range(rng.randint(1, 4))]
    return faults.these(*(faults.LinkGap(begin, begin + rng.uniform(0.3, 5)) for begin in begins))


def _compass(rng: Random, start_s: float, end_s: float) -> FaultSchedule:
    error_rad, ramp_s = math.radians(_either(rng, 4, 40)), rng.uniform(1, 20)
    return faults.these(faults.CompassError(start_s, error_rad, ramp_s, rng.choice((math.inf, end_s + ramp_s))))


FAULTS: dict[str, Callable[[Random, float, float], FaultSchedule | Spell]] = {
    "blind": lambda _, start_s, end_s: Spell("blind", start_s, end_s),
    "no fixes": lambda _, start_s, end_s: Spell("no_fix", start_s, end_s),
    "wrong fixes": lambda rng, t_s, _: Spell("wrong", t_s, t_s + rng.uniform(0.2, 0.8), _drawn_ne(rng, 4, 60)),
    "compass": _compass,
    "barometer": lambda rng, t_s, _: faults.these(faults.BaroDrift(t_s, _either(rng, 4, 25), rng.uniform(5, 60))),
    "link gaps": lambda rng, t_s, _: _links(rng, t_s),
    "frames late": lambda rng, t_s, _: faults.these(faults.FramesLate(t_s, rng.uniform(0, 0.6), rng.uniform(0, 1))),
    "camera silent": lambda _, start_s, end_s: faults.camera_silence(start_s, end_s),
    "camera frozen": lambda _, start_s, end_s: faults.camera_freeze(start_s, end_s),
    "worker dies": lambda rng, t_s, _: faults.these(faults.WorkerCrash(t_s, rng.uniform(1, 8))),
    "companion's clock": lambda rng, t_s, _: faults.these(faults.CompanionClockStep(t_s, _either(rng, 0.6, 3))),
    "autopilot's clock": lambda rng, t_s, _: faults.these(faults.AutopilotClockStep(t_s, _either(rng, 0.6, 5))),
}
"""From the random numbers and a span of time, seconds. `wrong fixes` are one to three in a row, as the level reckons with."""


def main(argv: Sequence[str] | None = None) -> None:
    """Fly, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1, help="of the first flight")
    parser.add_argument("--faults", type=int, default=2, help="beside that of GNSS")
    parser.add_argument("--only", nargs="+", choices=list(FAULTS), default=list(FAULTS))
    args = parser.parse_args(argv)
    print("| seed | flight | error / level | at s: error, level m | vertical | misleading | HMI | available | unsaid s |")
    print("|" + "---|" * 9)
    flights = []
    for seed in range(args.seed, args.seed + args.flights):
        plan = drawn(seed, args.faults, args.only)
        worst = flown(plan, seed)
        flights.append(worst)
        words = f"{plan.kind.value} {plan.vehicle}: {'; '.join(plan.words)}"
        at = f"{worst.at[0]:.1f}: {worst.at[1]:.1f}, {worst.at[2]:.1f}"
        share = f"{100 * worst.available / max(1, worst.epochs):.0f} %"
        print(
            f"| {seed} | {words} | {worst.ratio:.2f} | {at} | {worst.vertical_ratio:.2f} | "
            f"{worst.misleading} of {worst.epochs} | {worst.hmi} | {share} | {worst.unsaid_s:.1f} |",
            flush=True,
        )
    misleading, hmi = sum(w.misleading for w in flights), sum(w.hmi for w in flights)
    largest = float(np.max([w.ratio for w in flights], initial=0.0))
    print(f"\n{misleading} of {sum(w.epochs for w in flights)} epochs beyond the level, {hmi} HMI; largest ratio {largest:.2f}")


if __name__ == "__main__":
    main()
