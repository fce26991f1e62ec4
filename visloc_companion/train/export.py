"""From a checkpoint to `models/NAME/`: ONNX in three precisions, golden vector, manifest and card; nothing where one is wrong,
and what had the name stays until all is written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from visloc_companion.errors import ModelError
from visloc_companion.evaluate.cases import read_cases
from visloc_companion.evaluate.images.image import evaluate_image
from visloc_companion.localise.features.network_input import CHANNELS, RECIPE
from visloc_companion.localise.model_folder import (
    VARIANT_FILES,
    InputSpec,
    ModelManifest,
    OutputSpec,
    Training,
    TrainingData,
    VariantName,
    variant_entry,
    write_golden,
    write_manifest,
)
from visloc_companion.localise.runtime import NetworkChoice
from visloc_companion.train.checkpoint import Checkpoint, load_checkpoint, write_file
from visloc_companion.train.config import TrainingConfig, parse_training_config
from visloc_companion.train.config_sources import DatesSource, LandscapeSource, PairsSource, SourceConfig, share_images
from visloc_companion.train.judge import Difference, answer, check, compare, inputs_for_comparison, painted_input, placed_wrong
from visloc_companion.train.learner import network_settings, on_all, require_same_images
from visloc_companion.train.mixture import Places, Tell, pair_settings, validation_batches
from visloc_companion.train.model_card import CARD, model_card
from visloc_companion.train.model_swap import replacing
from visloc_companion.train.networks import BOUND, MULTIPLE_PX, ORIENTED, FeatureNetwork, NetworkSettings
from visloc_companion.train.onnx_file import INPUT, OPSET, OUTPUT, onnx_bytes, reduced
from visloc_companion.train.steps import Batch

MAX_FILE_BYTES = 5_000_000
CHANNEL_NAMES = ("normalised grey", "gradient cosine", "gradient sine")
GOLDEN_SEED, GOLDEN_SIZE = 3, (64, 96)
ELSEWHERE_MAX, ELSEWHERE_RMS = 5e-3, 5e-4
"""What another provider's float32 arithmetic may add to a variant's own difference on the golden input."""
METHOD = "deep"
OTHER_IMAGES = "give the data of the training (--data); figures of other images are none of that network's"
TRAINED_ON = " (trained on)"
"""Behind a figure of pairs that are cut from images of the training."""


@dataclass(frozen=True, slots=True)
class ExportOrder:
    """What is to be exported, as whom, and what it is to be measured on."""

    checkpoint: Path
    name: str
    out: Path
    licence: str
    data: Path | None = None
    """Folder of the training's data: the validation pairs are compared too, and figures of them stated."""
    cases: Path | None = None
    """Folder of image cases with truth: localisation figures of every variant are stated."""
    limit: int | None = None
    """Only the first so many cases."""


def export(order: ExportOrder, tell: Tell) -> ModelManifest:
    """Write the folder; the same checkpoint and order give the same bytes (but for measured localisation).

    Raises ModelError where the checkpoint cannot be used, a file answers otherwise than PyTorch or is too large (nothing is
    written then), ConfigError where the folder cannot be written or data are missing, CasesError for cases that cannot be read.
    """
    if order.cases is not None:
        read_cases(order.cases)
    saved = load_checkpoint(order.checkpoint)
    config = parse_training_config(saved.config, where=str(order.checkpoint))
    network = _network(saved, config, order.checkpoint)
    batches = _batches(saved, config, order, tell)
    tell("ONNX")
    contents: dict[VariantName, bytes] = {"float32": onnx_bytes(network)}
    for variant in ("float16", "int8"):
        contents[variant] = reduced(contents["float32"], variant)
    inputs = inputs_for_comparison(batches)
    differences: dict[VariantName, Difference] = {}
    for variant, content in contents.items():
        tell(f"comparing {variant} with PyTorch")
        _check_size(variant, content)
        differences[variant] = compare(network, content, inputs)
        check(variant, differences[variant])
    figures = _figures(contents, differences, batches, trained_on(saved, config), tell)
    with replacing(order.out) as folder:
        manifest = _written(folder, order, saved, config, network, contents, figures)
        if order.cases is not None:
            figures |= _localisation(order, folder, order.cases, contents, tell)
            manifest = manifest.model_copy(update={"figures": figures})
            write_manifest(folder, manifest)
        write_file(folder / CARD, model_card(manifest).encode())
    return manifest


def context_px(settings: NetworkSettings) -> int:
    """How far an output pixel depends on the input around it (networks.py): entry, down, blocks and bilinear rise, merge."""
    half = 1 + sum(settings.dilations) + 1
    if settings.quarter_dilations:
        half += 1 + 2 * (sum(settings.quarter_dilations) + 1)
    return 1 + 2 * half + 1 + 1


def _network(saved: Checkpoint, config: TrainingConfig, where: Path) -> FeatureNetwork:
    network = FeatureNetwork(network_settings(config.network))
    try:
        network.load_state_dict(saved.network)
    except RuntimeError as why:
        raise ModelError("does not fit this version's network", where=str(where), remedy="train again with this version") from why
    network.eval()
    return network


def _batches(saved: Checkpoint, config: TrainingConfig, order: ExportOrder, tell: Tell) -> dict[str, Sequence[Batch]]:
    if order.data is None:
        return {}
    places = Places(order.data, tell)
    batches = validation_batches(config.validation, pair_settings(config.pairs), places)
    before = {name: saved.images[name] for name in places.images if name in saved.images}
    require_same_images(before, {name: places.images[name] for name in before}, order.checkpoint, OTHER_IMAGES)
    return batches


