"""A network on disk: `models/NAME/` with the ONNX files, `golden.npz` and `manifest.json`, which says what each of them is.

The manifest names the SHA-256 of every file, what the network must be fed, what comes out, what it was trained on under which
licence, what it was measured to do, and a golden input with its output: what a runtime must answer before it is believed.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

import visloc_companion
from visloc_companion.errors import ModelError
from visloc_companion.whole_file import write_whole

SCHEMA: Literal[1] = 1
KIND: Literal["visloc-feature-model"] = "visloc-feature-model"
MANIFEST = "manifest.json"
GOLDEN = "golden.npz"
DEFAULT = "default"
"""File in `models/` with the name of the folder that is used where none is configured."""
COPY_AGAIN = "copy the model's folder again from where it was made, or export it again (visloc train export)"
OWN_SHA256 = "manifest_sha256"
"""Key of the manifest: SHA-256 of all else in it, as JSON with sorted keys and no spaces. Earlier exports have none."""
MAX_BYTES = 64 * 1024 * 1024
"""Larger files are refused unread: no network of this project comes near."""

EXCHANGES = 3
"""So often a model may be replaced while it is read."""

VariantName = Literal["float32", "float16", "int8"]
VARIANT_FILES: dict[VariantName, str] = {"float32": "model.onnx", "float16": "model_fp16.onnx", "int8": "model_int8.onnx"}
"""Usual file names; the manifest's are what counts."""

