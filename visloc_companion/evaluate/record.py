"""A flight as numpy arrays, built from what the journal, a replay or the simulator recorded, with the truth beside it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.types import (
    FIX_3D,
    Command,
    Event,
    Fix,
    FloatArray,
    FrameRef,
    GeoPoint,
    Gnss,
    Injection,
    LocaliseRequest,
    NoFix,
    Status,
    Vec3,
)

NS_PER_S = 1e9
MAX_TRUTH_GAP_S = 2.0
"""Truth is interpolated between samples that are at most so far apart."""


class EntryLike(Protocol):
    """One line of a journal (app/journal.Entry): an event or a command, and when."""

    @property
    def now_ns(self) -> int:
        """The shell's clock."""

    @property
    def event(self) -> Event | None:
        """What the navigator was given."""

    @property
    def command(self) -> Command | None:
        """What it answered."""


class TruthSample(Protocol):
    """Where the vehicle really was at a time of the shell's clock."""

    @property
    def t_ns(self) -> int:
        """Time."""

    @property
    def place(self) -> GeoPoint:
        """Position."""


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """A path: times (N,) in seconds since the flight's start, positions (N, 3) NED metres about the record's origin."""

    t_s: FloatArray
    p_ned_m: FloatArray

    def at(self, t_s: FloatArray) -> FloatArray:
        """(M, 3) positions interpolated at times; NaN outside of the track and in gaps of more than two seconds."""
        if not len(self.t_s):
            return np.full((len(t_s), 3), np.nan)
        found = np.column_stack([np.interp(t_s, self.t_s, self.p_ned_m[:, axis]) for axis in range(3)])
        after = np.clip(np.searchsorted(self.t_s, t_s, side="left"), 0, len(self.t_s) - 1)
        before = np.clip(np.searchsorted(self.t_s, t_s, side="right") - 1, 0, len(self.t_s) - 1)
        outside = (t_s < self.t_s[0] - 1e-6) | (t_s > self.t_s[-1] + 1e-6)
        found[outside | (self.t_s[after] - self.t_s[before] > MAX_TRUTH_GAP_S)] = np.nan
        return found


@dataclass(frozen=True, slots=True)
class FixPoint:
    """One fix: when its frame was exposed (s), where it puts the camera (NED, m), how long it took (ms), what it claims, by whom.

    `latency_ms` runs from exposure to the arrival of the answer, `elapsed_ms` is the computation alone.
    """

    t_s: float
    p_ned_m: Vec3
    latency_ms: float
    elapsed_ms: float
    sigma_m: float
    probability_wrong: float
    method: str


@dataclass(frozen=True, slots=True)
class Refusal:
    """One frame without a fix: when it was exposed (s), why not, how long that took (ms), by whom."""

    t_s: float
    reason: str
    latency_ms: float
    elapsed_ms: float
    method: str


