from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.core.satellites.reach import GNSS_BIAS_SIGMA_M, out_of_reach

COV = ((4.0, 1.5), (1.5, 2.0))


@pytest.mark.parametrize("bearing_deg", [0.0, 40.0, 90.0, 135.0, 250.0])
def test_reach_ends_where_the_mahalanobis_distance_is_the_gate(bearing_deg: float) -> None:
    S = np.array(COV) + (2.0**2 + GNSS_BIAS_SIGMA_M**2) * np.eye(2)
    bearing = np.radians(bearing_deg)
    ahead = np.array([np.cos(bearing), np.sin(bearing)])
    edge_m = 4.0 / np.sqrt(ahead @ np.linalg.solve(S, ahead))
    near, far = (share * edge_m * ahead for share in (0.999, 1.001))
    assert not out_of_reach((float(near[0]), float(near[1])), COV, 2.0, 4.0)
    assert out_of_reach((float(far[0]), float(far[1])), COV, 2.0, 4.0)
