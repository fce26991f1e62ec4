from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed: make install-train")
onnx = pytest.importorskip("onnx", reason="onnx is not installed: make install-train")
pytest.importorskip("onnxscript", reason="onnxscript is not installed: make install-train")
pytest.importorskip("onnxruntime")

from visloc_companion.errors import CasesError, ConfigError, ModelError  # noqa: E402
from visloc_companion.localise.model_folder import ModelManifest, read_manifest  # noqa: E402
from visloc_companion.localise.runtime import open_session  # noqa: E402
from visloc_companion.train import export as exporting  # noqa: E402
from visloc_companion.train.checkpoint import Ancestor, Checkpoint, load_checkpoint, save_checkpoint  # noqa: E402
from visloc_companion.train.config import TrainingConfig  # noqa: E402
from visloc_companion.train.export import ExportOrder, context_px, export, trained_on, training_of  # noqa: E402
from visloc_companion.train.learner import new_learner  # noqa: E402
from visloc_companion.train.networks import FeatureNetwork, NetworkSettings  # noqa: E402
from visloc_companion.train.onnx_file import reduced  # noqa: E402


@pytest.fixture(scope="module")
def order(tmp_path_factory: pytest.TempPathFactory, tiny: Callable[..., TrainingConfig]) -> ExportOrder:
    """Of a network with its first weights."""
    folder, config = tmp_path_factory.mktemp("export"), tiny(network={"quarter_width": 4, "quarter_dilations": [1, 2]})
    learner = new_learner(config, torch.device("cpu"))
    torch.nn.init.normal_(learner.network.quarter.back.weight)
    saved = (learner.network.state_dict(), learner.log_sharpness.detach(), {}, torch.get_rng_state(), "CPU (test)")
    save_checkpoint(folder / "checkpoint.pt", Checkpoint(4, 7200.0, config.plain(), *saved, ()))
    return ExportOrder(folder / "checkpoint.pt", "tiny", folder / "model", "Apache-2.0", data=folder)


@pytest.fixture(scope="module")
def exported(order: ExportOrder) -> ModelManifest:
    """Written once."""
    return export(order, lambda stage: None)


def test_every_variant_opens_in_the_runtime_and_answers_any_size(order: ExportOrder, exported: ModelManifest) -> None:
    given = np.random.default_rng(1).normal(0, 1, (2, 3, 20, 36)).astype(np.float32)
    answers = [open_session(order.out, threads=1, variant=variant).run(given) for variant in exported.variants]
    assert list(exported.variants) == ["float32", "float16", "int8"]
    sizes = [entry.bytes for entry in exported.variants.values()]
    assert sizes == sorted(sizes, reverse=True)
    assert {answer.shape for answer in answers} == {(2, 4, 20, 36)}
    largest = [float(np.abs(answer - answers[0]).max()) for answer in answers]
    assert 0 == largest[0] < largest[1] < 1e-2
    assert largest[2] < 0.1


def test_the_manifest_says_how_the_network_came_about(order: ExportOrder, exported: ModelManifest) -> None:
    assert read_manifest(order.out) == exported
    training = exported.training
    assert (training.steps, training.hours, training.seeds, training.split) == (4, 2.0, (5,), "nothing held out")
    assert [(source.name, source.licence) for source in training.data] == [("shapes", "own work")]
    assert exported.output.channels == 4
    assert exported.figures["float32: largest difference of a feature to PyTorch"] <= 1e-4
    assert "int8: validation queries placed wrong, shapes" in exported.figures
    assert "gradient features alone: validation queries placed wrong, shapes" in exported.figures


def test_figures_of_images_that_were_trained_on_say_so(
    order: ExportOrder, tiny: Callable[..., TrainingConfig], tmp_path: Path, write_raster: Callable[..., Any]
) -> None:
    dates = {"kind": "dates", "name": "own", "folder": "own"}
    (tmp_path / "own").mkdir()
    for year in (2019, 2024):
        pixels = np.random.default_rng(year).integers(1, 255, (240, 130, 3)).astype(np.uint8)
        write_raster(tmp_path / "own" / f"{year}.tif", pixels, "EPSG:32632", (48.0, 9.0), 1.0)
    checked = {
        "batch": 2,
        "windows_px": [32],
        "sources": [dates | {"last_row": 120}, dates | {"name": "other", "first_row": 120}],
    }
    config = tiny(validation=checked, network={"quarter_width": 4, "quarter_dilations": [1, 2]})
    saved = replace(load_checkpoint(order.checkpoint), config=config.plain())
    assert trained_on(saved, config) == frozenset()
    before = tiny(sources=[dates | {"first_row": 119, "last_row": 120}])
    saved = replace(saved, ancestors=(Ancestor(before.plain(), 6, 3600.0),))
    save_checkpoint(tmp_path / "checkpoint.pt", saved)
    told = ExportOrder(tmp_path / "checkpoint.pt", "tiny", tmp_path / "model", "Apache-2.0", data=tmp_path)
    figures = export(told, lambda stage: None).figures
    assert "int8: validation queries placed wrong, own (trained on)" in figures
    assert "int8: validation queries placed wrong, other" in figures
    save_checkpoint(tmp_path / "checkpoint.pt", replace(saved, images={"own 0 120": 1, "gone 0 9": 2}))
    with pytest.raises(ConfigError, match=r"holds a run on other images \(own 0 120\); remedy: .*--data"):
        export(replace(told, out=tmp_path / "other"), lambda stage: None)
    assert not (tmp_path / "other").exists()


