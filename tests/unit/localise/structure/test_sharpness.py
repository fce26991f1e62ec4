import math

import cv2
import numpy as np
import pytest

from visloc_companion.localise.structure.sharpness import blur_px


@pytest.mark.parametrize("length_px", [9, 15, 31])
def test_a_smear_is_found_in_any_direction(structure, length_px):
    picture = structure.texture(4)[:400, :400]
    for direction in (0, 45, 90, 135):
        kernel = np.zeros((length_px, length_px), np.float32)
        kernel[length_px // 2] = 1
        turn = cv2.getRotationMatrix2D((length_px // 2, length_px // 2), direction, 1)
        kernel = cv2.warpAffine(kernel, turn, (length_px, length_px))
        smeared = cv2.filter2D(picture, -1, kernel / kernel.sum())
        assert blur_px(smeared) > 0.55 * length_px / math.sqrt(12)


def test_a_sharp_picture_is_sharp_and_a_blank_one_is_not(structure):
    assert blur_px(structure.texture(4)[:400, :400]) < 1.5
    assert blur_px(np.full((100, 100), 90, np.uint8)) == math.inf
