"""A calibration in words and as plain values."""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import date
from typing import Any

from visloc_companion.geo.pinhole_view import field_of_view_deg, inner_reach
from visloc_companion.prepare.lens.calibrate import Calibration
from visloc_companion.prepare.lens.choose import Candidate
from visloc_companion.prepare.lens.limits import Shortcoming, rms_limit_px, scatter_words, sheet_words, shortcomings, unseen_words
from visloc_companion.prepare.lens.section import section


def document(of: Calibration) -> dict[str, Any]:
    """Everything, finite or null."""
    cov = of.coverage
    return {
        "schema": 1,
        "camera": section(of.lens.model),
        "sigma": {key: _finite(value) for key, value in of.sigmas.items()} | {"focal_share": _finite(of.focal_share)},
        "covariance": [[_finite(value) for value in row] for row in of.covariance.tolist()],
        "held_out_rms_px": _finite(of.candidate.rms_px),
        "held_out_limit_px": rms_limit_px(of.lens.model.width_px),
        "field_of_view_deg": list(field_of_view_deg(of.lens.model)),
        "folds_at_share_of_nearest_border": _finite(inner_reach(of.lens.model)),
        "models": [_model(each) for each in of.judged],
        "board": of.board.name,
        "views": [
            {"name": view.name, "corners": len(view.ids), "rms_px": error, "held_out_rms_px": math.sqrt(out), "tilt_deg": tilt}
            for view, error, out, tilt in zip(
                of.views, of.errors_px.tolist(), of.candidate.held_out_px2.tolist(), of.tilts_deg, strict=True
            )
        ],
        "left_out": left_out_words(of),
        "corners_astray": of.strays,
        "sheet": {
            "bent_m": of.sheet.bent_m,
            "stretched_share": of.sheet.stretched,
            "focal_share": of.sheet.focal_share,
            "sure": of.sheet.sure,
        },
        "off_centre": {"cx_px": of.off_centre.step[2].item(), "cy_px": of.off_centre.step[3].item(), "sure": of.off_centre.sure},
        "between_views": {"focal_share": of.scatter.focal_share, "centre_px": of.scatter.centre_px},
        "coverage": {"cells": cov.counts.tolist(), "share": cov.share, "empty_corners": cov.empty_corners},
        "ray_sigma_px": [[_finite(value) for value in row] for row in of.ray_sigmas_px.tolist()],
        "good": not shortcomings(of),
        "shortcomings": [{"what": each.what, "remedy": each.remedy} for each in shortcomings(of)],
    }


def left_out_words(of: Calibration) -> dict[str, str]:
    """Why each of the pictures that were not used was not."""
    why = "contradicts the others, {:.2f} px off: it was moving, the sheet was bent, or the lens was another"
    return of.looked.left_out | {name: why.format(error_px) for name, error_px in of.outlying.items()}


def lines(of: Calibration) -> Iterator[str]:
    """The result in words."""
    model = of.lens.model
    for name, why in left_out_words(of).items():
        yield f"not used: {name} {why}"
    if of.strays:
        yield f"not used: {of.strays} single corners that were found beside themselves"
    yield f"{len(of.views)} views of {model.width_px} x {model.height_px} px, {sum(len(v.ids) for v in of.views)} corners"
    for each in of.judged:
        mark = "chosen" if each is of.candidate else each.why_not or "not chosen"
        yield f"{each.kind:13} {each.rms_px:.3f} px on views held out ({mark})" if each.lens else f"{each.kind:13} {mark}"
    for name, value, sigma in of.numbers:
        yield f"{name} {value:.2f} ± {sigma:.2f} px"
    yield f"1-sigma of the focal length {share_words(of.focal_share)}: so much of every height above ground"
    if of.off_centre.sure:
        cx, cy = of.off_centre.step[2:4]
        yield f"the lens is out of centre, for which fisheye has nothing: cx may be off by {abs(cx):.2f}, cy by {abs(cy):.2f} px"
    if of.sheet.sure:
        yield f"the sheet is {sheet_words(of.sheet)}, and the focal length {100 * of.sheet.focal_share:.2f} % off for it"
    else:
        yield "the sheet is flat and alike across and down, as far as the views tell"
    if max(of.scatter.focal_share, of.scatter.centre_px) > 0:
        yield f"views differ by more than their corners err: {scatter_words(of)}"
    across, down = field_of_view_deg(model)
    yield f"field of view {across:.1f} x {down:.1f}°"
    cov = of.coverage
    where = f"; few or none: {', '.join(cov.emptiest)}" if cov.emptiest else ""
    yield f"corners were seen in {100 * cov.share:.0f} % of the picture's parts{where}"
    if (guessed := of.least_sure) is not None:
        yield f"where none were seen the lens is guessed: {unseen_words(guessed)}"


def comment(of: Calibration, when: date) -> str:
    """The line over the section: when, from how much, and how good."""
    short = "; ".join(each.what for each in shortcomings(of))
    return (
        f"# visloc calibrate, {when.isoformat()}: {len(of.views)} views of {of.board.name}, "
        f"{of.candidate.rms_px:.2f} px on views held out, focal length ± {share_words(of.focal_share)}"
        + (f". NOT GOOD: {short}" if short else "")
    )


def short_line(of: Shortcoming) -> str:
    """One thing that is not met, with its remedy."""
    return f"NOT GOOD: {of.what}; remedy: {of.remedy}"


def share_words(share: float) -> str:
    """A sigma as a share, in per cent."""
    return f"{100 * share:.2g} %" if share < 1 else "100 % or more"


def _model(of: Candidate) -> dict[str, Any]:
    lens = None if of.lens is None else section(of.lens.model)
    return {"model": of.kind, "held_out_rms_px": _finite(of.rms_px), "camera": lens, "why_not": of.why_not}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
