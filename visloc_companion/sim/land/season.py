"""What the two dates of the procedural landscape look like: crops, trees, ground, sun and the photograph's radiometry."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

Date = Literal["map", "flight", "snow"]
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
    grain: float = 0.015
    height_m: float = 0.0


@dataclass(frozen=True)
class SnowCover:
    """Snow that hides what it lies on: shares of open ground, roofs, and crowns with and without needles that are white.

    On crowns it lies in clumps: `clump` is the 1-sigma of the share over `clump_m`. Wind has drifted what lies on the ground:
    1-sigma height `drift_m`, widest forms `drift_cell_m` across, down to a sixteenth of that (ripples of the crust).
    """

    ground: float
    roofs: float
    conifer: float
    bare: float
    clump: float = 0.35
    clump_m: float = 1.5
    drift_m: float = 0.08
    drift_cell_m: float = 9.0
    color: Rgb = (232, 236, 242)
    grain: float = 0.006


@dataclass(frozen=True)
class Season:
    """One date. `years` have passed since the map; angles in degrees, azimuth clockwise from north.

    `bare_alpha` is the opacity of a crown without leaves, `bare_height` the share of its height at which a surface model sees it.
    `soil_inverted` is the share of fields where moist soil shows pale (a thriving crop) and not dark (bare ground).
    """

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
    bare_height: float
    soil_inverted: float
    snow: SnowCover | None = None


MAP = Season(
    years=0.0,
    leaf_on=True,
    sun_azimuth_deg=138.0,
    sun_elevation_deg=52.0,
    ambient=(0.37, 0.40, 0.45),
    direct=(0.74, 0.71, 0.64),
    contrast=1.0,
    saturation=1.0,
    haze=0.0,
    crops=(
        Cover((186, 164, 104), 1.5, 0.012, 21.0, 0.16, 0.015, 0.13),
        Cover((168, 150, 92), 1.5, 0.012, 24.0, 0.18, 0.015, 0.13),
        Cover((194, 180, 128), 1.5, 0.012, 18.0, 0.14, 0.015, 0.13),
        Cover((84, 116, 58), 1.5, 0.018, 0.0, 0.0, 0.015, 0.13, height_m=1.2),
        Cover((70, 106, 56), 1.5, 0.018, 0.0, 0.0, 0.015, 0.13, height_m=1.5),
        Cover((86, 128, 62), 2.0, 0.018, 27.0, 0.10, 0.020, 0.15),
        Cover((148, 148, 84), 1.5, 0.012, 24.0, 0.14, 0.015, 0.13, height_m=0.8),
        Cover((110, 124, 76), 3.0, 0.030, 0.0, 0.0, 0.015, 0.17),
    ),
    meadows=(
        Cover((108, 130, 70), 0.0, 0.000, 0.0, 0.0, 0.020, 0.15),
        Cover((122, 138, 78), 0.0, 0.000, 0.0, 0.0, 0.020, 0.15),
        Cover((144, 150, 96), 6.0, 0.024, 0.0, 0.0, 0.015, 0.13),
        Cover((98, 124, 64), 0.0, 0.000, 0.0, 0.0, 0.025, 0.17),
    ),
    forest_floor=Cover((72, 80, 50), mottle=0.1, grain=0.08),
    garden=Cover((112, 130, 76), mottle=0.10, soil=0.08, grain=0.08),
    clearing=Cover((120, 126, 76), mottle=0.25, grain=0.10),
    asphalt=(150, 149, 148),
    track=(196, 182, 150),
    verge=(122, 138, 76),
    water=(52, 74, 66),
    shore=(150, 142, 104),
    deciduous=((80, 112, 52), (92, 124, 58), (70, 102, 50), (104, 130, 66), (84, 106, 46), (64, 96, 52)),
    conifer=((58, 84, 58), (52, 76, 54), (64, 90, 60)),
    bare_alpha=1.0,
    bare_height=1.0,
    soil_inverted=0.84,
)

FLIGHT = Season(
    years=5.0,
    leaf_on=False,
    sun_azimuth_deg=212.0,
    sun_elevation_deg=32.0,
    ambient=(0.50, 0.56, 0.66),
    direct=(0.92, 0.80, 0.62),
    contrast=0.86,
    saturation=0.82,
    haze=0.05,
    crops=(
        Cover((104, 82, 64), 2.2, 0.024, 0.0, 0.0, 0.015, 0.23),
        Cover((120, 96, 74), 1.6, 0.018, 0.0, 0.0, 0.015, 0.23),
        Cover((92, 74, 60), 2.6, 0.030, 0.0, 0.0, 0.015, 0.21),
        Cover((140, 118, 92), 3.0, 0.018, 0.0, 0.0, 0.015, 0.23),
        Cover((104, 114, 70), 1.5, 0.018, 27.0, 0.12, 0.015, 0.19),
        Cover((92, 112, 66), 1.5, 0.012, 21.0, 0.14, 0.015, 0.17),
        Cover((166, 150, 114), 1.8, 0.024, 9.0, 0.08, 0.015, 0.13),
        Cover((122, 122, 70), 1.5, 0.012, 0.0, 0.0, 0.025, 0.13),
    ),
    meadows=(
        Cover((112, 116, 74), 0.0, 0.000, 0.0, 0.0, 0.020, 0.17),
        Cover((124, 120, 80), 0.0, 0.000, 0.0, 0.0, 0.020, 0.17),
        Cover((100, 110, 64), 4.5, 0.024, 0.0, 0.0, 0.015, 0.15),
        Cover((132, 126, 90), 0.0, 0.000, 0.0, 0.0, 0.025, 0.17),
    ),
    forest_floor=Cover((124, 100, 76), mottle=0.06, grain=0.10),
    garden=Cover((112, 112, 78), mottle=0.10, soil=0.08, grain=0.08),
    clearing=Cover((136, 118, 92), 4.0, 0.08, mottle=0.08, soil=0.08, grain=0.12),
    asphalt=(116, 116, 120),
    track=(140, 122, 98),
    verge=(118, 116, 76),
    water=(84, 96, 104),
    shore=(122, 108, 86),
    deciduous=((128, 112, 96), (118, 104, 92), (134, 120, 104), (124, 102, 84), (146, 108, 72), (112, 100, 90)),
    conifer=((58, 78, 60), (52, 72, 58), (64, 84, 62)),
    bare_alpha=0.38,
    bare_height=0.6,
    soil_inverted=0.16,
)


SNOW_WHITE: Rgb = (232, 236, 242)


def _snowed(cover: Cover, color: Rgb = SNOW_WHITE) -> Cover:
    """Under snow: white, and a fifth of the rows and wheel tracks still to be made out."""
    tracks = {"row_strength": cover.row_strength / 5, "tramline_strength": cover.tramline_strength / 5}
    return replace(cover, color=color, mottle=0.006, soil=0.01, grain=0.004, **tracks)


SNOW = replace(
    FLIGHT,
    sun_elevation_deg=14.0,
    ambient=(0.62, 0.66, 0.74),
    direct=(0.34, 0.31, 0.28),
    contrast=0.8,
    haze=0.12,
    crops=tuple(_snowed(cover) for cover in FLIGHT.crops),
    meadows=tuple(_snowed(cover) for cover in FLIGHT.meadows),
    forest_floor=_snowed(FLIGHT.forest_floor, (222, 226, 232)),
    garden=_snowed(FLIGHT.garden),
    clearing=_snowed(FLIGHT.clearing),
    asphalt=(176, 178, 182),
    track=(218, 220, 224),
    verge=SNOW_WHITE,
    water=(205, 212, 220),
    shore=SNOW_WHITE,
)
"""The later date under snow: fields, meadows, gardens and ice white, roads cleared, a low veiled sun."""

DEEP_SNOW = replace(
    FLIGHT,
    sun_azimuth_deg=217.0,
    sun_elevation_deg=10.0,
    ambient=(0.56, 0.61, 0.70),
    direct=(0.44, 0.38, 0.30),
    contrast=0.85,
    saturation=0.9,
    haze=0.06,
    snow=SnowCover(ground=0.98, roofs=0.93, conifer=0.7, bare=0.45),
)
"""The morning's map on an afternoon about the winter solstice at 48° north (20 minutes to three by the sun), after a snowstorm.

Fields, ways, verges and ice lie under snow too deep to show any of them, drifted by wind and not yet cleared or walked on; roofs
and crowns carry it too. The sun is 42° lower than over the map and 79° further west: shadows are seven times as long as the map's
and fall elsewhere; more than half of the light comes from the sky.
"""


def season_of(date: Date) -> Season:
    """The season of a date."""
    return {"map": MAP, "flight": FLIGHT, "snow": DEEP_SNOW}[date]