@dataclass(frozen=True, slots=True, eq=False)
class FlightRecord:
    """A whole flight. Times are seconds since its start (`t0_ns` on the shell's clock), positions NED metres about `origin`.

    Epochs are the ticks (N): `estimate_ned_m` (N, 3) is NaN while there is no state, `truth_ned_m` (N, 3) where the truth is
    unknown; `cov_ne_m2` (N, 2, 2), `sigma_m` (N,) the larger 1-sigma axis, `protection_level_m` (N,) NaN where none is stated;
    `vertical_protection_level_m` (N,) and the limits `alert_limit_m`, `vertical_alert_limit_m` (N,) likewise;
    `modes`, `verdicts` (N) names, `reasons` (N) of the verdict, `injected` (N,) whether the tick sent a position.
    `gnss` is what the first receiver reported while it claimed a 3D fix; `injection_t_s` (K,) all injections.
    `truth` is the true path at its own rate.
    """

    origin: GeoPoint
    t0_ns: int
    duration_s: float
    t_s: FloatArray
    estimate_ned_m: FloatArray
    truth_ned_m: FloatArray
    cov_ne_m2: FloatArray
    sigma_m: FloatArray
    protection_level_m: FloatArray
    vertical_protection_level_m: FloatArray
    alert_limit_m: FloatArray
    vertical_alert_limit_m: FloatArray
    modes: tuple[str, ...]
    verdicts: tuple[str, ...]
    reasons: tuple[tuple[str, ...], ...]
    injected: NDArray[np.bool_]
    truth: Track
    gnss: Track
    injection_t_s: FloatArray
    fixes: tuple[FixPoint, ...]
    refusals: tuple[Refusal, ...]
    n_frames: int
    n_requests: int

    @property
    def error_ne_m(self) -> FloatArray:
        """(N, 2) estimate minus truth, north and east; NaN where either is unknown."""
        return self.estimate_ned_m[:, :2] - self.truth_ned_m[:, :2]

    @property
    def error_m(self) -> FloatArray:
        """(N,) horizontal error."""
        return np.asarray(np.hypot(*self.error_ne_m.T), dtype=np.float64)

    @property
    def vertical_error_m(self) -> FloatArray:
        """(N,) distance of the stated height from the true one."""
        return np.abs(self.estimate_ned_m[:, 2] - self.truth_ned_m[:, 2])

    def while_verdict(self, *verdicts: str) -> NDArray[np.bool_]:
        """(N,) the epochs at which one of these verdicts stood."""
        return np.isin(np.array(self.verdicts, dtype=str), verdicts) if self.verdicts else np.zeros(0, dtype=bool)

    def changes(self, names: Sequence[str]) -> list[tuple[float, str]]:
        """(t_s, name) where a per-epoch name (modes or verdicts) begins or changes."""
        return [(float(self.t_s[i]), name) for i, name in enumerate(names) if i == 0 or name != names[i - 1]]


@dataclass(slots=True)
class _Collected:
    statuses: list[tuple[int, Status]] = field(default_factory=list)
    gnss: list[tuple[int, GeoPoint]] = field(default_factory=list)
    answers: list[Fix | NoFix] = field(default_factory=list)
    injections: list[int] = field(default_factory=list)
    n_frames: int = 0
    n_requests: int = 0
    first_ns: int | None = None
    last_ns: int = 0

    def take(self, entry: EntryLike) -> None:
        self.first_ns = entry.now_ns if self.first_ns is None else min(self.first_ns, entry.now_ns)
        self.last_ns = max(self.last_ns, entry.now_ns)
        match entry.event if entry.event is not None else entry.command:
            case Status() as status:
                self.statuses.append((entry.now_ns, status))
            case Gnss(receiver=0, fix_type=fix_type, place=place) if fix_type >= FIX_3D:
                self.gnss.append((entry.now_ns, place))
            case Fix() | NoFix() as answer:
                self.answers.append(answer)
            case Injection():
                self.injections.append(entry.now_ns)
            case FrameRef():
                self.n_frames += 1
            case LocaliseRequest():
                self.n_requests += 1


