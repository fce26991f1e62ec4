"""Pictures of a board, one after the other: image files, folders of them, and frames of videos."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from visloc_companion.adapters.camera.image import as_stored, decode_image, rgb
from visloc_companion.adapters.camera.motion_jpeg import require_one_size
from visloc_companion.adapters.camera.video_stamps import VIDEO_SUFFIXES
from visloc_companion.errors import CameraError
from visloc_companion.types import Image

IMAGES = frozenset((".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm"))
VIDEOS = frozenset(VIDEO_SUFFIXES)
UNREADABLE = frozenset((".heic", ".heif"))
"""Pictures that telephones take: to be told, not passed over."""
PICTURES_A_SECOND = 2.0
"""Of a video, where nobody says which: between two the board has moved."""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """(H, W) grey pixels and what names them; None where they cannot be read."""

    name: str
    grey: Image | None


def listed(paths: Sequence[Path]) -> list[Path]:
    """The files meant, those of a folder by name. Raises CameraError for what is not there, and for a folder without pictures."""
    files: list[Path] = []
    for path in paths:
        try:
            if path.is_dir():
                inside = _pictures_in(path)
                if not inside:
                    below = next((str(each) for each in sorted(path.iterdir()) if each.is_dir() and _pictures_in(each)), "")
                    remedy = f"name the folder in it that does: {below}" if below else "name a folder with pictures"
                    raise CameraError("holds no picture and no video", where=str(path), remedy=remedy)
                files += inside
            elif path.is_file():
                files.append(path)
            else:
                raise CameraError("is not there", where=str(path), remedy="name pictures, folders of pictures, or videos")
        except OSError as why:
            raise CameraError(f"cannot be read: {why.strerror}", where=str(path), remedy="check that you may read it") from why
    return list(dict.fromkeys(files))


def names_of(files: Sequence[Path]) -> list[str]:
    """What names each of several files: its name, or its path where two are called the same, as of two cards."""
    counted = Counter(file.name for file in files)
    return [file.name if counted[file.name] == 1 else str(file) for file in files]


def _pictures_in(folder: Path) -> list[Path]:
    known = IMAGES | VIDEOS | UNREADABLE
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in known and file.is_file())


def pictures_of(file: Path, every: int | None, name: str = "") -> Iterator[Picture]:
    """The picture of an image file, or every so many frames of a video (two a second where that is not said); `name` them so.

    Raises CameraError for a file that may not be read, and a video of JPEGs of several sizes.
    """
    if file.suffix.lower() in VIDEOS:
        yield from _frames(file, every, name or file.name)
        return
    try:
        pixels = decode_image(file.read_bytes(), keep_grey=True)
    except OSError as why:
        raise CameraError(f"cannot be read: {why.strerror}", where=str(file), remedy="check that you may read it") from why
    yield Picture(name or file.name, None if pixels is None else _grey(pixels))


def _frames(file: Path, every: int | None, name: str) -> Iterator[Picture]:
    video = cv2.VideoCapture()
    if not video.open(str(file)):
        yield Picture(name, None)
        return
    require_one_size(file, CameraError)
    as_stored(video)
    rate_hz = float(video.get(cv2.CAP_PROP_FPS))
    step = every or max(1, round(rate_hz / PICTURES_A_SECOND)) if np.isfinite(rate_hz) else 1
    number = 0
    try:
        while video.grab():
            if number % step == 0:
                ok, pixels = video.retrieve()
                yield Picture(f"{name} frame {number}", _grey(rgb(np.asarray(pixels))) if ok else None)
            number += 1
    finally:
        video.release()
    if number == 0:
        yield Picture(name, None)


def _grey(pixels: Image) -> Image:
    return pixels if pixels.ndim == 2 else np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
