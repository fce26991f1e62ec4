"""The model card: what the manifest says, for people."""

from __future__ import annotations

from collections.abc import Iterator

from visloc_companion.localise.model_folder import ModelManifest

CARD = "MODEL_CARD.md"
_LIMITS = """## Limits

* It was trained on nadir-like views with turn and scale known to what the search's grid leaves (about 11° and 10 %); the
  localiser turns and scales the frame first.
* Places unlike those above (dense cities, deserts, ice, water, night, thermal or radar images) are outside of what it saw.
  Measure on your own map with `visloc evaluate image` before you rely on it.
* It says nothing of whether a match is right: the localiser's verification does, and is calibrated apart from it.
* Not for identifying or following people."""


def model_card(manifest: ModelManifest) -> str:
    """Markdown made from the manifest alone."""
    return "\n".join(_lines(manifest))


def _lines(manifest: ModelManifest) -> Iterator[str]:
    training, output = manifest.training, manifest.output
    descriptors = output.channels - 2 * output.oriented
    yield f"# {manifest.name}\n"
    yield "Dense image features that last across seasons and years, for matching a drone's camera against an orthophoto.\n"
    yield "## What it is\n"
    yield f"* A fully convolutional network of {manifest.variants['float32'].bytes / 4e3:.0f} thousand float32 values, ONNX opset"
    yield f"  {manifest.opset}; N, H and W are free, H and W multiples of {output.multiple_px}."
    yield f"* Input `{manifest.input.name}` (N, {manifest.input.channels}, H, W): {', '.join(manifest.input.channel_names)}"
    yield f"  ({manifest.input.recipe})."
    yield f"* Output `{manifest.output.name}` (N, {output.channels}, H, W) within ±{output.bound:g}: gradient orientation times a"
    yield f"  learned weight (2 channels, they turn with the image), and {descriptors} learned channels. An output pixel depends"
    yield f"  on {output.context_px} px around it."
    yield f"* Licence of the weights: {manifest.licence}.\n"
    yield "## Intended use\n"
    yield "Methods `deep` and `iclk` of visloc-companion: a downward camera against a georeferenced orthophoto of another date,"
    yield "at 0.1 to 5 m per pixel. Features are compared with those of the same network only.\n"
    yield "## Training\n"
    yield "| data | part | licence |\n|---|---|---|"
    yield from (f"| {source.name} | {source.part} | {source.licence} |" for source in training.data)
    yield f"\nHeld out: {training.split}\n"
    yield f"{training.steps} steps in {training.hours:g} h on {training.hardware}; seed {', '.join(map(str, training.seeds))};"
    yield f"{training.software}.\n"
    yield "## Files\n"
    yield "| variant | file | bytes | SHA-256 |\n|---|---|---|---|"
    for variant, entry in manifest.variants.items():
        yield f"| {variant} | {entry.file} | {entry.bytes} | `{entry.sha256[:16]}…` |"
    yield "\nfloat16 and int8 hold the weights smaller; the computation is float32 in all of them.\n"
    yield "## Figures\n"
    yield "| figure | value |\n|---|---|"
    yield from (
        f"| {name} | {value:.4g} |" if isinstance(value, float) else f"| {name} | {value} |" for name, value in _figures(manifest)
    )
    yield f"\n{_LIMITS}\n"


def _figures(manifest: ModelManifest) -> list[tuple[str, float | str]]:
    return list(manifest.figures.items())
