"""Coordinate reference systems: the only importer of pyproj.

Every transformer is built with `always_xy=True` and `allow_ballpark=False`: pyproj's default silently treats heights of
different datums, and coordinates of unknown datums, as equal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache

import numpy as np
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError

from visloc_companion.errors import DatumMissing, MapError, OutsideMap
from visloc_companion.geo.wgs84 import radii_m
from visloc_companion.types import FloatArray, GeoPoint

_REMEDY = (
    "state a projected or geographic CRS (gdal_edit.py -a_srs EPSG:...) or change to one "
    "(gdalwarp -t_srs EPSG:..., for clouds pdal translate with filters.reprojection)"
)
HELD_FOR_WGS84_M = {4490: 1.0, 10284: 1.0, 6783: 2.0, 8237: 2.0, 8240: 2.0, 8246: 2.0, 8249: 2.0, 6325: 2.0, 6322: 5.0}
"""Geographic CRS, by EPSG code, that no table of PROJ relates to WGS 84 though it follows from what they are: the same
coordinates, to so many metres. CGCS2000 (4490) is ITRF97 at the epoch 2000.0, centimetres from WGS 84 but for the drift of the
continent since, 0.8 m by 2027 (ITRF2020's motion of the Eurasian plate); ETRS89/DREF91/2016 (10284) is ETRS89 in Germany, of
which EPSG states 1 m. NAD83(CORS96) (6783), NAD83(CSRS) v2 to v5 (8237, 8240, 8246, 8249), NAD83(MA11) and NAD83(PA11) (6325,
6322) lie beside the ITRF as EPSG's relations to that say: by 2027 up to 1.8 m in North America (1.94 m by 2035), 1.5 m in the
Marianas, 4.7 m in the Pacific."""
NO_BETTER_M = {4617: 2.0, 4152: 2.0, 4167: 2.0}
"""Geographic CRS, by EPSG code, of which EPSG states 1 m although they keep to a plate that has moved on by more: NAD83(CSRS)
without a version (4617) and NAD83(HARN) (4152) lie beside the ITRF by up to 1.8 m as the versions do, of which it states 2 m;
NZGD2000 (4167) is ITRF96 as of 2000.0, from where New Zealand has moved by 4 to 5 cm a year."""
_EVEN_ALL_AROUND = ("Popular Visualisation Pseudo Mercator", "Mercator (variant A)", "Mercator (variant B)")


@dataclass(frozen=True, slots=True, eq=False)
class Linearisation:
    """A CRS linearised at one place (protocols.LocalProjection): Jacobian and easting, northing of the place."""

    J_map_ne: FloatArray
    origin_map_m: tuple[float, float]

    @property
    def convergence_rad(self) -> float:
        """Direction of grid north (increasing northing), clockwise from true north."""
        north, east = np.linalg.solve(self.J_map_ne, np.array([0.0, 1.0]))
        return math.atan2(east, north)

    @property
    def scale(self) -> float:
        """Map units for a metre on the ground (geometric mean of the principal scales)."""
        return math.sqrt(abs(float(np.linalg.det(self.J_map_ne))))


@dataclass(frozen=True, slots=True, eq=False)
class _Related:
    """A CRS and the transformer to it from WGS 84; `held_m`: how good that is where its datum is held for WGS 84."""

    crs: CRS
    to_map: Transformer
    held_m: float | None


class MapCrs:
    """A horizontal CRS and its relation to WGS 84. Compare with `==`; build with `map_crs`.

    `vertical_metres_per_unit` is 1 where the CRS does not state heights (`states_heights`). `sea_level_name` is that of a known
    vertical CRS, all of which count from the sea's level or nearly so; empty where it has none, or one that only the file knows.
    `counts_down`: it is one of depths.
    """

    def __init__(self, related: _Related, vertical: CRS | None, is_ellipsoidal_3d: bool = False) -> None:
        self._crs, self._to_map, self._held_m = related.crs, related.to_map, related.held_m
        self.is_ellipsoidal_3d = is_ellipsoidal_3d
        self.vertical_name = vertical.name if vertical and not is_ellipsoidal_3d else ""
        self.vertical_metres_per_unit = float(vertical.axis_info[-1].unit_conversion_factor) if vertical else 1.0
        self.states_heights = vertical is not None
        self.counts_down = bool(vertical and vertical.axis_info[-1].direction == "down")
        self.sea_level_name = self.vertical_name if self.vertical_name and vertical and vertical.to_epsg() else ""

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MapCrs) and self._crs.equals(other._crs, ignore_axis_order=True)

    def __hash__(self) -> int:
        return hash(self._crs.name)

    @property
    def name(self) -> str:
        """Name as the authority gives it."""
        return str(self._crs.name)

    @property
    def wkt(self) -> str:
        """WKT 2."""
        return str(self._crs.to_wkt())

    @property
    def epsg(self) -> int | None:
        """EPSG code, where the CRS has one."""
        code = self._crs.to_epsg()
        return None if code is None else int(code)

    @property
    def is_geographic(self) -> bool:
        """Whether coordinates are angles."""
        return bool(self._crs.is_geographic)

    @property
    def metres_per_unit(self) -> float:
        """Of a projected CRS (feet: 0.3048); NaN of a geographic one."""
        return math.nan if self.is_geographic else float(self._crs.axis_info[0].unit_conversion_factor)

    def has_grid_of(self, other: MapCrs) -> bool:
        """Whether both are one projection of ellipsoids that agree to a metre (GRS 1980, WGS 84), whatever realisation of a datum
        each is tied to: NAD83 and NAD83(2011), ETRS89 and WGS 84. The datums of other ellipsoids lie 100 m and more away."""
        if self == other:
            return True
        mine, theirs = self._crs, other._crs
        same_projection = (mine.coordinate_operation, mine.coordinate_system, mine.prime_meridian) == (
            theirs.coordinate_operation,
            theirs.coordinate_system,
            theirs.prime_meridian,
        )
        axes_m = [(crs.ellipsoid.semi_major_metre, crs.ellipsoid.semi_minor_metre) for crs in (mine, theirs) if crs.ellipsoid]
        return same_projection and len(axes_m) == 2 and float(np.ptp(np.array(axes_m), axis=0).max()) < 1.0

    @cached_property
    def turn(self) -> float | None:
        """A full turn in map units (360 in degrees, 40,075 km in Web Mercator) where eastings grow evenly with the longitude
        all around the earth, so that a raster's may run on beyond the antimeridian; None elsewhere."""
        if self.is_geographic:
            return 2 * math.pi / float(self._crs.axis_info[0].unit_conversion_factor)
        if not (self._crs.coordinate_operation and self._crs.coordinate_operation.method_name in _EVEN_ALL_AROUND):
            return None
        half = self.to_map(0.0, 90.0)[0] - self.to_map(0.0, -90.0)[0]
        return 2 * half if half > 0 else None

    def to_map(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        """Easting and northing (map units). Raises OutsideMap where the CRS has no coordinates for the place."""
        easting, northing = self._to_map.transform(lon_deg, lat_deg)
        if not (math.isfinite(easting) and math.isfinite(northing)):
            raise OutsideMap(
                f"latitude {lat_deg}, longitude {lon_deg} has no coordinates in {self.name}", remedy="use a map of the place"
            )
        return float(easting), float(northing)

    def to_geo(self, easting: float, northing: float) -> tuple[float, float]:
        """Latitude and longitude, degrees WGS 84. Raises OutsideMap where they are not defined."""
        lon, lat = self._to_map.transform(easting, northing, direction="INVERSE")
        if not (math.isfinite(lat) and math.isfinite(lon)):
            raise OutsideMap(
                f"easting {easting}, northing {northing} is no place in {self.name}", remedy="use a map of the place"
            )
        return float(lat), float(lon)

    def accuracy_m(self, easting: float, northing: float) -> float | None:
        """What EPSG (else HELD_FOR_WGS84_M; no less than NO_BETTER_M) states of the relation to WGS 84 at a place, metres:
        nationwide parameters are good to 1 to 10 m.

        Zero of WGS 84 itself, None where nothing is stated. Raises OutsideMap.
        """
        self.to_geo(easting, northing)
        if self._held_m is not None:
            return self._held_m
        try:
            accuracy = self._to_map.get_last_used_operation().accuracy
        except ProjError:  # there is nothing to do
            accuracy = self._to_map.accuracy
        _, least_m = _of_datum(NO_BETTER_M, self._crs) or (None, 0.0)
        return None if accuracy < 0 else max(float(accuracy), least_m)

    def to_map_array(self, lat_lon_deg: FloatArray) -> FloatArray:
        """(N, 2) latitude, longitude to (N, 2) easting, northing; NaN where undefined."""
        return _finite(self._to_map.transform(lat_lon_deg[:, 1], lat_lon_deg[:, 0]))

    def to_geo_array(self, map_m: FloatArray) -> FloatArray:
        """(N, 2) easting, northing to (N, 2) latitude, longitude; NaN where undefined."""
        return _finite(self._to_map.transform(map_m[:, 0], map_m[:, 1], direction="INVERSE"))[:, ::-1]

    def linearised_at(self, place: GeoPoint) -> Linearisation:
        """Jacobian by central differences over ±1e-4 degrees (about 11 m): truncation and rounding stay below 1e-8 (1e-6 beside
        the CRS's seam, where differences are of one side)."""
        meridian_m, normal_m = radii_m(place.lat_deg)
        parallel_m = normal_m * math.cos(math.radians(place.lat_deg))
        step_deg = 1e-4
        lat, lon = place.lat_deg, place.lon_deg
        around = np.array(
            [[lat, lon], [lat + step_deg, lon], [lat - step_deg, lon], [lat, lon + step_deg], [lat, lon - step_deg]]
        )
        p = self.to_map_array(around)
        if not np.isfinite(p).all():
            raise OutsideMap(
                f"latitude {lat}, longitude {lon} has no coordinates in {self.name}", remedy="use a map of the place"
            )
        arc = 2 * math.radians(step_deg)
        J = np.column_stack([_across(p[2], p[0], p[1]) / (arc * meridian_m), _across(p[4], p[0], p[3]) / (arc * parallel_m)])
        return Linearisation(J, (float(p[0, 0]), float(p[0, 1])))

    def linearised_at_map(self, easting: float, northing: float) -> Linearisation:
        """The same, at a place given in the map's CRS."""
        lat_deg, lon_deg = self.to_geo(easting, northing)
        return Linearisation(self.linearised_at(GeoPoint(lat_deg, lon_deg, 0.0)).J_map_ne, (easting, northing))


@lru_cache(maxsize=64)
def map_crs(text: str, where: str = "") -> MapCrs:
    """The CRS of an EPSG code or WKT; of a compound one, the horizontal part.

    Raises MapError for text that is no CRS and for one without a horizontal position (geocentric, vertical, engineering);
    DatumMissing where the relation to WGS 84 is unknown.
    """
    try:
        full = CRS.from_user_input(text)
    except CRSError as why:
        raise MapError(f"is not a coordinate reference system: {text[:80]!r}", where=where, remedy=_REMEDY) from why
    parts = _parts(full)
    vertical = parts[1] if len(parts) > 1 and parts[1].is_vertical else None
    horizontal = parts[0].to_2d()
    if not (horizontal.is_projected or horizontal.is_geographic):
        raise MapError(f"the CRS {full.name!r} is neither projected nor geographic", where=where, remedy=_REMEDY)
    try:
        related = _related(full, horizontal)
    except ProjError as why:
        raise DatumMissing(f"the relation of {full.name!r} to WGS 84 is unknown", where=where, remedy=_REMEDY) from why
    is_3d = len(parts[0].axis_info) == 3
    return MapCrs(related, parts[0] if is_3d else vertical, is_ellipsoidal_3d=is_3d or _names_ellipsoid(vertical))


def _names_ellipsoid(vertical: CRS | None) -> bool:
    """Whether a vertical CRS is none of the sea: what GDAL makes of GeoTIFF's old keys (a datum that is "Not specified (based on
    GRS 1980 ellipsoid)") unless it knows them to be of the grid's own datum, and what programs name themselves."""
    if vertical is None:
        return False
    names = vertical.name, vertical.datum.name if vertical.datum else ""
    return any("ellipsoid" in name.lower() for name in names)


def vertical_unit_m(epsg: int) -> float | None:
    """Metres in a unit of a vertical CRS (feet: 0.3048), None where the code is none of one."""
    try:
        crs = CRS.from_epsg(epsg)
    except CRSError:
        return None
    return float(crs.axis_info[-1].unit_conversion_factor) if crs.is_vertical else None


def is_ellipsoidal(epsg: int) -> bool:
    """Whether a code, where a file names its vertical CRS, stands for heights above an ellipsoid: a three-dimensional geographic
    CRS (GeoTIFF 1.1), or one of GeoTIFF 1.0's own codes (section 6.3.4.1: 5001 to 5033, such as 5030 of WGS 84)."""
    if 5001 <= epsg <= 5033:
        return True
    try:
        crs = CRS.from_epsg(epsg)
    except CRSError:
        return False
    return bool(crs.is_geographic) and len(crs.axis_info) == 3


def utm_at(lat_deg: float, lon_deg: float) -> MapCrs:
    """The UTM zone (WGS 84) of a place; the zones' exceptions in Norway and Svalbard are not applied."""
    zone = int((lon_deg + 180) % 360 // 6) % 60 + 1  # a hair west of the antimeridian the remainder rounds to 360
    return map_crs(f"EPSG:{(32600 if lat_deg >= 0 else 32700) + zone}")


def _related(full: CRS, horizontal: CRS) -> _Related:
    """The horizontal part of a CRS and its relation to WGS 84. Raises ProjError where none is known.

    GDAL's tables may be newer than PROJ's here, and call the datum of a country by a name that these do not know (ETRS89 in
    Finland, Norway and Greenland). Then the CRS whose code `full` bears serves, where projection, axes, ellipsoid are the same.
    """
    try:
        return _from_wgs84(horizontal)
    except ProjError:
        named = _of_code(full)
        if named is None or _shape(named) != _shape(horizontal):
            raise
        return _from_wgs84(named)


def _from_wgs84(horizontal: CRS) -> _Related:
    start, held_m = _of_datum(HELD_FOR_WGS84_M, horizontal) or (CRS.from_epsg(4326), None)
    return _Related(horizontal, Transformer.from_crs(start, horizontal, always_xy=True, allow_ballpark=False), held_m)


def _of_datum(table: dict[int, float], horizontal: CRS) -> tuple[CRS, float] | None:
    """The first CRS of a table that is on the datum of another, with its metres; None where there is none."""
    known = ((_geographic(code), accuracy_m) for code, accuracy_m in table.items())
    return next(((crs, metres) for crs, metres in known if crs is not None and crs.datum == horizontal.datum), None)


@cache
def _geographic(code: int) -> CRS | None:
    """The CRS of an EPSG code, None where PROJ's tables here are of before it."""
    try:
        return CRS.from_epsg(code)
    except CRSError:
        return None


def _of_code(full: CRS) -> CRS | None:
    """The horizontal part of the CRS whose code a CRS bears; None where it bears none that is known."""
    bears = full.to_json_dict().get("id")
    try:
        known = None if bears is None else CRS.from_authority(bears["authority"], bears["code"])
    except CRSError:
        return None
    return known and _parts(known)[0].to_2d()


def _shape(horizontal: CRS) -> tuple[object, ...]:
    """All of a CRS but its datum's name."""
    return horizontal.coordinate_operation, horizontal.coordinate_system, horizontal.ellipsoid, horizontal.prime_meridian


def _parts(full: CRS) -> list[CRS]:
    """Of a compound CRS its parts, of any other one itself."""
    return full.sub_crs_list if full.is_compound else [full]


def _across(before: FloatArray, here: FloatArray, after: FloatArray) -> FloatArray:
    """From one neighbour of a place to the other, map units (2,); where the CRS has its seam between, at which coordinates jump
    by a whole turn (Web Mercator's is the antimeridian), twice the step on this side of it."""
    behind, ahead = here - before, after - here
    lengths = float(np.linalg.norm(behind)), float(np.linalg.norm(ahead))
    if max(lengths) < 2 * min(lengths):
        return np.asarray(after - before)
    return np.asarray(2 * (behind if lengths[0] < lengths[1] else ahead))


def _finite(xy: tuple[FloatArray, FloatArray]) -> FloatArray:
    points = np.column_stack(xy)
    return np.where(np.isfinite(points).all(axis=1, keepdims=True), points, np.nan)
