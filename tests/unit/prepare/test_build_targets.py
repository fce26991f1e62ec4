"""Where a pack is written: what is there already, links, names that nothing can be written to, full disks, builds that fail."""

import errno
import json
import os
import resource
import shutil
from pathlib import Path

import pytest

from tests.unit.prepare.test_build import PLACE, UTM, picture
from visloc_companion.errors import MapError
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare import replaced, work_folder
from visloc_companion.prepare.add_features import add_features
from visloc_companion.prepare.build import build_pack


def test_targets(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", picture(100), UTM, PLACE, 1.0)
    orthos = [tmp_path / "a.tif"]
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years of work")
    (tmp_path / "file").write_text("x")
    for target in ("mine", "file"):
        with pytest.raises(MapError, match=f"{target}: exists"):
            build_pack(orthos, None, tmp_path / target)
    assert (tmp_path / "mine" / "thesis.txt").read_text() == "years of work"
    (tmp_path / "mine" / "manifest.json").write_text(json.dumps({"kind": "something else"}))
    with pytest.raises(MapError, match="mine: exists"):
        build_pack(orthos, None, tmp_path / "mine")
    (tmp_path / "empty").mkdir()
    build_pack(orthos, None, tmp_path / "empty", name="first")
    (tmp_path / ".empty.building").mkdir()
    (tmp_path / ".empty.building" / "left.tif").write_text("from a build of something else that was killed")
    build_pack(orthos, None, tmp_path / "empty", name="second")
    assert PackMap.open(tmp_path / "empty").manifest.name == "second"
    assert not list(tmp_path.glob(".empty*"))


def test_what_lies_in_a_pack_without_being_part_of_it_is_not_lost(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", picture(100), UTM, PLACE, 1.0)
    build_pack([tmp_path / "a.tif"], None, tmp_path / "pack")
    (tmp_path / "pack" / "mission.plan").write_text("mine")
    for rebuild in (
        lambda: build_pack([tmp_path / "a.tif"], None, tmp_path / "pack"),
        lambda: add_features(tmp_path / "pack", []),
    ):
        with pytest.raises(MapError, match=r"pack: holds 'mission\.plan'.*remedy"):
            rebuild()
    assert (tmp_path / "pack" / "mission.plan").read_text() == "mine"


def test_a_mount_point_is_refused_before_the_work(tmp_path: Path, write_raster, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a container's volume is one: an hour of work ended in "Device or resource busy", however often it was gone on with."""
    write_raster(tmp_path / "a.tif", picture(100), UTM, PLACE, 1.0)
    build_pack([tmp_path / "a.tif"], None, tmp_path / "my pack")
    told = str(tmp_path / "my pack").replace(" ", "\\040")
    (tmp_path / "mounts").write_text(f"22 1 8:1 / / rw - ext4 /dev/sda1 rw\n23 22 8:1 /there {told} rw - ext4 /dev/sda1 rw\n")
    monkeypatch.setattr(replaced, "MOUNTS", tmp_path / "mounts")
    (tmp_path / "link").symlink_to(tmp_path / "my pack")
    for rebuild in (
        lambda: build_pack([tmp_path / "a.tif"], None, tmp_path / "link"),
        lambda: add_features(tmp_path / "my pack", []),
    ):
        with pytest.raises(MapError, match=r"is a mount point.*name a folder in it"):
            rebuild()
    build_pack([tmp_path / "a.tif"], None, tmp_path / "my pack 2")


def test_a_link_as_target_stays_and_leads_to_the_new_pack(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", picture(100), UTM, PLACE, 1.0)
    (tmp_path / "disk").mkdir()
    (tmp_path / "pack").symlink_to(tmp_path / "disk" / "pack")
    for name in ("first", "second", "third"):
        build_pack([tmp_path / "a.tif"], None, tmp_path / "pack", name=name)
        assert (tmp_path / "pack").is_symlink() and PackMap.open(tmp_path / "disk" / "pack").manifest.name == name
    assert {path.name for path in (*tmp_path.iterdir(), *(tmp_path / "disk").iterdir())} == {"a.tif", "disk", "pack"}


def test_places_and_names_that_nothing_can_be_written_to(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", picture(100), UTM, PLACE, 1.0)
    with pytest.raises(MapError, match="no folder can be made there: Not a directory; remedy"):
        build_pack([tmp_path / "a.tif"], None, tmp_path / "a.tif" / "pack")
    with pytest.raises(MapError, match="is not written in UTF-8; remedy"):
        build_pack([tmp_path / "a.tif"], None, tmp_path / os.fsdecode(b"pack\xff"))
    with pytest.raises(MapError, match="is not written in UTF-8; remedy"):
        build_pack([tmp_path / os.fsdecode(b"a\xff.tif")], None, tmp_path / "pack")


def test_a_full_disk_is_told_and_the_work_is_gone_on_with(tmp_path: Path, write_raster, monkeypatch: pytest.MonkeyPatch) -> None:
    write_raster(tmp_path / "a.tif", picture(100), UTM, PLACE, 1.0)

    def full(*_: object, **__: object) -> None:
        raise type("CPLE_AppDefinedError", (Exception,), {})("Write error at scanline 0")  # GDAL's own, as rasterio hands it on

    with monkeypatch.context() as patched:
        patched.setattr("rasterio.shutil.copy", full)
        with pytest.raises(MapError, match=r"cannot be written: Write error.* \([0-9.]+ [GM]B are free there\); remedy: check"):
            build_pack([tmp_path / "a.tif"], None, tmp_path / "pack")
    assert (tmp_path / ".pack.building").is_dir()
    build_pack([tmp_path / "a.tif"], None, tmp_path / "pack")
    assert PackMap.open(tmp_path / "pack").manifest.share_valid == 1.0


def test_a_write_that_the_system_refuses_is_told_with_its_reason(tmp_path: Path, write_raster) -> None:
    """By a limit of the size of files: rasterio says "Write failed. See previous exception for details"."""
    write_raster(tmp_path / "a.tif", picture(300), UTM, PLACE, 1.0)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, before[1]))
    try:
        with pytest.raises(MapError, match=r"ortho\.tif: cannot be written: TIFF.*rror.*; remedy: check the disk"):
            build_pack([tmp_path / "a.tif"], None, tmp_path / "pack")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_old_pack_survives_a_failing_build(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", picture(100), UTM, PLACE, 1.0)
    build_pack([tmp_path / "a.tif"], None, tmp_path / "pack", name="old")

    def stop(stage: str, share: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build_pack([tmp_path / "a.tif"], None, tmp_path / "pack", name="new", progress=stop)
    assert PackMap.open(tmp_path / "pack").manifest.name == "old"
    build_pack([tmp_path / "a.tif"], None, tmp_path / "pack", name="new")
    assert PackMap.open(tmp_path / "pack").manifest.name == "new"
    assert not list(tmp_path.glob(".pack*"))


def test_disk_space_is_asked_for_first(tmp_path: Path, write_raster, monkeypatch: pytest.MonkeyPatch) -> None:
    write_raster(tmp_path / "a.tif", picture(100), UTM, PLACE, 1.0)
    monkeypatch.setattr("shutil.disk_usage", lambda path: type("Usage", (), {"free": 10_000})())
    with pytest.raises(MapError, match=r"needs 0\.4 MB of disk, 0\.0 MB are free; remedy: free space"):
        build_pack([tmp_path / "a.tif"], None, tmp_path / "pack")
    assert not list(tmp_path.glob(".pack*"))


def test_what_is_done_stays_where_the_disk_lacks_the_space_for_the_rest(
    tmp_path: Path, write_raster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full disk broke a build off, "then give the command again: it goes on with what is done"; that deleted what was done."""
    write_raster(tmp_path / "a.tif", picture(100), UTM, PLACE, 1.0)
    monkeypatch.setattr(work_folder, "SYNC_S", 0.0)

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(tmp_path / "x"))

    with monkeypatch.context() as patched:
        patched.setattr("visloc_companion.prepare.build.feature_levels", full)
        with pytest.raises(MapError, match="No space left"):
            build_pack([tmp_path / "a.tif"], None, tmp_path / "pack")
    with monkeypatch.context() as patched:
        patched.setattr("shutil.disk_usage", lambda path: type("Usage", (), {"free": 10_000})())
        with pytest.raises(MapError, match=r"of disk, .* are free; remedy: free space"):
            build_pack([tmp_path / "a.tif"], None, tmp_path / "pack")
    assert (tmp_path / ".pack.building" / "ortho.tif").is_file()
    monkeypatch.setattr("visloc_companion.prepare.build.write_ortho", lambda *_: pytest.fail("written again"))
    assert build_pack([tmp_path / "a.tif"], None, tmp_path / "pack").share_valid == 1.0


@pytest.mark.parametrize("can_exchange", [True, False])
def test_a_new_pack_is_on_the_disk_before_the_old_one_goes(
    tmp_path: Path, write_raster, monkeypatch: pytest.MonkeyPatch, can_exchange: bool
) -> None:
    """A loss of power left the new name with an empty manifest, without the old pack and without the work to go on with."""
    write_raster(tmp_path / "a.tif", picture(100), UTM, PLACE, 1.0)
    files = [tmp_path / "a.tif"], None, tmp_path / "pack"
    build_pack(*files)
    synced: set[Path] = set()
    fsync, rename, exchange = os.fsync, Path.rename, work_folder.exchange

    def noted(descriptor: int) -> None:
        fsync(descriptor)
        synced.add(Path(f"/proc/self/fd/{descriptor}").readlink())

    def renamed(path: Path, target: Path) -> Path:
        assert {path, *path.iterdir()} <= synced or path.name == "pack"
        return rename(path, target)

    def exchanged(one: Path, other: Path) -> bool:
        assert {one, *one.iterdir()} <= synced
        return exchange(one, other) if can_exchange else False

    monkeypatch.setattr(os, "fsync", noted)
    monkeypatch.setattr(Path, "rename", renamed)
    monkeypatch.setattr(work_folder, "exchange", exchanged)
    removed: list[Path] = []

    def gone(path: Path, **_: object) -> None:
        if path.exists():
            assert tmp_path in synced
            removed.append(path)

    monkeypatch.setattr(shutil, "rmtree", gone)
    build_pack(*files)
    assert removed == [tmp_path / ".pack.old"]


def test_there_is_a_pack_at_every_moment(tmp_path: Path, write_raster, monkeypatch: pytest.MonkeyPatch) -> None:
    """Killed between two renames, a build left no pack, and the next one deleted what was whole; a daemon that began then had no
    map."""
    write_raster(tmp_path / "a.tif", picture(100), UTM, PLACE, 1.0)
    files = [tmp_path / "a.tif"], None, tmp_path / "pack"
    build_pack(*files, name="first")
    rename, seen = Path.rename, list[str]()

    def renamed(path: Path, target: Path) -> Path:
        seen.append(PackMap.open(tmp_path / "pack").manifest.name)
        moved = rename(path, target)
        seen.append(PackMap.open(tmp_path / "pack").manifest.name)
        return moved

    monkeypatch.setattr(Path, "rename", renamed)
    build_pack(*files, name="second")
    assert seen == ["second", "second"]
    assert {path.name for path in tmp_path.iterdir()} == {"a.tif", "pack"}
