"""Add features to a pack that exists: the old pack stays as it is until the new one is whole and takes its name."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path

from visloc_companion.localise.features.base import Features
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.geotiff import files_of
from visloc_companion.maps.manifest import MANIFEST, Manifest, sha256_file, write_manifest
from visloc_companion.maps.signature import read_signature, read_signed
from visloc_companion.maps.verify import verify_files
from visloc_companion.prepare.build import SOFTWARE
from visloc_companion.prepare.dates import named_again
from visloc_companion.prepare.defaults import FINEST_FEATURES_M
from visloc_companion.prepare.features import check_names, feature_levels, stored_bytes, wanted_levels
from visloc_companion.prepare.replaced import check_target
from visloc_companion.prepare.sign import Signer
from visloc_companion.prepare.target import TargetGrid
from visloc_companion.prepare.unchanged import Unchanged
from visloc_companion.prepare.work_folder import Progress, WorkFolder, work_key


def add_features(
    folder: Path,
    networks: Sequence[Features],
    *,
    other_dates: Sequence[Path] = (),
    finest_features_m: float = FINEST_FEATURES_M,
    replace: bool = False,
    signer: Signer | None = None,
    progress: Progress | None = None,
) -> Manifest:
    """Store the features of networks in a pack, in place of those of the same names; with `replace` in place of all networks'.

    `other_dates` are the orthophotos that a pack of several dates was built with: what is added is the mean over these, too.
    The files of the pack are linked, or copied where the disk knows no links. Work that was broken off is gone on with. Returns
    the new manifest. The old one's signature goes with the old pack; `signer` signs the new one. Raises MapError for what is no
    pack, a damaged one, other dates than it was built with, a pack or dates that change meanwhile, and too little space,
    SignatureInvalid where `signer` is to sign again what bears a signature that is not right or not its own, ModelError for bad
    names.
    """
    report: Progress = progress or (lambda stage, share: None)
    check_names((GRADIENT, *networks))
    used = Unchanged([folder / MANIFEST, *(file for path in other_dates for file in files_of(path))])
    old = _signed_if_it_was(folder, signer)
    check_target(folder)
    verify_files(folder, old)
    added = {each.name for each in networks}
    kept = tuple(level for level in old.features if level.name == GRADIENT.name or (not replace and level.name not in added))
    dropped = {level.file for level in old.features} - {level.file for level in kept}
    files = {name: entry for name, entry in old.files.items() if name not in dropped}
    grid = _grid(old, folder)
    dates = named_again(other_dates, old.other_dates, folder, grid) if networks else ()
    made_from = [sha256_file(folder / MANIFEST), replace, finest_features_m, *((each.name, each.recipe) for each in networks)]
    used.require()
    with used, WorkFolder(folder, work_key("add", SOFTWARE, made_from)) as work:
        need = sum(stored_bytes(wanted_levels(grid, each, finest_features_m), each) for each in networks)
        work.check_free(need)
        levels = feature_levels(work, grid, folder / old.ortho.file, networks, finest_features_m, report, dates)
        used.require()
        for name in files:
            _link(folder / name, work.path / name)
        entries = work.hashed([*files, *(level.file for level in levels)], report, files)
        manifest = old.model_copy(update={"features": kept + levels, "files": entries})
        raw = write_manifest(work.path, manifest)
        if signer is not None:
            signer.sign(raw, work.path)
        work.take_name()
    return manifest


def _signed_if_it_was(folder: Path, signer: Signer | None) -> Manifest:
    """The manifest of the old pack: who signs again must not vouch for what was changed since the first time."""
    was_signed = signer is not None and read_signature(folder) is not None
    return read_signed(folder, (signer.public,) if signer is not None and was_signed else ())


def _grid(manifest: Manifest, folder: Path) -> TargetGrid:
    """The grid that the pack was built on."""
    ortho = manifest.ortho
    pixel, _, west, _, _, north = ortho.transform
    crs = map_crs(manifest.crs.wkt, str(folder / MANIFEST))
    return TargetGrid(crs, west, north, pixel, ortho.rows, ortho.cols, 0)


def _link(source: Path, target: Path) -> None:
    target.unlink(missing_ok=True)
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)