Float32Array = NDArray[np.float32]
FileName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_-]*$"
Name = Annotated[str, Field(pattern=NAME_PATTERN)]
Size = Annotated[int, Field(gt=0)]
Count = Annotated[int, Field(ge=0)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class Part(BaseModel):
    """Base of the manifest's parts: frozen, no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class FileEntry(Part):
    """A file of the folder with its size and SHA-256."""

    file: FileName
    bytes: Count
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class VariantEntry(FileEntry):
    """An ONNX file and how far its golden answer may lie from the float32 one that was recorded, on any provider."""

    tolerance_max: Positive
    """Largest absolute difference of one value."""
    tolerance_rms: Positive
    """Root mean square of the differences."""


class InputSpec(Part):
    """What the network is fed: (N, channels, H, W) float32."""

    name: str
    """The input's name in the ONNX graph."""
    channels: Size
    channel_names: tuple[str, ...]
    recipe: str
    """`localise.features.network_input.RECIPE` of the training; the network must not be fed anything else."""


class OutputSpec(Part):
    """What comes out: (N, channels, H, W) float32, the first 2 x `oriented` turning with the image (features/base.py)."""

    name: str
    """The output's name in the ONNX graph."""
    channels: Size
    oriented: Count
    bound: Positive
    """Values lie within ±bound."""
    multiple_px: Size
    """H and W must be multiples of this."""
    context_px: Size
    """How far an output pixel depends on the input around it, in pixels of the network's input."""


class TrainingData(Part):
    """One source of training imagery."""

    name: str
    part: str
    """Which rows, seeds or files of it."""
    licence: str


class Training(Part):
    """How the weights came about."""

    data: tuple[TrainingData, ...]
    split: str
    """What was held out."""
    seeds: tuple[int, ...]
    steps: Count
    hours: NonNegative
    hardware: str
    software: str


class ModelManifest(Part):
    """`manifest.json`."""

    kind: Literal["visloc-feature-model"] = KIND
    schema_version: Literal[1] = SCHEMA
    name: Name
    licence: str
    """Of the weights."""
    opset: Size
    variants: dict[VariantName, VariantEntry]
    input: InputSpec
    output: OutputSpec
    training: Training
    figures: dict[str, Finite | str]
    """What it was measured to do: name of the figure, with its unit, to its value."""
    golden: FileEntry
    """.npz with `input` (1, channels, H, W) and the float32 network's `output`."""

    @model_validator(mode="after")
    def _consistent(self) -> ModelManifest:
        if "float32" not in self.variants:
            raise ValueError("variants: float32 is missing")
        if len(self.input.channel_names) != self.input.channels:
            raise ValueError("input.channel_names: there must be one for each of input.channels")
        if 2 * self.output.oriented > self.output.channels:
            raise ValueError("output.oriented: more pairs than output.channels hold")
        return self

    @property
    def identity(self) -> str:
        """Name and the float32 file's hash: what features of this network are kept under, whichever variant made them."""
        return f"{self.name}-{self.variants['float32'].sha256[:12]}"


def shipped_model() -> Path:
    """Folder of the network that came with this version: the one that `models/default` names, of the wheel or of the checkout.

    Raises ModelError where none came with it.
    """
    package = Path(visloc_companion.__file__).parent
    for models in (package / "models", package.parent / "models"):
        pointer = models / DEFAULT
        if pointer.is_file():
            return models / pointer.read_text(encoding="utf-8").strip()
    raise ModelError(
        "no network came with this version",
        where=str(package / "models" / DEFAULT),
        remedy="name the folder of one (localiser.model, --model), or choose a method that needs none (gradient)",
    )


def file_entry(path: Path) -> FileEntry:
    """What the manifest says of a file. Raises ModelError where it cannot be read."""
    content = _read(path)
    return FileEntry(file=path.name, bytes=len(content), sha256=hashlib.sha256(content).hexdigest())


def variant_entry(path: Path, tolerance_max: float, tolerance_rms: float) -> VariantEntry:
    """The same of an ONNX file. Raises ModelError where it cannot be read."""
    return VariantEntry(**file_entry(path).model_dump(), tolerance_max=tolerance_max, tolerance_rms=tolerance_rms)


def write_golden(folder: Path, given: Float32Array, expected: Float32Array) -> FileEntry:
    """Write `golden.npz`: (1, 3, H, W) fed and (1, C, H, W) float32 answered; the same arrays give the same bytes."""
    np.savez_compressed(folder / GOLDEN, input=given.astype(np.float32), output=expected.astype(np.float32))
    return file_entry(folder / GOLDEN)


def write_manifest(folder: Path, manifest: ModelManifest) -> None:
    """Write `manifest.json`, whole or not at all. Raises ModelError where a file of the folder is not what it says."""
    for variant in manifest.variants:
        read_variant(folder, manifest, variant)
    read_golden(folder, manifest)
    data = json.loads(manifest.model_dump_json())
    text = json.dumps(data | {OWN_SHA256: _sha256_of(data)}, indent=1, ensure_ascii=False) + "\n"
    write_whole(folder / MANIFEST, text.encode())


def read_manifest(folder: Path) -> ModelManifest:
    """The manifest of a model's folder. Raises ModelError where it is missing, of another kind or schema, wrong or changed."""
    where = folder / MANIFEST
    raw = _read(where)
    try:
        data = json.loads(raw)
    except (ValueError, RecursionError) as why:
        raise ModelError(f"is not valid JSON: {why}", where=str(where), remedy=COPY_AGAIN) from why
    if not isinstance(data, dict) or data.get("kind") != KIND:
        raise ModelError(f"kind: is not {KIND!r}", where=str(where), remedy="name the folder of a feature model")
    if (version := data.get("schema_version")) != SCHEMA:
        raise ModelError(
            f"schema_version: is {version!r}, this program reads {SCHEMA}",
            where=str(where),
            remedy="use the model that came with this version, or export it again (visloc train export)",
        )
    own = data.pop(OWN_SHA256, None)
    try:
        manifest = ModelManifest.model_validate_json(json.dumps(data))
    except ValidationError as why:
        wrong = "; ".join(f"{'.'.join(str(p) for p in e['loc']) or 'manifest'}: {e['msg']}" for e in why.errors())
        raise ModelError(wrong, where=str(where), remedy=COPY_AGAIN) from why
    if own is not None and own != _sha256_of(data):
        raise ModelError(
            f"was changed after it was written: {OWN_SHA256} does not fit",
            where=str(where),
            remedy=f"{COPY_AGAIN}; who changed it on purpose removes the line {OWN_SHA256}",
        )
    return manifest


def read_model(folder: Path, variant: VariantName) -> tuple[ModelManifest, bytes, tuple[Float32Array, Float32Array]]:
    """Manifest, ONNX file and golden input and output of one model, though another takes its place meanwhile.

    Raises as `read_manifest`, `read_variant` and `read_golden` do.
    """
    for _ in range(EXCHANGES):
        manifest = read_manifest(folder)
        try:
            return manifest, read_variant(folder, manifest, variant), read_golden(folder, manifest)
        except ModelError:
            if read_manifest(folder) == manifest:
                raise
    raise ModelError("is replaced again and again", where=str(folder), remedy="wait until nothing writes it any more")


def _sha256_of(data: object) -> str:
    return hashlib.sha256(json.dumps(data, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def read_variant(folder: Path, manifest: ModelManifest, variant: VariantName) -> bytes:
    """The ONNX file of a variant. Raises ModelError where the model has none or the file is not the one that was written."""
    entry = manifest.variants.get(variant)
    if entry is None:
        raise ModelError(
            f"variants: has no {variant!r}",
            where=str(folder / MANIFEST),
            remedy=f"set localiser.model_variant to one of {', '.join(manifest.variants)}",
        )
    return _checked(folder, entry)


def read_golden(folder: Path, manifest: ModelManifest) -> tuple[Float32Array, Float32Array]:
    """Golden input (1, 3, H, W) and output (1, C, H, W). Raises ModelError where they are changed or of the wrong shape."""
    where = str(folder / manifest.golden.file)
    content = _checked(folder, manifest.golden)
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            given, expected = arrays["input"], arrays["output"]
    except (ValueError, KeyError, OSError, zipfile.BadZipFile, TypeError) as why:
        raise ModelError(f"holds no golden vector: {why}", where=where, remedy=COPY_AGAIN) from why
    _check_shape("input", given, manifest.input.channels, manifest, where)
    _check_shape("output", expected, manifest.output.channels, manifest, where)
    if given.shape[2:] != expected.shape[2:]:
        raise ModelError(f"input {given.shape} and output {expected.shape} differ in size", where=where, remedy=COPY_AGAIN)
    return given, expected


def _check_shape(name: str, array: NDArray[np.float32], channels: int, manifest: ModelManifest, where: str) -> None:
    multiple = manifest.output.multiple_px
    right = array.ndim == 4 and array.shape[:2] == (1, channels) and array.dtype == np.float32
    if not right or array.size == 0 or array.shape[2] % multiple or array.shape[3] % multiple:
        raise ModelError(
            f"{name}: is {array.dtype} {array.shape}, wanted float32 (1, {channels}, H, W) with multiples of {multiple}",
            where=where,
            remedy=COPY_AGAIN,
        )
    if not np.isfinite(array).all():
        raise ModelError(f"{name}: is not finite", where=where, remedy=COPY_AGAIN)


def _checked(folder: Path, entry: FileEntry) -> bytes:
    path = folder / entry.file
    content = _read(path)
    found = hashlib.sha256(content).hexdigest()
    if len(content) != entry.bytes or found != entry.sha256:
        raise ModelError(
            f"has {len(content)} bytes and SHA-256 {found[:12]}..., {MANIFEST} names {entry.bytes} and {entry.sha256[:12]}...",
            where=str(path),
            remedy=COPY_AGAIN,
        )
    return content


def _read(path: Path) -> bytes:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ModelError(f"is larger than {MAX_BYTES} bytes", where=str(path), remedy=COPY_AGAIN)
        return path.read_bytes()
    except FileNotFoundError as why:
        raise ModelError(
            "there is no such file", where=str(path), remedy="name the folder of a model, or leave localiser.model empty"
        ) from why
    except OSError as why:
        raise ModelError(f"cannot be read: {why.strerror}", where=str(path), remedy=COPY_AGAIN) from why
