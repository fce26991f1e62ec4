"""State of a training run on disk: whole or not at all, and enough of it that a resumed run equals an uninterrupted one."""

from __future__ import annotations

import io
import pickle
import zipfile
import zlib
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch

from visloc_companion.errors import ConfigError, ModelError
from visloc_companion.whole_file import write_whole

FORMAT = "visloc-training-checkpoint"
VERSION = 2
FREE_SPACE = "free some space or name another folder for --out"
_DAMAGES = (
    *(RuntimeError, EOFError, IndexError, KeyError, ValueError, TypeError, AttributeError, NotImplementedError, OSError),
    *(pickle.UnpicklingError, zipfile.BadZipFile, zlib.error),
)
"""What zipfile and PyTorch raise over damaged files."""
START_AGAIN = "name an undamaged checkpoint, or train again into another folder"


@dataclass(frozen=True, slots=True)
class Ancestor:
    """A run that another one's first weights came from."""

    config: dict[str, Any]
    step: int
    seconds: float
    hardware: str = field(default="", compare=False)
    """As of a checkpoint; empty where it came from one that does not say."""


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """What a run is after `step` steps. Everything is plain data or tensors, so that reading one executes nothing."""

    step: int
    seconds: float
    """Time spent training so far, over all sittings."""
    config: dict[str, Any]
    """The configuration as plain data; a run goes on only with the same one."""
    network: dict[str, Any]
    log_sharpness: torch.Tensor
    optimiser: dict[str, Any]
    random: torch.Tensor
    """State of PyTorch's generator. Pairs follow from the seed and the step alone."""
    hardware: str
    """What the steps so far were computed on, in words; each once, in the order of the sittings (learner.on_all)."""
    ancestors: tuple[Ancestor, ...]
    """The runs before this one, the first one first; empty for a run that began with fresh weights."""
    images: dict[str, int] = field(default_factory=dict)
    """Checksums of the images of every folder that it reads (mixture.Places); empty in checkpoints that do not say."""


def write_file(path: Path, content: bytes) -> None:
    """Replace a file by new content, whole or not at all. Raises ConfigError where the disk is full or forbids it."""
    try:
        write_whole(path, content, synced=True)
    except OSError as why:
        raise ConfigError(f"cannot be written: {why.strerror}", where=str(path), remedy=FREE_SPACE) from why


def save_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Write atomically; the previous checkpoint stays until the new one is whole. Raises ConfigError as `write_file`."""
    buffer = io.BytesIO()
    torch.save(
        {
            "format": FORMAT,
            "version": VERSION,
            **{name: getattr(checkpoint, name) for name in Checkpoint.__slots__},
            "ancestors": [asdict(ancestor) for ancestor in checkpoint.ancestors],
        },
        buffer,
    )
    write_file(path, buffer.getvalue())


def _require_whole(content: bytes) -> None:
    """Raise BadZipFile for a changed byte of what is stored: PyTorch does not look at the checksums that it writes."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        if damaged := archive.testzip():
            raise zipfile.BadZipFile(damaged)


def load_checkpoint(path: Path) -> Checkpoint:
    """Read one, tensors on the CPU. Raises ModelError for a missing, damaged or foreign file."""
    try:
        content = path.read_bytes()
    except OSError as why:
        raise ModelError(f"cannot be read: {why.strerror}", where=str(path), remedy="name a checkpoint.pt that is there") from why
    try:
        _require_whole(content)
        data = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    except _DAMAGES as why:
        raise ModelError("is damaged or no checkpoint", where=str(path), remedy=START_AGAIN) from why
    if not isinstance(data, dict) or data.get("format") != FORMAT or data.get("version") != VERSION:
        raise ModelError(f"is no {FORMAT} of version {VERSION}", where=str(path), remedy=START_AGAIN)
    fields = {"images": {}} | {name: data[name] for name in Checkpoint.__slots__ if name in data}
    if missing := set(Checkpoint.__slots__) - set(fields):
        raise ModelError(f"lacks {', '.join(sorted(missing))}", where=str(path), remedy=START_AGAIN)
    return Checkpoint(**{**fields, "ancestors": tuple(Ancestor(**ancestor) for ancestor in fields["ancestors"])})
