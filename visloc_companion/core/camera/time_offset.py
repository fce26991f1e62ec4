"""The time offset between camera and autopilot, from how the picture turned and how the autopilot says that the camera turned.

A frame that was taken `offset` after its stamp shows the attitude of then. Over a pair of frames the two turns differ by the body
rates at its end less those at its start, times the offset: nothing in steady flight or in a steady turn, much where a vehicle
rocks, banks or begins a turn. Each offset of a grid is a hypothesis whose likelihoods (Student's, so that a wrong turn costs it
little) add up; the peak's curvature is the variance. What is older than some minutes counts less, and no hypothesis falls so far
behind that it could not come back within a few turns.

What an autopilot says is not how the vehicle turns: its attitude's error wanders, by something else at each offset. So a turn
counts on each axis by that share of its variation from offset to offset which such errors do not make: where a vehicle flies
straight on, by none.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from statistics import median

import numpy as np

from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.geo import se3
from visloc_companion.types import FloatArray, Quat, Turn

STEP_S, REACH_S = 0.01, 0.6
OFFSETS_S: FloatArray = np.linspace(-REACH_S, REACH_S, 2 * round(REACH_S / STEP_S) + 1)
DEGREES = 4.0
"""Of freedom of Student's distribution."""
ATTITUDE_SIGMA_RAD = math.radians(0.06)
"""1-sigma of the autopilot's turn between two frames, each axis, at least."""
MOUNT_SIGMA_RAD = math.radians(1.5)
"""Of the camera's mounting and scale: a turn of an angle is seen off by so much of it."""
WEIGHT = 0.7
"""Neighbouring turns share a frame and the relief below: so much of their information is new. Fitted on rendered flights."""
MEMORY_S = 300.0
MOST_BEHIND = 60.0
NEAR = 4
"""Cells on either side of the peak that its curvature stands for."""
LEAST_SIGMA_S = 0.002
REACH_NS = round((REACH_S + STEP_S) * 1e9)
LONG_AGO_S = 2.5
LATE_S: FloatArray = np.linspace(-LONG_AGO_S, REACH_S, round((LONG_AGO_S + REACH_S) / STEP_S) + 1)
"""Offsets among which frames are looked for that come through a network's buffers."""
FITS_SIGMAS, RECENT = 4.0, 20
"""A turn fits an offset within so many sigmas; so many turns tell which share of them does."""
NOISE_MARGIN = 60.0
"""By so many times the variance of an attitude's noise a turn counts for less: the noise is another one at each offset, and what
n turns say by chance for one offset before another grows as the root of n."""
NOISE_EVERY, NOISES_KEPT = 4, 10
"""Of so many turns one measures that noise; so many tell its median."""
THIRD_DIFFERENCE, MEDIAN_OF_NORMAL = 20.0, 0.6745
"""Variance of 1, -3, 3, -1 times independent noise; median of its size over its 1-sigma."""
WANDER_MARGIN = 1.5
"""So many times its variance the wandering of an attitude's error makes of how the autopilot's turns vary between offsets."""
WANDERS_KEPT, WANDER_EVERY = 24, 2
"""So many turns tell that wandering; every so many it is looked at anew."""
MEDIAN_OF_SQUARE = 0.455
"""Median over mean of a normal error's squares."""
MAX_GAP_NS = 150_000_000
"""Between attitudes further apart than this nothing is known."""


@dataclass(frozen=True, slots=True)
class Offset:
    """Seconds from a frame's stamp to when it was taken (negative: stamped late), its 1-sigma, and the share of recent turns that
    it explains: some offset is always the likeliest, also where a camera is mounted or a lens bent otherwise than configured."""

    offset_s: float
    sigma_s: float
    fits: float = 1.0


