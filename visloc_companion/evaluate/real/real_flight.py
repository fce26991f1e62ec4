"""What a flight against a real simulator showed: the figures of docs/autopilots.md, and limits on them.

Judged are samples in the air, from the begin of the circuit to the end of the scenario (landing apart).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from visloc_companion.evaluate.gate import Check
from visloc_companion.sim.real.programs import Simulator
from visloc_companion.sim.real.record import RealLog, RealSample
from visloc_companion.sim.real.scenario import Operator, RealScenario
from visloc_companion.types import Vec2, Vec3

COPTER_LIMIT_M, PLANE_LIMIT_M = 3.0, 5.0
REJECTED_LIMIT, PULLED_LIMIT_M = 0.01, 15.0
NOTICED_S = {"jam": 5.0, "drag": 30.0}
"""How long after a fault the autopilot may still fly on the bad receiver before that counts as a wrong source."""
PROBATION_S = 40.0
"""How long after GNSS is good again it may still fly on vision: the monitor's probation of 20 s, and as much for its evidence. A
daemon that is started again begins it anew; an operator's own time comes on top."""
ENOUGH_S = 30.0
GRACE_S, SETTLED_M, SETTLED_LIMIT_S = 10.0, 3.0, 5.0
"""After fixes have jumped on purpose errors and rejections are not judged for so long; the estimate must be there sooner."""
ON_GROUND_M = 0.4
"""Less above where it stood before take-off, a vehicle stands."""
BACK_S = 4.0
"""A daemon that is started again must send a position within so long."""
LATE_S, STARVED = 0.15, 0.01
"""A position is late when it comes so long after the one before (10 Hz). Where more than this share of them is, the machine was
too busy for the speed of the flight, which shows nothing then and must be flown again. With 1.4 % EKF2 once dropped
all for 9 s."""
SLOW_S = 0.2
"""So does EKF2 with positions that reach it older than that (EKF2_DELAY_MAX), however evenly they come: where more than STARVED
of the round trips take longer, the machine was too busy as well."""


@dataclass(frozen=True, slots=True)
class RealFigures:
    """None where a flight has nothing to tell. Errors are horizontal, of the autopilot's own estimate against the truth, metres.

    `velocity_rms_mps` is that of the autopilot's reported velocity on vision. `failsafes` are texts, in the air.
    `wrong_source_s`: how long the autopilot flew on a receiver that was bad, or on vision while GNSS was good, longer than
    `NOTICED_S` and `PROBATION_S` allow. `pulled_m`: how far the estimate, and with it the vehicle, was off while a dragged
    receiver was flown on. `touch_down_mps`: the sideways speed at which a copter touched the ground. `gap_s`: the longest time
    without a position sent, on vision. `settled_s`: the longest time from a deliberate jump of the fixes until the autopilot was
    within 3 m of them again. `late_share`: see STARVED. `slow_share`: of round trips on vision, see SLOW_S. `strayed_m`: how far
    the estimate was off at most after the jam, in the air, where no daemon helped.
    """

    vision_s: float
    error_p95_m: float | None
    error_max_m: float | None
    gnss_p95_m: float | None
    end_error_m: float | None
    velocity_rms_mps: float | None
    rejected_share: float | None
    failsafes: tuple[str, ...]
    wrong_source_s: float
    pulled_m: float | None
    touch_down_mps: float | None
    gap_s: float | None
    settled_s: float | None
    late_share: float | None
    slow_share: float | None = None
    strayed_m: float | None = None

    @property
    def starved(self) -> bool:
        """Whether the machine was too busy for this flight to show anything."""
        return any(share is not None and share > STARVED for share in (self.late_share, self.slow_share))


