from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("open3d")

from visloc_companion.localise.registration.base import Registered
from visloc_companion.localise.registration.registry import make_registration


def test_matches_irregular_points_from_afar(scene):
    found = make_registration("features", 1.0)(scene.source_m, scene.reference_m, scene.prior)
    assert isinstance(found, Registered)
    assert np.abs(scene.offset_m(found.T_reference_source).mean(0)).max() < 3.0
