"""From posed frames to a local cloud: choose, track, adjust, rectify, match, triangulate, merge, scale.

Pure and deterministic: nothing is drawn at random, and no answer depends on the number of threads.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from visloc_companion.errors import Reason
from visloc_companion.geo.camera import project
from visloc_companion.localise.frame import check_pixels
from visloc_companion.localise.structure.adjusted import Adjusted, Evidence, adjusted, no
from visloc_companion.localise.structure.base import LocalCloud, NoCloud, PosedFrame, StereoSettings
from visloc_companion.localise.structure.bundle import Bundle
from visloc_companion.localise.structure.disparity import match
from visloc_companion.localise.structure.pairs import choose
from visloc_companion.localise.structure.rectify import rectify
from visloc_companion.localise.structure.scale import Scale, baseline_sigma, from_heights
from visloc_companion.localise.structure.sharpness import blur_px
from visloc_companion.localise.structure.surface import Points, triangulated, upper_surface
from visloc_companion.localise.working_size import reduced_model, resized
from visloc_companion.types import CameraModel, FloatArray, Image

MOST_APART_SIGMAS = 5.0


def local_cloud(frames: Sequence[PosedFrame], model: CameraModel, settings: StereoSettings | None = None) -> LocalCloud | NoCloud:
    """A cloud of the ground that overlapping frames (two or more, in the order taken) of one camera have in common.

    Raises ValueError, naming frame and field, for poses, sigmas or heights that are none.
    """
    settings = settings or StereoSettings()
    for number, frame in enumerate(frames):
        _check(number, frame)
        why = check_pixels(frame.pixels, model)
        if why:
            return NoCloud(why[0], f"frame {number}: {why[1]}")
    if len(frames) < 2:
        return NoCloud(Reason.BAD_INPUT, f"{len(frames)} frames; stereo needs two")
    stars = choose(frames, model, settings)
    if isinstance(stars, NoCloud):
        return stars
    worked = reduced_model(model, settings.working_px)
    greys = {i: _grey(frames[i].pixels, worked) for star in stars for i in (star.hub, *star.partners)}
    evidence = {"base_to_height": max(stars[0].base_to_height), "overlap": max(stars[0].overlap)}
    found: Adjusted | LocalCloud | NoCloud = adjusted(frames, greys, stars, worked, settings, evidence)
    if isinstance(found, Adjusted):
        found = _dense(frames, greys, found, (worked, model), settings, evidence)
    return found if isinstance(found, LocalCloud) else _blamed_on_blur(found, greys, settings)


def _check(number: int, frame: PosedFrame) -> None:
    T = np.asarray(frame.T_local_cam)
    if T.shape != (4, 4) or not np.isfinite(T).all() or abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() > 1e-6:
        raise ValueError(f"frame {number}: T_local_cam is no rigid (4, 4) transform")
    for name in ("sigma_position_m", "sigma_tilt_rad", "sigma_yaw_rad", "height_m", "sigma_height_m"):
        if not getattr(frame, name) > 0:
            raise ValueError(f"frame {number}: {name} is {getattr(frame, name)}, it must be positive")


def _grey(pixels: Image, model: CameraModel) -> Image:
    """The frame in grey, at the model's size."""
    grey = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY) if pixels.ndim == 3 else pixels
    return resized(np.asarray(grey, dtype=np.uint8), model)


def _blamed_on_blur(refusal: NoCloud, greys: dict[int, Image], settings: StereoSettings) -> NoCloud:
    """A refusal for want of features is one for blur where the frames are smeared."""
    if refusal.reason not in {Reason.LOW_TEXTURE, Reason.TOO_FEW_FEATURES}:
        return refusal
    blur = max(blur_px(grey) for grey in greys.values())
    if not settings.max_blur_px < blur < math.inf:
        return refusal
    return NoCloud(Reason.BLURRED, f"{refusal.detail}; edges are smeared over {blur:.1f} px (1-sigma)", refusal.evidence)


