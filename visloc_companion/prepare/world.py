"""The embedded procedural world: the pack of its older date and the scene of its newer one, made once and kept."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import visloc_companion
from visloc_companion.app.with_parent import end_with_parent
from visloc_companion.errors import ConfigError
from visloc_companion.localise.features.base import Features
from visloc_companion.prepare.build import build_pack
from visloc_companion.prepare.kept_folders import draft_in, hold, remove_unused
from visloc_companion.prepare.shipped import shipped_networks
from visloc_companion.prepare.work_folder import synced
from visloc_companion.sim.land.season import Date
from visloc_companion.sim.landscape import build_landscape

CACHE_REMEDY = "set XDG_CACHE_HOME to a writable folder with 1 GB of space"
MAKERS = (
    *("sim/landscape.py", "sim/land/*.py", "sim/scene.py", "prepare/*.py", "maps/*.py", "localise/features/*.py"),
    *("localise/mapped/shadow.py", "localise/parabola.py", "geo/raster.py", "geo/wgs84.py"),
)
"""All code that what is in a world depends on."""


@dataclass(frozen=True, slots=True)
class ProceduralWorld:
    """Files of one world: the pack that the navigator has, and what the camera sees years later."""

    pack: Path
    flight_ortho: Path
    flight_dsm: Path


def cache_folder() -> Path:
    """Where worlds are kept: `$XDG_CACHE_HOME/visloc` or `~/.cache/visloc`. Raises ConfigError for a user without a home (a
    container's, of a number alone)."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "visloc"
    except RuntimeError as why:
        raise ConfigError(f"the procedural world cannot be kept: {why}", remedy=CACHE_REMEDY) from why


def procedural_world(
    seed: int,
    folder: Path | None = None,
    on_stage: Callable[[str], None] | None = None,
    size_m: float = 2000.0,
    networks: Sequence[Features] | None = None,
) -> ProceduralWorld:
    """The world of a seed, a square of `size_m`; kept in `folder` (by default the cache) and made only where it is missing.

    It stays while this process runs. When one is made, those that nobody has used for a week (of other versions) are removed
    (kept_folders.py). The two dates are made side by side, then the pack is built, with the features of `networks` (None: of the
    one that came with this version, where it can be opened). Made whole or not at all. Raises ConfigError for a folder that
    cannot be written, MapError where there is no space.
    """
    networks = shipped_networks()[0] if networks is None else networks
    home = (folder or cache_folder()) / f"landscape-{seed}-{size_m:g}m-{_digest(networks)}"
    world = ProceduralWorld(home / "pack", home / "flight" / "ortho.tif", home / "flight" / "dsm.tif")
    if hold(home):
        return world
    tell = on_stage or (lambda stage: None)
    with _draft(home.parent, ".landscape-") as draft:
        if removed := remove_unused(home.parent.glob("landscape-*")):
            tell(f"removed what nobody has used for a week: {', '.join(sorted(each.name for each in removed))}")
        tell("making the landscape of two dates")
        with ProcessPoolExecutor(2, mp_context=get_context("spawn"), initializer=end_with_parent) as pool:
            list(pool.map(_make_date, [seed] * 2, [size_m] * 2, ["map", "flight"], [draft] * 2))
        tell("building the map pack")
        build_pack(
            [draft / "map" / "ortho.tif"],
            draft / "map" / "dsm.tif",
            draft / "pack",
            source="procedural landscape",
            licence="CC0-1.0",
            capture_date="2021-07-15",
            networks=networks,
        )
        shutil.rmtree(draft / "map")
        _keep(draft, home)
    hold(home)
    return world


def scene_on(
    world: ProceduralWorld, date: Date, seed: int, on_stage: Callable[[str], None] | None = None, size_m: float = 2000.0
) -> tuple[Path, Path]:
    """Orthophoto and surface model of what the camera sees on a date over the world of a seed and a size.

    Any date but the world's own is made where it is missing, and kept beside it.
    """
    if date == "flight":
        return world.flight_ortho, world.flight_dsm
    home = world.pack.parent / date
    if not home.is_dir():
        if on_stage is not None:
            on_stage(f"making the landscape's {date}")
        with _draft(home.parent, f".{date}-") as draft:
            _make_date(seed, size_m, date, draft)
            _keep(draft / date, home)
    return home / "ortho.tif", home / "dsm.tif"


@contextmanager
def _draft(folder: Path, prefix: str) -> Iterator[Path]:
    with ExitStack() as kept:
        try:
            draft = kept.enter_context(draft_in(folder, prefix))
        except OSError as why:
            raise ConfigError(f"the procedural world cannot be kept: {why}", where=str(folder), remedy=CACHE_REMEDY) from why
        yield draft


def _keep(draft: Path, home: Path) -> None:
    """Give a draft its name once the disk has all of it: of a world that a loss of power emptied nobody would know."""
    for path in draft.rglob("*"):
        if path.is_file():
            synced(path)
    try:
        draft.rename(home)
    except OSError:
        if not home.is_dir():  # else another process was faster, with the very same world
            raise


def _digest(networks: Sequence[Features]) -> str:
    """Digest of the code and the networks that make a world, so that a kept one never outlives a change."""
    root = Path(visloc_companion.__file__).parent
    makers = [path for pattern in MAKERS for path in root.glob(pattern)]
    digest = hashlib.blake2b(digest_size=6)
    for path in sorted(makers):
        digest.update(path.read_bytes())
    for each in networks:
        digest.update(f"{each.name}\n{each.recipe}\n".encode())
    return digest.hexdigest()


def _make_date(seed: int, size_m: float, date: Date, folder: Path) -> None:
    build_landscape(seed, date, size_m).save(folder / date)
