"""Refined poses of the frames of a cloud: the tracks of all its stars in one adjustment, or why there are none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from visloc_companion.errors import Reason
from visloc_companion.localise.features.base import Mask
from visloc_companion.localise.structure.base import NoCloud, PosedFrame, StereoSettings
from visloc_companion.localise.structure.bundle import Bundle, PosePriors, adjust, rotation_only_px
from visloc_companion.localise.structure.pairs import Star
from visloc_companion.localise.structure.tracks import Tracks, follow, joined
from visloc_companion.types import CameraModel, Image

TURN_ONLY_PX = 1.5
"""Rays that fit a mere turn to within this show no parallax."""
MOST_CHI2 = 9.0

Evidence = dict[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    """`bundle` of the frames `used` (their numbers, the first star's hub first), and the `pairs` (hub, other) to be matched."""

    used: tuple[int, ...]
    bundle: Bundle
    pairs: tuple[tuple[int, int], ...]


def adjusted(
    frames: Sequence[PosedFrame],
    greys: Mapping[int, Image],
    stars: Sequence[Star],
    model: CameraModel,
    settings: StereoSettings,
    evidence: Evidence,
) -> Adjusted | NoCloud:
    """Refined poses of all stars whose tracks determine them; a refusal where the first star's do not.

    Writes what it found into `evidence`.
    """
    focal = float(np.sqrt(model.fx_px * model.fy_px))
    kept: list[tuple[Star, Tracks]] = []
    for star in stars:
        if kept and not any(star.hub in known.partners for known, _ in kept):
            continue
        followed, tracks = _followed(frames, greys, star, model, settings)
        why = _bad_tracks(tracks, focal, settings, {} if kept else evidence)
        if why and not kept:
            return no(*why, evidence)
        if not why and (not kept or followed.partners[0] == star.partners[0]):
            kept.append((followed, tracks))
    used = tuple(dict.fromkeys(i for star, _ in kept for i in (star.hub, *star.partners)))
    numbers = [[used.index(i) for i in (star.hub, *star.partners)] for star, _ in kept]
    tracks = joined([tracks for _, tracks in kept], numbers)
    bundle = adjust(tracks, _priors(frames, used), focal, settings.sigma_track_px)
    if bundle is None:
        return no(Reason.REFINEMENT_DIVERGED, "relative poses are undetermined", evidence)
    evidence |= {"scatter_px": bundle.scatter_px, "chi2": bundle.chi2, "good_tracks": float(bundle.good.sum())}
    pairs = _agreeing(kept, bundle.good, settings.min_tracks)
    if not pairs:
        return no(Reason.TOO_FEW_FEATURES, f"{bundle.good.sum()} of {len(bundle.good)} tracks agree on poses", evidence)
    if bundle.chi2 > MOST_CHI2:
        return no(Reason.INCONSISTENT_WITH_PRIOR, f"poses move by {bundle.chi2**0.5:.1f} of their sigmas", evidence)
    held = [k for k, i in enumerate(used) if any(i in pair for pair in pairs)]
    return Adjusted(tuple(used[k] for k in held), bundle.of(held), pairs)


def no(reason: Reason, detail: str, evidence: Evidence) -> NoCloud:
    """A refusal with what was found until then."""
    return NoCloud(reason, detail, tuple(evidence.items()))


def _followed(
    frames: Sequence[PosedFrame], greys: Mapping[int, Image], star: Star, model: CameraModel, settings: StereoSettings
) -> tuple[Star, Tracks]:
    """Tracks of a star, without the partners in which too few corners are found again, unless that is all of them."""
    tracks = follow(frames, greys, star, model, settings)
    found = [len(tracks.of(k + 1)[0]) >= settings.min_tracks for k in range(len(star.partners))]
    if all(found) or not any(found):
        return star, tracks
    fewer = star.of(found)
    return fewer, follow(frames, greys, fewer, model, settings)


def _agreeing(kept: Sequence[tuple[Star, Tracks]], good: Mask, fewest: int) -> tuple[tuple[int, int], ...]:
    """Hub and partner of every pair with enough tracks that agree with the poses, each pair once.

    A further star that does not share the base to its first partner with that one's star is tied to nothing.
    """
    pairs: list[tuple[int, int]] = []
    first = 0
    for star, tracks in kept:
        end = first + int(tracks.point.max()) + 1
        enough = [int(good[first:end][tracks.of(k + 1)[0]].sum()) >= fewest for k in range(len(star.partners))]
        first = end
        if not pairs or (enough[0] and (star.partners[0], star.hub) in pairs):
            held = [(star.hub, j) for j, held in zip(star.partners, enough, strict=True) if held]
            pairs += [pair for pair in held if pair[::-1] not in pairs]
    return tuple(pairs)


def _bad_tracks(tracks: Tracks, focal_px: float, settings: StereoSettings, evidence: Evidence) -> tuple[Reason, str] | None:
    """Why tracks do not determine relative poses, or None."""
    least = min(len(tracks.of(k)[0]) for k in range(1, tracks.frames))
    evidence |= {"corners": float(tracks.corners), "tracks": float(least)}
    if tracks.corners < settings.min_tracks:
        return Reason.LOW_TEXTURE, f"{tracks.corners} corners"
    if least < settings.min_tracks:
        return Reason.TOO_FEW_FEATURES, f"{least} of {tracks.corners} corners are found again"
    turned = min(rotation_only_px(tracks, k, focal_px) for k in range(1, tracks.frames))
    evidence["rotation_only_px"] = turned
    if turned < TURN_ONLY_PX:
        return Reason.NO_PARALLAX, f"rotation alone explains the frames to {turned:.1f} px"
    return None


def _priors(frames: Sequence[PosedFrame], used: tuple[int, ...]) -> PosePriors:
    taken = [frames[i] for i in used]
    sigma = [[*[f.sigma_position_m] * 3, f.sigma_tilt_rad, f.sigma_tilt_rad, f.sigma_yaw_rad] for f in taken]
    return PosePriors(np.array([f.T_local_cam for f in taken], dtype=np.float64), np.array(sigma, dtype=np.float64))
