"""The manifest of a map pack: what is in it, in which CRS and datum, from where, and the hash of every file.

`manifest.json` is checked against `manifest.sha256` (as `sha256sum` writes it), so that a changed capture date is found as a
changed pixel is.
"""

from __future__ import annotations

import hashlib
import json
import stat
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from visloc_companion.errors import HashMismatch, MapError

SCHEMA: Literal[2] = 2
KIND: Literal["visloc-map-pack"] = "visloc-map-pack"
MANIFEST = "manifest.json"
DIGEST = "manifest.sha256"
REBUILD = "build the pack again (visloc map build) or copy it again from where it was built"
ALLOW = "let this user read it (sudo chmod -R a+rX FOLDER); nothing under /home or /root is there for visloc.service"

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Size = Annotated[int, Field(gt=0)]
Affine = tuple[Finite, Finite, Finite, Finite, Finite, Finite]
FileName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]


class Part(BaseModel):
    """Base of the manifest's parts: frozen, no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class FileEntry(Part):
    """Size and SHA-256 of a file."""

    bytes: Annotated[int, Field(ge=0)]
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class CrsEntry(Part):
    """The pack's CRS."""

    name: str
    epsg: int | None
    wkt: str


class ReprojectedFrom(Part):
    """Another CRS that orthophotos were changed from to the pack's, and what EPSG states of its relation to WGS 84 there, metres
    (None: nothing). What it is off by, the pack is off by, whatever its own CRS is."""

    name: str
    accuracy_m: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None


class Bounds(Part):
    """The rectangle of the pixels, in map coordinates and as the geographic box around it (west > east where it crosses 180°)."""

    west_map_m: Finite
    south_map_m: Finite
    east_map_m: Finite
    north_map_m: Finite
    west_deg: Finite
    south_deg: Finite
    east_deg: Finite
    north_deg: Finite


class Grid(Part):
    """A raster: file, (rows, cols), and the affine (a, b, c, d, e, f) from ras (col, row) to map."""

    file: FileName
    rows: Size
    cols: Size
    transform: Affine


class HeightEntry(Part):
    """Heights of the pack are above mean sea level; `source_datum` says what they were made from."""

    source_datum: Literal["amsl", "ellipsoidal"]
    geoid_undulation_m: Finite | None
    plane_amsl_m: Finite
    grid: Grid | None
    share_known: Annotated[float, Field(ge=0, le=1)]
    """Share of the orthophoto with a height."""
    share_filled: Annotated[float, Field(ge=0, le=1)]
    """Share of the surface model that was filled from neighbours; cells that a cloud's points missed by chance do not count."""


class FeatureLevel(Grid):
    """Features of one GSD: a .npy of int8 in tiles (maps/stored.py); value = stored x `step`.

    `name` and `recipe` are those of `localise.features.base.Features`: for a network they hold the hash of the model. Features
    of another recipe must not be compared with these. The first 2 x `oriented` channels turn with the image.
    """

    name: Annotated[str, Field(min_length=1)]
    recipe: Annotated[str, Field(min_length=1)]
    channels: Size
    oriented: Annotated[int, Field(ge=0)]
    step: Positive
    gsd_m: Positive
    tile_px: Annotated[int, Field(gt=0, le=4096)]
    n_dates: Size = 1
    """Of how many dates they are the mean."""


class CloudEntry(Part):
    """Points of the upper surface in square tiles (maps/cloud_tiles.py), row by row from the north-west corner.

    `points` is a .npy of uint16 (n_points, 3), `tiles` one of int64 (tile_rows x tile_cols + 1, 2). Heights are above mean sea
    level, made from `source_datum` heights. `spacing_m` is the side of the cell of which the highest point was kept.
    """

    points: FileName
    tiles: FileName
    n_points: Size
    tile_rows: Size
    tile_cols: Size
    west_map_m: Finite
    north_map_m: Finite
    tile_m: Positive
    spacing_m: Positive
    step_m: Positive
    source_datum: Literal["amsl", "ellipsoidal"]
    geoid_undulation_m: Finite | None
    share_covered: Annotated[float, Field(ge=0, le=1)]
    """Share of the orthophoto's rectangle with points, in squares of 4 m."""


class SourceEntry(Part):
    """A file that the pack was made from."""

    file: str
    sha256: str


class OtherDate(Part):
    """An orthophoto of another date that the features are the mean over as well: its files, how it was moved to lie on the pack's
    own, and how far parts of it lie beside that then (root mean square of an axis; None where too little tells)."""

    moved_east_m: Finite
    moved_north_m: Finite
    parts_apart_m: Finite | None
    inputs: Annotated[tuple[SourceEntry, ...], Field(min_length=1)]


