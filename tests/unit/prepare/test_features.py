import errno
import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio

from visloc_companion.errors import HashMismatch, MapError, ModelError
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare import features, work_folder
from visloc_companion.prepare.add_features import add_features
from visloc_companion.prepare.build import build_pack
from visloc_companion.prepare.check import check_pack, features_info
from visloc_companion.prepare.features import level_grids
from visloc_companion.prepare.target import TargetGrid
from visloc_companion.prepare.work_folder import WorkFolder
from visloc_companion.testing.fake_features import FakeNetwork

UTM, PLACE = "EPSG:32633", (47.0, 15.3)
NETWORK, OTHER = FakeNetwork(), FakeNetwork("other-000000000000", "other 1", channels=4)
BUILD = """
import os, signal, sys
from dataclasses import dataclass
from pathlib import Path
from visloc_companion.prepare import add_features, build, features, work_folder
from visloc_companion.testing.fake_features import FakeNetwork
features.BLOCK_PX, work_folder.SYNC_S = 256, 0.0
calls = 0

class Mortal(FakeNetwork):
    def __call__(self, image, valid, margin_px=0):
        global calls
        calls += 1
        if calls > int(sys.argv[3]):
            os.kill(os.getpid(), signal.SIGKILL)
        return super().__call__(image, valid, margin_px)

folder = Path(sys.argv[1])
if sys.argv[2] == "build":
    build.build_pack([folder / "a.tif"], folder / "dsm.tif", folder / "pack", networks=[Mortal()])
else:
    add_features.add_features(folder / "pack", [Mortal()])
print(calls)
"""


@pytest.fixture
def sources(tmp_path: Path, write_raster) -> Path:
    rng = np.random.default_rng(1)
    image = np.kron(rng.integers(1, 255, (100, 100)), np.ones((4, 4))).astype(np.uint8)
    image[300:, 200:] = 0
    write_raster(tmp_path / "a.tif", image, UTM, PLACE, 0.5, nodata=0)
    write_raster(tmp_path / "dsm.tif", np.full((210, 210), 300, np.float32), UTM, PLACE, 1.0)
    return tmp_path


def digests(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}


def built_whole(folder: Path, what: str, monkeypatch: pytest.MonkeyPatch) -> int:
    """The work done at one go; how often the network was asked."""
    calls = []

    class Counted(FakeNetwork):
        def __call__(self, image, valid, margin_px=0):
            calls.append(image.shape)
            return super().__call__(image, valid, margin_px)

    monkeypatch.setattr(features, "BLOCK_PX", 256)
    if what == "build":
        build_pack([folder / "a.tif"], folder / "dsm.tif", folder / "pack", networks=[Counted()])
    else:
        add_features(folder / "pack", [Counted()])
    return len(calls)


def run(folder: Path, what: str, calls: int) -> tuple[int, str]:
    done = subprocess.run(
        [sys.executable, "-c", BUILD, str(folder), what, str(calls)], capture_output=True, text=True, check=False
    )
    return done.returncode, done.stdout.strip() or done.stderr


