"""Sparse features: upright, as many as there are, and at a scale that outlives the years."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from benchmarks.image_cases.photos import TILT_KNOWN, drone_urban
from visloc_companion.evaluate.cases import Case, read_cases, read_frame, read_truth
from visloc_companion.evaluate.images.image_metrics import CaseResult, case_error
from visloc_companion.localise.keypoint import MATCHED_AT_ONCE, _detect, _two_nearest
from visloc_companion.localise.registry import make_localiser
from visloc_companion.maps.raster import RasterMap
from visloc_companion.types import Fix, FrameRef, LocaliseRequest

N_PHOTOS = 4


def test_a_large_map_keeps_all_its_key_points() -> None:
    noise = np.random.default_rng(1).normal(size=(900, 900)).astype(np.float32)
    image = cv2.GaussianBlur(noise, (0, 0), 1.5)
    points, descriptors = _detect(image, np.ones(image.shape, np.bool_))
    assert len(points) == len(descriptors) > 8000
    quarter, _ = _detect(image[:450, :450], np.ones((450, 450), np.bool_))
    assert len(quarter) > 0.2 * len(points), "none of a quarter's is lost to stronger ones elsewhere"


def test_descriptors_tell_which_way_a_pattern_lies() -> None:
    """What looks the same only after a turn is another thing on a map."""
    noise = np.random.default_rng(2).normal(size=(200, 200)).astype(np.float32)
    image = cv2.GaussianBlur(noise, (0, 0), 3.0)
    seen = np.ones(image.shape, np.bool_)
    (_, north_up), (_, turned) = _detect(image, seen), _detect(np.ascontiguousarray(np.rot90(image)), seen)
    nearest = np.linalg.norm(north_up[:, None] - turned[None], axis=2).min(1)
    assert np.median(nearest) > 0.5


def test_the_two_nearest_are_those_that_are_found_one_by_one() -> None:
    """More than are matched at once; the last ones are of the other set, and one is there twice."""
    rng = np.random.default_rng(4)
    among, descriptors = (np.sqrt(rng.dirichlet(np.full(128, 0.3), n)).astype(np.float32) for n in (700, 3 * MATCHED_AT_ONCE - 5))
    among[650] = among[90]
    descriptors[-20:] = among[80:100]
    nearest, distance = _two_nearest(descriptors, among)
    found = cv2.BFMatcher(cv2.NORM_L2).knnMatch(descriptors, among, k=2)
    alike = len(descriptors) - 10
    assert sorted(nearest[alike].tolist()) == [90, 650], "which of both is the nearer one is chance"
    assert distance[alike].tolist() == [0.0, 0.0]
    others = np.arange(len(descriptors)) != alike
    want = np.array([[(match.trainIdx, match.distance) for match in pair] for pair in found])
    np.testing.assert_array_equal(nearest[others], want[others, :, 0])
    np.testing.assert_allclose(distance, want[..., 1], atol=1e-6)


def test_photographs_of_a_town_are_found_over_a_satellite_map(shared_data: Path, tmp_path: Path) -> None:
    folder = drone_urban(tmp_path, TILT_KNOWN)
    truth, errors_m = read_truth(folder), []
    for case in read_cases(folder)[:N_PHOTOS]:
        assert isinstance(case, Case)
        pixels = read_frame(case.frame)
        assert pixels is not None
        model, reference = case.camera.model(pixels), RasterMap.open(case.ortho, case.dsm)
        frame = FrameRef(0, 0, 0, 0, model.width_px, model.height_px, 3)
        answer = make_localiser("keypoint", model, max_probability_wrong=1.0).localise(
            LocaliseRequest(0, frame, case.prior, 1), pixels, reference
        )
        result = CaseResult(case.case_id, answer if isinstance(answer, Fix) else None, None, map_gsd_m=reference.gsd_m)
        error = case_error(result, truth[case.case_id])
        errors_m.append(np.inf if error is None else error.horizontal_m)
    assert sum(off_m < 15.0 for off_m in errors_m) >= N_PHOTOS - 1, errors_m