def _check_size(variant: VariantName, content: bytes) -> None:
    if len(content) > MAX_FILE_BYTES:
        raise ModelError(
            f"the {variant} file has {len(content)} bytes, {MAX_FILE_BYTES} are allowed",
            where="visloc train export",
            remedy="train a smaller network (network.full_width, network.half_width)",
        )


def _figures(
    contents: Mapping[VariantName, bytes],
    differences: Mapping[VariantName, Difference],
    batches: Mapping[str, Sequence[Batch]],
    trained: frozenset[str],
    tell: Tell,
) -> dict[str, float | str]:
    figures: dict[str, float | str] = {}
    for variant, difference in differences.items():
        figures[f"{variant}: largest difference of a feature to PyTorch"] = _rounded(difference.largest)
        figures[f"{variant}: rms difference of features to PyTorch"] = _rounded(difference.rms)
    if batches:
        for who, content in (("gradient features alone", None), *contents.items()):
            tell(f"validation pairs: {who}")
            for name, share in placed_wrong(content, batches).items():
                remark = TRAINED_ON if name in trained else ""
                figures[f"{who}: validation queries placed wrong, {name}{remark}"] = _rounded(share)
    return figures


def trained_on(saved: Checkpoint, config: TrainingConfig) -> frozenset[str]:
    """Names of the validation sources whose images this run, or one that its first weights came from, was trained on."""
    sources = [source for run in _runs(saved, config) for source in run.sources]
    return frozenset(own.name for own in config.validation.sources if any(share_images(own, source) for source in sources))


def _runs(saved: Checkpoint, config: TrainingConfig) -> tuple[TrainingConfig, ...]:
    return (*(parse_training_config(run.config, where="ancestor") for run in saved.ancestors), config)


def _localisation(
    order: ExportOrder, folder: Path, cases: Path, contents: Mapping[VariantName, bytes], tell: Tell
) -> dict[str, float | str]:
    """Figures of `visloc evaluate image` with each variant."""
    figures: dict[str, float | str] = {}
    for variant in contents:
        tell(f"cases: {variant}")
        document, _ = evaluate_image(cases, METHOD, limit=order.limit, network=NetworkChoice(folder, variant=variant))
        summary: dict[str, Any] = document["summary"]
        found = {
            "cases": summary["n"],
            "fixes": summary["n_fix"],
            "share within 5 px": summary.get("within_5px_share"),
            "share within 2 px": summary.get("within_2px_share"),
            "wrong and accepted": summary.get("wrong_and_accepted"),
            "mean error (px)": (summary.get("error_px") or {}).get("mean"),
        }
        figures |= {f"{variant}, {cases.name}: {what}": _rounded(value) for what, value in found.items() if value is not None}
    return figures


def _written(
    folder: Path,
    order: ExportOrder,
    saved: Checkpoint,
    config: TrainingConfig,
    network: FeatureNetwork,
    contents: Mapping[VariantName, bytes],
    figures: dict[str, float | str],
) -> ModelManifest:
    """Files, golden vector and manifest on disk."""
    given = painted_input(GOLDEN_SEED, *GOLDEN_SIZE)
    expected = answer(network, given)
    for variant, content in contents.items():
        write_file(folder / VARIANT_FILES[variant], content)
    golden = write_golden(folder, given, expected)
    own = {variant: compare(network, content, [given]) for variant, content in contents.items()}
    entries = {
        variant: variant_entry(
            folder / VARIANT_FILES[variant],
            _rounded(2 * own[variant].largest + ELSEWHERE_MAX),
            _rounded(2 * own[variant].rms + ELSEWHERE_RMS),
        )
        for variant in contents
    }
    manifest = ModelManifest(
        name=order.name,
        licence=order.licence,
        opset=OPSET,
        variants=entries,
        input=InputSpec(name=INPUT, channels=CHANNELS, channel_names=CHANNEL_NAMES, recipe=RECIPE),
        output=OutputSpec(
            name=OUTPUT,
            channels=expected.shape[1],
            oriented=ORIENTED,
            bound=BOUND,
            multiple_px=MULTIPLE_PX,
            context_px=context_px(network_settings(config.network)),
        ),
        training=training_of(saved, config),
        figures=figures,
        golden=golden,
    )
    write_manifest(folder, manifest)
    return manifest


def training_of(saved: Checkpoint, config: TrainingConfig) -> Training:
    """How the weights came about, as the manifest states it: this run and those that its first weights came from."""
    runs = _runs(saved, config)
    return Training(
        data=tuple(dict.fromkeys(_trained_on(source) for run in runs for source in run.sources)),
        split=config.split or "not stated",
        seeds=tuple(run.seed for run in runs),
        steps=saved.step + sum(run.step for run in saved.ancestors),
        hours=round((saved.seconds + sum(run.seconds for run in saved.ancestors)) / 3600, 2),
        hardware=on_all(*(run.hardware for run in saved.ancestors), saved.hardware),
        software=f"torch {torch.__version__}, numpy {np.__version__}, opencv {cv2.__version__}",
    )


def _trained_on(source: SourceConfig) -> TrainingData:
    return TrainingData(name=source.name, part=part_of(source), licence=source.licence)


def part_of(source: SourceConfig) -> str:
    """Which part of a source was trained on, in words."""
    if isinstance(source, DatesSource):
        return f"{source.folder}, rows {source.first_row} to {source.last_row - 1}"
    if isinstance(source, PairsSource):
        return f"{source.folder}, {', '.join(source.pairs) or 'all pairs'}"
    if isinstance(source, LandscapeSource):
        return f"procedural, seeds {', '.join(map(str, source.seeds))}, {source.size_m:g} m at {source.gsd_m:g} m/px"
    return "invented, new for each pair"


def _rounded(value: float) -> float:
    """Four digits: rounding of the last bits is no difference."""
    return float(f"{value:.4g}")
