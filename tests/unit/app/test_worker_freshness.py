"""The worker refuses the pictures of a camera that froze."""

from __future__ import annotations

from typing import Any

import numpy as np

from visloc_companion.app.worker_process import open_localiser
from visloc_companion.config import parse_config
from visloc_companion.errors import Reason
from visloc_companion.types import FrameRef, GeoPoint, LocaliseRequest, NoFix, PosePrior


def test_a_frozen_camera_is_refused_by_the_worker(small_world: Any) -> None:
    camera = {"url": "x:y", "width_px": 64, "height_px": 48, "fx_px": 100.0, "fy_px": 100.0, "cx_px": 31.5, "cy_px": 23.5}
    answer = open_localiser(parse_config({"camera": camera, "map": {"pack": str(small_world.pack)}}))
    prior = PosePrior(GeoPoint(46.998, 9.002, 80.0), (1.0, 0.0, 0.0, 0.0), ((4.0, 0.0), (0.0, 4.0)), 2.0, 0.02, 0.02)
    pixels = np.full((48, 64), 90, np.uint8)
    answers = [answer(LocaliseRequest(n, FrameRef(0, 5, n, 0, 64, 48, 1), prior, 1), pixels) for n in range(2)]
    refused = [isinstance(one, NoFix) and one.reason is Reason.FROZEN and "frozen" in one.detail for one in answers]
    assert refused == [False, True]
