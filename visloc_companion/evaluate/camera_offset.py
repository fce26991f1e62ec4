"""The offset between the clock of recorded frames and the autopilot's boot clock, found from how pictures and vehicle turn.

Two neighbouring frames show how the camera turned between them (localise/odometry/rotation.py), whatever the vehicle's attitude
was. An offset is right where the autopilot's attitudes turned the same way at the same times: of all offsets that put most of the
frames into the log, the one with the largest likelihood (Student's, so that a wrong turn costs it little). It is believed only
where it is far likelier than every other one that is not its neighbour. In flight the same is done for small offsets only
(core/camera/time_offset.py).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from visloc_companion.adapters.logs.folder import FoundOffset
from visloc_companion.adapters.logs.frames import FrameSource
from visloc_companion.adapters.logs.recording import NS_PER_S, NS_PER_US, Recording
from visloc_companion.core.camera.time_offset import log_likelihood
from visloc_companion.errors import LogError
from visloc_companion.geo.pinhole_view import pinhole_view
from visloc_companion.geo.se3 import R_from_quat
from visloc_companion.localise.around.rectified import rectified
from visloc_companion.localise.masked import painted_over, with_margin
from visloc_companion.localise.odometry.rotation import TurnWatch
from visloc_companion.types import Attitude, CameraModel, FloatArray, Quat, Turn

LEAST_GAP_US = 150_000
"""Frames nearer than this to the one before are passed over: a turn must be seen above its noise."""
MOST_PAIRS = 600
"""Those that turned most, beside as many in order: the search takes time with each."""
MOST_FRAMES = 6000
"""Are decoded: of a video a quarter of an hour and more, so that one that begins long before the take-off tells, too."""
COARSE_S, FINE_S = 0.1, 0.005
PEAKS, NEAR_S = 6, 1.0
"""So many offsets are looked at closely, each further than this from the others."""
LEAST_SHARE = 0.5
"""Of the turns must lie within the log."""
SIGMA_RAD = math.radians(0.6)
"""1-sigma of the difference of two turns about each axis: mounting, relief and the autopilot's own errors."""
COARSE_SIGMA_RAD = math.radians(2.5)
LEAST_LEAD = 20.0
"""Logarithm of how much likelier the offset must be than any other."""
LEAST_TURNS = 30


def find_offset(recording: Recording, frames: FrameSource, model: CameraModel, q_frd_cambody: Quat) -> FoundOffset:
    """Boot time minus the frames' time. Raises LogError where the pictures do not tell: too few, too little turning."""
    turns = seen_turns(frames, model, q_frd_cambody)
    attitudes = [event for _, event in recording.events if isinstance(event, Attitude)]
    if len(turns) < LEAST_TURNS or len(attitudes) < LEAST_TURNS:
        raise _unknown(recording, f"{len(turns)} pairs of frames and {len(attitudes)} attitudes tell how it turned")
    return best_offset(recording, _informative(turns), attitudes, q_frd_cambody)


def seen_turns(frames: FrameSource, model: CameraModel, q_frd_cambody: Quat) -> list[Turn]:
    """How the camera turned between neighbouring frames, on the frames' own clock; the vehicle is taken to be about level."""
    shown = with_margin(model)
    watch, turns, n_decoded = TurnWatch(pinhole_view(shown)), [], 0
    last_us: int | None = None
    for number, t_us in enumerate(frames.t_us):
        if last_us is not None and t_us - last_us < LEAST_GAP_US:
            continue
        if n_decoded == MOST_FRAMES:
            break
        pixels, n_decoded = frames.pixels(number), n_decoded + 1
        if pixels is None:
            continue
        last_us = t_us
        turn = watch.step(rectified(painted_over(pixels, model), shown), t_us * NS_PER_US, q_frd_cambody).since_last
        if turn is not None:
            turns.append(turn)
    return turns


def best_offset(recording: Recording, turns: list[Turn], attitudes: Sequence[Attitude], q_frd_cambody: Quat) -> FoundOffset:
    """The offset at which the attitudes (time order) turn as the turns do. Raises LogError where none stands out."""
    spans_s = np.array([(turn.t_from_ns, turn.t_to_ns) for turn in turns]) / NS_PER_S
    R = R_from_quat(q_frd_cambody)
    told = np.array([R @ _rotation_vector(np.array(turn.q_from_to)) for turn in turns])
    log_s = np.array([event.t_boot_ns for event in attitudes]) / NS_PER_S
    path = _Path(log_s, np.array([event.q_ned_frd for event in attitudes]))
    span_s = float(spans_s[-1, 1] - spans_s[0, 0])
    if LEAST_SHARE * span_s >= log_s[-1] - log_s[0]:
        raise _unknown(recording, "the frames last more than twice as long as the log")
    aside_s = (1 - LEAST_SHARE) * span_s
    coarse = np.arange(log_s[0] - spans_s[0, 0] - aside_s, log_s[-1] - spans_s[-1, 1] + aside_s, COARSE_S)
    peaks = _peaks(coarse, _scores(path, spans_s, told, coarse, COARSE_SIGMA_RAD))
    if not peaks:
        raise _unknown(recording, "no offset puts half of the turns into the log")
    tried = [_refined(path, spans_s, told, near_s) for near_s in peaks]
    *others, best = sorted(tried)
    lead = best.score - others[-1].score if others else math.inf
    if best.sigma_s >= NEAR_S or lead < LEAST_LEAD:
        raise _unknown(
            recording, f"the best offset, {best.at_s:.2f} s, is not far likelier than others (by {lead:.1f}, in logarithms)"
        )
    return FoundOffset(round(best.at_s * NS_PER_S), best.sigma_s)


