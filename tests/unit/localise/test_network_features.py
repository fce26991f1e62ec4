"""Features by a network: padding, validity, bounds, tiles without seams, batches, and which network is the shipped one."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from visloc_companion.errors import ModelError
from visloc_companion.localise import model_folder
from visloc_companion.localise.features.base import Features, Float32Array
from visloc_companion.localise.features.gradient import GRADIENT, eroded
from visloc_companion.localise.features.grey import GREY
from visloc_companion.localise.features.network_input import network_input
from visloc_companion.localise.features.onnx import INPUT_CONTEXT_PX, NetworkFeatures, open_features
from visloc_companion.localise.model_folder import InputSpec
from visloc_companion.localise.runtime import NetworkSession, open_session
from visloc_companion.testing.fake_features import FakeNetwork

Make = Callable[..., Path]


@pytest.fixture(scope="module")
def features(network: Path) -> NetworkFeatures:
    return open_features(network, threads=1)


def picture(height: int, width: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 255, (height, width, 3)).astype(np.uint8)


def all_of(image: np.ndarray) -> np.ndarray:
    return np.ones(image.shape[:2], bool)


def watched(session: NetworkSession) -> tuple[NetworkSession, list[tuple[int, ...]]]:
    """The session, and the shapes that it is run on from now on."""
    shapes: list[tuple[int, ...]] = []

    def run(batch: Float32Array) -> Float32Array:
        shapes.append(batch.shape)
        return session.run(batch)

    return replace(session, run=run), shapes


def test_it_is_features_and_says_whose(features: NetworkFeatures) -> None:
    kept: Features = features
    assert kept.name == features.session.manifest.identity and kept.name.startswith("tiny-")
    assert (kept.recipe, kept.channels, kept.oriented, kept.bound) == (features.session.manifest.input.recipe, 10, 1, 2.0)
    assert kept.context_px >= 112 + 8


@pytest.mark.parametrize("size", [(32, 48), (33, 47), (1, 1), (5, 90)])
def test_any_size_comes_back_as_it_was(features: NetworkFeatures, size: tuple[int, int]) -> None:
    image = picture(*size)
    values = features(image, all_of(image))
    assert values.shape == (*size, 10) and values.dtype == np.float32 and values.flags.c_contiguous
    assert np.abs(values).max() <= features.bound


def test_padding_is_zero_and_cut_off(features: NetworkFeatures) -> None:
    image = picture(30, 41)
    fed = network_input(image, all_of(image))
    padded = np.zeros((1, 3, 32, 44), np.float32)
    padded[0, :, :30, :41] = fed
    expected = features.session.run(padded)[0, :, :30, :41].transpose(1, 2, 0).clip(-2, 2)
    np.testing.assert_array_equal(features(image, all_of(image)), expected)


def test_values_beyond_the_bound_are_clipped(network: Path) -> None:
    session = open_session(network, threads=1)
    loud = NetworkFeatures(replace(session, run=lambda batch: 100 * session.run(batch)))
    image = picture(40, 40)
    assert np.abs(loud(image, all_of(image))).max() == 2.0


def test_invalid_pixels_and_their_neighbours_are_zero(features: NetworkFeatures) -> None:
    image, valid = picture(60, 80), np.ones((60, 80), bool)
    valid[:, 50:] = False
    values = features(image, valid)
    assert not values[eroded(valid, 3) == 0].any() and values[:, :47].any(axis=2).mean() > 0.9
    image[:, 50:] = 0  # what is invalid does not matter
    np.testing.assert_allclose(features(image, valid)[:, :40], values[:, :40], atol=1e-4)


def test_grey_and_float_images_are_taken(features: NetworkFeatures) -> None:
    grey = picture(40, 44)[:, :, 0]
    np.testing.assert_array_equal(features(grey, all_of(grey)), features(grey.astype(np.float32), all_of(grey)))
    three = np.dstack([grey] * 3)
    np.testing.assert_allclose(features(three, all_of(grey)), features(grey, all_of(grey)), atol=1e-4)


@pytest.mark.parametrize("size", [(150, 130), (161, 64), (47, 203), (97, 99)])
def test_tiles_leave_no_seam(network: Path, features: NetworkFeatures, size: tuple[int, int]) -> None:
    session, shapes = watched(features.session)
    tiled = NetworkFeatures(session, tile_px=48)
    image = picture(*size)
    valid = np.random.default_rng(1).random(size) > 0.001
    np.testing.assert_allclose(tiled(image, valid), features(image, valid), atol=1e-4)
    assert len(shapes) > 3
    assert max(height for _, _, height, _ in shapes) <= 48 and max(width for _, _, _, width in shapes) <= 48


def test_tiles_see_more_than_they_answer(network: Path, features: NetworkFeatures) -> None:
    """With the overlap taken away the seams are there: the test above can fail."""
    session = features.session
    output = session.manifest.output.model_copy(update={"context_px": 1, "multiple_px": 4})
    short = replace(session, manifest=session.manifest.model_copy(update={"output": output}))
    wrong = NetworkFeatures(short, tile_px=48)
    wrong._overlap = 0
    image = picture(150, 130)
    assert np.abs(wrong(image, all_of(image)) - features(image, all_of(image))).max() > 0.01


@pytest.mark.parametrize("margin", [0, 3, 8, 20, 121, 127])
@pytest.mark.parametrize("size", [(270, 290), (257, 301)])
def test_a_margin_is_seen_and_cut_off(features: NetworkFeatures, margin: int, size: tuple[int, int]) -> None:
    """The features are those of the whole image; what serves the network's input alone does not go through the network."""
    session, shapes = watched(features.session)
    image, valid = picture(*size), np.random.default_rng(2).random(size) > 0.001
    values = NetworkFeatures(session)(image, valid, margin)
    whole = features(image, valid)[margin : size[0] - margin, margin : size[1] - margin]
    np.testing.assert_allclose(values, whole, atol=1e-6)
    reach = features.context_px - INPUT_CONTEXT_PX
    assert all(got <= want - 2 * max(0, margin - reach) + 10 for got, want in zip(shapes[0][2:], size, strict=True))


