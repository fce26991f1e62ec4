from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed: make install-train")

from visloc_companion.errors import ConfigError, ModelError  # noqa: E402
from visloc_companion.train import run  # noqa: E402
from visloc_companion.train.checkpoint import Ancestor, Checkpoint, load_checkpoint  # noqa: E402
from visloc_companion.train.config import TrainingConfig  # noqa: E402
from visloc_companion.train.learner import begun, checked_device, learning_rate, new_learner  # noqa: E402

Tiny = Callable[..., TrainingConfig]


def log_of(out: Path) -> list[dict[str, Any]]:
    lines = [json.loads(line) for line in (out / "log.jsonl").read_text(encoding="utf-8").splitlines()]
    return [{key: value for key, value in line.items() if key != "seconds"} for line in lines]


def assert_same(a: Any, b: Any) -> None:
    if isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            assert_same(a[key], b[key])
    elif isinstance(a, list | tuple):
        assert len(a) == len(b)
        for left, right in zip(a, b, strict=True):
            assert_same(left, right)
    elif isinstance(a, torch.Tensor):
        assert torch.equal(a, b)
    else:
        assert a == b


def assert_same_state(a: Checkpoint, b: Checkpoint) -> None:
    for name in ("step", "config", "network", "log_sharpness", "optimiser", "random"):
        assert_same(getattr(a, name), getattr(b, name))


def test_a_run_that_is_broken_off_and_resumed_equals_an_uninterrupted_one(tmp_path: Path, tiny: Tiny, watcher: Any) -> None:
    config, whole, parts = tiny(), watcher(), watcher(break_at=3)
    uninterrupted = load_checkpoint(run.train(config, tmp_path, tmp_path / "whole", whole))
    with pytest.raises(KeyboardInterrupt):
        run.train(config, tmp_path, tmp_path / "parts", parts)
    assert load_checkpoint(tmp_path / "parts" / "checkpoint.pt").step == 2
    torch.rand(3)
    resumed = watcher()
    assert_same_state(load_checkpoint(run.train(config, tmp_path, tmp_path / "parts", resumed)), uninterrupted)
    assert log_of(tmp_path / "parts") == log_of(tmp_path / "whole")
    assert (whole.steps, parts.steps, resumed.steps) == ([1, 2, 3, 4], [1, 2, 3], [3, 4])
    assert whole.validations == [2, 4]
    assert (tmp_path / "parts" / "curves.svg").read_bytes() == (tmp_path / "whole" / "curves.svg").read_bytes()