@pytest.mark.parametrize("what", ["build", "add"])
def test_killed_work_goes_on_and_ends_in_the_same_bytes(sources: Path, what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if what == "add":
        build_pack([sources / "a.tif"], sources / "dsm.tif", sources / "pack")
        before = digests(sources / "pack")
    whole = sources / "whole"
    shutil.copytree(sources, whole)
    all_calls = built_whole(whole, what, monkeypatch)
    assert run(sources, what, 5)[0] == -9
    if what == "add":
        assert digests(sources / "pack") == before, "the old pack stays as it is"
        PackMap.open(sources / "pack")
    else:
        assert not (sources / "pack").exists()
    log = sources / ".pack.building" / ".work.jsonl"
    log.write_text(log.read_text() + '{"torn')
    assert run(sources, what, 4)[0] == -9
    code, text = run(sources, what, 1000)
    assert code == 0, text
    assert int(text) == all_calls - 9, "what was done is not done again"
    assert digests(sources / "pack") == digests(whole / "pack")
    assert not list(sources.glob(".pack*"))
    PackMap.open(sources / "pack")


def test_work_left_behind_for_something_else_is_not_gone_on_with(sources: Path, write_raster) -> None:
    assert run(sources, "build", 5)[0] == -9
    write_raster(sources / "a.tif", np.random.default_rng(2).integers(1, 255, (300, 300)).astype(np.uint8), UTM, PLACE, 0.5)
    build_pack([sources / "a.tif"], sources / "dsm.tif", sources / "pack", networks=[NETWORK])
    shutil.copytree(sources / "pack", sources / "kept")
    shutil.rmtree(sources / "pack")
    build_pack([sources / "a.tif"], sources / "dsm.tif", sources / "pack", networks=[NETWORK])
    assert digests(sources / "pack") == digests(sources / "kept")


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_work_on_another_place_or_other_tiles_is_not_gone_on_with(
    sources: Path, write_raster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where a raster lies may stand beside it, and its pixels in other files: neither changes the file that is named."""
    monkeypatch.setattr("visloc_companion.prepare.work_folder.SYNC_S", 0.0)
    ortho, sheet = sources / "a.tif", sources / "a.vrt"
    with rasterio.open(ortho) as tiff:
        where, shape = tiff.transform, tiff.shape
    sheet.write_text(
        f'<VRTDataset rasterXSize="{shape[1]}" rasterYSize="{shape[0]}"><SRS>{UTM}</SRS><GeoTransform>'
        f'{", ".join(map(str, where.to_gdal()))}</GeoTransform><VRTRasterBand dataType="Byte" band="1"><SimpleSource>'
        '<SourceFilename relativeToVRT="1">a.tif</SourceFilename><SourceBand>1</SourceBand>'
        "</SimpleSource></VRTRasterBand></VRTDataset>"
    )
    plain = sources / "plain.tif"
    with rasterio.open(ortho) as tiff, rasterio.open(plain, "w", **(tiff.profile | {"transform": None})) as copy:
        copy.write(tiff.read())
    world = sources / "plain.tfw"
    write_world(world, where)

    def stopped(path: Path) -> None:
        def stop(stage: str, share: float) -> None:
            if stage == "features gradient":
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            build_pack([path], None, sources / "pack", progress=stop)

    stopped(plain)
    write_world(world, rasterio.Affine(where.a, where.b, where.c - 3 * where.a, where.d, where.e, where.f))
    manifest = build_pack([plain], None, sources / "pack")
    assert PackMap.open(sources / "pack").manifest == manifest
    assert [entry.file for entry in manifest.inputs] == ["plain.tif", "plain.tfw"]
    shutil.rmtree(sources / "pack")
    stopped(sheet)
    write_raster(ortho, np.full(shape, 77, np.uint8), UTM, PLACE, 0.5)
    build_pack([sheet], None, sources / "pack")
    with rasterio.open(sources / "pack" / "ortho.tif") as built:
        assert (built.read(1, window=((40, 200), (40, 200))) == 77).all()


def write_world(path: Path, where: rasterio.Affine) -> None:
    """A world file: it names the centre of the first pixel."""
    east, north = where.c + (where.a + where.b) / 2, where.f + (where.d + where.e) / 2
    path.write_text("\n".join(map(repr, (where.a, where.d, where.b, where.e, east, north))))


def test_adding_is_building_with_them(sources: Path) -> None:
    build_pack([sources / "a.tif"], sources / "dsm.tif", sources / "pack", capture_date="2020-01-02", networks=[NETWORK])
    build_pack([sources / "a.tif"], sources / "dsm.tif", sources / "later", capture_date="2020-01-02", name="pack")
    manifest = add_features(sources / "later", [NETWORK])
    assert digests(sources / "later") == digests(sources / "pack")
    assert PackMap.open(sources / "later").manifest == manifest
    add_features(sources / "later", [OTHER])
    assert [each["name"] for each in features_info(PackMap.open(sources / "later").manifest)] == [
        "gradient",
        NETWORK.name,
        OTHER.name,
    ]
    add_features(sources / "later", [NETWORK], replace=True)
    assert digests(sources / "later") == digests(sources / "pack"), "files of the dropped network are gone"


def test_damaged_and_foreign_packs_are_refused(sources: Path) -> None:
    with pytest.raises(MapError, match=r"manifest\.json"):
        add_features(sources, [NETWORK])
    build_pack([sources / "a.tif"], None, sources / "pack")
    raw = bytearray((sources / "pack" / "ortho.tif").read_bytes())
    raw[-100] ^= 4
    (sources / "pack" / "ortho.tif").write_bytes(raw)
    with pytest.raises(HashMismatch, match=r"ortho\.tif"):
        add_features(sources / "pack", [NETWORK])
    assert not list(sources.glob(".pack*"))


def test_links_that_the_disk_does_not_know_become_copies(sources: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    build_pack([sources / "a.tif"], None, sources / "pack")

    def refuse(*_: object) -> None:
        raise OSError("no links here")

    monkeypatch.setattr(os, "link", refuse)
    add_features(sources / "pack", [NETWORK])
    assert not PackMap.open(sources / "pack").why_not_stored(NETWORK.name, NETWORK.recipe)


@pytest.mark.parametrize("of", ["gradient", NETWORK.name])
def test_a_disk_that_fills_up_is_told_before_the_features_are_mapped(
    sources: Path, monkeypatch: pytest.MonkeyPatch, of: str
) -> None:
    """A write to a mapped file that the disk has no block for ends the process without a word."""

    def full(descriptor: int, offset: int, length: int) -> None:
        name = Path(f"/proc/self/fd/{descriptor}").readlink().name
        if name.startswith(of):
            assert (offset, length) == (0, os.fstat(descriptor).st_size) and length > 10_000
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr(os, "posix_fallocate", full)
        with pytest.raises(MapError, match=r"cannot be written: No space left on device .*; remedy: check the disk"):
            build_pack([sources / "a.tif"], None, sources / "pack", networks=[NETWORK])
    assert (sources / ".pack.building").is_dir()
    build_pack([sources / "a.tif"], None, sources / "pack", networks=[NETWORK])
    assert PackMap.open(sources / "pack").stored


def test_failing_network_leaves_the_old_pack(sources: Path) -> None:
    build_pack([sources / "a.tif"], None, sources / "pack")
    before = digests(sources / "pack")

    class Broken(FakeNetwork):
        def __call__(self, image, valid, margin_px=0):
            raise ModelError("answers what is not finite")

    with pytest.raises(ModelError, match="not finite"):
        add_features(sources / "pack", [Broken()])
    assert digests(sources / "pack") == before and not list(sources.glob(".pack*"))


def test_one_process_at_a_time(sources: Path) -> None:
    work = WorkFolder(sources / "pack", "key")
    with pytest.raises(MapError, match=r"pack: another process is at work"):
        build_pack([sources / "a.tif"], None, sources / "pack")
    work.remove()
    build_pack([sources / "a.tif"], None, sources / "pack")


def test_a_folder_that_is_being_named_is_not_begun_anew(sources: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between the end of its log and its name a second build emptied it, and the empty folder took the old pack's place."""
    told, flushed = list[str](), work_folder._entries_synced

    def a_second_one(folder: Path) -> None:
        if folder == work.path:
            with pytest.raises(MapError) as refused:
                WorkFolder(sources / "pack", "another key")
            told.append(str(refused.value))
        flushed(folder)

    build_pack([sources / "a.tif"], None, sources / "pack", name="first")
    monkeypatch.setattr(work_folder, "_entries_synced", a_second_one)
    with WorkFolder(sources / "pack", "key") as work:
        (work.path / "content").touch()
        work.take_name()
    assert (sources / "pack" / "content").exists()
    assert "another process is at work on it" in told[0]


def test_a_disk_that_knows_no_locks_is_built_on(sources: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """NFS without its lock daemon: "another process is at work on it"."""

    def none(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(work_folder.fcntl, "flock", none)
    assert build_pack([sources / "a.tif"], None, sources / "pack").files


@pytest.mark.parametrize("names", [("a/b",), ("",), ("net", "net"), ("gradient",)])
def test_names_that_cannot_be_stored(sources: Path, names: tuple[str, ...]) -> None:
    with pytest.raises(ModelError, match="name"):
        build_pack([sources / "a.tif"], None, sources / "pack", networks=[FakeNetwork(name) for name in names])


def test_levels_from_a_gsd_on() -> None:
    grid = TargetGrid(map_crs(UTM), 500_000.0, 5_200_000.0, 0.1, 4096, 4096, 3)
    assert [round(level.pixel, 3) for level in level_grids(grid)][:4] == [0.1, 0.141, 0.2, 0.283]
    assert [round(level.pixel, 3) for level in level_grids(grid, 0.4)][:2] == [0.4, 0.566]
    first = level_grids(grid, 0.33)[0]
    assert (first.number, round(first.pixel, 3)) == (3, 0.283), "0.33 is served by the level below"
    assert level_grids(grid, 1000.0) == level_grids(grid)[-1:], "the coarsest is always there"


def test_network_levels_and_their_size_are_stated(sources: Path) -> None:
    build_pack([sources / "a.tif"], sources / "dsm.tif", sources / "pack", networks=[NETWORK], finest_features_m=1.0)
    pack = PackMap.open(sources / "pack")
    gradient, network = features_info(pack.manifest)
    assert gradient["gsd_m"][0] == pytest.approx(0.5, rel=1e-3) and network["gsd_m"][0] == pytest.approx(1.0, rel=1e-3)
    assert (network["channels"], network["oriented"], network["recipe"]) == (10, 1, NETWORK.recipe)
    assert network["bytes"] == sum(path.stat().st_size for path in (sources / "pack").glob(f"{NETWORK.name}_*.npy"))
    assert network["bytes_per_km2"] == pytest.approx(network["bytes"] / (200 * 200e-6), rel=0.05)
    assert all(level.step * 127 == pytest.approx(NETWORK.bound) for level in pack.manifest.features if level.name == NETWORK.name)


def test_check_warns_of_features_that_will_be_computed_in_flight(sources: Path) -> None:
    build_pack([sources / "a.tif"], None, sources / "pack", networks=[NETWORK])
    pack = PackMap.open(sources / "pack")

    def warnings(*networks: FakeNetwork) -> list[str]:
        return [text for text in check_pack(pack, None, networks=networks)["warnings"] if "computed in flight" in text]

    assert warnings(NETWORK) == []
    assert len(warnings(OTHER)) == 1 and OTHER.name in warnings(OTHER)[0]
    assert "recipe" in warnings(FakeNetwork(recipe="fake 2"))[0]


def test_feature_files_are_checked_as_the_others_are(sources: Path) -> None:
    build_pack([sources / "a.tif"], None, sources / "pack", networks=[NETWORK])
    path = sources / "pack" / f"{NETWORK.name}_01.npy"
    raw = path.read_bytes()
    path.write_bytes(raw[:-1] + bytes([raw[-1] ^ 1]))
    with pytest.raises(HashMismatch, match=rf"{path.name}.*SHA-256.*remedy"):
        PackMap.open(sources / "pack")
    path.write_bytes(raw[:-5])
    with pytest.raises(HashMismatch, match=rf"{path.name}: has .* bytes"):
        PackMap.open(sources / "pack", verify_hashes=False)
    path.unlink()
    with pytest.raises(MapError, match=rf"{path.name}: the pack lacks"):
        PackMap.open(sources / "pack", verify_hashes=False)
