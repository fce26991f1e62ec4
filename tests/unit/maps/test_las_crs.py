from __future__ import annotations

import struct
from pathlib import Path

import laspy
import numpy as np
import pytest
from pyproj import CRS

from visloc_companion.errors import CloudError
from visloc_companion.maps.cloud import read_cloud
from visloc_companion.maps.cloud_las import open_las

FOOT_M, SURVEY_FOOT_M = 0.3048, 1200 / 3937
MODEL, GEOGRAPHIC, PROJECTED, GRID_UNITS, VERTICAL, VERTICAL_UNITS = 1024, 2048, 3072, 3076, 4096, 4099
SITE = 'LOCAL_CS["site",UNIT["metre",1]]'
FEET_3D = "EPSG:6588+6360"


def keys(values: dict[int, int]) -> laspy.VLR:
    """The record of GeoTIFF keys."""
    body = b"".join(struct.pack("<4H", key, 0, 1, value) for key, value in values.items())
    return laspy.VLR("LASF_Projection", 34735, "", struct.pack("<4H", 1, 1, 0, len(values)) + body)


def wkt(text: str) -> laspy.VLR:
    return laspy.VLR("LASF_Projection", 2112, "", text.encode() + b"\0")


def write(path: Path, *records: laspy.VLR) -> Path:
    """Three points, 1000 units up."""
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales, header.offsets = np.full(3, 0.001), np.array([600_000.0, 700_000.0, 0.0])
    header.vlrs.extend(records)
    las = laspy.LasData(header)
    las.x, las.y, las.z = np.array([600_000.0, 600_001.0, 600_002.0]), np.array([700_000.0] * 3), np.array([1000.0] * 3)
    las.write(path)
    return path


@pytest.mark.parametrize(
    ("record", "grid_m", "height_m"),
    [
        (keys({MODEL: 1, PROJECTED: 2264}), SURVEY_FOOT_M, SURVEY_FOOT_M),  # North Carolina, nothing said of heights
        (keys({MODEL: 1, PROJECTED: 2994, GRID_UNITS: 9002}), FOOT_M, FOOT_M),
        (keys({MODEL: 1, PROJECTED: 2264, VERTICAL: 5103, VERTICAL_UNITS: 9001}), SURVEY_FOOT_M, 1.0),
        (keys({MODEL: 1, PROJECTED: 32617, VERTICAL_UNITS: 9003}), 1.0, SURVEY_FOOT_M),
        (keys({MODEL: 1, PROJECTED: 32617, VERTICAL: 6360}), 1.0, SURVEY_FOOT_M),
        (keys({MODEL: 1, PROJECTED: 2264, VERTICAL: 5703}), SURVEY_FOOT_M, 1.0),
        (keys({MODEL: 1, PROJECTED: 32617}), 1.0, 1.0),
        (keys({MODEL: 1, GEOGRAPHIC: 4269, PROJECTED: 32767}), 1.0, 1.0),  # a projection that the keys only describe
        (wkt(SITE), 1.0, 1.0),
        (wkt("''"), 1.0, 1.0),
        (wkt(""), 1.0, 1.0),
    ],
)
def test_units_of_the_grid_and_of_heights(tmp_path: Path, record: laspy.VLR, grid_m: float, height_m: float) -> None:
    points = read_cloud(write(tmp_path / "a.las", record)).points_m
    assert points[0] == pytest.approx([600_000 * grid_m, 700_000 * grid_m, 1000 * height_m], rel=1e-9)


def test_wkt_comes_before_keys_which_still_tell_the_unit_of_heights(tmp_path: Path) -> None:
    path = write(tmp_path / "a.las", keys({MODEL: 1, PROJECTED: 32617, VERTICAL_UNITS: 9001}), wkt(CRS("EPSG:2264").to_wkt()))
    with open_las(path) as las:
        assert las.crs is not None
        assert las.crs.epsg == 2264
        assert las.metres_per_unit == pytest.approx([SURVEY_FOOT_M, SURVEY_FOOT_M, 1.0])


@pytest.mark.parametrize(
    ("records", "ellipsoidal", "height_m"),
    [
        ((keys({MODEL: 1, PROJECTED: 32632, VERTICAL: 5030}),), True, 1.0),  # GeoTIFF's own code of the ellipsoid of WGS 84
        ((keys({MODEL: 1, PROJECTED: 25832, VERTICAL: 5019, VERTICAL_UNITS: 9001}),), True, 1.0),
        ((keys({MODEL: 1, PROJECTED: 2264, VERTICAL: 5030, VERTICAL_UNITS: 9003}),), True, SURVEY_FOOT_M),
        ((keys({MODEL: 1, PROJECTED: 32632, VERTICAL: 4979}),), True, 1.0),
        ((keys({MODEL: 1, PROJECTED: 32632, VERTICAL: 5030}), wkt(CRS("EPSG:32632").to_wkt())), True, 1.0),
        ((keys({MODEL: 1, PROJECTED: 32632, VERTICAL: 5030}), wkt(CRS("EPSG:32632+5773").to_wkt())), False, 1.0),
        ((keys({MODEL: 1, PROJECTED: 32632, VERTICAL: 5773}),), False, 1.0),
        ((keys({MODEL: 1, PROJECTED: 32632, VERTICAL: 32767}),), False, 1.0),
    ],
)
def test_keys_say_that_heights_are_ellipsoidal(
    tmp_path: Path, records: tuple[laspy.VLR, ...], ellipsoidal: bool, height_m: float
) -> None:
    """laspy reads the grid's CRS alone from them, and a map built of it lay higher by all of the geoid's height."""
    with open_las(write(tmp_path / "a.las", *records)) as las:
        assert las.crs is not None and las.crs.is_ellipsoidal_3d == ellipsoidal
        assert las.height_unit_m == pytest.approx(height_m)


def test_the_crs_that_is_given_serves_where_the_file_names_none(tmp_path: Path) -> None:
    with open_las(write(tmp_path / "a.las", wkt(SITE)), FEET_3D) as las:
        assert las.crs is not None
        assert las.crs.vertical_name
        assert las.height_unit_m == pytest.approx(SURVEY_FOOT_M)


def test_degrees_are_refused(tmp_path: Path) -> None:
    with pytest.raises(CloudError, match=r"a\.las: is in degrees; remedy"):
        read_cloud(write(tmp_path / "a.las", keys({MODEL: 2, GEOGRAPHIC: 4269})))
