"""Files that change while a pack is made of them: no pack of two versions, and the file is named."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio

from tests.unit.prepare.test_build import PLACE, UTM, picture, slope
from visloc_companion.errors import MapError
from visloc_companion.maps.manifest import MANIFEST
from visloc_companion.prepare import work_folder
from visloc_companion.prepare.add_features import add_features
from visloc_companion.prepare.build import build_pack
from visloc_companion.testing.fake_features import FakeNetwork

SIDE = 600


@pytest.fixture
def folder(tmp_path: Path, write_raster, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Rasters that are read by windows: an orthophoto, another version of it, an earlier date of it and a surface model."""
    monkeypatch.setattr("visloc_companion.maps.geotiff.IN_MEMORY_BYTES", 1000)
    write_raster(tmp_path / "a.tif", picture(SIDE), UTM, PLACE, 1.0)
    write_raster(tmp_path / "new.tif", picture(SIDE, seed=2), UTM, PLACE, 1.0)
    write_raster(tmp_path / "b.tif", picture(SIDE), UTM, PLACE, 1.0)
    write_raster(tmp_path / "dsm.tif", slope(SIDE).astype(np.float32), UTM, PLACE, 1.0)
    return tmp_path


def once(at: str, act: Callable[[], object]) -> Callable[[str, float], None]:
    """A progress that acts when a stage is reported for the first time."""
    left = [act]

    def report(stage: str, share: float) -> None:
        del share
        if stage.startswith(at) and left:
            left.pop()()

    return report


def rewrite(path: Path) -> None:
    """Other pixels in the same file, as an export that goes over it leaves them."""
    with rasterio.open(path, "r+") as out:
        out.write(np.flipud(out.read(1)), 1)


@pytest.mark.parametrize("at", ["inputs", "orthophoto"])
@pytest.mark.parametrize("changed", ["a.tif", "dsm.tif"])
@pytest.mark.parametrize("how", ["rewritten", "replaced"])
def test_a_file_that_changes_while_a_pack_is_made_is_named(folder: Path, at: str, changed: str, how: str) -> None:
    path = folder / changed
    act = (lambda: rewrite(path)) if how == "rewritten" else (lambda: shutil.copyfile(folder / "new.tif", path))
    with pytest.raises(MapError, match=rf"{changed}: has changed while .*remedy: wait until nothing writes"):
        build_pack([folder / "a.tif"], folder / "dsm.tif", folder / "pack", progress=once(at, act))
    assert not (folder / "pack").exists() and not list(folder.glob(".pack*"))


@pytest.mark.parametrize("at", ["inputs", "orthophoto"])
@pytest.mark.parametrize("goes", [True, False])
def test_a_file_that_goes_or_breaks_meanwhile_is_told_as_changed(folder: Path, at: str, goes: bool) -> None:
    """Its pixels "cannot be read: download the file again", which is not what is wrong."""
    path = folder / "a.tif"
    content = path.read_bytes()
    with pytest.raises(MapError, match=r"a\.tif: has changed while"):
        act = path.unlink if goes else lambda: path.write_bytes(content[:9000])
        build_pack([path], folder / "dsm.tif", folder / "pack", progress=once(at, act))


def test_another_date_that_changes_is_named_and_the_old_pack_stays(folder: Path) -> None:
    orthos, dates = [folder / "a.tif"], [folder / "b.tif"]
    before = build_pack(orthos, None, folder / "pack", other_dates=dates)
    with pytest.raises(MapError, match=r"b\.tif: has changed while"):
        changed = once("features", lambda: rewrite(folder / "b.tif"))
        build_pack(orthos, None, folder / "pack", other_dates=dates, name="new", progress=changed)
    assert before.name in (folder / "pack" / MANIFEST).read_text()
    shutil.copyfile(folder / "a.tif", folder / "b.tif")
    network = FakeNetwork()
    with pytest.raises(MapError, match=r"b\.tif: has changed while"):
        changed = once("features", lambda: rewrite(folder / "b.tif"))
        add_features(folder / "pack", [network], other_dates=dates, progress=changed)


def test_features_are_not_added_to_a_pack_that_is_replaced_meanwhile(folder: Path) -> None:
    build_pack([folder / "a.tif"], None, folder / "pack")
    build_pack([folder / "new.tif"], None, folder / "other")

    def replaced() -> None:
        shutil.rmtree(folder / "pack")
        (folder / "other").rename(folder / "pack")

    with pytest.raises(MapError, match=r"manifest\.json: has changed while"):
        add_features(folder / "pack", [FakeNetwork()], progress=once("features", replaced))


def test_a_file_that_changed_since_the_build_was_broken_off_begins_it_anew(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was done of the old file would stand beside the new one."""
    monkeypatch.setattr(work_folder, "SYNC_S", 0.0)

    class Killed(BaseException):
        pass

    def kill() -> None:
        raise Killed

    with pytest.raises(Killed):
        build_pack([folder / "a.tif"], None, folder / "pack", progress=once("features", kill))
    assert list(folder.glob(".pack.building/ortho.tif"))
    shutil.copyfile(folder / "new.tif", folder / "a.tif")
    build_pack([folder / "a.tif"], None, folder / "pack", name="p")
    shutil.copyfile(folder / "pack" / "ortho.tif", folder / "resumed.tif")
    shutil.rmtree(folder / "pack")
    build_pack([folder / "a.tif"], None, folder / "pack", name="p")
    assert (folder / "pack" / "ortho.tif").read_bytes() == (folder / "resumed.tif").read_bytes()
