"""Fixes over woods and elsewhere under another sun than the map's, with the map as it is and as under the sun of the frame.

    python -m benchmarks.sunlight [--worlds 40 41 ...] [--frames 40] [--tilt 0.05] [--largest 25]

Worlds, dates and views are those of `benchmarks.leaning`. The map's sun stands at 138 degrees, 52 high, that of the frames at 212
and 32 (leafless March) or 200 and 45 (summer, eight years later). Every frame is localised with the map as it is, under the sun
that frame and map show themselves, and under one that is told within 6 degrees (1-sigma), as earlier frames would have told it.
The attitude is known nearly exactly, so that it does not hide what the light does.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple
from unittest.mock import patch

import numpy as np

from benchmarks.leaning import DATES, Row, cells, judged, opened, shots
from benchmarks.pages.scenario_page import table
from visloc_companion.localise import dense
from visloc_companion.types import Fix, Sun

NAMES = ("March", "March, thin crowns", "summer")
AS_IS, SEEN, TOLD = "as it is", "under the sun that is seen", "under a sun that is told"
TOLD_DEG = 6.0
COLUMNS = (
    *(
        "frames",
        "of",
        "map",
        "fixes",
        "lit",
        "m rms",
        "median",
        "95 %",
        "height m rms",
        "over sigma",
        "height",
        "in 95 % ellipse",
    ),
    "mean north, east m",
)


class Answer(NamedTuple):
    """Of one frame: date, whether it looks at a wood, how the map was taken, whether under another sun, and the fix, if any."""

    date: int
    wooded: bool
    way: str
    lit: bool
    row: Row | None


def of_world(seed: int, n: int, sigma_tilt_rad: float, largest_deg: float) -> Iterator[Answer]:
    """All answers over the procedural world of a seed, of `n` frames of each date."""
    reference, localiser = opened(seed)
    for date, view, pixels, request, rng in shots(seed, n, sigma_tilt_rad, largest_deg):
        true = DATES[date].sun_azimuth_deg, DATES[date].sun_elevation_deg
        azimuth_deg, elevation_deg = rng.normal(true, TOLD_DEG).tolist()
        told = replace(request, prior=replace(request.prior, sun=Sun(azimuth_deg, elevation_deg)))
        for way, asked in ((AS_IS, request), (SEEN, request), (TOLD, told)):
            seen = dense.under_the_frames_sun if way != AS_IS else lambda task, pose: None
            with patch.object(dense, "under_the_frames_sun", seen):
                answer = localiser.localise(asked, pixels, reference)
            row = judged(answer, view) if isinstance(answer, Fix) else None
            yield Answer(date, bool(view[3]), way, dict(answer.evidence).get("lit") == 1.0, row)


def line(date: int, wooded: bool, way: str, answers: Sequence[Answer]) -> list[str]:
    """One line of the table."""
    rows = np.array([answer.row for answer in answers if answer.row is not None])
    count, *figures = cells(rows)
    lit = sum(answer.lit for answer in answers if answer.row is not None)
    north, east = rows[:, :2].mean(axis=0).tolist()
    place = "a wood" if wooded else "elsewhere"
    return [NAMES[date], place, way, f"{count} of {len(answers)}", str(lit), *figures, f"{north:+.2f}, {east:+.2f}"]


def main(argv: Sequence[str] | None = None) -> None:
    """Localise and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, nargs="+", default=[40, 41, 42, 43])
    parser.add_argument("--frames", type=int, default=40, help="of each of the three dates over each world")
    parser.add_argument("--tilt", type=float, default=0.05, help="1-sigma of the prior's tilt, degrees")
    parser.add_argument("--largest", type=float, default=25.0, help="lean, degrees")
    chosen = parser.parse_args(argv)
    sigma_rad = math.radians(chosen.tilt)
    answers = [a for seed in chosen.worlds for a in of_world(seed, chosen.frames, sigma_rad, chosen.largest)]
    lines = []
    for date in range(len(DATES)):
        for wooded in (True, False):
            for way in (AS_IS, SEEN, TOLD):
                these = [a for a in answers if (a.date, a.wooded, a.way) == (date, wooded, way)]
                if any(a.row is not None for a in these):
                    lines.append(line(date, wooded, way, these))
    print(table(COLUMNS, lines))


if __name__ == "__main__":
    main()
