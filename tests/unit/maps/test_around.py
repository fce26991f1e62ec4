from pathlib import Path

import numpy as np
import pytest

from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.raster import RasterMap
from visloc_companion.protocols import ShapeMap
from visloc_companion.types import GeoPoint

PLACE = (47.0, 15.3)


def slope(size: int, pixel_m: float) -> np.ndarray:
    """10 % up to the east, 20 % up to the south of the raster's own axes, 200 m in the middle."""
    x = (np.arange(size) - (size - 1) / 2) * pixel_m
    return (200 + 0.1 * x[None, :] + 0.2 * x[:, None]).astype(np.float32)


@pytest.mark.parametrize(("crs", "pixel_m"), [("EPSG:32633", 0.2), ("EPSG:32633", 3.0), ("EPSG:32632", 1.0), ("EPSG:4326", 1.0)])
def test_samples_of_a_surface_model_in_any_crs(tmp_path: Path, write_raster, crs: str, pixel_m: float) -> None:
    size = round(120 / pixel_m)
    write_raster(tmp_path / "a.tif", np.full((150, 150), 90, np.uint8), "EPSG:32633", PLACE, 1.0)
    write_raster(tmp_path / "dsm.tif", slope(size, pixel_m), crs, PLACE, pixel_m)
    ground = RasterMap.open(tmp_path / "a.tif", tmp_path / "dsm.tif")
    assert isinstance(ground, ShapeMap)
    points = ground.cloud_around(ground.to_map(*PLACE), 40.0)
    spacing = max(0.5, pixel_m)
    assert len(points) == pytest.approx(np.pi * 40**2 / spacing**2, rel=0.08)
    here = map_crs(crs).linearised_at(GeoPoint(*PLACE, 0.0)).convergence_rad
    east, north = points[:, 0], points[:, 1]
    right, up = east * np.cos(here) - north * np.sin(here), east * np.sin(here) + north * np.cos(here)
    np.testing.assert_allclose(points[:, 2], 200 + 0.1 * right - 0.2 * up, atol=0.03)


def test_a_circle_at_the_edge_has_what_is_there(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", np.full((150, 150), 90, np.uint8), "EPSG:32633", PLACE, 1.0)
    heights = slope(100, 1.0)
    heights[:, 50:] = -9999
    write_raster(tmp_path / "dsm.tif", heights, "EPSG:32633", PLACE, 1.0, nodata=-9999)
    ground = RasterMap.open(tmp_path / "a.tif", tmp_path / "dsm.tif")
    points = ground.cloud_around(ground.to_map(*PLACE), 30.0)
    assert len(points) == pytest.approx(np.pi * 30**2 / 2, rel=0.05) and points[:, 0].max() < 1.0
    assert points[:, 2].min() > 150