class TimeOffset:
    """Adds up what turns say of each offset (seconds, STEP_S apart)."""

    def __init__(self, offsets_s: FloatArray = OFFSETS_S) -> None:
        self._offsets_s = offsets_s
        self._earliest_ns = round((STEP_S - float(offsets_s[0])) * 1e9)
        self._score, self._fits, self._n = np.zeros(len(offsets_s)), np.zeros(len(offsets_s)), 0
        self._slopes2, self._bends = np.zeros(len(offsets_s)), np.zeros(len(offsets_s))
        self._noises_rad2: deque[float] = deque(maxlen=NOISES_KEPT)
        self._squares_rad2: deque[FloatArray] = deque(maxlen=WANDERS_KEPT)
        self._others_rad2: deque[FloatArray] = deque(maxlen=WANDERS_KEPT)
        self._wander_rad2 = np.full(3, ATTITUDE_SIGMA_RAD**2)
        self._t_ns: int | None = None

    def add(
        self,
        turn: Turn,
        stamps_boot_ns: tuple[int, int],
        sigma_s: float,
        attitude: AttitudeBuffer,
        q_frd_cambody: Quat,
    ) -> bool:
        """Take a turn between two stamps on the autopilot's clock, each good to `sigma_s` beside the offset.

        False where the autopilot's attitudes about these times are not known.
        """
        first_ns, last_ns = stamps_boot_ns[0] - self._earliest_ns, stamps_boot_ns[1] + REACH_NS
        t_ns, q = attitude.between(first_ns - MAX_GAP_NS, last_ns + MAX_GAP_NS)
        if not len(t_ns) or t_ns[0] > first_ns or t_ns[-1] < last_ns or int(np.diff(t_ns).max(initial=0)) > MAX_GAP_NS:
            return False
        t_s, apart_s = (
            np.asarray((t_ns - stamps_boot_ns[0]) * 1e-9, dtype=np.float64),
            (stamps_boot_ns[1] - stamps_boot_ns[0]) * 1e-9,
        )
        offsets_s = self._offsets_s
        start, of_start = _at(t_s, q, offsets_s)
        end, of_end = _at(t_s, q, np.asarray(offsets_s + apart_s, dtype=np.float64))
        if self._n % NOISE_EVERY == 0:
            self._noises_rad2.append(noise_rad2(t_s, q))
        noise = median(self._noises_rad2)
        r = _difference(
            start, end, se3.quat_multiply(se3.quat_multiply(q_frd_cambody, turn.q_from_to), se3.quat_inverse(q_frd_cambody))
        )
        peak = min(max(int(np.argmax(self._score)), 1), len(offsets_s) - 2)
        rate2 = sum(float(((at[peak + 1] - at[peak - 1]) ** 2).sum()) for at in (start, end)) / STEP_S**2
        angle = se3.angle_between(turn.q_from_to, (1.0, 0.0, 0.0, 0.0))
        common = (MOUNT_SIGMA_RAD * angle) ** 2 + sigma_s**2 * rate2
        R = se3.R_from_quat(q_frd_cambody)
        seen = R @ np.array(turn.cov_rad2) @ R.T
        self._note_wander(r**2, np.asarray(np.diag(seen) + common + 2 * noise))
        uneven, common = noise * (2 - of_start - of_end), common + NOISE_MARGIN * noise
        size2 = _size2(r, seen + np.diag(self._wander_rad2 + common), uneven, _shares(r, self._wander_rad2 + 2 * noise))
        plain2 = _size2(r, seen + (ATTITUDE_SIGMA_RAD**2 + common) * np.eye(3), uneven, np.ones(3))
        self._forget(turn.t_to_ns)
        says = log_likelihood(size2)
        before, here, after = says[: -2 * NEAR], says[NEAR:-NEAR], says[2 * NEAR :]
        self._slopes2[NEAR:-NEAR] += (after - before) ** 2
        self._bends[NEAR:-NEAR] += 2 * here - before - after
        self._score += says
        self._score -= self._score.max()
        np.maximum(self._score, -MOST_BEHIND, out=self._score)
        self._n += 1
        self._fits += ((plain2 <= FITS_SIGMAS**2) - self._fits) / min(self._n, RECENT)
        return True

    def best(self) -> Offset:
        """The likeliest offset; the sigma takes in what lies elsewhere, and is that of the whole grid before the first turn."""
        p = np.exp(self._score)
        p /= p.sum()
        peak = int(np.argmax(p))
        if not 0 < peak < len(p) - 1:
            return Offset(float(self._offsets_s[peak]), REACH_S, float(self._fits[peak]))
        before, here, after = (float(v) for v in self._score[peak - 1 : peak + 2])
        bend = 2 * here - before - after
        at = float(self._offsets_s[peak]) + (0.5 * STEP_S * (after - before) / bend if bend > 0 else 0.0)
        curved = STEP_S**2 / bend if bend > 0 else REACH_S**2
        far = np.abs(np.arange(len(p)) - peak) > NEAR
        spread = float(p[far] @ (self._offsets_s[far] - at) ** 2)
        sigma_s = math.sqrt(max(LEAST_SIGMA_S**2, min(curved, REACH_S**2), self._scattered_s2(peak)) + spread)
        return Offset(at, sigma_s, float(self._fits[peak]))

    def _scattered_s2(self, peak: int) -> float:
        """Variance of an offset by how turns disagree about it, whatever each claims (White 1982, the sandwich): the squares of
        their slopes NEAR cells about it over the square of their bends."""
        bends = float(self._bends[peak])
        if bends <= 0:
            return REACH_S**2
        variance = float(self._slopes2[peak]) * (NEAR * STEP_S / (2 * bends)) ** 2 / WEIGHT
        return min(variance, REACH_S**2)

    def _note_wander(self, squares_rad2: FloatArray, others_rad2: FloatArray) -> None:
        """What the attitude's error changes by between two frames (variance on each axis): from the squares (M, 3) of what turns
        differ by at each offset their median, at the offset where it is least, less what else makes them (3,)."""
        self._squares_rad2.append(squares_rad2)
        self._others_rad2.append(others_rad2)
        if self._n % WANDER_EVERY == 0:
            medians = np.median(np.array(self._squares_rad2), axis=0) / MEDIAN_OF_SQUARE
            least = medians[int(np.argmin(medians.sum(1)))] - np.median(np.array(self._others_rad2), axis=0)
            self._wander_rad2 = np.maximum(ATTITUDE_SIGMA_RAD**2, least)

    def _forget(self, t_ns: int) -> None:
        if self._t_ns is not None and t_ns > self._t_ns:
            left = math.exp(-(t_ns - self._t_ns) * 1e-9 / MEMORY_S)
            self._score *= left
            self._slopes2 *= left
            self._bends *= left
        self._t_ns = t_ns