def test_a_run_says_all_that_it_was_computed_on(
    tmp_path: Path, tiny: Tiny, watcher: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Resumed on a CPU for its last steps, a run of a GPU was one of that CPU on the model's card."""
    here = run.hardware(torch.device("cpu"), 1)
    monkeypatch.setattr(run, "hardware", lambda *_: "a GPU")
    with pytest.raises(KeyboardInterrupt):
        run.train(tiny(), tmp_path, tmp_path / "parts", watcher(break_at=3))
    monkeypatch.undo()
    resumed = run.train(tiny(), tmp_path, tmp_path / "parts", watcher())
    assert load_checkpoint(resumed).hardware == f"a GPU, then {here}"
    after = run.train(tiny(seed=6), tmp_path, tmp_path / "after", watcher(), first=resumed)
    assert [each.hardware for each in load_checkpoint(after).ancestors] == [f"a GPU, then {here}"]
    assert load_checkpoint(after).hardware == here


def test_processes_make_the_same_batches_as_a_thread_and_go_on_where_they_were(tmp_path: Path, tiny: Tiny, watcher: Any) -> None:
    config = tiny()
    by_a_thread = load_checkpoint(run.train(config, tmp_path, tmp_path / "thread", watcher()))
    told = watcher()
    by_processes = load_checkpoint(run.train(config, tmp_path, tmp_path / "processes", told, workers=3))
    assert_same_state(by_processes, by_a_thread)
    assert told.steps == [1, 2, 3, 4]
    with pytest.raises(KeyboardInterrupt):
        run.train(config, tmp_path, tmp_path / "parts", watcher(break_at=3), workers=2)
    assert_same_state(load_checkpoint(run.train(config, tmp_path, tmp_path / "parts", watcher(), workers=2)), by_a_thread)


def test_a_process_that_is_lost_is_told_and_what_was_learned_stays(
    tmp_path: Path, tiny: Tiny, watcher: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = run.make_batch

    def killed(seed: list[int], *given: Any) -> Any:
        if seed[1] == 3 and len(given) == 3:
            os.kill(os.getpid(), signal.SIGKILL)
        return made(seed, *given)

    config, out = tiny(), tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr(run, "make_batch", killed)
        with pytest.raises(ConfigError, match=r"--workers: a process that makes pairs was ended from outside; remedy: fewer"):
            run.train(config, tmp_path, out, watcher(), workers=1)
    assert load_checkpoint(out / "checkpoint.pt").step == 2
    assert load_checkpoint(run.train(config, tmp_path, out, watcher(), workers=1)).step == 4


def test_another_seed_gives_other_weights_and_the_run_of_another_configuration_is_not_gone_on_with(
    tmp_path: Path, tiny: Tiny, watcher: Any
) -> None:
    short = {"steps": 1, "check_every": 1}
    weights = []
    for seed in (1, 2):
        config = tiny(seed=seed, schedule=short)
        weights.append(load_checkpoint(run.train(config, tmp_path, tmp_path / str(seed), watcher())).network["entry.weight"])
    assert not torch.equal(*weights)
    with pytest.raises(ConfigError, match=r"another configuration \(seed, schedule.batch\)"):
        run.train(tiny(seed=3, schedule={**short, "batch": 3}), tmp_path, tmp_path / "1", watcher())


def test_a_folder_that_another_process_trains_into_is_refused_until_that_ends(tmp_path: Path, tiny: Tiny, watcher: Any) -> None:
    out = tmp_path / "run"
    holding = "import sys; from pathlib import Path; from visloc_companion.train.run_folder import run_folder\n"
    holding += "with run_folder(Path(sys.argv[1])): print('held', flush=True); sys.stdin.read()"
    with subprocess.Popen(
        [sys.executable, "-c", holding, str(out)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with pytest.raises(ConfigError, match=r"run: another process is training into it; remedy: .*another folder for --out"):
            run.train(tiny(), tmp_path, out, watcher())
        other.kill()
    assert load_checkpoint(run.train(tiny(), tmp_path, out, watcher())).step == 4


def test_a_finished_run_is_left_as_it_is(tmp_path: Path, tiny: Tiny, watcher: Any) -> None:
    config = tiny(schedule={"steps": 1, "check_every": 1})
    path = run.train(config, tmp_path, tmp_path / "run", watcher())
    before = path.read_bytes()
    again = watcher()
    run.train(config, tmp_path, tmp_path / "run", again)
    assert path.read_bytes() == before
    assert again.steps == []


WIDER = {"quarter_width": 4, "quarter_dilations": [1, 2]}


def test_a_wider_network_begins_with_what_another_run_learned_and_answers_as_it_did(
    tmp_path: Path, tiny: Tiny, watcher: Any
) -> None:
    first = run.train(tiny(), tmp_path, tmp_path / "first", watcher())
    learned = load_checkpoint(first)
    beginning = begun(tiny(network=WIDER), tmp_path / "none", torch.device("cpu"), first)
    smaller = new_learner(tiny(), torch.device("cpu"))
    smaller.network.load_state_dict(learned.network)
    image = torch.rand(1, 3, 24, 32)
    assert torch.equal(beginning.learner.network(image), smaller.network(image))
    assert torch.equal(beginning.learner.log_sharpness, learned.log_sharpness)
    assert beginning.ancestors == (Ancestor(learned.config, learned.step, learned.seconds),)


def test_a_run_that_began_with_another_ones_weights_is_resumed_with_the_same_only(
    tmp_path: Path, tiny: Tiny, watcher: Any
) -> None:
    first = run.train(tiny(), tmp_path, tmp_path / "first", watcher())
    other = run.train(tiny(seed=6), tmp_path, tmp_path / "other", watcher())
    config = tiny(network=WIDER)
    whole = load_checkpoint(run.train(config, tmp_path, tmp_path / "whole", watcher(), first=first))
    with pytest.raises(KeyboardInterrupt):
        run.train(config, tmp_path, tmp_path / "parts", watcher(break_at=3), first=first)
    with pytest.raises(ConfigError, match=r"began with other weights.*the same --from"):
        run.train(config, tmp_path, tmp_path / "parts", watcher(), first=other)
    resumed = load_checkpoint(run.train(config, tmp_path, tmp_path / "parts", watcher()))
    assert_same_state(resumed, whole)
    assert resumed.ancestors == whole.ancestors
    assert len(whole.ancestors) == 1


def test_weights_that_do_not_fit_are_refused(tmp_path: Path, tiny: Tiny, watcher: Any) -> None:
    first = run.train(tiny(network=WIDER), tmp_path, tmp_path / "first", watcher())
    for network in ({"half_width": 8, **WIDER}, {}, {**WIDER, "dilations": [1, 2, 1]}):
        with pytest.raises(ModelError, match=r"does not fit.*only a quarter resolution may be added"):
            run.train(tiny(network=network), tmp_path, tmp_path / "out", watcher(), first=first)


def test_missing_data_and_small_images_are_told_before_anything_is_learned(
    tmp_path: Path, tiny: Tiny, watcher: Any, write_raster: Any
) -> None:
    import numpy as np

    dates = {"kind": "dates", "name": "own", "folder": "own"}
    with pytest.raises(ConfigError, match=r"source 'own': there is no such folder; remedy: .*--data"):
        run.train(tiny(sources=[dates]), tmp_path, tmp_path / "run", watcher())
    pairs = {"kind": "pairs", "name": "own", "folder": "own"}
    (tmp_path / "own").mkdir()
    with pytest.raises(ConfigError, match=r"holds no folder with a\.tif and b\.tif"):
        run.train(tiny(sources=[pairs]), tmp_path, tmp_path / "run", watcher())
    pixels = np.random.default_rng(0).integers(0, 255, (120, 130, 3)).astype(np.uint8)
    for year in (2019, 2024):
        write_raster(tmp_path / "own" / f"{year}.tif", pixels, "EPSG:32632", (48.0, 9.0), 1.0)
    with pytest.raises(ConfigError, match="only 130 x 40 px are left"):
        run.train(tiny(sources=[{**dates, "first_row": 80}]), tmp_path, tmp_path / "run", watcher())
    done = run.train(tiny(sources=[dates], schedule={"steps": 1, "check_every": 1}), tmp_path, tmp_path / "run", watcher())
    assert load_checkpoint(done).step == 1


def test_a_loss_that_is_not_finite_ends_the_run(
    tmp_path: Path, tiny: Tiny, watcher: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "training_loss", lambda network, sharpness, batch, seed: sharpness * float("inf"))
    with pytest.raises(ModelError, match=r"the loss is inf at step 1.*learning_rate"):
        run.train(tiny(), tmp_path, tmp_path / "run", watcher())
    assert not (tmp_path / "run" / "checkpoint.pt").exists()


@pytest.mark.parametrize("rate", [1e5, 1e9])
def test_weights_that_are_not_finite_end_the_run_before_they_are_saved(
    tmp_path: Path, tiny: Tiny, watcher: Any, rate: float
) -> None:
    """The last loss was, but not what came of it: the log refused a line, with a traceback."""
    config = tiny(schedule={"learning_rate": rate, "warm_up_steps": 1, "check_every": 1})
    with pytest.raises(ModelError, match=r"is (nan|inf) at step \d; remedy: lower schedule.learning_rate"):
        run.train(config, tmp_path, tmp_path / "run", watcher())
    saved = tmp_path / "run" / "checkpoint.pt"
    assert not saved.exists() or all(weights.isfinite().all() for weights in load_checkpoint(saved).network.values())


def test_a_run_does_not_go_on_with_other_images(tmp_path: Path, tiny: Tiny, watcher: Any, write_raster: Any) -> None:
    """It did, in silence, where a date had been added or changed, or --data named another folder."""
    import numpy as np

    def data(name: str, *seeds: int) -> Path:
        (tmp_path / name / "own").mkdir(parents=True, exist_ok=True)
        for seed in seeds:
            pixels = np.random.default_rng(seed).integers(1, 250, (120, 130, 3)).astype(np.uint8)
            write_raster(tmp_path / name / "own" / f"{seed}.tif", pixels, "EPSG:32632", (48.0, 9.0), 1.0)
        return tmp_path / name

    dates = {"kind": "dates", "name": "mine", "folder": "own"}
    config, out, first = tiny(sources=[dates]), tmp_path / "run", data("first", 1, 2)
    with pytest.raises(KeyboardInterrupt):
        run.train(config, first, out, watcher(break_at=3))
    before = (out / "log.jsonl").read_bytes()
    for other in (data("more", 1, 2, 3), data("others", 1, 4)):
        with pytest.raises(ConfigError, match=r"holds a run on other images \(own 0 1000000\); remedy: .*--data"):
            run.train(config, other, out, watcher())
    assert (out / "log.jsonl").read_bytes() == before
    assert load_checkpoint(run.train(config, data("copied", 1, 2), out, watcher())).step == 4


def test_a_run_from_before_a_key_came_is_gone_on_with(tmp_path: Path, tiny: Tiny, watcher: Any) -> None:
    """What an earlier version did is what the key's default stands for; another value is another configuration."""
    with pytest.raises(KeyboardInterrupt):
        run.train(tiny(), tmp_path, tmp_path / "run", watcher(break_at=3))
    path = tmp_path / "run" / "checkpoint.pt"
    saved = torch.load(path, weights_only=True)
    del saved["config"]["pairs"]["misfit_tilt_deg"]
    torch.save(saved, path)
    with pytest.raises(ConfigError, match=r"another configuration \(pairs.misfit_tilt_deg\)"):
        run.train(tiny(pairs={"misfit_tilt_deg": 3.0}), tmp_path, tmp_path / "run", watcher())
    assert load_checkpoint(run.train(tiny(), tmp_path, tmp_path / "run", watcher())).step == 4


def test_a_checkpoint_that_does_not_say_its_images_is_gone_on_with(tmp_path: Path, tiny: Tiny, watcher: Any) -> None:
    with pytest.raises(KeyboardInterrupt):
        run.train(tiny(), tmp_path, tmp_path / "run", watcher(break_at=3))
    path = tmp_path / "run" / "checkpoint.pt"
    saved = torch.load(path, weights_only=True)
    del saved["images"]
    torch.save(saved, path)
    assert load_checkpoint(path).images == {}
    assert load_checkpoint(run.train(tiny(), tmp_path, tmp_path / "run", watcher())).step == 4


def test_the_rate_rises_and_falls(tiny: Tiny) -> None:
    schedule = tiny(schedule={"steps": 1000, "warm_up_steps": 100, "learning_rate": 0.01, "final_share": 0.1}).schedule
    rates = [learning_rate(schedule, step) for step in range(1000)]
    assert rates[0] == pytest.approx(1e-4)
    assert max(rates) == pytest.approx(0.01, rel=0.03)
    assert rates[-1] == pytest.approx(0.001, rel=0.01)
    assert rates[200:] == sorted(rates[200:], reverse=True)


def test_a_device_that_is_not_there() -> None:
    assert checked_device("cpu").type == "cpu"
    for name in ("cuda:99", "toaster"):
        with pytest.raises(ConfigError, match=f"--device: '{name}' cannot be used"):
            checked_device(name)