def test_cases_that_are_not_there_are_told_before_anything_is_written(order: ExportOrder, tmp_path: Path) -> None:
    with pytest.raises(CasesError, match=r"nowhere/cases\.csv: cannot be read"):
        export(replace(order, out=tmp_path / "model", cases=tmp_path / "nowhere"), lambda stage: None)
    assert not (tmp_path / "model").exists()


def test_the_card_states_what_the_manifest_does(order: ExportOrder, exported: ModelManifest) -> None:
    card = (order.out / "MODEL_CARD.md").read_text(encoding="utf-8")
    assert card.startswith("# tiny\n")
    for words in ("nothing held out", "Apache-2.0", "own work", "CPU (test)", exported.variants["int8"].sha256[:16], "## Limits"):
        assert words in card
    assert all(f"| {name} | " in card for name in exported.figures)


def test_the_same_checkpoint_gives_the_same_bytes_with_nothing_of_this_machine(
    order: ExportOrder, exported: ModelManifest
) -> None:
    again = replace(order, out=order.out.with_name("again"))
    export(again, lambda stage: None)
    files = {path.name: path.read_bytes() for path in order.out.iterdir()}
    assert files == {path.name: path.read_bytes() for path in again.out.iterdir()}
    assert set(files) == {"model.onnx", "model_fp16.onnx", "model_int8.onnx", "golden.npz", "manifest.json", "MODEL_CARD.md"}
    for content in files.values():
        assert b"site-packages" not in content
        assert b".py" not in content
        assert str(Path(__file__).parents[3]).encode() not in content


def _spoilt(content: bytes, name: str) -> bytes:
    """The file with one of its tensors off by a hundredth."""
    model = onnx.load_from_string(content)
    tensor = next(tensor for tensor in model.graph.initializer if tensor.name == name)
    values = onnx.numpy_helper.to_array(tensor)
    tensor.CopyFrom(onnx.numpy_helper.from_array((values * 1.5 + 0.01).astype(values.dtype), name))
    return model.SerializeToString()


@pytest.mark.parametrize(
    ("target", "made", "expected"),
    [
        ("onnx_bytes", lambda content: lambda network: _spoilt(content, "head.bias"), "the float32 file answers otherwise"),
        ("reduced", lambda _: lambda content, kind: _spoilt(reduced(content, kind), f"merge.weight_{kind}"), "the float16 file"),
        ("MAX_FILE_BYTES", lambda _: 1000, "1000 are allowed"),
    ],
)
def test_nothing_is_written_where_a_file_is_wrong(
    order: ExportOrder, exported: ModelManifest, monkeypatch: pytest.MonkeyPatch, target: str, made: Any, expected: str
) -> None:
    right = (order.out / exported.variants["float32"].file).read_bytes()
    monkeypatch.setattr(exporting, "onnx_bytes", lambda network: right)
    monkeypatch.setattr(exporting, target, made(right))
    out = order.out.with_name(f"wrong-{target}")
    with pytest.raises(ModelError, match=expected):
        export(replace(order, out=out, data=None), lambda stage: None)
    assert not out.exists()


def test_an_export_that_breaks_off_leaves_the_model_that_it_goes_over(
    order: ExportOrder, exported: ModelManifest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The files of the new one lay beside the manifest of the old one, which did not fit them."""
    out = tmp_path / "model"
    shutil.copytree(order.out, out)

    def killed(folder: Path, *_: object) -> None:
        assert (folder / "model.onnx").is_file()
        raise KeyboardInterrupt

    monkeypatch.setattr(exporting, "write_golden", killed)
    with pytest.raises(KeyboardInterrupt):
        export(replace(order, name="other", out=out, data=None), lambda stage: None)
    assert all(path.read_bytes() == (out / path.name).read_bytes() for path in order.out.iterdir())
    assert list(tmp_path.iterdir()) == [out] and open_session(out, threads=1).manifest == exported


def test_the_manifest_counts_the_runs_that_the_weights_came_from(tiny: Callable[..., TrainingConfig]) -> None:
    config, before = tiny(seed=7), tiny(seed=6, split="before")
    saved = Checkpoint(4, 1800.0, config.plain(), {}, torch.tensor(4.0), {}, torch.get_rng_state(), "CPU", ())
    alone = training_of(saved, config)
    ancestors = Ancestor(before.plain(), 6, 3600.0, "a GPU, then CPU"), Ancestor(before.plain(), 0, 0.0)
    stated = training_of(replace(saved, ancestors=ancestors[:1]), config)
    assert (alone.hardware, stated.hardware) == ("CPU", "a GPU, then CPU")
    assert training_of(replace(saved, ancestors=ancestors[1:]), config).hardware == "CPU"
    assert (stated.steps, stated.hours, stated.seeds, stated.data) == (10, 1.5, (6, 7), alone.data)
    assert stated.split == config.split


@pytest.mark.parametrize(("dilations", "quarter"), [((1,), ()), ((1, 2, 4), ()), ((1,), (1,)), ((1, 2), (1, 2))])
def test_the_stated_context_is_what_an_output_pixel_depends_on(dilations: tuple[int, ...], quarter: tuple[int, ...]) -> None:
    torch.manual_seed(2)
    settings = NetworkSettings(8, 8, dilations, 2, 8, quarter)
    network, size = FeatureNetwork(settings).double(), 96
    if network.quarter is not None:
        torch.nn.init.normal_(network.quarter.back.weight)
    image = torch.randn(1, 3, size, size, dtype=torch.float64, requires_grad=True)
    reach = 0
    for at in range(44, 48):
        (gradient,) = torch.autograd.grad(network(image)[0, :, 44, at].sum(), image)
        columns = torch.nonzero(gradient[0].abs().sum((0, 1)))
        reach = max(reach, int((columns - at).abs().max()))
    assert context_px(settings) - 4 <= reach <= context_px(settings)
