"""The procedural world: made once, whole or not at all."""

from __future__ import annotations

import ast
import os
from pathlib import Path

import numpy as np
import pytest

import visloc_companion
from visloc_companion.errors import ConfigError
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare import world as module
from visloc_companion.prepare.world import ProceduralWorld, cache_folder, procedural_world, scene_on
from visloc_companion.sim.landscape import build_landscape
from visloc_companion.sim.scene import Scene
from visloc_companion.testing.fake_features import FakeNetwork

SIZE_M = 400.0


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ProceduralWorld, list[str]]:
    folder, told = tmp_path_factory.mktemp("worlds"), list[str]()
    return folder, procedural_world(3, folder, told.append, SIZE_M, ()), told


def test_the_pack_is_the_older_date_and_the_scene_the_newer(kept: tuple[Path, ProceduralWorld, list[str]]) -> None:
    _, world, _ = kept
    pack = PackMap.open(world.pack, verify_hashes=True)
    assert pack.shape == (800, 800)
    newer = Scene.load(world.flight_ortho, world.flight_dsm)
    assert np.array_equal(newer.pixels, build_landscape(3, "flight", SIZE_M).pixels)
    assert newer.center_map == pytest.approx(pack.center_map_m, abs=0.01)
    older = build_landscape(3, "map", SIZE_M)
    patch = pack.patch(pack.center_map_m, (300, 300), 0.5, 0.0)
    assert np.mean(np.abs(patch.pixels.astype(float) - older.pixels[250:550, 250:550])) < 3.0
    assert np.mean(np.abs(patch.pixels.astype(float) - newer.pixels[250:550, 250:550])) > 10.0


def test_it_is_made_only_once(kept: tuple[Path, ProceduralWorld, list[str]]) -> None:
    folder, world, told = kept
    again: list[str] = []
    before = sorted((path, path.stat().st_mtime_ns) for path in folder.rglob("*"))
    assert procedural_world(3, folder, again.append, SIZE_M, ()) == world
    assert sorted((path, path.stat().st_mtime_ns) for path in folder.rglob("*")) == before
    assert (told, again) == (["making the landscape of two dates", "building the map pack"], [])


def test_another_date_is_made_once_and_kept_beside(kept: tuple[Path, ProceduralWorld, list[str]]) -> None:
    _, world, _ = kept
    told: list[str] = []
    ortho, dsm = scene_on(world, "snow", 3, told.append, SIZE_M)
    snow = Scene.load(ortho, dsm)
    assert np.array_equal(snow.pixels, build_landscape(3, "snow", SIZE_M).pixels)
    assert told == ["making the landscape's snow"]
    assert scene_on(world, "snow", 3, told.append, SIZE_M) == (ortho, dsm)
    assert len(told) == 1
    assert scene_on(world, "flight", 3, told.append, SIZE_M) == (world.flight_ortho, world.flight_dsm)
    assert not [path for path in ortho.parent.parent.iterdir() if path.name.startswith(".")], "no draft is left"


def test_another_network_makes_another_world() -> None:
    digests = {module._digest(networks) for networks in ((), [FakeNetwork()], [FakeNetwork(recipe="fake 2")])}
    assert len(digests) == 3


def test_nothing_is_left_of_a_world_that_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The next attempt begins anew, and never finds half a world."""
    monkeypatch.setattr(module, "ProcessPoolExecutor", _Broken)
    with pytest.raises(OSError, match="no space left"):
        procedural_world(3, tmp_path, size_m=SIZE_M, networks=())
    assert list(tmp_path.iterdir()) == []


class _Broken:
    def __init__(self, *_: object, **__: object) -> None:
        raise OSError("no space left")


def test_who_was_faster_wins(tmp_path: Path) -> None:
    """Two processes make the same world: the second one's draft gives way to the first one's world."""
    draft, home = tmp_path / "draft", tmp_path / "home"
    for folder in (draft, home):
        folder.mkdir()
        (folder / folder.name).touch()
    module._keep(draft, home)
    assert [path.name for path in home.iterdir()] == ["home"]
    with pytest.raises(OSError, match="missing"):
        module._keep(tmp_path / "missing", tmp_path / "other")


def test_a_draft_is_on_the_disk_before_it_has_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After a loss of power a kept world may else be one of empty files, and every flight over it fails."""
    draft, home = tmp_path / ".draft", tmp_path / "landscape"
    (draft / "flight").mkdir(parents=True)
    for path in (draft / "flight" / "ortho.tif", draft / "flight" / "dsm.tif"):
        path.write_bytes(b"pixels")
    on_disk, fsync, rename = set[str](), os.fsync, Path.rename

    def noted(descriptor: int) -> None:
        fsync(descriptor)
        on_disk.add(Path(f"/proc/self/fd/{descriptor}").readlink().name)

    def renamed(path: Path, target: Path) -> Path:
        assert on_disk == {"ortho.tif", "dsm.tif"}
        return rename(path, target)

    monkeypatch.setattr(os, "fsync", noted)
    monkeypatch.setattr(Path, "rename", renamed)
    module._keep(draft, home)
    assert (home / "flight" / "ortho.tif").is_file()


def test_the_cache_is_the_users(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "visloc"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "visloc"


def test_a_user_without_a_home_is_told_what_to_set(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a container that is run as a number: a traceback of pathlib's."""

    def none(_: object) -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", classmethod(none))
    with pytest.raises(ConfigError, match=r"cannot be kept: Could not determine home.*set XDG_CACHE_HOME"):
        cache_folder()


def test_other_code_makes_another_world(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The digest of the code that makes worlds is part of the folder's name."""
    package = tmp_path / "visloc_companion"
    (package / "sim" / "land").mkdir(parents=True)
    monkeypatch.setattr(visloc_companion, "__file__", str(package / "__init__.py"))
    digests = []
    for text in ("a = 1\n", "a = 2\n"):
        (package / "sim" / "land" / "landscape_x.py").write_text(text)
        digests.append(module._digest(()))
    (package / "sim" / "vehicle.py").write_text("b = 1\n")
    assert digests[0] != digests[1] == module._digest(())


def test_all_code_that_makes_a_world_makes_another_one_where_it_changes() -> None:
    """A change of localise/mapped/shadow.py left kept worlds with the shadows of before."""
    root = Path(visloc_companion.__file__).parents[1]
    folder = root / "visloc_companion"
    made_by, left = set[Path](), [folder / "sim" / "landscape.py", folder / "prepare" / "build.py"]
    while left:
        path = left.pop()
        if path not in made_by:
            made_by.add(path)
            left += imported_by(path, root)
    makers = {path for pattern in module.MAKERS for path in folder.glob(pattern)}
    words = {folder / "__init__.py", folder / "errors.py", *(folder / "types").glob("*.py")}
    assert made_by <= makers | words


def imported_by(path: Path, root: Path) -> list[Path]:
    """Files of this package that a file imports, functions' own imports too."""
    names = set[str]()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    places = [root.joinpath(*name.split(".")) for name in names]
    return [file for place in places for file in (place.with_suffix(".py"), place / "__init__.py") if file.is_file()]


def test_a_cache_that_cannot_be_written_is_told_with_what_to_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    with pytest.raises(ConfigError, match=r"file/visloc: the procedural world cannot be kept.*set XDG_CACHE_HOME"):
        procedural_world(3, size_m=SIZE_M, networks=())