def _dense(
    frames: Sequence[PosedFrame],
    greys: dict[int, Image],
    found: Adjusted,
    models: tuple[CameraModel, CameraModel],
    settings: StereoSettings,
    evidence: Evidence,
) -> LocalCloud | NoCloud:
    """The cloud of refined frames. `models`: of the frames as worked on and as delivered."""
    model, delivered = models
    used, bundle = found.used, found.bundle
    parts: list[Points] = []
    matched = common = 0
    for hub, other in found.pairs:
        T_hub, T_other = (bundle.T_local_cam[used.index(i)] for i in (hub, other))
        pair = rectify(greys[hub], greys[other], T_hub, T_other, bundle.points[bundle.good], model)
        if pair is None:
            continue
        disparity = match(pair, settings)
        parts.append(triangulated(pair, disparity))
        matched, common = matched + int(disparity.good.sum()), common + int(disparity.common.sum())
    completeness = matched / max(common, 1)
    evidence |= {"completeness": completeness, "pairs": float(len(parts))}
    if completeness < settings.min_completeness:
        return no(Reason.LOW_TEXTURE, f"{completeness:.0%} of the common ground can be matched", evidence)
    height = float(np.median([frames[i].height_m for i in used]))
    cell = settings.cell_m or 2 * height / float(np.sqrt(model.fx_px * model.fy_px))
    surface = upper_surface(parts, cell)
    if len(surface.m) < settings.min_points:
        return no(Reason.TOO_FEW_FEATURES, f"{len(surface.m)} points", evidence)
    evidence["sigma_m"] = sigma = float(np.median(surface.sigma_m))
    if sigma > settings.max_sigma_share * height:
        return no(Reason.LOW_TEXTURE, f"heights are good to {sigma:.2f} m only", evidence)
    scale = from_heights([frames[i] for i in used], bundle.T_local_cam, surface.m, baseline_sigma(bundle))
    evidence |= {"scale": scale.factor, "scale_apart_sigmas": scale.apart_sigmas}
    if scale.apart_sigmas > MOST_APART_SIGMAS:
        return no(Reason.INCONSISTENT_WITH_PRIOR, f"baseline and height differ by {scale.apart_sigmas:.1f} sigma", evidence)
    return _cloud(used, bundle, surface, scale, delivered, evidence)


def _cloud(
    used: tuple[int, ...], bundle: Bundle, surface: Points, scale: Scale, model: CameraModel, evidence: Evidence
) -> LocalCloud:
    middle = bundle.T_local_cam[:, :3, 3].mean(0)
    points = middle + (surface.m - middle) * scale.factor
    T = bundle.T_local_cam.copy()
    T[:, :3, 3] = middle + (T[:, :3, 3] - middle) * scale.factor
    latest = int(np.argmax(used))
    tilt, yaw = np.sqrt(np.diag(bundle.covariance)[[3, 4]].max()), np.sqrt(bundle.covariance[5, 5])
    return LocalCloud(
        points_m=points,
        sigma_m=surface.sigma_m * scale.factor,
        pix=_pixels(points, T[latest], model),
        frames=used,
        T_local_cam=T,
        reference=used[latest],
        sigma_scale=scale.sigma,
        sigma_tilt_rad=float(tilt),
        sigma_yaw_rad=float(yaw),
        evidence=tuple(evidence.items()),
        scale_per_height=scale.per_height,
    )


def _pixels(points: FloatArray, T_local_cam: FloatArray, model: CameraModel) -> FloatArray:
    """(N, 2) where a frame shows points; NaN outside it."""
    pix = project(model, (points - T_local_cam[:3, 3]) @ T_local_cam[:3, :3])
    size = np.array([model.width_px - 1, model.height_px - 1])
    with np.errstate(invalid="ignore"):
        outside = ((pix < 0) | (pix > size)).any(1)
    pix[outside] = np.nan
    return pix
