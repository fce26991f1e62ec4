"""What is scored on: case sets by name, none of them trained or fitted on.

NAIP frames are centred in rows >= 400, the landscape's seeds are 100 and more. Sets of `NEGATIVE` have no right answer. Those of
`PHOTOS` are real photographs (each with 15 priors; that of the take-off has no right answer), judged in metres for pixels; as
their truth is good to 1.5 to 3.3 m only, they count for no pooled figure.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from benchmarks.image_cases.answers import RENDERED
from benchmarks.image_cases.cases import SHARED, TEST_ROWS, CaseSet, make
from benchmarks.image_cases.frames import Recipe, two_dates, write_cases
from benchmarks.image_cases.landscape_cases import FIRST_SCORING_SEED, Worlds, write_landscape
from benchmarks.image_cases.negatives import clouds, outside, water, write_pack
from benchmarks.image_cases.photos import TILT_KNOWN, TILT_UNKNOWN, drone_urban, takeoff

N = 500
SCORED_ROWS = (400, 721)
OTHER_PLACE = "bitemporal/bragg_2009_2012"
PLACE = Recipe(offset_px=40, heading_deg=10, height=0.08)
LANDSCAPE = Worlds(tuple(range(FIRST_SCORING_SEED, FIRST_SCORING_SEED + 25)), per_seed=N // 25)
Maker = Callable[[Path], Path]


def _tool(name: str, kind: str, seed: int, n: int = N, foot: float = 173, dates: str = "naip", elsewhere: str = "") -> Maker:
    rows = TEST_ROWS if dates == "naip" else ":"
    return lambda root: make(CaseSet(name, kind, n, rows, seed, dates, foot, elsewhere), root)


def _pairs() -> list[Path]:
    return sorted(path for path in (SHARED / "data" / "bitemporal").glob("bragg_*") if path.is_dir())


POSITIVE: dict[str, Maker] = {
    "t2": _tool("t2", "t2", 1),
    "low96": _tool("low96", "low", 3, foot=96),
    "low64": _tool("low64", "low", 3, foot=64),
    "low48": _tool("low48", "low", 3, foot=48),
    "same": _tool("same", "same", 4),
    "wide": _tool("wide", "wide", 2),
    "oblique": _tool("oblique", "oblique", 5),
    "bitemporal": lambda root: write_cases(root / "bitemporal", N, 21, two_dates(_pairs(), 128, PLACE), PLACE),
    "landscape": lambda root: write_landscape(root / "landscape", LANDSCAPE),
}
NEGATIVE: dict[str, Maker] = {
    "elsewhere": _tool("elsewhere", "elsewhere", 6, 250, elsewhere=OTHER_PLACE),
    "elsewhere64": _tool("elsewhere64", "elsewhere", 8, 150, foot=64, elsewhere=OTHER_PLACE),
    "naip_elsewhere": _tool("naip_elsewhere", "elsewhere", 9, 150, foot=128, dates=OTHER_PLACE, elsewhere="naip"),
    "outside": lambda root: write_cases(
        root / "outside", 150, 22, outside(write_pack(root / "pack", (0, 300)), SCORED_ROWS, 173), Recipe()
    ),
    "outside64": lambda root: write_cases(
        root / "outside64", 150, 23, outside(write_pack(root / "pack", (0, 300)), SCORED_ROWS, 64), Recipe()
    ),
    "water": lambda root: write_cases(root / "water", 150, 24, water(40, SCORED_ROWS), Recipe()),
    "clouds": lambda root: write_cases(root / "clouds", 100, 25, clouds(SCORED_ROWS, 128), Recipe()),
    "blind": _tool("blind", "blind", 7, 200),
}
PHOTOS: dict[str, Maker] = {
    "photos_tilt_known": lambda root: drone_urban(root / "photos_tilt_known", TILT_KNOWN, draws=15),
    "photos_tilt_unknown": lambda root: drone_urban(root / "photos_tilt_unknown", TILT_UNKNOWN, draws=15),
    "photos_takeoff": lambda root: takeoff(root / "photos_takeoff"),
}
SETS = POSITIVE | NEGATIVE | PHOTOS
FAMILIES = {
    "naip": ("t2", "low96", "low64", "low48", "wide", "oblique"),
    "bitemporal": ("bitemporal",),
    "landscape": ("landscape",),
}
"""The places: what a model that has not seen one of them is scored on."""
MAP_SIGMAS = {"landscape": RENDERED}
"""Where it is not `UNSTATED`."""