def _shares(r: FloatArray, errs_rad2: FloatArray) -> FloatArray:
    """(3,) shares of how differences (M, 3) vary from offset to offset that errors of variance `errs_rad2` (3,) do not make."""
    return np.asarray(np.maximum(0.0, 1 - WANDER_MARGIN * errs_rad2 / np.maximum(r.var(0), 1e-18)))


def _size2(r: FloatArray, covariance_rad2: FloatArray, uneven_rad2: FloatArray, shares: FloatArray) -> FloatArray:
    """Squared sizes (M,) of differences (M, 3) in sigmas, of which each axis counts by its share, with the variance `uneven_rad2`
    (M,) put back that interpolation took off them."""
    information = np.linalg.inv(covariance_rad2) * np.sqrt(np.outer(shares, shares))
    return np.asarray(((r @ information) * r).sum(1) + np.trace(information) * uneven_rad2)


def log_likelihood(size2: FloatArray) -> FloatArray:
    """Of turns whose differences have these squared sizes, in sigmas: Student's, less what neighbours say as well."""
    return np.asarray(-WEIGHT * (DEGREES + 3) / 2 * np.log1p(size2 / DEGREES))


def noise_rad2(t_s: FloatArray, q: FloatArray) -> float:
    """Variance on each axis of what attitudes (N, 4) at times (N,) err by anew in each sample: by the third differences of turns
    about the body's axes, which a vehicle's own motion hardly shows; zero of fewer than five."""
    if len(q) < 5:
        return 0.0
    dt_s = np.diff(t_s)
    turned = _difference(q[:-1], q[1:], (1.0, 0.0, 0.0, 0.0)) * (dt_s.mean() / dt_s)[:, None]
    third = np.abs(np.diff(turned, n=2, axis=0))
    return float(np.square(np.median(third, axis=0) / MEDIAN_OF_NORMAL).mean() / THIRD_DIFFERENCE)


def _at(t_s: FloatArray, q: FloatArray, wanted_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(M, 4) unit quaternions at times, linear between samples, and how much of a sample's variance they have (M,)."""
    k = np.minimum(np.maximum(t_s.searchsorted(wanted_s) - 1, 0), len(t_s) - 2)
    before_s = t_s.take(k)
    share = ((wanted_s - before_s) / (t_s.take(k + 1) - before_s))[:, None]
    found: FloatArray = q.take(k, 0) * (1 - share)
    found += q.take(k + 1, 0) * share
    found /= np.sqrt(np.add.reduce(found * found, 1))[:, None]
    return found, np.asarray((1 - share[:, 0]) ** 2 + share[:, 0] ** 2)


def _difference(start: FloatArray, end: FloatArray, turn: Quat) -> FloatArray:
    """(M, 3) small turn about the body's axes at the end by which `turn` differs from that of attitudes (M, 4)."""
    w, x, y, z = turn
    ahead = start @ np.array([[w, x, y, z], [-x, w, -z, y], [-y, z, w, -x], [-z, -y, x, w]])
    aw, ax, ay, az = end.T
    bw, bx, by, bz = ahead.T
    sign = 2 * np.sign(aw * bw + ax * bx + ay * by + az * bz)
    turned: FloatArray = np.empty((len(start), 3))
    turned[:, 0] = sign * (aw * bx - bw * ax - ay * bz + az * by)
    turned[:, 1] = sign * (aw * by - bw * ay - az * bx + ax * bz)
    turned[:, 2] = sign * (aw * bz - bw * az - ax * by + ay * bx)
    return turned
