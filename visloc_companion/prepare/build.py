"""Build a map pack: all checks first, then everything into a folder beside the target, which then takes its name."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

import visloc_companion
from visloc_companion.errors import MapError
from visloc_companion.maps.geotiff import DatasetLayer, ground_gsd_m, layer_of, open_ortho
from visloc_companion.maps.layer import level_shapes
from visloc_companion.maps.manifest import (
    KIND,
    MANIFEST,
    SCHEMA,
    Bounds,
    CrsEntry,
    FileEntry,
    Grid,
    HeightEntry,
    Manifest,
    SourceEntry,
    is_manifest,
    sha256_file,
    write_manifest,
)
from visloc_companion.prepare import features
from visloc_companion.prepare.mosaic import Step, write_ortho
from visloc_companion.prepare.surface import Datum, Surface, make_surface, surface_sources, write_surface
from visloc_companion.prepare.target import Source, TargetGrid, pack_grid

Progress = Callable[[str, float], None]
"""Called with the name of the stage and the share of it (0 to 1) that is done."""
ORTHO = "ortho.tif"


def build_pack(
    orthos: Sequence[Path],
    dsm: Path | None,
    out: Path,
    *,
    clouds: Sequence[Path] = (),
    cloud_crs: str = "",
    name: str = "",
    source: str = "",
    licence: str = "",
    capture_date: str = "",
    ground_h_amsl_m: float = 0.0,
    vertical_datum: Datum | None = None,
    geoid_undulation_m: float | None = None,
    progress: Progress | None = None,
) -> Manifest:
    """Build a pack from GeoTIFFs (the first orthophoto on top), and from clouds where there is no surface model.
    `cloud_crs` is that of clouds that state none.

    Without either the ground is the plane `ground_h_amsl_m`. `vertical_datum` is that of the surface; where heights are
    ellipsoidal, h_amsl = h_ell - `geoid_undulation_m`. An existing pack is replaced when the new one is whole; a build that
    was broken off starts anew. Returns the manifest. Raises MapError and DatumMissing for files that cannot be used, too
    little disk space, and a target that is something else than a pack.
    """
    report = progress or _no_progress
    _check_target(out)
    if not orthos:
        raise MapError("no orthophoto is given", remedy="--ortho FILE")
    sources = [_ortho_source(path) for path in orthos]
    grid = pack_grid(sources)
    surface = make_surface(surface_sources(dsm, clouds, cloud_crs), grid, vertical_datum, geoid_undulation_m)
    _check_space(out, grid, surface, max(each.layer.channels for each in sources))
    building = out.absolute().with_name(f".{out.name}.building")
    shutil.rmtree(building, ignore_errors=True)
    building.mkdir(parents=True)
    try:
        share = write_ortho(building / ORTHO, grid, sources, _stage(report, "orthophoto", grid.rows * grid.cols))
        if not share:
            raise MapError("holds no valid pixel", where=str(orthos[0]), remedy="name an orthophoto with content")
        heights = _heights(building, grid, surface, ground_h_amsl_m, report)
        pixels = DatasetLayer(open_ortho(building / ORTHO), level_shapes(grid.rows, grid.cols))
        levels = features.write_features(building, grid, pixels, _stage(report, "features", features.total_pixels(grid)))
        inputs = [*orthos, *([dsm] if dsm else clouds)]
        manifest = Manifest(
            kind=KIND,
            schema_version=SCHEMA,
            name=name or out.name,
            software=f"visloc-companion {visloc_companion.__version__}",
            crs=CrsEntry(name=grid.crs.name, epsg=grid.crs.epsg, wkt=grid.crs.wkt),
            gsd_m=ground_gsd_m(grid.crs, grid.T_map_pix, (grid.rows, grid.cols)),
            bounds=_bounds(grid),
            capture_date=capture_date,
            source=source,
            licence=licence,
            share_valid=share,
            ortho=Grid(file=ORTHO, rows=grid.rows, cols=grid.cols, transform=grid.transform),
            heights=heights,
            features=levels,
            inputs=tuple(SourceEntry(file=path.name, sha256=sha256_file(path)) for path in inputs),
            files=_hashed(building, report),
        )
        write_manifest(building, manifest)
        _replace(building, out.absolute())
    finally:
        shutil.rmtree(building, ignore_errors=True)
    return manifest


def _ortho_source(path: Path) -> Source:
    tiff = open_ortho(path)
    gsd_m = tiff.gsd_m
    return Source(str(path), layer_of(tiff), tiff.crs, gsd_m)


def _heights(folder: Path, grid: TargetGrid, surface: Surface | None, plane_h_amsl_m: float, report: Progress) -> HeightEntry:
    if surface is None:
        return HeightEntry(
            source_datum="amsl",
            geoid_undulation_m=None,
            plane_amsl_m=plane_h_amsl_m,
            grid=None,
            share_known=1.0,
            share_filled=0.0,
        )
    step = _stage(report, "surface model", surface.grid.rows * surface.grid.cols)
    return write_surface(folder, surface, grid, plane_h_amsl_m, step)


def _check_target(out: Path) -> None:
    """A folder that is empty or a pack (of any version, whole or not) may be replaced."""
    if not out.exists() or (out.is_dir() and (not any(out.iterdir()) or is_manifest(out / MANIFEST))):
        return
    raise MapError("exists and is no map pack", where=str(out), remedy="name a folder that does not exist yet, or remove it")


def _check_space(out: Path, grid: TargetGrid, surface: Surface | None, channels: int) -> None:
    """The plain raster and its optimised copy (with overviews) lie side by side for a while."""
    need = grid.rows * grid.cols * (channels + 1) * 2.4 + features.total_pixels(grid) * 2
    need += surface.grid.rows * surface.grid.cols * 4 * 2.4 if surface else 0
    folder = next(parent for parent in out.absolute().parents if parent.exists())
    free = shutil.disk_usage(folder).free
    if free < need * 1.05:
        raise MapError(
            f"needs {need / 1e9:.2f} GB of disk, {free / 1e9:.2f} GB are free",
            where=str(folder),
            remedy="free space, or build elsewhere",
        )


def _bounds(grid: TargetGrid) -> Bounds:
    west, south, east, north = grid.bounds
    x, y = np.meshgrid(np.linspace(west, east, 17), np.linspace(south, north, 17))
    geo = grid.crs.to_geo_array(np.column_stack([x.ravel(), y.ravel()]))
    (south_deg, west_deg), (north_deg, east_deg) = (tuple(float(v) for v in f(geo, axis=0)) for f in (np.min, np.max))
    return Bounds(
        west_map_m=west,
        south_map_m=south,
        east_map_m=east,
        north_map_m=north,
        west_deg=west_deg,
        south_deg=south_deg,
        east_deg=east_deg,
        north_deg=north_deg,
    )


def _hashed(folder: Path, report: Progress) -> dict[str, FileEntry]:
    paths = sorted(folder.iterdir())
    entries = {}
    for n, path in enumerate(paths):
        with path.open("rb") as stream:
            os.fsync(stream.fileno())
        entries[path.name] = FileEntry(bytes=path.stat().st_size, sha256=sha256_file(path))
        report("hashes", (n + 1) / len(paths))
    return entries


def _replace(building: Path, out: Path) -> None:
    """Give the finished folder its name; an old pack goes only after that."""
    old = out.with_name(f".{out.name}.old")
    shutil.rmtree(old, ignore_errors=True)
    if out.exists():
        out.rename(old)
    try:
        building.rename(out)
    except OSError:
        with suppress(OSError):
            old.rename(out)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _stage(report: Progress, name: str, total: int) -> Step:
    done = 0

    def step(pixels: int) -> None:
        nonlocal done
        done += pixels
        report(name, min(1.0, done / max(1, total)))

    return step


def _no_progress(stage: str, share: float) -> None:
    del stage, share
