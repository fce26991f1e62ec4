"""Whatever is flipped, cut off or added anywhere in a pack: a MapError that names the file, never a crash, never silence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.fuzz.damage import KINDS, damaged
from visloc_companion.errors import MapError
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.build import build_pack

laspy = pytest.importorskip("laspy")
FUZZ = settings(max_examples=120, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fuzz")
    image = np.random.default_rng(1).integers(1, 255, (70, 60)).astype(np.uint8)
    place = rasterio.Affine(1.0, 0.0, 500_000.0, 0.0, -1.0, 5_200_000.0)
    for name, values in (("a.tif", image), ("dsm.tif", image.astype(np.float32))):
        shape = {"width": 60, "height": 70, "count": 1, "dtype": values.dtype}
        with rasterio.open(folder / name, "w", driver="GTiff", crs="EPSG:32633", transform=place, **shape) as out:
            out.write(values, 1)
    build_pack([folder / "a.tif"], folder / "dsm.tif", folder / "pack", clouds=[cloud(folder / "c.las")], cloud_crs="EPSG:32633")
    return folder / "pack"


def cloud(path: Path) -> Path:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.array([0.01] * 3), np.array([500_000.0, 5_199_930.0, 0.0])
    las = laspy.LasData(header)
    las.x, las.y, las.z = (np.random.default_rng(2).uniform(0, 60, (900, 3)) * [1, 1, 0.1] + header.offsets).T
    las.write(path)
    return path


@FUZZ
@given(data=st.data())
def test_any_damage_is_a_map_error(pack: Path, data: st.DataObject) -> None:
    path = data.draw(st.sampled_from(sorted(pack.iterdir())))
    raw = path.read_bytes()
    changed = damaged(raw, data, data.draw(st.sampled_from(KINDS)), most_added=20, most_swapped=20)
    path.write_bytes(changed)
    try:
        if changed == raw:
            PackMap.open(pack)
            return
        with pytest.raises(MapError) as why:
            PackMap.open(pack)
        assert why.value.where.startswith(str(pack))
        assert why.value.remedy
    finally:
        path.write_bytes(raw)


@FUZZ
@given(data=st.data())
def test_unverified_damage_never_crashes(pack: Path, data: st.DataObject) -> None:
    """Without hashes a changed pixel may pass; opening and reading end in a patch or a MapError."""
    path = data.draw(st.sampled_from(sorted(pack.glob("*.tif")) + sorted(pack.glob("*.npy"))))
    raw = path.read_bytes()
    at = data.draw(st.integers(0, min(len(raw), 2000) - 1))
    part = data.draw(st.binary(min_size=1, max_size=8))
    path.write_bytes((raw[:at] + part + raw[at + len(part) :])[: len(raw)])
    try:
        damaged_pack = PackMap.open(pack, verify_hashes=False)
        damaged_pack.patch(damaged_pack.center_map_m, (40, 40), 1.0, 0.0)
        damaged_pack.stored_patch(damaged_pack.center_map_m, (40, 40), 1.0, GRADIENT.name, GRADIENT.recipe)
        assert np.isfinite(damaged_pack.cloud_around(damaged_pack.center_map_m, 40.0)).all()
    except MapError:
        pass
    finally:
        path.write_bytes(raw)


def test_wherever_the_directory_of_the_orthophoto_is_zeroed_opening_ends_in_a_map_or_a_map_error(pack: Path) -> None:
    """Of an unknown tag GDAL tells only when the meaning of the bands is asked for."""
    path = pack / "ortho.tif"
    raw, refused = path.read_bytes(), 0
    try:
        for at in range(min(len(raw), 1200) - 2):
            path.write_bytes(raw[:at] + b"\0\0" + raw[at + 2 :])
            try:
                PackMap.open(pack, verify_hashes=False)
            except MapError as why:
                refused += 1
                assert why.where.startswith(str(pack))
    finally:
        path.write_bytes(raw)
    assert refused > 0
