"""A real photograph that no localiser can place: taken at take-off, by a vehicle that believes itself in the air."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.image_cases.photos import TAKEOFF, TILT_KNOWN, drone_urban
from visloc_companion.errors import Reason
from visloc_companion.evaluate.cases import Case, read_cases, read_frame
from visloc_companion.localise.features.onnx import open_features
from visloc_companion.localise.registry import make_localiser
from visloc_companion.maps.raster import RasterMap
from visloc_companion.types import FrameRef, LocaliseRequest, NoFix

pytest.importorskip("onnxruntime")


def test_the_photograph_at_take_off_is_refused(shared_data: Path, tmp_path: Path) -> None:
    case = read_cases(drone_urban(tmp_path, TILT_KNOWN, seed=3))[-1]
    assert isinstance(case, Case) and case.case_id == TAKEOFF["id"]
    pixels = read_frame(case.frame)
    assert pixels is not None
    model, reference = case.camera.model(pixels), RasterMap.open(case.ortho, case.dsm)
    frame = FrameRef(0, 0, 0, 0, model.width_px, model.height_px, 3)
    localiser = make_localiser("deep", model, features=open_features(threads=1))
    answer = localiser.localise(LocaliseRequest(0, frame, case.prior, 1), pixels, reference)
    assert isinstance(answer, NoFix)
    assert answer.reason in {Reason.AMBIGUOUS, Reason.NO_MATCH, Reason.BLOCKS_DISAGREE}
