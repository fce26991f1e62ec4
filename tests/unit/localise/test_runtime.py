"""Sessions on a real network of a thousand bytes: the ladder of providers, the settings, the self-test."""

from __future__ import annotations

import builtins
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from visloc_companion.errors import ConfigError, ModelError
from visloc_companion.localise import runtime
from visloc_companion.localise.model_folder import ModelManifest, read_manifest, variant_entry, write_golden, write_manifest
from visloc_companion.localise.runtime import default_threads, load_onnx, open_session, run_onnx

onnxruntime = pytest.importorskip("onnxruntime")
DATA = Path(__file__).parents[2] / "data"
Make = Callable[..., Path]


def rewritten(folder: Path, **changes: Any) -> None:
    manifest = read_manifest(folder)
    write_manifest(folder, ModelManifest.model_validate(manifest.model_dump() | changes))


@pytest.fixture
def own(make_network: Make, tmp_path: Path) -> Path:
    return make_network(tmp_path / "own")


def test_the_committed_networks_are_what_their_recipe_makes() -> None:
    pytest.importorskip("onnx")
    import importlib.util

    spec = importlib.util.spec_from_file_location("make_networks", DATA / "make_networks.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert {path.name: path.read_bytes() for path in DATA.glob("*.onnx")} == module.all_networks()


@pytest.mark.parametrize("shape", [(1, 3, 4, 4), (1, 3, 40, 64), (3, 3, 20, 8)])
def test_any_batch_and_size_are_answered(network: Path, shape: tuple[int, ...]) -> None:
    session = open_session(network)
    batch = np.random.default_rng(0).standard_normal(shape).astype(np.float32)
    answer = session.run(batch)
    assert answer.shape == (shape[0], 10, *shape[2:]) and answer.dtype == np.float32
    for one, expected in zip(batch, answer, strict=True):
        np.testing.assert_allclose(session.run(one[None])[0], expected, atol=1e-5)


def test_a_file_without_a_manifest_answers_as_with_one(network: Path) -> None:
    batch = np.random.default_rng(5).standard_normal((2, 3, 12, 16)).astype(np.float32)
    answer = load_onnx((network / "model.onnx").read_bytes(), threads=1)
    np.testing.assert_array_equal(answer(batch), open_session(network, threads=1).run(batch))
    with pytest.raises(ModelError, match=r"ONNX file: does not run on \(2, 3, 5, 16\)"):
        answer(batch[:, :, :5])


def test_what_was_opened_is_said(network: Path) -> None:
    session = open_session(network, threads=2)
    assert (session.provider, session.skipped, session.threads) == ("cpu", (), 2)
    assert session.about == f"{session.manifest.identity} float32 on cpu, 2 threads"


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Every session of onnxruntime that is made meanwhile."""
    made: list[Any] = []

    class Watched(onnxruntime.InferenceSession):
        def __init__(self, *args: Any, **kwargs: Any) -> None:
            super().__init__(*args, **kwargs)
            made.append(self)

    monkeypatch.setattr(onnxruntime, "InferenceSession", Watched)
    return made


@pytest.mark.parametrize(("asked", "set_to"), [(3, 3), (None, default_threads())])
def test_threads_and_spinning_are_really_set(network: Path, started: list[Any], asked: int | None, set_to: int) -> None:
    open_session(network, threads=asked)
    options = started[0].get_session_options()
    assert (options.intra_op_num_threads, options.inter_op_num_threads) == (set_to, 1)
    assert options.get_session_config_entry("session.intra_op.allow_spinning") == "0"
    assert options.get_session_config_entry("session.inter_op.allow_spinning") == "0"
    assert options.execution_mode == onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    assert options.graph_optimization_level == onnxruntime.GraphOptimizationLevel.ORT_ENABLE_ALL
    assert not options.enable_mem_pattern


@pytest.mark.parametrize(("cores", "threads"), [(1, 1), (2, 1), (4, 3)])
def test_one_core_is_left_to_the_daemon(monkeypatch: pytest.MonkeyPatch, cores: int, threads: int) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(cores)))
    assert default_threads() == threads


def test_the_ladder_falls_to_the_cpu_and_says_why(network: Path) -> None:
    session = open_session(network, ("tensorrt", "qnn", "cpu"), threads=1)
    assert session.provider == "cpu"
    assert [why.split(":")[0] for why in session.skipped] == ["tensorrt", "qnn"]
    assert "passed over tensorrt: not in this build of onnxruntime (it has" in session.about


def test_a_provider_that_silently_becomes_another_is_passed_over(
    network: Path, monkeypatch: pytest.MonkeyPatch, recwarn: pytest.WarningsRecorder
) -> None:
    """Onnxruntime names CUDA but has no device: it warns and computes on the CPU."""
    real = onnxruntime.InferenceSession

    def fallen_back(content: bytes, options: Any, providers: Any, **more: Any) -> Any:
        return real(content, options, providers=["CPUExecutionProvider"], **more)

    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: ["CUDAExecutionProvider", "CPUExecutionProvider"])
    monkeypatch.setattr(onnxruntime, "InferenceSession", fallen_back)
    session = open_session(network, ("cuda", "cpu"))
    assert session.provider == "cpu"
    assert session.skipped == ("cuda: onnxruntime fell back to CPUExecutionProvider; its libraries or the device are missing",)
    with pytest.raises(ConfigError, match=r"localiser.providers: no provider can be used \(cuda: onnxruntime fell back"):
        open_session(network, ("cuda",))


def test_a_provider_that_cannot_start_is_passed_over(network: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = onnxruntime.InferenceSession

    def no_device(content: bytes, options: Any, providers: Any, **more: Any) -> Any:
        if providers[0][0] != "CPUExecutionProvider":
            raise RuntimeError("CUDA failure 100: no CUDA-capable device is detected\n at line 129")
        return real(content, options, providers=providers, **more)

    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: ["CUDAExecutionProvider", "CPUExecutionProvider"])
    monkeypatch.setattr(onnxruntime, "InferenceSession", no_device)
    session = open_session(network, ("cuda", "cpu"))
    assert session.skipped == ("cuda: cannot be loaded: CUDA failure 100: no CUDA-capable device is detected",)


class Lost:
    """A session on an accelerator whose device is lost at will; what it computes is the CPU's."""

    fails = False

    def __init__(self, content: bytes, options: Any, providers: Any, **more: Any) -> None:
        self.name = providers[0][0]
        self.session = onnxruntime_session(content, options, providers=["CPUExecutionProvider"], **more)

    def get_providers(self) -> list[str]:
        return [self.name]

    def run(self, *args: Any) -> Any:
        if Lost.fails and self.name != "CPUExecutionProvider":
            raise RuntimeError("CUDA failure 719: unspecified launch failure")
        return self.session.run(*args)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.session, name)