class Manifest(Part):
    """`manifest.json`."""

    kind: Literal["visloc-map-pack"]
    schema_version: Literal[2]
    name: str
    software: str
    crs: CrsEntry
    reprojected_from: tuple[ReprojectedFrom, ...] = ()
    gsd_m: Positive
    bounds: Bounds
    capture_date: str
    source: str
    licence: str
    share_valid: Annotated[float, Field(ge=0, le=1)]
    ortho: Grid
    heights: HeightEntry
    features: tuple[FeatureLevel, ...]
    cloud: CloudEntry | None = None
    inputs: tuple[SourceEntry, ...]
    other_dates: tuple[OtherDate, ...] = ()
    files: dict[FileName, FileEntry]


def sha256_file(path: Path) -> str:
    """Hex digest of a file. Raises MapError where it cannot be read."""
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as why:
        raise _unreadable(path, why) from why


def source_entry(path: Path) -> SourceEntry:
    """What the manifest says of a file. Raises MapError where it cannot be read."""
    return SourceEntry(file=path.name, sha256=sha256_file(path))


def write_manifest(folder: Path, manifest: Manifest) -> bytes:
    """Write `manifest.json` and its digest. Returns the bytes of the manifest."""
    raw = (manifest.model_dump_json(indent=1) + "\n").encode()
    (folder / MANIFEST).write_bytes(raw)
    (folder / DIGEST).write_text(_digest_line(raw), encoding="utf-8")
    return raw


def read_manifest(folder: Path) -> Manifest:
    """Read and check the manifest of a pack.

    Raises HashMismatch where it is not the one that was written, MapError where it is missing, of another schema or wrong.
    """
    return parsed_manifest(manifest_bytes(folder), folder)


def manifest_bytes(folder: Path) -> bytes:
    """`manifest.json` as it stands there. Raises MapError where it is missing or cannot be read."""
    return _read(folder / MANIFEST)


def parsed_manifest(raw: bytes, folder: Path) -> Manifest:
    """A manifest of these bytes, checked as `read_manifest` does."""
    where = folder / MANIFEST
    digest = _read(folder / DIGEST)
    version = _schema_of(raw, str(where))
    if digest != _digest_line(raw).encode():
        raise HashMismatch(f"does not have the hash that {DIGEST} names", where=str(where), remedy=REBUILD)
    if version != SCHEMA:
        raise MapError(
            f"schema_version is {version!r}, this program reads {SCHEMA}",
            where=str(where),
            remedy="build the pack again with this version (visloc map build)",
        )
    try:
        manifest = Manifest.model_validate_json(raw)
    except ValidationError as why:
        wrong = "; ".join(f"{'.'.join(str(p) for p in e['loc'])}: {e['msg']}" for e in why.errors())
        raise MapError(wrong, where=str(where), remedy=REBUILD) from why
    if missing := [name for name in _files_of(manifest) if name not in manifest.files]:
        raise MapError(f"files: has no entry {missing[0]!r}", where=str(where), remedy=REBUILD)
    return manifest


def _files_of(manifest: Manifest) -> list[str]:
    """Names of the files that the parts of a manifest name."""
    grids = (manifest.ortho, manifest.heights.grid, *manifest.features)
    cloud = manifest.cloud
    return [grid.file for grid in grids if grid is not None] + ([cloud.points, cloud.tiles] if cloud is not None else [])


def is_manifest(path: Path) -> bool:
    """Whether a file is the manifest of a pack of any version, changed or not."""
    try:
        _schema_of(path.read_bytes(), str(path))
    except (OSError, MapError):
        return False
    return True


def require_utf8(*texts: str) -> None:
    """Raise MapError for a text (of a manifest, or a path) that is none in UTF-8: neither JSON nor GDAL takes it."""
    for text in texts:
        try:
            text.encode()
        except UnicodeEncodeError as why:
            raise MapError("is not written in UTF-8", where=ascii(text), remedy="rename it (convmv -t UTF-8)") from why


def _schema_of(raw: bytes, where: str) -> object:
    try:
        data = json.loads(raw)
    except (ValueError, RecursionError) as why:
        raise MapError(f"is not valid JSON: {why}", where=where, remedy=REBUILD) from why
    if not isinstance(data, dict) or data.get("kind") != KIND:
        raise MapError(f"kind: is not {KIND!r}", where=where, remedy="name the folder that visloc map build wrote")
    return data.get("schema_version")


def _read(path: Path) -> bytes:
    try:
        if stat.S_ISREG(path.stat().st_mode):
            return path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        pass
    except OSError as why:
        raise _unreadable(path, why) from why
    raise MapError("there is no such file", where=str(path), remedy="name the folder of a pack, or build one (visloc map build)")


def _unreadable(path: Path, why: OSError) -> MapError:
    remedy = ALLOW if isinstance(why, PermissionError) else REBUILD
    return MapError(f"cannot be read: {why.strerror}", where=str(path), remedy=remedy)


def _digest_line(raw: bytes) -> str:
    return f"{hashlib.sha256(raw).hexdigest()}  {MANIFEST}\n"
