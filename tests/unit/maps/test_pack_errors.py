import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.errors import NotGeoreferencedWarning

from visloc_companion.errors import HashMismatch, MapError
from visloc_companion.maps.manifest import DIGEST, MANIFEST, is_manifest, read_manifest
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.build import build_pack


@pytest.fixture
def folder(tmp_path: Path, write_raster) -> Path:
    image = np.random.default_rng(1).integers(1, 255, (120, 100)).astype(np.uint8)
    write_raster(tmp_path / "a.tif", image, "EPSG:32633", (47.0, 15.3), 1.0)
    write_raster(tmp_path / "dsm.tif", np.full((60, 60), 300, np.float32), "EPSG:32633", (47.0, 15.3), 2.0)
    build_pack([tmp_path / "a.tif"], tmp_path / "dsm.tif", tmp_path / "pack")
    return tmp_path / "pack"


def rewrite(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change the manifest and sign it again, as somebody would who means it."""
    data = json.loads((folder / MANIFEST).read_text())
    change(data)
    seal(folder, json.dumps(data).encode())


def seal(folder: Path, raw: bytes) -> None:
    (folder / MANIFEST).write_bytes(raw)
    (folder / DIGEST).write_text(f"{hashlib.sha256(raw).hexdigest()}  {MANIFEST}\n")


def adopt(folder: Path, name: str) -> None:
    """Let the manifest name the file as it is now."""
    raw = (folder / name).read_bytes()
    entry = {"bytes": len(raw), "sha256": hashlib.sha256(raw).hexdigest()}
    rewrite(folder, lambda data: data["files"].update({name: entry}))


def test_whole_pack_opens(folder: Path) -> None:
    pack = PackMap.open(folder)
    assert pack.height_amsl_m(*pack.center_map_m) == 300.0
    digest = (folder / DIGEST).read_text().split()
    assert digest == [hashlib.sha256((folder / MANIFEST).read_bytes()).hexdigest(), MANIFEST], "sha256sum -c reads it"


@pytest.mark.parametrize(
    ("name", "band"),
    [
        ("dsm.tif.aux.xml", "<UnitType>ft</UnitType>"),
        ("dsm.tif.aux.xml", "<Scale>3</Scale>"),
        ("dsm.tif.aux.xml", "<NoDataValue>300</NoDataValue>"),
        ("ortho.tif.aux.xml", "<NoDataValue>77</NoDataValue>"),
        ("ortho.tif.aux.xml", "<ColorInterp>Alpha</ColorInterp>"),
        ("ortho.tif.msk", ""),
    ],
)
def test_what_lies_beside_the_files_of_a_pack_changes_nothing(folder: Path, name: str, band: str) -> None:
    """Programs that show rasters write such files, GDAL believes them, and no hash tells: 300 m were 91 m, in feet."""
    pack = PackMap.open(folder)
    want = pack.patch(pack.center_map_m, (90, 90), 1.0, 0.0)
    if band:
        (folder / name).write_text(f'<PAMDataset><PAMRasterBand band="1">{band}</PAMRasterBand></PAMDataset>')
    else:
        with (
            pytest.warns(NotGeoreferencedWarning),
            rasterio.open(folder / name, "w", "GTiff", width=pack.shape[1], height=pack.shape[0], count=1, dtype="uint8") as mask,
        ):
            mask.update_tags(INTERNAL_MASK_FLAGS_1="2")
    pack = PackMap.open(folder)
    got = pack.patch(pack.center_map_m, (90, 90), 1.0, 0.0)
    np.testing.assert_array_equal(got.valid, want.valid)
    np.testing.assert_array_equal(got.pixels, want.pixels)
    np.testing.assert_array_equal(got.dsm_amsl_m, want.dsm_amsl_m)


def test_flipped_byte_is_found_by_its_hash(folder: Path) -> None:
    for name in ("ortho.tif", "dsm.tif", "gradient_00.npy"):
        raw = (folder / name).read_bytes()
        damaged = bytearray(raw)
        damaged[len(raw) // 2] ^= 1
        (folder / name).write_bytes(damaged)
        with pytest.raises(HashMismatch, match=rf"{name}.*SHA-256.*remedy"):
            PackMap.open(folder)
        (folder / name).write_bytes(raw)


def test_truncated_file_is_found_without_hashing(folder: Path) -> None:
    raw = (folder / "ortho.tif").read_bytes()
    (folder / "ortho.tif").write_bytes(raw[:-10])
    with pytest.raises(HashMismatch, match=rf"ortho\.tif: has {len(raw) - 10} bytes, the manifest says {len(raw)}"):
        PackMap.open(folder, verify_hashes=False)


@pytest.mark.parametrize("name", ["ortho.tif", "dsm.tif", "gradient_01.npy", MANIFEST, DIGEST])
def test_missing_file_is_named(folder: Path, name: str) -> None:
    (folder / name).unlink()
    with pytest.raises(MapError, match=rf"{name}.*remedy"):
        PackMap.open(folder)


def test_no_pack_at_all(tmp_path: Path) -> None:
    for name in ("absent", "."):
        with pytest.raises(MapError, match=r"manifest\.json.*visloc map build"):
            PackMap.open(tmp_path / name)


def test_manifest_changed_by_hand(folder: Path) -> None:
    text = (folder / MANIFEST).read_text()
    (folder / MANIFEST).write_text(text.replace('"capture_date": ""', '"capture_date": "2026-01-01"'))
    with pytest.raises(HashMismatch, match=r"manifest\.json.*manifest\.sha256"):
        read_manifest(folder)


def test_truncated_manifest(folder: Path) -> None:
    raw = (folder / MANIFEST).read_bytes()
    for keep in (0, 1, len(raw) // 2, len(raw) - 2):
        seal(folder, raw[:keep])
        with pytest.raises(MapError, match=r"manifest\.json.*not valid JSON.*remedy"):
            read_manifest(folder)


@pytest.mark.parametrize("raw", [b"[]", b"{}", b'{"kind": "other"}', b"[" * 100_000, b"\xff\xfe"])
def test_manifest_of_something_else(folder: Path, raw: bytes) -> None:
    seal(folder, raw)
    with pytest.raises(MapError, match=r"manifest\.json"):
        read_manifest(folder)
    assert not is_manifest(folder / MANIFEST)


def test_other_schema_version(folder: Path) -> None:
    rewrite(folder, lambda data: data.update(schema_version=1))
    with pytest.raises(MapError, match=r"schema_version is 1, this program reads 2.*remedy"):
        PackMap.open(folder)
    assert is_manifest(folder / MANIFEST)


@pytest.mark.parametrize(
    ("field", "value"),
    [("gsd_m", 0), ("gsd_m", "coarse"), ("surprise", 1), ("share_valid", 2), ("files", {"../ortho.tif": {}}), ("ortho", {})],
)
def test_wrong_fields_are_named(folder: Path, field: str, value: object) -> None:
    rewrite(folder, lambda data: data.update({field: value}))
    with pytest.raises(MapError, match=rf"manifest\.json: .*{field}"):
        read_manifest(folder)


def test_files_that_the_manifest_does_not_list(folder: Path) -> None:
    rewrite(folder, lambda data: data["files"].pop("dsm.tif"))
    with pytest.raises(MapError, match=r"files: has no entry 'dsm\.tif'"):
        read_manifest(folder)


def test_rasters_that_are_not_as_described(folder: Path) -> None:
    rewrite(folder, lambda data: data["ortho"].update(rows=data["ortho"]["rows"] + 1))
    with pytest.raises(MapError, match=r"ortho\.tif.*not what the manifest says"):
        PackMap.open(folder)
    rewrite(folder, lambda data: data["ortho"].update(rows=data["ortho"]["rows"] - 1))
    rewrite(folder, lambda data: data["crs"].update(wkt=data["crs"]["wkt"].replace("15,", "21,", 1)))
    with pytest.raises(MapError, match=r"ortho\.tif.*not what the manifest says"):
        PackMap.open(folder)
    rewrite(folder, lambda data: data["crs"].update(wkt="no CRS"))
    with pytest.raises(MapError, match=r"manifest\.json.*coordinate reference system"):
        PackMap.open(folder)


@pytest.mark.parametrize("content", [b"", b"no array", b"\x93NUMPY\x01\x00v\x00" + b"{" * 118])
def test_features_that_are_no_array(folder: Path, content: bytes) -> None:
    (folder / "gradient_00.npy").write_bytes(content)
    adopt(folder, "gradient_00.npy")
    with pytest.raises(MapError, match=r"gradient_00\.npy"):
        PackMap.open(folder)


def test_features_of_another_shape(folder: Path) -> None:
    np.save(folder / "gradient_00.npy", np.zeros((5, 5, 2), np.int8))
    adopt(folder, "gradient_00.npy")
    with pytest.raises(MapError, match=r"gradient_00\.npy.*int8 \(1, 1, 256, 256, 2\)"):
        PackMap.open(folder)
    np.save(folder / "gradient_00.npy", np.array([{"a": 1}], dtype=object))
    adopt(folder, "gradient_00.npy")
    with pytest.raises(MapError, match=r"gradient_00\.npy"):
        PackMap.open(folder)


def test_raster_that_is_no_raster(folder: Path) -> None:
    (folder / "ortho.tif").write_bytes(b"II*\x00" + b"\xff" * 500)
    adopt(folder, "ortho.tif")
    with pytest.raises(MapError, match=r"ortho\.tif.*remedy"):
        PackMap.open(folder)


def test_folder_in_place_of_a_file(folder: Path) -> None:
    (folder / MANIFEST).unlink()
    (folder / MANIFEST).mkdir()
    with pytest.raises(MapError, match=r"manifest\.json"):
        PackMap.open(folder)
    shutil.rmtree(folder / MANIFEST)