onnxruntime_session = onnxruntime.InferenceSession


@pytest.fixture
def losable(monkeypatch: pytest.MonkeyPatch) -> type[Lost]:
    names = ["TensorrtExecutionProvider", "CUDAExecutionProvider", "CPUExecutionProvider"]
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: names)
    monkeypatch.setattr(onnxruntime, "InferenceSession", Lost)
    monkeypatch.setattr(Lost, "fails", False)
    return Lost


def test_an_accelerator_that_is_lost_in_flight_is_left_for_the_next(network: Path, losable: type[Lost]) -> None:
    batch = np.random.default_rng(3).random((1, 3, 16, 24), np.float32)
    session = open_session(network, ("cuda", "cpu"), threads=1)
    right = session.run(batch)
    assert (session.provider, session.skipped) == ("cuda", ())
    losable.fails = True
    np.testing.assert_array_equal(session.run(batch), right)
    assert session.provider == "cpu"
    assert session.about.endswith(
        "on cpu, 1 thread; passed over cuda: does not run on (1, 3, 16, 24): CUDA failure 719: unspecified launch failure"
    )
    losable.fails = False
    session.run(batch)
    assert session.provider == "cpu", "a device that was lost is not asked again by this process"


def test_two_accelerators_that_are_lost_are_both_left(network: Path, losable: type[Lost]) -> None:
    session = open_session(network, ("tensorrt", "cuda", "cpu"), threads=1)
    assert session.provider == "tensorrt"
    losable.fails = True
    session.run(np.zeros((1, 3, 8, 8), np.float32))
    assert session.provider == "cpu"
    assert [why.split(":")[0] for why in session.skipped] == ["tensorrt", "cuda"]


def test_an_input_that_no_provider_takes_costs_no_accelerator(
    network: Path, losable: type[Lost], monkeypatch: pytest.MonkeyPatch
) -> None:
    session = open_session(network, ("cuda", "cpu"), threads=1)
    opened: list[str] = []
    start = runtime._start
    monkeypatch.setattr(runtime, "_start", lambda content, name, *rest: opened.append(name) or start(content, name, *rest))
    for _ in range(3):
        with pytest.raises(ModelError, match=r"model.onnx: does not run on \(1, 3, 5, 8\)"):
            session.run(np.zeros((1, 3, 5, 8), np.float32))
    assert (session.provider, session.skipped, opened) == ("cuda", (), ["cpu"])


def test_an_accelerator_that_is_the_only_one_asked_for_fails_aloud(network: Path, losable: type[Lost]) -> None:
    session = open_session(network, ("cuda",), threads=1)
    losable.fails = True
    with pytest.raises(ModelError, match=r"CUDA failure 719"):
        session.run(np.zeros((1, 3, 8, 8), np.float32))


def test_no_provider_at_all(network: Path) -> None:
    with pytest.raises(ConfigError, match=r'localiser.providers: no provider can be used \(qnn: .*remedy: add "cpu"'):
        open_session(network, ("qnn",))


def test_absent_onnxruntime_names_the_extra(network: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *args: Any, **kwargs: Any) -> Any:
        if name == "onnxruntime":
            raise ModuleNotFoundError("No module named 'onnxruntime'", name=name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ConfigError, match=r"networks need onnxruntime: .*remedy: pip install 'visloc-companion\[cpu\]'"):
        open_session(network)


