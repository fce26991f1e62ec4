"""A model's folder: written and read back, and every way in which it can be broken."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from visloc_companion.errors import ModelError
from visloc_companion.localise import model_folder
from visloc_companion.localise.model_folder import (
    GOLDEN,
    MANIFEST,
    InputSpec,
    ModelManifest,
    OutputSpec,
    Training,
    TrainingData,
    file_entry,
    read_golden,
    read_manifest,
    read_model,
    read_variant,
    variant_entry,
    write_golden,
    write_manifest,
)


def made(folder: Path, output_shape: tuple[int, ...] = (1, 10, 8, 12)) -> ModelManifest:
    (folder / "model.onnx").write_bytes(b"not a network, but that is not for this module to know")
    rng = np.random.default_rng(0)
    given = rng.standard_normal((1, 3, 8, 12)).astype(np.float32)
    golden = write_golden(folder, given, rng.standard_normal(output_shape).astype(np.float32))
    return ModelManifest(
        name="tiny",
        licence="Apache-2.0",
        opset=20,
        variants={"float32": variant_entry(folder / "model.onnx", 1e-3, 1e-4)},
        input=InputSpec(name="image", channels=3, channel_names=("grey", "cosine", "sine"), recipe="grey sigma 14"),
        output=OutputSpec(name="features", channels=10, oriented=1, bound=2.0, multiple_px=4, context_px=40),
        training=Training(
            data=(TrainingData(name="somewhere", part="rows < 400", licence="CC0"),),
            split="by rows",
            seeds=(1,),
            steps=10,
            hours=0.1,
            hardware="2 CPU cores",
            software="torch",
        ),
        figures={"T2 < 5 px, %": 99.5},
        golden=golden,
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_manifest(tmp_path, made(tmp_path))
    return tmp_path


def edited(folder: Path, **changes: object) -> None:
    data = json.loads((folder / MANIFEST).read_text())
    (folder / MANIFEST).write_text(json.dumps(data | changes))


def test_what_was_written_is_read(folder: Path) -> None:
    manifest = read_manifest(folder)
    assert manifest == made(folder)
    assert read_variant(folder, manifest, "float32") == (folder / "model.onnx").read_bytes()
    given, expected = read_golden(folder, manifest)
    assert given.shape == (1, 3, 8, 12) and expected.shape == (1, 10, 8, 12)
    assert manifest.identity == f"tiny-{manifest.variants['float32'].sha256[:12]}"
    assert [path.name for path in folder.iterdir() if path.name.startswith(".")] == []


def test_the_same_golden_vector_gives_the_same_bytes(tmp_path: Path) -> None:
    assert made(tmp_path).golden == made(tmp_path).golden


def test_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"manifest.json: there is no such file; remedy: name the folder of a model"):
        read_manifest(tmp_path / "nowhere")


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, "\x00\x01"])
def test_corrupt_json(folder: Path, text: str) -> None:
    (folder / MANIFEST).write_text(text)
    with pytest.raises(ModelError, match=r"manifest.json: is not valid JSON"):
        read_manifest(folder)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"kind": "visloc-map-pack"}, "kind: is not 'visloc-feature-model'"),
        ({"schema_version": 2}, "schema_version: is 2, this program reads 1"),
        ({"name": "../up"}, "name: "),
        ({"opset": -1}, "opset: "),
        ({"colour": "blue"}, "colour: Extra inputs"),
        ({"variants": {}}, "variants: float32 is missing"),
        ({"figures": {"x": float("nan")}}, "figures.x"),
        ({"golden": {"file": "/etc/passwd", "bytes": 1, "sha256": "0" * 64}}, "golden.file: "),
    ],
)
def test_wrong_fields_are_named(folder: Path, changes: dict[str, object], named: str) -> None:
    edited(folder, **changes)
    with pytest.raises(ModelError, match=r"manifest.json: ") as caught:
        read_manifest(folder)
    assert named in str(caught.value) and "remedy: " in str(caught.value)


@pytest.mark.parametrize(
    ("field", "value"),
    [("oriented", 0), ("oriented", 2), ("context_px", 41), ("bound", 3.0), ("multiple_px", 2)],
)
def test_a_changed_manifest_is_refused_though_its_fields_fit(folder: Path, field: str, value: float) -> None:
    output = json.loads((folder / MANIFEST).read_text())["output"]
    edited(folder, output=output | {field: value})
    with pytest.raises(ModelError, match=r"manifest.json: was changed after it was written.*removes the line manifest_sha256"):
        read_manifest(folder)
    data = json.loads((folder / MANIFEST).read_text())
    del data["manifest_sha256"]
    (folder / MANIFEST).write_text(json.dumps(data))
    assert getattr(read_manifest(folder).output, field) == value


def test_a_manifest_that_is_only_written_otherwise_is_read(folder: Path) -> None:
    before = read_manifest(folder)
    (folder / MANIFEST).write_text(json.dumps(json.loads((folder / MANIFEST).read_text()), indent=4, sort_keys=True))
    assert read_manifest(folder) == before


def test_a_changed_network_is_refused(folder: Path) -> None:
    content = (folder / "model.onnx").read_bytes()
    (folder / "model.onnx").write_bytes(content[:-1] + b"!")
    with pytest.raises(ModelError, match=r"model.onnx: has \d+ bytes and SHA-256 .* manifest.json names"):
        read_variant(folder, read_manifest(folder), "float32")
    with pytest.raises(ModelError, match=r"model.onnx: has"):
        write_manifest(folder, read_manifest(folder))


def test_a_variant_that_is_not_there(folder: Path) -> None:
    with pytest.raises(ModelError, match=r"variants: has no 'int8'; remedy: set localiser.model_variant to one of float32"):
        read_variant(folder, read_manifest(folder), "int8")


def test_a_changed_golden_vector_is_refused(folder: Path) -> None:
    (folder / GOLDEN).write_bytes(b"PK")
    with pytest.raises(ModelError, match=r"golden.npz: has 2 bytes"):
        read_golden(folder, read_manifest(folder))


def test_a_golden_vector_of_another_shape_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"golden.npz: output: is float32 \(1, 9, 8, 12\), wanted float32 \(1, 10, H, W\)"):
        write_manifest(tmp_path, made(tmp_path, (1, 9, 8, 12)))
    with pytest.raises(ModelError, match=r"golden.npz: input \(1, 3, 8, 12\) and output \(1, 10, 8, 8\) differ in size"):
        write_manifest(tmp_path, made(tmp_path, (1, 10, 8, 8)))
    assert not (tmp_path / MANIFEST).exists()


def test_a_golden_vector_that_is_not_finite_is_refused(tmp_path: Path) -> None:
    manifest = made(tmp_path)
    bad = write_golden(tmp_path, np.full((1, 3, 8, 12), np.nan, np.float32), np.zeros((1, 10, 8, 12), np.float32))
    with pytest.raises(ModelError, match=r"input: is not finite"):
        write_manifest(tmp_path, manifest.model_copy(update={"golden": bad}))


def test_a_golden_file_that_is_no_archive_is_refused(tmp_path: Path) -> None:
    manifest = made(tmp_path)
    with (tmp_path / GOLDEN).open("wb") as stream:
        np.save(stream, np.zeros(3))
    with pytest.raises(ModelError, match=r"golden.npz: holds no golden vector"):
        read_golden(tmp_path, manifest.model_copy(update={"golden": file_entry(tmp_path / GOLDEN)}))


def test_a_model_that_is_replaced_while_it_is_read_is_read_as_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The manifest of the old one and the files of the new one "have SHA-256 ...", and a daemon that began then did not start."""
    folders = [tmp_path / name for name in ("model", "new", "newer", "newest")]
    for number, folder in enumerate(folders):
        folder.mkdir()
        manifest = made(folder)
        (folder / "model.onnx").write_bytes(b"%d" % number)
        entry = variant_entry(folder / "model.onnx", 1e-3, 1e-4)
        write_manifest(folder, manifest.model_copy(update={"variants": {"float32": entry}}))
    left = folders[1:2]
    reading, count = model_folder.read_variant, itertools.count()

    def replaced(folder: Path, manifest: ModelManifest, variant: str) -> bytes:
        if left:
            folder.rename(tmp_path / f"old{next(count)}")
            left.pop(0).rename(folder)
        return reading(folder, manifest, variant)

    monkeypatch.setattr(model_folder, "read_variant", replaced)
    manifest, content, _ = read_model(tmp_path / "model", "float32")
    assert content == b"1" and manifest == read_manifest(tmp_path / "model")
    left += [*folders[2:], tmp_path / "old0"]
    with pytest.raises(ModelError, match=r"model: is replaced again and again; remedy"):
        read_model(tmp_path / "model", "float32")
    (tmp_path / "model" / "model.onnx").write_bytes(b"broken")
    with pytest.raises(ModelError, match=r"model\.onnx: has 6 bytes and SHA-256"):
        read_model(tmp_path / "model", "float32")
