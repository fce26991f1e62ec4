"""From the configuration's sources to stacks of images in memory."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from visloc_companion.errors import ConfigError
from visloc_companion.train.config import PairsConfig, TrainingConfig, ValidationConfig
from visloc_companion.train.config_sources import DatesSource, LandscapeSource, PairsSource, SourceConfig
from visloc_companion.train.pairs import PairSettings, StackPyramid
from visloc_companion.train.sources import Stack, dates_stack, landscape_stack, paired_stack
from visloc_companion.train.steps import Batch, Source, make_batch

Tell = Callable[[str], None]
"""Called with what is being done."""
MIN_SIDE_PX = 96
"""A smaller image is no place to cut pairs from."""


class Places:
    """Opened sources. One that is named twice (for training and for validation) is read once.

    `images`: a checksum of what was read of each folder, by its name and the part that is used.
    """

    def __init__(self, data: Path, tell: Tell) -> None:
        self.images: dict[str, int] = {}
        self._data, self._tell = data, tell
        self._landscapes: dict[tuple[int, float, float, int], StackPyramid] = {}
        self._folders: dict[tuple[str, ...], tuple[StackPyramid, ...]] = {}

    def open(self, config: SourceConfig) -> Source:
        """The source that a table names. Raises ConfigError for missing folders, CasesError for images that cannot be used."""
        if isinstance(config, DatesSource):
            stacks = self._opened(config, lambda folder: [dates_stack(folder, config.first_row, config.last_row)])
        elif isinstance(config, PairsSource):
            stacks = self._opened(config, lambda folder: paired_stack(folder, config.pairs or pairs_in(folder)))
        elif isinstance(config, LandscapeSource):
            stacks = tuple(self._landscape(config, seed) for seed in config.seeds)
        else:
            stacks = ()
        return Source(config.name, stacks, config.share, config.scales)

    def _landscape(self, config: LandscapeSource, seed: int) -> StackPyramid:
        key = (seed, config.size_m, config.gsd_m, config.dates)
        if key not in self._landscapes:
            self._tell(f"{config.name}: landscape {seed}")
            self._landscapes[key] = StackPyramid(landscape_stack(*key))
        return self._landscapes[key]

    def _opened(self, config: DatesSource | PairsSource, read: Callable[[Path], list[Stack]]) -> tuple[StackPyramid, ...]:
        folder = self._data / config.folder
        if not folder.is_dir():
            raise ConfigError(
                f"source {config.name!r}: there is no such folder",
                where=str(folder),
                remedy="name the folder that the sources' folders lie in with --data, or correct the source's `folder`",
            )
        rows = (str(config.first_row), str(config.last_row)) if isinstance(config, DatesSource) else config.pairs
        key = (config.kind, config.folder, *rows)
        if key not in self._folders:
            self._tell(f"{config.name}: {config.folder}")
            stacks = read(folder)
            for stack in stacks:
                check_side(stack, folder)
            self._folders[key] = tuple(StackPyramid(stack) for stack in stacks)
            self.images[" ".join((config.folder, *rows))] = _checksum(stacks)
        return self._folders[key]


def _checksum(stacks: Sequence[Stack]) -> int:
    """CRC-32 of the pixels, and of where they show land."""
    checksum = 0
    for stack in stacks:
        for array in (*stack.dates, stack.valid):
            checksum = zlib.crc32(np.ascontiguousarray(array).data, zlib.crc32(repr(array.shape).encode(), checksum))
    return checksum


def pairs_in(folder: Path) -> tuple[str, ...]:
    """Names of the folders that hold `a.tif` and `b.tif`, in order. Raises ConfigError where there are none."""
    names = tuple(sorted(path.parent.name for path in folder.glob("*/a.tif") if (path.parent / "b.tif").is_file()))
    if not names:
        raise ConfigError(
            "holds no folder with a.tif and b.tif", where=str(folder), remedy="name the folder of the pairs' folders"
        )
    return names


def check_side(stack: Stack, folder: Path) -> None:
    """Raises ConfigError for images too small to cut pairs from."""
    rows, cols = stack.dates[0].shape[:2]
    if min(rows, cols) < MIN_SIDE_PX:
        raise ConfigError(
            f"{stack.name}: only {cols} x {rows} px are left to train on",
            where=str(folder),
            remedy=f"give images of at least {MIN_SIDE_PX} px a side, or correct first_row and last_row",
        )


def pair_settings(config: PairsConfig) -> PairSettings:
    """What `make_pair` wants, in radians."""
    return PairSettings(
        config.reference_px,
        config.windows_px,
        config.footprint_share,
        math.radians(config.turn_deg),
        config.log_scale,
        math.radians(config.misfit_turn_deg),
        config.misfit_log_scale,
        math.radians(config.misfit_tilt_deg),
        config.same_date_share,
        config.change_share,
        config.photometric,
    )


def training_sources(config: TrainingConfig, places: Places) -> list[Source]:
    """The mixture. Raises as `Places.open`."""
    return [places.open(source) for source in config.sources]


def validation_batches(config: ValidationConfig, settings: PairSettings, places: Places) -> dict[str, Sequence[Batch]]:
    """The fixed batches of each validation source. Raises as `Places.open`."""
    batches: dict[str, Sequence[Batch]] = {}
    for table in config.sources:
        source = places.open(table)
        batches[source.name] = [
            make_batch([config.seed, k], [source], settings, config.batch, window) for k, window in enumerate(config.windows_px)
        ]
    return batches
