"""What a calibration has to meet, and what to do where it does not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from visloc_companion.prepare.lens.calibrate import Calibration
from visloc_companion.prepare.lens.flat import Warp
from visloc_companion.prepare.lens.unseen import Unseen

FOCAL_SHARE = 0.005
"""1-sigma of the focal length, its error for a sheet that is not flat, and its 1-sigma between views: half a percent of every
height, as in the error budget (docs/error-budget.md). The principal point may differ by as much of the focal length."""
RMS_SHARE, RMS_PX = 0.0005, 0.5
"""Error of the views held out: a share of the picture's width, and what is allowed of small pictures."""


@dataclass(frozen=True, slots=True)
class Shortcoming:
    """What is not met, with the figures, and what mends it."""

    what: str
    remedy: str


def rms_limit_px(width_px: int) -> float:
    """Most of the error of held-out views in pictures of this width."""
    return max(RMS_PX, RMS_SHARE * width_px)


def sheet_words(sheet: Warp) -> str:
    """How the sheet was not as it was told to be."""
    way = "longer" if sheet.stretched > 0 else "shorter"
    told = [(f"bent by {1e3 * sheet.bent_m:.1f} mm", 1e4 * sheet.bent_m >= 1)]
    told.append((f"{100 * abs(sheet.stretched):.1f} % {way} across than down", 1e3 * abs(sheet.stretched) >= 1))
    return " and ".join(words for words, counts in told if counts) or "not quite flat"


def scatter_words(of: Calibration) -> str:
    """By how much views differ."""
    focal, centre = (f"{100 * share:.1f} %" for share in _scatter_shares(of))
    return f"1-sigma {focal} between their focal lengths, {of.scatter.centre_px:.1f} px ({centre}) between their principal points"


def _scatter_shares(of: Calibration) -> tuple[float, float]:
    """Of the focal length: the scatter of that itself, and of the principal point."""
    return of.scatter.focal_share, of.scatter.centre_px / of.lens.model.fx_px


def ray_limit_px(of: Calibration) -> float:
    """Most of the 1-sigma of rays where no corner was seen: what the principal point may differ by."""
    return FOCAL_SHARE * of.lens.model.fx_px


def unseen_words(of: Unseen) -> str:
    """How sure rays are there."""
    return f"{of.part}, rays are 1-sigma {of.sigma_px:.2g} px off" if np.isfinite(of.sigma_px) else f"{of.part}, it folds back"


def shortcomings(of: Calibration) -> list[Shortcoming]:
    """What the calibration does not meet; empty where it is good."""
    found = []
    if of.sheet.sure and of.sheet.focal_share > FOCAL_SHARE:
        found.append(
            Shortcoming(
                f"the sheet is {sheet_words(of.sheet)}: the focal length is {100 * of.sheet.focal_share:.1f} % off for it, "
                f"at most {100 * FOCAL_SHARE:g} % may be",
                "lay it on something flat (glass, a door) and measure both rulers; print it again where they differ",
            )
        )
    elif max(_scatter_shares(of)) > FOCAL_SHARE:
        found.append(
            Shortcoming(
                f"the views contradict each other: {scatter_words(of)}, at most {100 * FOCAL_SHARE:g} % may be",
                "one camera, focus and zoom locked, stabilisation off, no picture cropped or turned round, camera and board "
                "still (a rolling shutter bends what moves), the sheet flat",
            )
        )
    elif not of.focal_share <= FOCAL_SHARE:
        sigma = f"1-sigma {100 * of.focal_share:.1f} %" if of.focal_share < 1 else "1-sigma of 100 % and more"
        found.append(
            Shortcoming(
                f"the focal length is not determined: {sigma}, at most {100 * FOCAL_SHARE:g} % may be",
                "more views, in which the board is tilted by 30 to 45° to the left, to the right, forwards and backwards",
            )
        )
    limit_px = rms_limit_px(of.lens.model.width_px)
    if of.candidate.rms_px > limit_px:
        found.append(
            Shortcoming(
                f"views held out are {of.candidate.rms_px:.2f} px off, at most {limit_px:.2f} may be",
                "hold camera and board still (a rolling shutter bends what moves), in more light, the sheet flat",
            )
        )
    if of.folds:
        found.append(
            Shortcoming(
                "the lens folds back before corners that were seen, and has no rays for what lies further out",
                "more views, with the board towards the picture's border, or --model fisheye",
            )
        )
    if (guessed := of.least_sure) is not None and guessed.sigma_px > ray_limit_px(of):
        found.append(
            Shortcoming(
                f"the lens is guessed where no corner of the board was seen: {unseen_words(guessed)}, "
                f"at most {ray_limit_px(of):.1f} px may be",
                f"more views with the board over the border of the picture, {guessed.part}",
            )
        )
    if corners := of.coverage.empty_corners:
        found.append(
            Shortcoming(
                f"no corner of the board is seen in the picture's {' and '.join(corners)} corner{'s' * (len(corners) > 1)}",
                f"more views with the board towards the {', '.join(corners)}",
            )
        )
    return found
