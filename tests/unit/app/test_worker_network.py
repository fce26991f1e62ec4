"""The worker with a method on a network: opened and tested there and nowhere else; what is wrong with it prevents the start."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from visloc_companion.adapters.camera.calibration import camera_model
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.app.preflight import preflight
from visloc_companion.app.settings import network_choice
from visloc_companion.app.slots import SharedFrameSlots
from visloc_companion.app.worker import WorkerSupervisor
from visloc_companion.app.worker_process import open_localiser
from visloc_companion.config import Config, parse_config
from visloc_companion.errors import ConfigError, ModelError
from visloc_companion.localise import runtime
from visloc_companion.localise.model_folder import read_golden, read_manifest, write_golden, write_manifest
from visloc_companion.localise.registry import ON_FEATURES
from visloc_companion.types import WorkerState

METHOD = next(iter(ON_FEATURES))
Make = Callable[..., Path]


def configuration(pack: Path, model: Path, **localiser: Any) -> Config:
    camera = {"url": "x:y", "width_px": 240, "height_px": 200, "fx_px": 160.0, "fy_px": 160.0, "cx_px": 119.5, "cy_px": 99.5}
    chosen = {"method": METHOD, "model": str(model), "threads": 1} | localiser
    return parse_config({"camera": camera, "map": {"pack": str(pack)}, "localiser": chosen})


@asynccontextmanager
async def worker(config: Config) -> AsyncIterator[WorkerSupervisor]:
    with SharedFrameSlots(camera_model(config.camera)) as slots:
        supervisor = WorkerSupervisor(config, slots, MonotonicClock(), on_notice=lambda _: None)
        try:
            await supervisor.start()
            yield supervisor
        finally:
            await supervisor.close()


async def test_the_worker_alone_opens_the_network_and_says_what_computes(
    small_world: Any, network: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runtime, "_onnxruntime", lambda: pytest.fail("opened in the parent"))  # a spawned worker has its own
    config = configuration(small_world.pack, network, providers=["cuda", "cpu"])
    async with worker(config) as supervisor:
        state = await supervisor.events.get()
    assert isinstance(state, WorkerState) and state.up
    assert state.detail.startswith(f"ready: {read_manifest(network).identity} float32 on cpu, 1 thread; passed over cuda: ")


async def test_a_network_that_answers_wrong_stands_against_the_start(
    small_world: Any, make_network: Make, tmp_path: Path
) -> None:
    folder = make_network(tmp_path / "wrong")
    manifest = read_manifest(folder)
    given, expected = read_golden(folder, manifest)
    write_manifest(folder, manifest.model_copy(update={"golden": write_golden(folder, given, 1.5 * expected)}))
    with pytest.raises(ModelError, match=r"model.onnx: answers the golden input wrong on cpu: .*remedy: "):
        async with worker(configuration(small_world.pack, folder)):
            pass


def test_what_else_is_wrong_with_it_is_told_at_the_same_place(
    small_world: Any, network: Path, make_network: Make, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=r"localiser.providers: no provider can be used"):
        open_localiser(configuration(small_world.pack, network, providers=["qnn"]))
    with pytest.raises(ModelError, match=r"variants: has no 'int8'"):
        open_localiser(configuration(small_world.pack, network, model_variant="int8"))
    folder = make_network(tmp_path / "changed")
    (folder / "model.onnx").write_bytes((folder / "model.onnx").read_bytes()[:-1])
    with pytest.raises(ModelError, match=r"model.onnx: has \d+ bytes"):
        open_localiser(configuration(small_world.pack, folder))


def test_the_configuration_names_the_network(network: Path) -> None:
    choice = network_choice(parse_config({"localiser": {"model": str(network), "threads": 3}}).localiser)
    assert (choice.folder, choice.providers, choice.threads, choice.variant) == (network, ("cpu",), 3, "float32")
    default = network_choice(Config().localiser)
    assert (default.folder, default.threads) == (None, None)


def test_methods_without_a_network_open_none(small_world: Any) -> None:
    config = configuration(small_world.pack, Path("nowhere"), method="gradient")
    assert open_localiser(config).about == ""


def test_the_check_before_the_flight_opens_it_and_says_what_computes(small_world: Any, network: Path) -> None:
    _, found = preflight(configuration(small_world.pack, network))
    assert found["localiser"].startswith(f"{read_manifest(network).identity} float32 on cpu, 1 thread")
    problems, found = preflight(configuration(small_world.pack, network / "none"))
    assert found["localiser"] == "" and any(isinstance(problem, ModelError) for problem in problems)