def real_figures(log: RealLog, scenario: RealScenario) -> RealFigures:
    """Judge a flight."""
    begun, over = log.at("begun"), log.at("over")
    start_s, end_s = math.inf if begun is None else begun, math.inf if over is None else over
    flown = [s for s in log.samples if start_s <= s.t_s <= end_s]
    on_vision = [s for s in flown if s.phase == "vision"]
    on_gnss = [s for s in flown if s.phase == "gnss" and not _is_bad(s, log)]
    jumps = [start_s + at_s for from_s, to_s, *_ in scenario.oracle.moved for at_s in (from_s, to_s)]
    judged = [s for s in on_vision if not any(0 <= s.t_s - at_s < GRACE_S for at_s in jumps)]
    gaps, silent_s = _gaps_s(log, on_vision)
    errors, ratios = _errors(judged), [s.ratio for s in judged if s.ratio is not None]
    velocity = [_norm(s.estimate_v_ned_mps, s.true_v_ned_mps) for s in on_vision if s.estimate_v_ned_mps is not None]
    dragged = [s for s in flown if scenario.drag_at_s is not None and s.phase == "gnss" and _is_bad(s, log)]
    last = _errors(flown[-1:])
    return RealFigures(
        vision_s=_duration_s(on_vision),
        error_p95_m=_percentile(errors, 95),
        error_max_m=_percentile(errors, 100),
        gnss_p95_m=_percentile(_errors(on_gnss), 95),
        end_error_m=last[0] if last else None,
        velocity_rms_mps=float(np.sqrt(np.mean(np.square(velocity)))) if velocity else None,
        rejected_share=_share_above(ratios, 1.0),
        failsafes=tuple(sorted({name for t_s, name in log.failsafes if start_s <= t_s <= end_s})),
        wrong_source_s=_wrong_source_s(flown, log, scenario),
        pulled_m=_percentile(_errors(dragged), 100) if scenario.drag_at_s is not None else None,
        touch_down_mps=_touch_down_mps(log),
        gap_s=max([*gaps, silent_s]) if on_vision else None,
        settled_s=max((_settled_s(on_vision, at_s) for at_s in jumps), default=None),
        late_share=_share_above(gaps, LATE_S),
        slow_share=_slow_share(log, on_vision),
        strayed_m=None if scenario.with_daemon else _percentile(_errors(_unaided(flown, log)), 100),
    )


def checks(figures: RealFigures, scenario: RealScenario, simulator: Simulator) -> list[Check]:
    """What is asked of a flight with the daemon."""
    usual_m = PLANE_LIMIT_M if simulator.is_plane else COPTER_LIMIT_M
    limit_m = usual_m if scenario.p95_limit_m is None else scenario.p95_limit_m
    found = [
        Check("failsafes in the air", ", ".join(figures.failsafes) or "none", "none", not figures.failsafes),
        Check("on a wrong source", f"{figures.wrong_source_s:.1f} s", "0 s", figures.wrong_source_s == 0),
        _at_most("95 % of the autopilot's error on vision", figures.error_p95_m, limit_m, "m"),
        _at_most("share of rejected positions", figures.rejected_share, REJECTED_LIMIT, ""),
        Check("on vision for", f"{figures.vision_s:.0f} s", f"≥ {ENOUGH_S:.0f} s", figures.vision_s >= ENOUGH_S),
    ]
    if scenario.drag_at_s is not None:
        found.append(_at_most("pulled by the drag", figures.pulled_m, PULLED_LIMIT_M, "m"))
    if scenario.restarts:
        found.append(_at_most("without a position", figures.gap_s, scenario.down_s + BACK_S, "s"))
    if scenario.oracle.moved:
        found.append(_at_most("at the new place after a jump", figures.settled_s, SETTLED_LIMIT_S, "s"))
    return found


def _at_most(name: str, value: float | None, limit: float, unit: str) -> Check:
    shown = "none known" if value is None else "never" if value == math.inf else f"{value:.3g} {unit}".strip()
    return Check(name, shown, f"≤ {limit:.3g} {unit}".strip(), value is not None and value <= limit)


def _is_bad(sample: RealSample, log: RealLog) -> bool:
    """Whether the receiver was jammed or dragged at that time."""
    starts = [t_s for t_s in (log.at("jam"), log.at("drag")) if t_s is not None]
    back_s = log.at("back")
    return bool(starts) and sample.t_s >= min(starts) and (back_s is None or sample.t_s < back_s)