def from_entries(
    entries: Iterable[EntryLike], truth: Sequence[TruthSample] | None = None, *, t0_ns: int | None = None
) -> FlightRecord:
    """The record of a flight from its journal's entries and, where somebody knows it, the truth.

    `t0_ns` is the flight's start on the shell's clock; without it the first entry (or truth sample) counts. It ends with the
    last entry: truth is often recorded for longer. An empty journal gives a record without epochs.
    """
    got = _Collected()
    for entry in entries:
        got.take(entry)
    samples = list(truth or ())
    starts = [t for t in (got.first_ns, samples[0].t_ns if samples else None) if t is not None]
    start_ns = t0_ns if t0_ns is not None else min(starts, default=0)
    ends = [got.last_ns] if got.first_ns is not None else [sample.t_ns for sample in samples[-1:]]
    end_ns = max([*ends, start_ns])
    origin = _origin(samples, got)
    true_path = _track([(sample.t_ns, sample.place) for sample in samples], origin, start_ns)
    t_s = _seconds([now for now, _ in got.statuses], start_ns)
    statuses = [status for _, status in got.statuses]
    cov = np.array([s.cov_ne_m2 for s in statuses], dtype=np.float64).reshape(-1, 2, 2)
    has_state = np.array([s.place is not None for s in statuses], dtype=bool)
    sigma = np.sqrt(np.maximum(np.linalg.eigvalsh(cov)[:, -1], 0.0)) if len(cov) else np.zeros(0)
    return FlightRecord(
        origin=origin,
        t0_ns=start_ns,
        duration_s=(end_ns - start_ns) / NS_PER_S,
        t_s=t_s,
        estimate_ned_m=_positions([s.place for s in statuses], origin),
        truth_ned_m=true_path.at(t_s),
        cov_ne_m2=cov,
        sigma_m=np.where(has_state, sigma, np.nan),
        protection_level_m=_known(s.protection_level_m for s in statuses),
        vertical_protection_level_m=_known(s.vertical_protection_level_m for s in statuses),
        alert_limit_m=_known(s.alert_limit_m for s in statuses),
        vertical_alert_limit_m=_known(s.vertical_alert_limit_m for s in statuses),
        modes=tuple(str(s.mode) for s in statuses),
        verdicts=tuple(str(s.verdict) for s in statuses),
        reasons=tuple(s.reasons for s in statuses),
        injected=np.array([s.injected for s in statuses], dtype=bool),
        truth=true_path,
        gnss=_track(got.gnss, origin, start_ns),
        injection_t_s=_seconds(got.injections, start_ns),
        fixes=tuple(_fix_point(a, origin, start_ns) for a in got.answers if isinstance(a, Fix)),
        refusals=tuple(_refusal(a, start_ns) for a in got.answers if isinstance(a, NoFix)),
        n_frames=got.n_frames,
        n_requests=got.n_requests,
    )


def rebased(record: FlightRecord, origin: GeoPoint) -> FlightRecord:
    """The same flight with its tracks about another origin near by (exact to centimetres within some kilometres)."""
    shift = np.array(ned_from_geo(record.origin, origin))
    return replace(
        record,
        origin=origin,
        estimate_ned_m=record.estimate_ned_m + shift,
        truth_ned_m=record.truth_ned_m + shift,
        truth=Track(record.truth.t_s, record.truth.p_ned_m + shift),
        gnss=Track(record.gnss.t_s, record.gnss.p_ned_m + shift),
        fixes=tuple(replace(fix, p_ned_m=tuple(np.add(fix.p_ned_m, shift).tolist())) for fix in record.fixes),
    )


def _origin(samples: list[TruthSample], got: _Collected) -> GeoPoint:
    if samples:
        return samples[0].place
    estimated = (status.place for _, status in got.statuses if status.place is not None)
    reported = (place for _, place in got.gnss)
    return next(estimated, None) or next(reported, None) or GeoPoint(0.0, 0.0, 0.0)


def _seconds(times_ns: list[int], start_ns: int) -> FloatArray:
    return np.array([(t_ns - start_ns) / NS_PER_S for t_ns in times_ns], dtype=np.float64)


def _known(values: Iterable[float | None]) -> FloatArray:
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


def _positions(places: Sequence[GeoPoint | None], origin: GeoPoint) -> FloatArray:
    unknown = (np.nan, np.nan, np.nan)
    rows = [unknown if place is None else ned_from_geo(place, origin) for place in places]
    return np.array(rows, dtype=np.float64).reshape(-1, 3)


def _track(points: list[tuple[int, GeoPoint]], origin: GeoPoint, start_ns: int) -> Track:
    return Track(_seconds([t for t, _ in points], start_ns), _positions([place for _, place in points], origin))


def _fix_point(fix: Fix, origin: GeoPoint, start_ns: int) -> FixPoint:
    sigma = float(np.sqrt(max(0.0, np.linalg.eigvalsh(np.array(fix.cov_ne_m2))[-1])))
    latency_ms = (fix.t_rx_ns - fix.t_ns) / 1e6
    t_s = (fix.t_ns - start_ns) / NS_PER_S
    return FixPoint(t_s, ned_from_geo(fix.place, origin), latency_ms, fix.elapsed_ms, sigma, fix.probability_wrong, fix.method)


def _refusal(answer: NoFix, start_ns: int) -> Refusal:
    latency_ms = (answer.t_rx_ns - answer.t_ns) / 1e6
    return Refusal((answer.t_ns - start_ns) / NS_PER_S, str(answer.reason), latency_ms, answer.elapsed_ms, answer.method)
