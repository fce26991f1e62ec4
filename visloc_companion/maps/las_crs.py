"""What a LAS file's records say of its axes: the CRS, and how long a unit of height is."""

from __future__ import annotations

from typing import Any

from visloc_companion.maps.crs import MapCrs, is_ellipsoidal, vertical_unit_m

_MODEL, _PROJECTED, _VERTICAL_CRS, _VERTICAL_UNITS = 1024, 1, 4096, 4099
"""GeoTIFF keys and a value of the first; laspy passes over these keys where it reads the CRS."""
_METRES = {9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937}
"""Units by their EPSG codes: metre, foot, US survey foot."""

_EMPTY = " \n'\""
"""What writers put where they know no CRS."""


def stated_wkt(header: Any) -> str:
    """WKT of the CRS that a header (of laspy) states, its WKT record before its GeoTIFF keys; a three-dimensional one where the
    keys alone say that heights are above the ellipsoid, which laspy passes over.

    Empty where it states none: also where the record is empty, for the CRS of a site (LOCAL_CS), which leads nowhere, and where
    the keys describe a projection without naming it (laspy then gives the geographic CRS below it).
    """
    found: Any = None
    on_ellipsoid = is_ellipsoidal(_all_keys(header).get(_VERTICAL_CRS, 0))
    for record in _records(header):
        keys = _keys(record)
        crs = record.parse_crs() if keys or record.string.strip(_EMPTY) else None
        if crs is None or crs.type_name == "Engineering CRS" or (keys.get(_MODEL) == _PROJECTED and crs.is_geographic):
            continue
        found = crs
        if not keys:
            break
    if found is None:
        return ""
    return str((found.to_3d() if on_ellipsoid and len(found.axis_info) == 2 else found).to_wkt())


def height_unit_m(header: Any, crs: MapCrs | None) -> float:
    """Metres in a unit of height: as the CRS or the GeoTIFF keys say, else that of the grid, which is the custom in LAS files."""
    if crs is None:
        return 1.0
    keys = _all_keys(header)
    stated = _METRES.get(keys.get(_VERTICAL_UNITS, 0)) or vertical_unit_m(keys.get(_VERTICAL_CRS, 0))
    if crs.states_heights and not (stated and crs.is_ellipsoidal_3d):
        return crs.vertical_metres_per_unit
    return stated or crs.metres_per_unit


def _records(header: Any) -> list[Any]:
    """The WKT records and the GeoTIFF keys, before the points and behind them."""
    known = header.vlrs.get_by_id("LASF_Projection") + (header.evlrs.get_by_id("LASF_Projection") if header.evlrs else [])
    return [record for record in known if hasattr(record, "parse_crs")]


def _all_keys(header: Any) -> dict[int, int]:
    return {key: value for record in _records(header) for key, value in _keys(record).items()}


def _keys(record: Any) -> dict[int, int]:
    return {int(key.id): int(key.value_offset) for key in getattr(record, "geo_keys", ())}