def _wrong_source_s(samples: Sequence[RealSample], log: RealLog, scenario: RealScenario) -> float:
    """Seconds on a bad receiver, or on vision with a good one, beyond what is allowed."""
    operator = scenario.operator or Operator(0.0, 0.0)
    faults = {name: t_s for name in NOTICED_S if (t_s := log.at(name)) is not None}
    back_s = log.at("back")
    begun_anew = [t_s + scenario.down_s for t_s, name in log.marks if name == "restart"]
    proven_s = math.inf if back_s is None else max([back_s, *begun_anew]) + PROBATION_S + operator.to_gnss_s
    wrong_s = 0.0
    for before, sample in itertools.pairwise(samples):
        late = any(sample.t_s > t_s + NOTICED_S[name] + operator.to_vision_s for name, t_s in faults.items())
        on_bad = sample.phase == "gnss" and _is_bad(sample, log) and late
        overdue = sample.phase == "vision" and sample.t_s > proven_s
        wrong_s += (sample.t_s - before.t_s) * (on_bad or overdue)
    return wrong_s


def _touch_down_mps(log: RealLog) -> float | None:
    """Sideways speed in the last half second before the truth says that the ground was reached."""
    over_s = log.at("over")
    if over_s is None or log.at("landed") is None:
        return None
    low = [s for s in log.samples if s.t_s > over_s and not _in_the_air(s, log)]
    return math.hypot(*low[0].true_v_ned_mps[:2]) if low else None


def _in_the_air(sample: RealSample, log: RealLog) -> bool:
    return sample.true_place.h_amsl_m >= log.samples[0].true_place.h_amsl_m + ON_GROUND_M


def _unaided(flown: Sequence[RealSample], log: RealLog) -> list[RealSample]:
    """On a bad receiver, until the ground was reached."""
    return list(itertools.takewhile(lambda s: _in_the_air(s, log), (s for s in flown if _is_bad(s, log))))


def _gaps_s(log: RealLog, on_vision: Sequence[RealSample]) -> tuple[list[float], float]:
    """Times between positions sent while the autopilot flew on vision, and that from the last one to the end of it."""
    if not on_vision:
        return [], 0.0
    begun_s, ended_s = on_vision[0].t_s, on_vision[-1].t_s
    sent_s = [t_s for t_s in log.injected_s if begun_s <= t_s <= ended_s]
    return [b - a for a, b in itertools.pairwise(sent_s)], ended_s - max(sent_s, default=begun_s)


def _slow_share(log: RealLog, on_vision: Sequence[RealSample]) -> float | None:
    if not on_vision:
        return None
    took_s = [s for t_s, s in log.round_trips if on_vision[0].t_s <= t_s <= on_vision[-1].t_s]
    return _share_above(took_s, SLOW_S)


def _settled_s(samples: Sequence[RealSample], jumped_s: float) -> float:
    after = (s for s in samples if s.t_s >= jumped_s + 0.5)
    near = (s.t_s - jumped_s for s in after if (error_m := _error_m(s)) is not None and error_m < SETTLED_M)
    return next(near, math.inf)


def _errors(samples: Sequence[RealSample]) -> list[float]:
    return [error_m for s in samples if (error_m := _error_m(s)) is not None]


def _error_m(s: RealSample) -> float | None:
    return None if s.estimate_p_ned_m is None else _norm(s.estimate_p_ned_m, s.true_p_ned_m, s.offset_ne_m)


def _norm(a: Vec3 | None, b: Vec3, offset: Vec2 = (0.0, 0.0)) -> float:
    return math.nan if a is None else math.hypot(a[0] - b[0] - offset[0], a[1] - b[1] - offset[1])


def _duration_s(samples: Sequence[RealSample]) -> float:
    gaps = [b.t_s - a.t_s for a, b in itertools.pairwise(samples)]
    return float(sum(gap for gap in gaps if gap < 1.0))


def _share_above(values: Sequence[float], limit: float) -> float | None:
    return float(np.mean(np.array(values) > limit)) if values else None


def _percentile(values: Sequence[float], share: float) -> float | None:
    return float(np.percentile(values, share)) if values else None
