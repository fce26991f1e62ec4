"""Build a map pack: all checks first, then everything into a folder beside the target, which then takes its name."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

import visloc_companion
from visloc_companion.errors import DatumMissing, MapError
from visloc_companion.localise.features.base import Features
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.maps.geotiff import files_of, stretches_of
from visloc_companion.maps.ground_pixel import ground_gsd_m
from visloc_companion.maps.manifest import (
    KIND,
    SCHEMA,
    Bounds,
    CrsEntry,
    Grid,
    HeightEntry,
    Manifest,
    SourceEntry,
    require_utf8,
    source_entry,
    write_manifest,
)
from visloc_companion.maps.spilled import Spill
from visloc_companion.prepare.cloud_points import PackCloud, pack_cloud, write_cloud
from visloc_companion.prepare.dates import dated_sources
from visloc_companion.prepare.defaults import FINEST_FEATURES_M
from visloc_companion.prepare.features import (
    check_names,
    feature_levels,
    stored_bytes,
    wanted_levels,
)
from visloc_companion.prepare.mosaic import write_ortho
from visloc_companion.prepare.replaced import check_target, existing_parent
from visloc_companion.prepare.seams import seams
from visloc_companion.prepare.specks import specks
from visloc_companion.prepare.surface import Datum, Surface, make_surface, surface_sources, write_surface
from visloc_companion.prepare.target import Source, TargetGrid, finer_than_first, ortho_source, pack_grid, reprojected_from
from visloc_companion.prepare.unchanged import Unchanged
from visloc_companion.prepare.work_folder import Progress, WorkFolder, stage, synced, work_key
from visloc_companion.types import FloatArray

ORTHO = "ortho.tif"
SOFTWARE = f"visloc-companion {visloc_companion.__version__}"


def build_pack(
    orthos: Sequence[Path],
    dsm: Path | Sequence[Path] | None,
    out: Path,
    *,
    other_dates: Sequence[Path] = (),
    clouds: Sequence[Path] = (),
    cloud_crs: str = "",
    name: str = "",
    source: str = "",
    licence: str = "",
    capture_date: str = "",
    ground_h_amsl_m: float = 0.0,
    vertical_datum: Datum | None = None,
    geoid_undulation_m: float | None = None,
    networks: Sequence[Features] = (),
    finest_features_m: float = FINEST_FEATURES_M,
    sign: Callable[[bytes, Path], None] | None = None,
    progress: Progress | None = None,
    warn: Callable[[str], None] | None = None,
) -> Manifest:
    """Build a pack from GeoTIFFs (of orthophotos, and of surface models, the first on top) and clouds.

    `other_dates` are orthophotos of other dates: the features are the mean over all dates, pixels and grid are those of `orthos`.
    `cloud_crs` is that of clouds that state none.
    The pack keeps the clouds' upper points; where there is no surface model, they make that as well. Without either the ground
    is the plane `ground_h_amsl_m`. `vertical_datum` is that of the surface; where heights are
    ellipsoidal, h_amsl = h_ell - `geoid_undulation_m`. The gradient's features are stored at all levels, those of `networks`
    at levels from the GSD `finest_features_m` on. An existing pack is replaced when the new one is whole; a build of the same
    inputs that was broken off is gone on with, and ends in the same bytes. `sign` is given the manifest's bytes and the folder
    before that has its name (`prepare.sign.Signer.sign`). `warn` is told what of the orthophotos and of the
    surface models does not fit together. Returns the manifest. Raises MapError and DatumMissing for files that cannot be used or
    that change meanwhile, too little disk space, and a target that is something else than a pack, ModelError for networks whose
    names are no file names.
    """
    report = progress or _no_progress
    dsms = [dsm] if isinstance(dsm, Path) else list(dsm or ())
    require_utf8(*map(str, (*orthos, *other_dates, *dsms, *clouds, out)), name, source, licence)
    check_target(out)
    functions = (GRADIENT, *networks)
    check_names(functions)
    if not orthos:
        raise MapError("no orthophoto is given", remedy="--ortho FILE")
    rasters = [file for path in (*orthos, *dsms) for file in files_of(path)]
    used, dated = Unchanged([*rasters, *clouds]), Unchanged(file for path in other_dates for file in files_of(path))
    stretches = stretches_of(orthos)
    spill = Spill(existing_parent(out))
    sources = [ortho_source(path, stretches, spill) for path in orthos]
    grid = pack_grid(sources)
    dates = dated_sources(other_dates, sources, grid, spill)
    cloud = pack_cloud(clouds, cloud_crs, grid, vertical_datum, geoid_undulation_m)
    surface = make_surface(surface_sources(dsms, clouds, cloud_crs, spill), grid, vertical_datum, geoid_undulation_m)
    _check_undulation(geoid_undulation_m, surface, cloud)
    if vertical_datum == "ellipsoidal" and surface is None and cloud is None:
        raise DatumMissing(
            "there are no heights but that of the ground, which counts above sea level",
            where="--vertical-datum ellipsoidal",
            remedy="--ground-height-m: the ground's height above sea level; or --dsm, --cloud",
        )
    if warn is not None:
        steps = seams(surface.sources, surface.grid, "surface models" if dsms else "clouds") if surface is not None else []
        coarse = finer_than_first(surface.sources, sources[0].gsd_m) if surface is not None and dsms else []
        for said in (*finer_than_first(sources), *specks(sources, orthos), *coarse, *steps):
            warn(said)
    inputs = tuple(_inputs([*rasters, *clouds], report))
    made_from: list[object] = [
        cloud_crs,
        ground_h_amsl_m,
        vertical_datum,
        geoid_undulation_m,
        len(orthos),
        len(dsms),
        len(clouds),
        *(date.laid.model_dump(mode="json") for date in dates),
    ]
    made_from += [finest_features_m, *(entry.sha256 for entry in inputs), *((each.name, each.recipe) for each in functions)]
    used.require()  # what was hashed is what was opened
    with used, dated, WorkFolder(out, work_key("build", SOFTWARE, made_from)) as work:
        _check_space(work, grid, surface, cloud, max(each.layer.channels for each in sources), functions, finest_features_m)
        share = _ortho(work, grid, sources, report)
        heights = _heights(work, grid, surface, ground_h_amsl_m, report)
        points = write_cloud(work, cloud, report)
        used.require()
        levels = feature_levels(work, grid, work.path / ORTHO, functions, finest_features_m, report, dates)
        dated.require()
        names = [ORTHO, *([heights.grid.file] if heights.grid else []), *(level.file for level in levels)]
        names += [points.points, points.tiles] if points else []
        manifest = Manifest(
            kind=KIND,
            schema_version=SCHEMA,
            name=name or (out.resolve() if out.name in ("", "..") else out).name,
            software=SOFTWARE,
            crs=CrsEntry(name=grid.crs.name, epsg=grid.crs.epsg, wkt=grid.crs.wkt),
            reprojected_from=reprojected_from(sources, grid.crs),
            gsd_m=ground_gsd_m(grid.crs, grid.T_map_pix, (grid.rows, grid.cols), str(out)),
            bounds=_bounds(grid),
            capture_date=capture_date,
            source=source,
            licence=licence,
            share_valid=share,
            ortho=Grid(file=ORTHO, rows=grid.rows, cols=grid.cols, transform=grid.transform),
            heights=heights,
            features=levels,
            cloud=points,
            inputs=inputs,
            other_dates=tuple(date.laid for date in dates),
            files=work.hashed(names, report),
        )
        raw = write_manifest(work.path, manifest)
        if sign is not None:
            sign(raw, work.path)
        work.take_name()
    return manifest


def _inputs(paths: Sequence[Path], report: Progress) -> Iterator[SourceEntry]:
    for n, path in enumerate(paths):
        yield source_entry(path)
        report("inputs", (n + 1) / len(paths))


def _ortho(work: WorkFolder, grid: TargetGrid, sources: Sequence[Source], report: Progress) -> float:
    """Share of valid pixels of the orthophoto, which is written unless it is there."""
    known = work.result(ORTHO)
    if known is not None:
        return float(known)
    share = write_ortho(work.path / ORTHO, grid, sources, stage(report, "orthophoto", grid.rows * grid.cols))
    if not share:
        raise MapError("holds no valid pixel", where=sources[0].name, remedy="name an orthophoto with content")
    work.record(ORTHO, share, partial(synced, work.path / ORTHO))
    return share


def _heights(work: WorkFolder, grid: TargetGrid, surface: Surface | None, plane_h_amsl_m: float, report: Progress) -> HeightEntry:
    known = work.result("heights")
    if known is not None:
        return HeightEntry.model_validate(known)
    if surface is None:
        return HeightEntry(
            source_datum="amsl",
            geoid_undulation_m=None,
            plane_amsl_m=plane_h_amsl_m,
            grid=None,
            share_known=1.0,
            share_filled=0.0,
        )
    step = stage(report, "surface model", surface.grid.rows * surface.grid.cols)
    entry = write_surface(work.path, surface, grid, plane_h_amsl_m, step)
    flush = None if entry.grid is None else partial(synced, work.path / entry.grid.file)
    work.record("heights", entry.model_dump(mode="json"), flush)
    return entry


def _check_undulation(given_m: float | None, surface: Surface | None, cloud: PackCloud | None) -> None:
    """Refuse an undulation that no heights are corrected by: whoever gives one holds them for ellipsoidal."""
    used = [each.undulation_m for each in (surface, cloud) if each is not None]
    if given_m is not None and given_m not in used:
        raise DatumMissing(
            "is given, but all heights count as above sea level",
            where="--geoid-undulation-m",
            remedy="--vertical-datum ellipsoidal where those of --dsm or --cloud are ellipsoidal, else leave it out",
        )


def _check_space(
    work: WorkFolder,
    grid: TargetGrid,
    surface: Surface | None,
    cloud: PackCloud | None,
    channels: int,
    functions: Sequence[Features],
    finest_gsd_m: float,
) -> None:
    """The plain raster and its optimised copy (with overviews) lie side by side for a while."""
    need = grid.rows * grid.cols * (channels + 1) * 2.4
    need += sum(stored_bytes(wanted_levels(grid, each, finest_gsd_m), each) for each in functions)
    need += surface.grid.rows * surface.grid.cols * 4 * 2.4 if surface else 0
    need += cloud.bytes_needed if cloud else 0
    work.check_free(need)


def _bounds(grid: TargetGrid) -> Bounds:
    west, south, east, north = grid.bounds
    x, y = np.meshgrid(np.linspace(west, east, 17), np.linspace(south, north, 17))
    geo = grid.crs.to_geo_array(np.column_stack([x.ravel(), y.ravel()]))
    south_deg, north_deg = float(geo[:, 0].min()), float(geo[:, 0].max())
    west_deg, east_deg = _longitudes(geo[:, 1])
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


def _longitudes(lon_deg: FloatArray) -> tuple[float, float]:
    """The westernmost and the easternmost of places near each other; across the antimeridian west is larger than east."""
    away = (lon_deg - lon_deg[0] + 180) % 360 - 180
    return float(lon_deg[np.argmin(away)]), float(lon_deg[np.argmax(away)])


def _no_progress(stage: str, share: float) -> None:
    del stage, share
