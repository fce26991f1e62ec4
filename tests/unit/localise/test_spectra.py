from __future__ import annotations

import cv2
import numpy as np
import pytest

from visloc_companion.localise.spectra import BlockCorrelator, block_size, correlated_within, paired

RNG = np.random.default_rng(5)


def complex_noise(*shape: int) -> np.ndarray:
    return (RNG.normal(size=shape) + 1j * RNG.normal(size=shape)).astype(np.complex64)


@pytest.fixture(params=[True, False], ids=["primitives", "scipy"])
def _library(request):
    before = cv2.ipp.useIPP()
    cv2.ipp.setUseIPP(request.param)
    yield
    cv2.ipp.setUseIPP(before)


@pytest.mark.usefixtures("_library")
@pytest.mark.parametrize("size", [(16, 24), (24, 16), (48, 64)])
def test_the_correlation_is_the_direct_sum_beyond_the_borders_too(size):
    fields, template, real = complex_noise(2, 20, 31), complex_noise(2, 5, 7), RNG.normal(size=(1, 5, 7)).astype(np.float32)
    box, extent, offset = (-6, -3, 33, 24), (-4, 0, 5, 7), (-3, 2)
    correlator = BlockCorrelator(fields, box, extent, size)
    around = np.pad(fields, ((0, 0), (20, 20), (20, 20)))
    summed, each = np.full((28, 40), np.nan, np.complex64), np.full((2, 28, 40), np.nan, np.complex64)
    for block, at in enumerate(correlator.blocks):
        summed[at] = correlator.summed(block, correlator.spectrum(template, offset))
        each[0][at], each[1][at] = correlator.each(block, correlator.spectrum(real, offset))
    for v in range(box[1], box[3] + 1):
        for u in range(box[0], box[2] + 1):
            seen = around[:, 20 + v + 2 : 20 + v + 7, 20 + u - 3 : 20 + u + 4]
            assert summed[v + 3, u + 6] == pytest.approx(np.vdot(template, seen), abs=2e-4)
            assert each[1, v + 3, u + 6] == pytest.approx(np.vdot(real[0], seen[1]), abs=2e-4)


@pytest.mark.usefixtures("_library")
@pytest.mark.parametrize(("channels", "fields"), [(1, 1), (4, 2), (5, 3)])
def test_within_the_fields_a_correlation_is_the_direct_sum_over_the_channels(channels, fields):
    values, template = (RNG.normal(size=(*size, channels)).astype(np.float32) for size in ((23, 31), (7, 9)))
    assert paired(values).shape == (fields, 23, 31)
    found = correlated_within(paired(values), paired(template)).real
    assert found.shape == (17, 23)
    for v in range(17):
        for u in range(23):
            assert found[v, u] == pytest.approx(float((values[v : v + 7, u : u + 9] * template).sum()), abs=1e-3)


def test_a_template_outside_the_extent_is_refused():
    correlator = BlockCorrelator(complex_noise(1, 20, 20), (0, 0, 9, 9), (-2, -2, 2, 2), (16, 16))
    for offset, shape in (((-3, 0), (1, 2, 2)), ((0, -3), (1, 2, 2)), ((1, 0), (1, 2, 3)), ((0, 1), (1, 3, 2))):
        with pytest.raises(ValueError, match="outside the extent"):
            correlator.spectrum(complex_noise(*shape), offset)


def test_block_sizes_hold_the_template_and_follow_the_work():
    extent = (-70, -60, 70, 60)
    assert block_size((0, 0, 0, 0), extent, 6, 1)[0] in range(121, 129), "one position needs no more than the template"
    height, width = block_size((0, 0, 469, 364), extent, 6, 45)
    assert 121 < height <= 512
    assert 141 < width <= 640
    huge = block_size((0, 0, 3999, 3999), extent, 6, 45)
    assert max(huge) <= 640, "blocks follow the template, not the map"
    assert min(block_size((0, 0, 9, 9), (-500, -400, 500, 400), 6, 45)) >= 810, "a large template needs a large block"
    with pytest.raises(ValueError, match="largest transform"):
        block_size((0, 0, 0, 0), (0, 0, 9999, 10), 6, 1)


@pytest.mark.parametrize("size", [(480, 400), (320, 324), (200, 160)])
def test_large_sums_over_the_fields_are_those_of_each_field(size):
    """Large ones are worked out in parts, the last one with fewer rows."""
    fields, template = complex_noise(3, 150, 140), complex_noise(3, 31, 24)
    box, extent = (0, 0, size[1] - 60, size[0] - 60), (0, 0, 40, 40)
    together = BlockCorrelator(fields, box, extent, size)
    found = together.summed(0, together.spectrum(template, (2, 3)))
    alone = [BlockCorrelator(field[None], box, extent, size) for field in fields]
    want = sum(c.summed(0, c.spectrum(of_field[None], (2, 3))) for c, of_field in zip(alone, template, strict=True))
    assert found.shape == want.shape
    np.testing.assert_allclose(found, want, atol=1e-5 * float(np.abs(want).max()))