@pytest.mark.parametrize("each", [GRADIENT, GREY, FakeNetwork()])
def test_a_margin_is_cut_off_by_every_function(each: Features) -> None:
    image = picture(60, 70)
    np.testing.assert_array_equal(each(image, all_of(image), 7), each(image, all_of(image))[7:-7, 7:-7])


def test_memory_is_bounded_by_the_tile(network: Path) -> None:
    session, shapes = watched(open_session(network, threads=1))
    bounded = NetworkFeatures(session, tile_px=256)
    for side in (600, 1200):
        image = picture(side, side)
        tracemalloc.start()
        bounded(image, all_of(image))
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak / side**2 < 200  # bytes a pixel: what goes in and comes out
    assert max(np.prod(shape[2:]) for shape in shapes) <= 256**2


def test_many_are_what_each_is_in_few_runs(network: Path, features: NetworkFeatures) -> None:
    session, shapes = watched(features.session)
    batched = NetworkFeatures(session, tile_px=64)
    images = [picture(30, 34, seed) for seed in range(5)]
    valids = [np.random.default_rng(seed).random((30, 34)) > 0.01 for seed in range(5)]
    answers = batched.many(images, valids)
    assert [shape[0] for shape in shapes] == [4, 1]
    for image, valid, answer in zip(images, valids, answers, strict=True):
        np.testing.assert_allclose(answer, features(image, valid), atol=1e-5)
    assert batched.many([], []) == []


def test_many_large_ones_go_in_tiles(features: NetworkFeatures) -> None:
    session, shapes = watched(features.session)
    images = [picture(100, 90, seed) for seed in range(2)]
    answers = NetworkFeatures(session, tile_px=48).many(images, [all_of(image) for image in images])
    np.testing.assert_allclose(answers[1], features(images[1], all_of(images[1])), atol=1e-4)
    assert max(shape[2] for shape in shapes) <= 48


def test_what_is_not_finite_is_never_handed_on(features: NetworkFeatures) -> None:
    broken = NetworkFeatures(replace(features.session, run=lambda batch: np.full((1, 10, *batch.shape[2:]), np.nan, np.float32)))
    image = picture(20, 20)
    with pytest.raises(ModelError, match=r"tiny-\w+: answers what is not finite to \(1, 3, 20, 20\); remedy: "):
        broken(image, all_of(image))


def test_a_network_for_another_input_is_refused(make_network: Make, tmp_path: Path) -> None:
    other = InputSpec(name="image", channels=3, channel_names=("r", "g", "b"), recipe="colours")
    folder = make_network(tmp_path / "other", input=other)
    with pytest.raises(ModelError, match=r"manifest.json: input.recipe: it was trained on 'colours', this version feeds"):
        open_features(folder)


def test_the_shipped_network_is_the_one_that_is_named(
    make_network: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside the package in a checkout, inside it in a wheel; the wheel's goes first."""
    package = tmp_path / "visloc_companion"
    monkeypatch.setattr(model_folder.visloc_companion, "__file__", str(package / "__init__.py"))
    with pytest.raises(ModelError, match=r"no network came with this version; remedy: name the folder of one"):
        open_features()
    make_network(tmp_path / "models" / "first")
    (tmp_path / "models" / "default").write_text("first\n")
    assert open_features().session.manifest.name == "tiny"
    assert model_folder.shipped_model() == tmp_path / "models" / "first"
    make_network(package / "models" / "second")
    (package / "models" / "default").write_text("second\n")
    assert model_folder.shipped_model() == package / "models" / "second"
