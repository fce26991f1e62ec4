"""What claims are fitted on: case sets by family. NAIP rows above 400, the bi-temporal pairs, landscape seeds below 100; and what
they are judged on besides: ground that is laid out alike in several places, and lines that have moved, of seeds below 100."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from benchmarks.image_cases.cases import SHARED, TRAINING_ROWS, CaseSet, make
from benchmarks.image_cases.frames import Recipe, two_dates, write_cases
from benchmarks.image_cases.landscape_cases import Worlds, write_landscape
from benchmarks.image_cases.moved_cases import Moved, write_moved
from benchmarks.image_cases.negatives import clouds, outside, water, write_pack
from benchmarks.image_cases.tilt_cases import untold
from benchmarks.image_cases.wooded_cases import write_wooded
from benchmarks.worlds.look_alike_worlds import GSD_M, scene_of

Maker = Callable[[Path], Path]
ROWS = (0, 400)
OTHER_PLACE = "bitemporal/bragg_2006_2009"
LARGEST_TILT_DEG = 12.0
"""Of the cases whose prior says nadir and 6 degrees."""
ALIKE_OFFSET_PX = 120.0
"""As wide as a square that is laid out again: the prior does not tell neighbours apart."""
FITTED_PAIRS = ("2006_2009", "2006_2014", "2009_2012", "2010_2014", "2012_2014")


def _tool(name: str, kind: str, n: int, seed: int, foot: float = 173, elsewhere: str = "") -> Maker:
    return lambda root: make(CaseSet(name, kind, n, TRAINING_ROWS, seed, "naip", foot, elsewhere), root)


def _pairs() -> list[Path]:
    return [SHARED / "data" / "bitemporal" / f"bragg_{pair}" for pair in FITTED_PAIRS]


def _pairs_at(name: str, foot: float, n: int, seed: int) -> Maker:
    return lambda root: write_cases(root / name, n, seed, two_dates(_pairs(), foot, Recipe()), Recipe())


def _outside(name: str, foot: float, seed: int, pack: Callable[[Path], Path], rows: tuple[int, int], n: int = 100) -> Maker:
    return lambda root: write_cases(root / name, n, seed, outside(pack(root), rows, foot), Recipe())


def _untold(name: str, source: Maker, n: int, largest_deg: float = LARGEST_TILT_DEG, *, without_surface: bool = False) -> Maker:
    return lambda root: untold(source(root), root / name, largest_deg=largest_deg, n=n, without_surface=without_surface)


def _tilted_land(root: Path) -> Path:
    worlds = Worlds(tuple(range(10, 26)), 6, foot_px=160, tilt_deg=LARGEST_TILT_DEG)
    return write_landscape(root / "tilted_land", worlds)


def _alike(foot: int, seeds: range) -> Maker:
    worlds = Worlds(tuple(seeds), 15, (GSD_M,), foot, ALIKE_OFFSET_PX, scene_of=scene_of, least_m=0.0)
    return lambda root: write_landscape(root / f"alike{foot}", worlds)


def _north(root: Path) -> Path:
    return write_pack(root / "north", (0, 210))


def _bragg(_: Path) -> Path:
    return SHARED / "data" / "bitemporal" / "bragg_2009_2012"


NAIP: dict[str, Maker] = {
    "t2": _tool("t2", "t2", 200, 101),
    "wide": _tool("wide", "wide", 150, 102),
    **{f"low{foot}": _tool(f"low{foot}", "low", 150, 103 + foot, foot) for foot in (128, 96, 64, 48)},
    "oblique": _tool("oblique", "oblique", 150, 104),
    "tilt_naip": _untold("tilt_naip", _tool("tilted_naip", "oblique", 500, 151), 120),
    "tilt_elsewhere": _untold("tilt_elsewhere", _tool("elsewhere_tilted", "elsewhere", 100, 152, elsewhere=OTHER_PLACE), 100),
    "elsewhere": _tool("elsewhere", "elsewhere", 200, 105, elsewhere=OTHER_PLACE),
    "elsewhere64": _tool("elsewhere64", "elsewhere", 150, 106, 64, elsewhere="bitemporal/bragg_2010_2014"),
    "blind": _tool("blind", "blind", 100, 107),
    "water": lambda root: write_cases(root / "water", 100, 121, water(48, ROWS), Recipe()),
    "clouds": lambda root: write_cases(root / "clouds", 60, 122, clouds(ROWS, 96), Recipe()),
    "outside": _outside("outside", 128, 123, _north, (210, 400)),
    "outside64": _outside("outside64", 64, 124, _north, (210, 400)),
}
BITEMPORAL: dict[str, Maker] = {
    "pairs128": _pairs_at("pairs128", 128, 150, 131),
    "pairs64": _pairs_at("pairs64", 64, 150, 132),
    "naip_on_pairs": _outside("naip_on_pairs", 96, 133, _bragg, ROWS),
}
LANDSCAPE: dict[str, Maker] = {
    "land128": lambda root: write_landscape(root / "land128", Worlds(tuple(range(60, 72)), 12)),
    "tilt_land": _untold("tilt_land", _tilted_land, 96),
    "tilt_plane": _untold("tilt_plane", _tilted_land, 96, without_surface=True),
    "land64": lambda root: write_landscape(root / "land64", Worlds(tuple(range(72, 84)), 12, foot_px=64, gsds_m=(1.0, 1.5))),
}
WOODS: dict[str, Maker] = {"wooded": lambda root: write_wooded(root / "wooded", tuple(range(40, 48)), 20)}
"""Cameras that lean, half of them over woods that are bare, felled or grown since the map was made."""
ALIKE: dict[str, Maker] = {
    "alike48": _alike(48, range(84, 89)),
    "alike64": _alike(64, range(89, 94)),
    "alike96": _alike(96, range(94, 99)),
    "alike128": _alike(128, range(55, 60)),
}
"""Each over one world of every kind of `look_alike_worlds`."""
MOVED: dict[str, Maker] = {
    "shores": lambda root: write_moved(
        root / "shores", Moved(tuple(range(28, 40)), ("shore",), (0.0, 3.0, 5.0, 10.0, 20.0), (0.5, 1.0, 2.0))
    ),
    "lines": lambda root: write_moved(
        root / "lines", Moved(tuple(range(2, 10)), ("ebb", "field", "flood", "shade"), (5.0, 10.0), (0.5, 1.0, 2.0))
    ),
}
"""Footprints of 210 to 270, 105 to 135 and 52 to 68 map pixels."""
SETS = NAIP | BITEMPORAL | LANDSCAPE | WOODS | ALIKE | MOVED
FAMILIES = {
    "naip": tuple(NAIP),
    "bitemporal": tuple(BITEMPORAL),
    "landscape": tuple(LANDSCAPE),
    "woods": tuple(WOODS),
    "alike": tuple(ALIKE),
    "moved": tuple(MOVED),
}
MADE = FAMILIES["landscape"] + FAMILIES["woods"] + FAMILIES["alike"] + FAMILIES["moved"]
"""Sets whose dates are registered exactly."""
