"""Frames of a flight beside the map, in its report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from visloc_companion.evaluate.reports.report_parts import captioned


@dataclass(frozen=True, slots=True)
class PicturePair:
    """JPEG bytes of the camera's frame and of the map under it, both with north at the top, at a time of the flight."""

    t_s: float
    camera: bytes
    map: bytes


def picture_section(pairs: Sequence[PicturePair]) -> str:
    """The section of a report (HTML); empty without pictures."""
    if not pairs:
        return ""
    shown = "".join(
        f'<div class="pair">{captioned(pair.camera, f"what the camera saw at {pair.t_s:.0f} s")}'
        f"{captioned(pair.map, f'the map there at {pair.t_s:.0f} s')}</div>"
        for pair in pairs
    )
    return f'<h2>Camera and map</h2><div class="pairs">{shown}</div>'