@dataclass(frozen=True, slots=True, order=True)
class _Peak:
    score: float
    at_s: float
    sigma_s: float


def _peaks(offsets_s: FloatArray, scores: FloatArray) -> list[float]:
    """The best offsets that lie apart from each other."""
    found: list[float] = []
    for k in np.argsort(-scores, kind="stable"):
        if len(found) == PEAKS or not math.isfinite(scores[k]):
            break
        if all(abs(offsets_s[k] - other) > NEAR_S for other in found):
            found.append(float(offsets_s[k]))
    return found


def _refined(path: _Path, spans_s: FloatArray, told: FloatArray, near_s: float) -> _Peak:
    """The likeliest offset near one, with the 1-sigma of its peak; NEAR_S where it has none."""
    fine = near_s + np.arange(-2 * COARSE_S, 2 * COARSE_S, FINE_S)
    scores = _scores(path, spans_s, told, fine, SIGMA_RAD)
    k = int(np.argmax(scores))
    bend = 2 * scores[k] - scores[k - 1] - scores[k + 1] if 0 < k < len(fine) - 1 else 0.0
    return _Peak(float(scores[k]), float(fine[k]), float(FINE_S / math.sqrt(bend)) if bend > 1e-9 else NEAR_S)


class _Path:
    """Attitudes (N, 4) at times (N,), to be asked between them."""

    def __init__(self, t_s: FloatArray, q: FloatArray) -> None:
        order = np.argsort(t_s, kind="stable")
        self.t_s, q = t_s[order], q[order]
        flips = np.cumprod(np.where((q[1:] * q[:-1]).sum(1) < 0, -1.0, 1.0))
        self.parts = np.ascontiguousarray(np.vstack([q[:1], q[1:] * flips[:, None]]).T)  # np.interp would copy them at each call

    def at(self, t_s: FloatArray) -> FloatArray:
        """(M, 4) unit quaternions, NaN outside of the log."""
        found = np.column_stack([np.interp(t_s, self.t_s, part, left=math.nan, right=math.nan) for part in self.parts])
        return np.asarray(found / np.sqrt((found**2).sum(1))[:, None])


def _scores(path: _Path, spans_s: FloatArray, told: FloatArray, offsets_s: FloatArray, sigma_rad: float) -> FloatArray:
    """(M,) logarithms of the likelihoods of offsets; a turn that an offset puts outside of the log counts as any other turn
    would in its place."""
    scores = np.full(len(offsets_s), -math.inf)
    own2 = (told**2).sum(1)
    any2 = (own2 + np.median(own2)) / sigma_rad**2
    for k, offset_s in enumerate(offsets_s):
        turned = _turned(path.at(spans_s[:, 0] + offset_s), path.at(spans_s[:, 1] + offset_s))
        inside = np.isfinite(turned[:, 0])
        if inside.mean() < LEAST_SHARE:
            continue
        size2 = ((turned - told) ** 2).sum(1) / sigma_rad**2
        size2[~inside] = any2[~inside]
        scores[k] = float(log_likelihood(size2).sum())
    return scores


def _turned(a: FloatArray, b: FloatArray) -> FloatArray:
    """(N, 3) rotation vectors from attitudes (N, 4) to others, about the body's axes."""
    w = (a * b).sum(1)
    v = a[:, :1] * b[:, 1:] - b[:, :1] * a[:, 1:] - np.cross(a[:, 1:], b[:, 1:])
    return _rotation_vectors(w, v)


def _rotation_vector(q: FloatArray) -> FloatArray:
    return np.asarray(_rotation_vectors(q[:1], q[None, 1:])[0])


def _rotation_vectors(w: FloatArray, v: FloatArray) -> FloatArray:
    size = np.sqrt((v**2).sum(1))
    angle = 2 * np.arctan2(size, np.abs(w)) * np.sign(w)
    return np.asarray(v * (angle / np.maximum(size, 1e-12))[:, None])


def _informative(turns: list[Turn]) -> list[Turn]:
    """At most MOST_PAIRS in time order: half of those that turned most, the rest spread evenly."""
    if len(turns) <= MOST_PAIRS:
        return turns
    most = np.argsort([turn.q_from_to[0] ** 2 for turn in turns], kind="stable")[: MOST_PAIRS // 2]
    evenly = np.linspace(0, len(turns) - 1, MOST_PAIRS // 2).round().astype(int)
    return [turns[k] for k in sorted({*most.tolist(), *evenly.tolist()})]


def _unknown(recording: Recording, why: str) -> LogError:
    return LogError(
        f"the frames' clock cannot be found: {why}",
        where=str(recording.path.parent),
        remedy='state offset_s (boot time minus file time, seconds) beside time_base = "offset" in camera.toml',
    )
