"""What the two dates of the procedural landscape look like: crops, trees, ground, sun and the photograph's radiometry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Date = Literal["map", "flight"]
Rgb = tuple[float, float, float]


@dataclass(frozen=True)
class Cover:
    """How a ground cover is painted: colour and how it varies, rows and wheel tracks (metres; shares of brightness)."""

    color: Rgb
    row_m: float = 0.0
    row_strength: float = 0.0
    tramline_m: float = 0.0
    tramline_strength: float = 0.0
    mottle: float = 0.06
    soil: float = 0.05
    grain: float = 0.04
    height_m: float = 0.0


@dataclass(frozen=True)
class Season:
    """One date. `years` have passed since the map; angles in degrees, azimuth clockwise from north."""

    years: float
    leaf_on: bool
    sun_azimuth_deg: float
    sun_elevation_deg: float
    ambient: Rgb
    direct: Rgb
    contrast: float
    saturation: float
    haze: float
    crops: tuple[Cover, ...]
    meadows: tuple[Cover, ...]
    forest_floor: Cover
    garden: Cover
    clearing: Cover
    asphalt: Rgb
    track: Rgb
    verge: Rgb
    water: Rgb
    shore: Rgb
    deciduous: tuple[Rgb, ...]
    conifer: tuple[Rgb, ...]
    bare_alpha: float


MAP = Season(
    years=0.0,
    leaf_on=True,
    sun_azimuth_deg=138.0,
    sun_elevation_deg=52.0,
    ambient=(0.36, 0.39, 0.45),
    direct=(0.86, 0.82, 0.74),
    contrast=1.0,
    saturation=1.0,
    haze=0.0,
    crops=(
        Cover((196, 174, 112), 1.5, 0.03, 21.0, 0.22, 0.07, 0.07),
        Cover((176, 158, 96), 1.5, 0.03, 24.0, 0.25, 0.08, 0.06),
        Cover((206, 192, 138), 1.5, 0.02, 18.0, 0.18, 0.06, 0.06),
        Cover((84, 116, 58), 1.5, 0.10, 0.0, 0.0, 0.06, 0.03, height_m=1.6),
        Cover((66, 104, 54), 1.5, 0.12, 0.0, 0.0, 0.05, 0.03, height_m=2.0),
        Cover((86, 132, 62), 2.0, 0.10, 27.0, 0.15, 0.08, 0.05),
        Cover((150, 152, 84), 1.5, 0.02, 24.0, 0.2, 0.08, 0.05, height_m=1.0),
        Cover((110, 126, 74), 3.0, 0.16, 0.0, 0.0, 0.06, 0.06),
    ),
    meadows=(
        Cover((112, 136, 70), 0.0, 0.0, 0.0, 0.0, 0.10, 0.05),
        Cover((128, 146, 78), 0.0, 0.0, 0.0, 0.0, 0.10, 0.05),
        Cover((152, 158, 98), 6.0, 0.07, 0.0, 0.0, 0.07, 0.04),
        Cover((98, 128, 62), 0.0, 0.0, 0.0, 0.0, 0.14, 0.05),
    ),
    forest_floor=Cover((72, 80, 46), mottle=0.2, grain=0.08),
    garden=Cover((112, 132, 74), mottle=0.22, grain=0.09),
    clearing=Cover((120, 126, 76), mottle=0.25, grain=0.10),
    asphalt=(150, 149, 148),
    track=(196, 182, 150),
    verge=(122, 138, 76),
    water=(52, 74, 66),
    shore=(150, 142, 104),
    deciduous=((80, 112, 52), (92, 124, 58), (70, 102, 50), (104, 130, 66), (84, 106, 46), (64, 96, 52)),
    conifer=((44, 68, 46), (38, 60, 42), (50, 74, 48)),
    bare_alpha=1.0,
)

FLIGHT = Season(
    years=5.0,
    leaf_on=False,
    sun_azimuth_deg=222.0,
    sun_elevation_deg=21.0,
    ambient=(0.50, 0.56, 0.66),
    direct=(0.92, 0.80, 0.62),
    contrast=0.86,
    saturation=0.82,
    haze=0.05,
    crops=(
        Cover((104, 82, 64), 2.2, 0.14, 0.0, 0.0, 0.10, 0.16),
        Cover((120, 96, 74), 1.6, 0.08, 0.0, 0.0, 0.10, 0.16),
        Cover((92, 74, 60), 2.6, 0.16, 0.0, 0.0, 0.10, 0.14),
        Cover((140, 118, 92), 3.0, 0.07, 0.0, 0.0, 0.08, 0.14),
        Cover((104, 116, 70), 1.5, 0.05, 27.0, 0.22, 0.08, 0.12),
        Cover((88, 114, 62), 1.5, 0.04, 21.0, 0.25, 0.08, 0.10),
        Cover((170, 154, 116), 1.8, 0.12, 9.0, 0.12, 0.08, 0.06),
        Cover((126, 126, 66), 1.5, 0.03, 0.0, 0.0, 0.16, 0.06),
    ),
    meadows=(
        Cover((112, 116, 74), 0.0, 0.0, 0.0, 0.0, 0.12, 0.08),
        Cover((126, 122, 80), 0.0, 0.0, 0.0, 0.0, 0.12, 0.08),
        Cover((100, 110, 64), 4.5, 0.08, 0.0, 0.0, 0.08, 0.06),
        Cover((136, 128, 90), 0.0, 0.0, 0.0, 0.0, 0.14, 0.08),
    ),
    forest_floor=Cover((132, 104, 76), mottle=0.16, grain=0.12),
    garden=Cover((112, 112, 78), mottle=0.2, grain=0.09),
    clearing=Cover((142, 122, 94), 4.0, 0.22, mottle=0.25, grain=0.16),
    asphalt=(116, 116, 120),
    track=(140, 122, 98),
    verge=(118, 116, 76),
    water=(84, 96, 104),
    shore=(122, 108, 86),
    deciduous=((128, 112, 96), (118, 104, 92), (134, 120, 104), (124, 102, 84), (146, 108, 72), (112, 100, 90)),
    conifer=((50, 68, 52), (44, 62, 50), (56, 74, 54)),
    bare_alpha=0.62,
)


def season_of(date: Date) -> Season:
    """The season of a date."""
    return MAP if date == "map" else FLIGHT
