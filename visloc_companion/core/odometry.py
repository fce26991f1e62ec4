"""Odometry added up between fixes: displacements as a tree over time, with an error that grows by stated laws.

A displacement runs from a keyframe to a frame, and keyframes are the ends of earlier displacements: the times of frames are the
nodes of a tree. What one displacement gets wrong on its own is independent of the others (variances add along the tree: the
error grows with the root of the number of legs); what it shares with its neighbours (scale, heading, focal length) adds up with
its sign, in proportion to the displacement, or to how far the camera turned: on a straight line it grows with the distance, on a
closed loop it cancels, and where the camera turns back.

    cov(d) = sum of own_k + s s' + h h' + f f',   s = sum of sigma_scale_k d_k,
    h = sum of sigma_heading_k (d_k turned by 90 degrees),   f = sum of sigma_focal_k per_focal_k

Where displacements are missing the velocity is held, which is wrong by `VELOCITY_MPS` t and `ACCELERATION_MPS2` t² / 2 (1-sigma,
each axis). Two frames of one leg are taken for independent, which claims too much error rather than too little. Displacements
are folded in the order of their times, so within the memory the order of arrival does not matter.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from itertools import accumulate
from operator import add, sub

from visloc_companion.core.covariance import floored
from visloc_companion.errors import Reason
from visloc_companion.geo.se3 import plus
from visloc_companion.types import Cov2, Odometry, Rejected, TooOld, Vec2, Vec3

MEMORY_S = 60.0
VELOCITY_MPS = 0.5
ACCELERATION_MPS2 = 1.0
MOST_SPEED_MPS = 150.0
"""A displacement that is faster is refused."""
SHAKE_M = 10.0
"""However short its time, a displacement of this length is not refused as too fast."""
ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class Travelled:
    """Displacement between two times, NED metres, its horizontal covariance, that without what neighbouring displacements have in
    common, for how many seconds of it nothing was seen, the length of the path along keyframes, and what a focal length
    that is off adds for each share of it."""

    displacement_ned_m: Vec3
    cov_ne_m2: Cov2
    own_ne_m2: Cov2
    unseen_s: float
    path_m: float
    per_focal_ne_m: Vec2


@dataclass(frozen=True, slots=True, eq=False)
class _Node:
    """A time with sums from the root of the tree: position, own variances (north, north with east, east), and what adds up with
    its sign, each north and east: the errors by scale, heading and focal length, and what the latter adds for each share of it.
    Plain numbers: for so few arrays take longer."""

    t_ns: int
    parent_ns: int | None
    p_ned_m: Vec3
    own_m2: Vec3
    shared_m: tuple[float, ...]
    unseen_s: float
    path_m: float


class OdometryTrack:
    """Displacements in any order; `between` answers for times that they cover."""

    def __init__(self, memory_s: float = MEMORY_S) -> None:
        self._memory_ns = round(memory_s * 1e9)
        self._items: list[Odometry] = []
        self._n_before: list[int] = []
        self._times: list[int] = []
        self._nodes: dict[int, _Node] = {}

    @property
    def newest_ns(self) -> int | None:
        """The latest time that is known, None before the first displacement."""
        return self._times[-1] if self._times else None

    def add(self, odometry: Odometry) -> Rejected | TooOld | None:
        """Take a displacement; None when it is taken. One that was taken already changes nothing."""
        why = _why_refused(odometry)
        if why is not None:
            return Rejected(why, math.inf)
        newest = self.newest_ns
        if newest is not None and odometry.t_to_ns < newest - self._memory_ns:
            return TooOld((newest - odometry.t_to_ns) * 1e-9)
        items, key = self._items, _key(odometry)
        at = len(items) if not items or key > _key(items[-1]) else bisect_left(items, key, key=_key)
        if at < len(items) and _key(items[at]) == key:
            return None
        self._items.insert(at, odometry)
        keep = self._n_before[at] if at < len(self._n_before) else len(self._times)
        for t_ns in self._times[keep:]:
            del self._nodes[t_ns]
        del self._times[keep:], self._n_before[at:]
        for item in self._items[at:]:
            self._n_before.append(len(self._times))
            self._fold(item)
        self._forget()
        return None

    def between(self, t_from_ns: int, t_to_ns: int) -> Travelled | None:
        """The displacement from one time to a later one (ValueError for an earlier one); None before the first time known. After
        the last known time the velocity is held."""
        if t_to_ns < t_from_ns:
            raise ValueError(f"{t_to_ns} ns is before {t_from_ns} ns")
        a, b = self._at(t_from_ns), self._at(t_to_ns)
        if a is None or b is None:
            return None
        nn, ne, ee = self._own_between(a, b)
        scale_n, scale_e, heading_n, heading_e, lens_n, lens_e, focal_n, focal_e = map(sub, b.shared_m, a.shared_m)
        shared_nn = scale_n * scale_n + heading_n * heading_n + lens_n * lens_n
        shared_ne = scale_n * scale_e + heading_n * heading_e + lens_n * lens_e
        shared_ee = scale_e * scale_e + heading_e * heading_e + lens_e * lens_e
        north, east, down = map(sub, b.p_ned_m, a.p_ned_m)
        return Travelled(
            (north, east, down),
            ((nn + shared_nn, ne + shared_ne), (ne + shared_ne, ee + shared_ee)),
            ((nn, ne), (ne, ee)),
            max(0.0, b.unseen_s - a.unseen_s),
            max(math.hypot(north, east), b.path_m - a.path_m),
            (focal_n, focal_e),
        )

    def _fold(self, item: Odometry) -> None:
        """Hang a displacement on its start; one that starts at a time between nodes, or ends where a node is, hangs nowhere."""
        start = self._nodes.get(item.t_from_ns)
        if item.t_to_ns in self._nodes:
            return
        if start is None:
            if self._times and item.t_from_ns < self._times[-1]:
                return
            start = self._held(item.t_from_ns) if self._times else _root(item.t_from_ns)
            self._put(start)
        self._put(_moved(start, item))

    def _put(self, node: _Node) -> None:
        self._times.append(node.t_ns)
        self._nodes[node.t_ns] = node

    def _held(self, t_ns: int) -> _Node:
        """Beyond the last node: its velocity goes on."""
        last = self._nodes[self._times[-1]]
        before = self._nodes[self._times[-2]]
        seconds = (t_ns - last.t_ns) * 1e-9
        share = seconds / ((last.t_ns - before.t_ns) * 1e-9)
        north, east, down = (share * moved_m for moved_m in map(sub, last.p_ned_m, before.p_ned_m))
        sigma2 = (VELOCITY_MPS * seconds) ** 2 + (ACCELERATION_MPS2 * seconds**2 / 2) ** 2
        nn, ne, ee = last.own_m2
        return _Node(
            t_ns,
            last.t_ns,
            plus(last.p_ned_m, (north, east, down)),
            (nn + sigma2, ne, ee + sigma2),
            last.shared_m,
            last.unseen_s + seconds,
            last.path_m + math.hypot(north, east),
        )

    def _at(self, t_ns: int) -> _Node | None:
        if not self._times or t_ns < self._times[0]:
            return None
        if t_ns in self._nodes:
            return self._nodes[t_ns]
        k = bisect_right(self._times, t_ns)
        if k == len(self._times):
            return self._held(t_ns)
        a, b = self._nodes[self._times[k - 1]], self._nodes[self._times[k]]
        share = (t_ns - a.t_ns) / (b.t_ns - a.t_ns)
        chord = ACCELERATION_MPS2 * ((b.t_ns - a.t_ns) * 1e-9) ** 2 * share * (1 - share) / 2
        north, east, down = (x + share * (y - x) for x, y in zip(a.p_ned_m, b.p_ned_m, strict=True))
        nn, ne, ee = (x + share**2 * more for x, more in zip(a.own_m2, self._own_between(a, b), strict=True))
        return _Node(
            t_ns,
            a.t_ns,
            (north, east, down),
            (nn + chord**2, ne, ee + chord**2),
            tuple(x + share * (y - x) for x, y in zip(a.shared_m, b.shared_m, strict=True)),
            a.unseen_s + share * (b.unseen_s - a.unseen_s),
            a.path_m + share * (b.path_m - a.path_m),
        )

    def _own_between(self, a: _Node, b: _Node) -> Vec3:
        """Own variances on the way from one node to another, by the node where their ways to the root meet."""
        x, y = a, b
        while x.t_ns != y.t_ns:
            later, other = (x, y) if x.t_ns > y.t_ns else (y, x)
            parent = None if later.parent_ns is None else self._nodes.get(later.parent_ns)
            if parent is None:  # beyond the memory: as if they had met at the earlier one
                x = y = other
            else:
                x, y = parent, other
        (a_nn, a_ne, a_ee), (b_nn, b_ne, b_ee), (nn, ne, ee) = a.own_m2, b.own_m2, x.own_m2
        return a_nn + b_nn - 2 * nn, a_ne + b_ne - 2 * ne, a_ee + b_ee - 2 * ee

    def _forget(self) -> None:
        """Drop displacements older than the memory, and the nodes that no other hangs on; in portions."""
        horizon = self._times[-1] - self._memory_ns if self._times else 0
        if not self._items or self._items[0].t_to_ns > horizon - self._memory_ns // 8:
            return
        old = bisect_left(self._items, horizon, key=lambda item: item.t_to_ns)
        del self._items[:old]
        n_before = self._n_before[old:]
        wanted = {item.t_from_ns for item in self._items}
        kept = [t >= horizon or t in wanted for t in self._times]
        counts = [0, *accumulate(kept)]
        self._n_before = [counts[n] for n in n_before]
        self._times = [t for t, keep in zip(self._times, kept, strict=True) if keep]
        self._nodes = {t: self._nodes[t] for t in self._times}


def _key(item: Odometry) -> tuple[int, int]:
    return item.t_to_ns, -item.t_from_ns


def _why_refused(odometry: Odometry) -> Reason | None:
    d, cov = odometry.displacement_ned_m, odometry.cov_ne_m2
    shared = (odometry.sigma_scale, odometry.sigma_heading_rad, odometry.sigma_focal)
    numbers = (*d, *cov[0], *cov[1], *shared, *odometry.per_focal_ne_m)
    if not all(map(math.isfinite, numbers)):
        return Reason.NOT_FINITE
    if odometry.t_to_ns <= odometry.t_from_ns:
        return Reason.IMPLAUSIBLE_TIME
    (nn, ne), (en, ee) = cov
    if min(nn, ee) < 0 or nn * ee - ne * ne < -ROUNDING * (nn + ee) ** 2 or abs(ne - en) > ROUNDING * (nn + ee):
        return Reason.BAD_INPUT
    seconds = (odometry.t_to_ns - odometry.t_from_ns) * 1e-9
    return Reason.BAD_INPUT if math.hypot(*d) > SHAKE_M + MOST_SPEED_MPS * seconds else None


def _root(t_ns: int) -> _Node:
    return _Node(t_ns, None, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0,) * 8, 0.0, 0.0)


def _moved(start: _Node, item: Odometry) -> _Node:
    (north, east, _), (focal_n, focal_e) = item.displacement_ned_m, item.per_focal_ne_m
    scale, heading, focal = item.sigma_scale, item.sigma_heading_rad, item.sigma_focal
    by_scale, by_heading, by_lens = (
        (scale * north, scale * east),
        (-heading * east, heading * north),
        (focal * focal_n, focal * focal_e),
    )
    return _Node(
        item.t_to_ns,
        start.t_ns,
        plus(start.p_ned_m, item.displacement_ned_m),
        plus(start.own_m2, _own(item.cov_ne_m2, (by_scale, by_heading, by_lens))),
        tuple(map(add, start.shared_m, (*by_scale, *by_heading, *by_lens, focal_n, focal_e))),
        start.unseen_s,
        start.path_m + math.hypot(north, east),
    )


def _own(cov: Cov2, shared_m: tuple[Vec2, ...]) -> Vec3:
    """A displacement's variances (north, north with east, east) less the errors that it shares, nowhere negative."""
    (nn, ne), (_, ee) = cov
    for north, east in shared_m:
        nn, ne, ee = nn - north**2, ne - north * east, ee - east**2
    (nn, ne), (_, ee) = floored(((nn, ne), (ne, ee)), 0.0)
    return nn, ne, ee
