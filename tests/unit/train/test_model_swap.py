"""Exports over a model that is in use: the old one stays until the new one is whole."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="PyTorch is not installed: make install-train")

from tests.unit.localise.test_model_folder import made
from visloc_companion.errors import ConfigError
from visloc_companion.localise.model_folder import MANIFEST, read_model, variant_entry, write_manifest
from visloc_companion.train import model_swap
from visloc_companion.train.model_swap import replacing


def write(folder: Path, content: bytes) -> None:
    manifest = made(folder)
    (folder / "model.onnx").write_bytes(content)
    entry = variant_entry(folder / "model.onnx", 1e-3, 1e-4)
    write_manifest(folder, manifest.model_copy(update={"variants": {"float32": entry}}))


def content_of(folder: Path) -> bytes:
    _, content, (given, _) = read_model(folder, "float32")
    assert np.isfinite(given).all()
    return content


@pytest.fixture
def model(tmp_path: Path) -> Path:
    with replacing(tmp_path / "models" / "mine") as folder:
        write(folder, b"old")
    return tmp_path / "models" / "mine"


def test_the_old_model_is_there_until_the_new_one_is_whole(model: Path) -> None:
    (model / MANIFEST).chmod(0o644)
    usual = model.parent / "usual"
    usual.mkdir()
    assert model.stat().st_mode == usual.stat().st_mode
    model.chmod(0o775)
    with replacing(model) as folder:
        assert content_of(model) == b"old"
        write(folder, b"new")
        assert content_of(model) == b"old"
    assert content_of(model) == b"new"
    assert model.stat().st_mode & 0o777 == 0o775
    assert sorted(path.name for path in model.parent.iterdir()) == ["mine", "usual"]


def test_what_breaks_off_leaves_the_old_model(model: Path) -> None:
    """Files were replaced one by one: ONNX files of the new model beside the manifest of the old one."""
    for why in (KeyboardInterrupt(), OSError(28, "No space left on device")):
        with pytest.raises((KeyboardInterrupt, ConfigError)), replacing(model) as folder:
            (folder / "model.onnx").write_bytes(b"new")
            raise why
        assert content_of(model) == b"old"
        assert [path.name for path in model.parent.iterdir()] == ["mine"]


@pytest.mark.parametrize("other", [True, False], ids=["beside other files", "that cannot change places"])
def test_files_beside_a_model_stay(model: Path, other: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if other:
        (model / "notes.txt").write_text("mine")
    else:
        monkeypatch.setattr(model_swap, "exchange", lambda one, two: False)
    written: list[str] = []
    writing = model_swap.write_whole
    monkeypatch.setattr(model_swap, "write_whole", lambda path, *a, **k: (written.append(path.name), writing(path, *a, **k)))
    with replacing(model) as folder:
        write(folder, b"new")
    assert content_of(model) == b"new" and written[-1] == MANIFEST
    assert not other or (model / "notes.txt").read_text() == "mine"
    assert [path.name for path in model.parent.iterdir()] == ["mine"]


def test_a_link_as_target_is_followed(model: Path) -> None:
    link = model.parent / "link"
    link.symlink_to("mine")
    with replacing(link) as folder:
        write(folder, b"new")
    assert link.is_symlink() and content_of(model) == b"new"


def test_a_target_that_is_no_folder_is_refused(model: Path) -> None:
    file = model.parent / "file"
    file.write_text("mine")
    with pytest.raises(ConfigError, match="file: cannot be written: is no folder"), replacing(file) as folder:
        write(folder, b"new")
    assert file.read_text() == "mine"


def test_a_folder_that_alone_may_be_written_to_is_enough(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a volume of a container is, in a folder of root's."""
    allowed = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != model.parent and allowed(path, mode))
    with replacing(model) as folder:
        assert folder.parent == model
        write(folder, b"new")
    assert content_of(model) == b"new" and not list(model.glob(".*"))
