"""Frames of several sizes under one calibration: those of another size than the calibration's are placed off, and sure of it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from visloc_companion.evaluate.cases import BadCase, Camera, Case
from visloc_companion.evaluate.images.image_metrics import CaseResult

Size = tuple[int, int]
"""Width and height, px."""


def mixed_sizes(cases: Sequence[Case | BadCase], results: Sequence[CaseResult]) -> list[str]:
    """A sentence for each calibration that does not state its size and has frames of several, with what mends it."""
    found = defaultdict[Camera, dict[Size, list[str]]](dict)
    for case, result in zip(cases, results, strict=True):
        if isinstance(case, Case) and case.camera.size_px is None and result.frame_px is not None:
            found[case.camera].setdefault(result.frame_px, []).append(case.case_id)
    return [_told(camera, sizes) for camera, sizes in found.items() if len(sizes) > 1]


def _told(camera: Camera, sizes: dict[Size, list[str]]) -> str:
    which = f"fx_px {camera.fx_px:g}, fy_px {camera.fy_px:g}, cx_px {camera.cx_px:g}, cy_px {camera.cy_px:g}"
    often = sorted(sizes.items(), key=lambda item: -len(item[1]))
    listed = ", ".join(f"{width} x {height} px ({len(ids)}, as {ids[0]})" for (width, height), ids in often)
    return (
        f"cases.csv: one calibration ({which}) has frames of several sizes: {listed}; it is of one of them, and fixes of the "
        "others lie off; remedy: state its width_px and height_px in columns of cases.csv"
    )
