from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed: make install-train")

from visloc_companion.errors import ConfigError, ModelError  # noqa: E402
from visloc_companion.train.checkpoint import Ancestor, Checkpoint, load_checkpoint, save_checkpoint, write_file  # noqa: E402
from visloc_companion.train.log import RunLog  # noqa: E402


def checkpoint(step: int = 3) -> Checkpoint:
    weights = {"w": torch.arange(6.0).reshape(2, 3) + step}
    before = (Ancestor({"seed": 0}, 9, 2.5),)
    images, random = {"valley 0 400": 123}, torch.get_rng_state()
    return Checkpoint(step, 1.5, {"seed": 1}, weights, torch.tensor(4.0), {"state": {}}, random, "CPU", before, images)


def full_disk(*_: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_what_was_saved_is_loaded(tmp_path: Path) -> None:
    save_checkpoint(tmp_path / "checkpoint.pt", checkpoint(7))
    loaded = load_checkpoint(tmp_path / "checkpoint.pt")
    assert (loaded.step, loaded.seconds, loaded.config, loaded.hardware) == (7, 1.5, {"seed": 1}, "CPU")
    assert loaded.ancestors == (Ancestor({"seed": 0}, 9, 2.5),)
    assert torch.equal(loaded.network["w"], checkpoint(7).network["w"])
    assert torch.equal(loaded.random, checkpoint().random)
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint.pt"]


def test_a_full_disk_is_told_and_leaves_the_previous_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "checkpoint.pt"
    save_checkpoint(path, checkpoint(1))
    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(ConfigError, match=r"No space left on device.*free some space"):
        save_checkpoint(path, checkpoint(2))
    assert load_checkpoint(path).step == 1
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint.pt"]


def test_a_checkpoint_with_a_flipped_bit_is_refused_or_holds_what_was_saved(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.pt"
    save_checkpoint(path, checkpoint())
    content, saved = path.read_bytes(), load_checkpoint(path)
    rng, refused = np.random.default_rng(0), 0
    for at in rng.choice(len(content), 150, replace=False):
        damaged = bytearray(content)
        damaged[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        try:
            loaded = load_checkpoint(path)
        except ModelError:
            refused += 1
            continue
        assert torch.equal(loaded.network["w"], saved.network["w"])
        assert torch.equal(loaded.random, saved.random)
        assert (loaded.step, loaded.seconds, loaded.config) == (3, 1.5, {"seed": 1})
        assert loaded.ancestors == saved.ancestors
    assert refused > 75


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be written"):
        write_file(tmp_path / "nowhere" / "file", b"")
    with pytest.raises(ModelError, match="cannot be read"):
        load_checkpoint(tmp_path / "checkpoint.pt")


@pytest.mark.parametrize("cut", [0, 10, 200, 1000])
def test_a_damaged_checkpoint_is_told(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "checkpoint.pt"
    save_checkpoint(path, checkpoint())
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(ModelError, match="damaged or no checkpoint"):
        load_checkpoint(path)


def test_files_of_other_programs_are_refused_and_not_executed(tmp_path: Path) -> None:
    path, witness = tmp_path / "other.pt", tmp_path / "witness"

    class Payload:
        def __reduce__(self) -> tuple[object, ...]:
            return (Path.touch, (witness,))

    torch.save({"w": torch.zeros(2)}, path)
    with pytest.raises(ModelError, match="is no visloc-training-checkpoint"):
        load_checkpoint(path)
    torch.save(Payload(), path)
    with pytest.raises(ModelError, match="damaged or no checkpoint"):
        load_checkpoint(path)
    assert not witness.exists()


def test_the_log_is_cut_back_to_the_checkpoint(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    log = RunLog(path, 0)
    for step in (50, 100, 150):
        log.add("loss", step, loss=step / 10)
    path.write_text(path.read_text(encoding="utf-8") + '{"kind": "loss", "st', encoding="utf-8")
    resumed = RunLog(path, 100)
    assert [entry["step"] for entry in resumed.of("loss")] == [50, 100]
    assert len(path.read_text(encoding="utf-8").splitlines()) == 2
    assert RunLog(path, 0).entries == []
    with pytest.raises(ValueError, match="JSON"):
        log.add("loss", 200, loss=float("nan"))