def test_an_import_that_is_interrupted_is_not_an_absent_package(network: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C in that moment: the map was built without the network's features, and replaced the one that had them."""
    imported = builtins.__import__

    def interrupted(name: str, *rest: Any) -> Any:
        if name == "onnxruntime":
            raise ImportError("initialization failed") from KeyboardInterrupt()
        return imported(name, *rest)

    monkeypatch.setattr(builtins, "__import__", interrupted)
    with pytest.raises(KeyboardInterrupt):
        open_session(network, threads=1)


def test_a_truncated_network_is_refused_by_its_hash(own: Path) -> None:
    content = (own / "model.onnx").read_bytes()
    (own / "model.onnx").write_bytes(content[: len(content) // 2])
    with pytest.raises(ModelError, match=r"model.onnx: has \d+ bytes"):
        open_session(own)


@pytest.mark.parametrize("content", [b"", b"\x08\x0a", b"not a network at all"])
def test_what_is_no_network_is_refused(own: Path, content: bytes) -> None:
    """The manifest names the hash of the rubbish: the exporter was broken."""
    (own / "model.onnx").write_bytes(content)
    rewritten(own, variants={"float32": variant_entry(own / "model.onnx", 1e-4, 1e-5).model_dump()})
    with pytest.raises(ModelError, match=r"model.onnx: cannot be loaded"):
        open_session(own)
    with pytest.raises(ModelError, match=r"cannot be loaded"):
        run_onnx(content, np.zeros((1, 3, 4, 4), np.float32))


def test_another_answer_to_the_golden_input_is_refused(own: Path) -> None:
    given = np.ones((1, 3, 16, 16), np.float32)
    golden = write_golden(own, given, run_onnx((own / "model.onnx").read_bytes(), given) + np.float32(2e-4))
    rewritten(own, golden=golden.model_dump())
    with pytest.raises(ModelError, match=r"model.onnx: answers the golden input wrong on cpu: off by 0.0002 at most .* remedy: "):
        open_session(own)


def test_a_small_error_everywhere_is_refused(own: Path) -> None:
    given = np.ones((1, 3, 16, 16), np.float32)
    golden = write_golden(own, given, run_onnx((own / "model.onnx").read_bytes(), given) + np.float32(5e-5))
    rewritten(own, golden=golden.model_dump())
    with pytest.raises(ModelError, match=r"5e-05 rms, allowed are 0.0001 and 1e-05"):
        open_session(own)


def test_nan_is_refused(own: Path) -> None:
    given = np.full((1, 3, 16, 16), 3e38, np.float32)
    rewritten(own, golden=write_golden(own, given, np.zeros((1, 10, 16, 16), np.float32)).model_dump())
    with pytest.raises(ModelError, match=r"answers the golden input wrong on cpu: off by nan"):
        open_session(own)


@pytest.mark.parametrize(
    ("part", "field", "value", "said"),
    [
        ("input", "name", "picture", r"input.name: the manifest says picture, the graph has \['image'\]"),
        ("output", "name", "answer", r"output.name: the manifest says answer, the graph has \['features'\]"),
    ],
)
def test_a_graph_that_is_not_the_manifests(own: Path, part: str, field: str, value: object, said: str) -> None:
    manifest = read_manifest(own).model_dump()
    rewritten(own, **{part: manifest[part] | {field: value}})
    with pytest.raises(ModelError, match=said):
        open_session(own)


def test_a_graph_with_other_channels(own: Path) -> None:
    manifest = read_manifest(own)
    given, answer = np.zeros((1, 3, 8, 8), np.float32), np.zeros((1, 8, 8, 8), np.float32)
    golden = write_golden(own, given, answer).model_dump()
    rewritten(own, output=manifest.output.model_dump() | {"channels": 8}, golden=golden)
    with pytest.raises(ModelError, match=r"output: the manifest says tensor\(float\) \[any, 8, any, any\]"):
        open_session(own)


def test_a_graph_of_one_size_only(make_network: Make, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"input: the manifest says .* the graph has tensor\(float\) \['n', 3, 32, 32\]"):
        open_session(make_network(tmp_path / "fixed", DATA / "fixed.onnx"))


def test_a_size_that_the_network_cannot_take(network: Path) -> None:
    with pytest.raises(ModelError, match=r"model.onnx: does not run on \(1, 3, 5, 8\)"):
        open_session(network).run(np.zeros((1, 3, 5, 8), np.float32))


def test_onnxruntime_is_loaded_only_where_a_session_is_opened() -> None:
    assert not hasattr(runtime, "onnxruntime")


def test_no_computer_tells_anyone_which_networks_it_runs(network: Path, tmp_path: Path) -> None:
    """What onnxruntime notes of each session in the home folder is sent to its maker when there is a network."""
    home = tmp_path / "home"
    home.mkdir()
    program = f"from visloc_companion.localise.runtime import open_session, Path; open_session(Path({str(network)!r}))"
    unset = {name: value for name, value in os.environ.items() if not name.startswith(("ORT_", "XDG_"))}
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**unset, "HOME": str(home)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert sorted(home.rglob("*")) == []
