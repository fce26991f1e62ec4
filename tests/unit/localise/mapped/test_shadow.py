from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from visloc_companion.localise.mapped import shadow


def hills(relief_m: float, seed: int) -> NDArray[np.float32]:
    """(90, 120) round hills of this relief on ground at 480 m."""
    rng = np.random.default_rng(seed)
    smooth = cv2.GaussianBlur(rng.normal(size=(90, 120)).astype(np.float32), (0, 0), 3.0)
    return np.asarray(480 + relief_m * (smooth - smooth.min()) / np.ptp(smooth), dtype=np.float32)


@pytest.mark.parametrize("elevation_deg", [12.0, 30.0, 56.0])
@pytest.mark.parametrize("relief_m", [0.0, 2.0, 25.0, 120.0])
def test_a_shadow_is_followed_no_further_than_anything_can_throw_it(
    relief_m: float, elevation_deg: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    surface, looked = hills(relief_m, round(relief_m)), []
    warp = cv2.warpAffine
    monkeypatch.setattr(cv2, "warpAffine", lambda *args, **kinds: looked.append(args) or warp(*args, **kinds))
    found = shadow.cast_shadow(surface, 0.5, 140.0, elevation_deg)
    steps = len(looked)
    monkeypatch.setattr(shadow, "ROUNDING_M", 1e9)
    np.testing.assert_array_equal(found, shadow.cast_shadow(surface, 0.5, 140.0, elevation_deg))
    assert len(looked) - steps == 8, "as far as FURTHEST_SHADOW_M"
    climb_m = 0.5 * np.tan(np.radians(elevation_deg))
    assert steps == sum(climb_m * 2**k <= relief_m + 0.01 for k in range(8))


def test_missing_heights_hide_no_shadow() -> None:
    """Of a sun in the east, behind which they lie."""
    surface = hills(25.0, 1)
    whole = shadow.cast_shadow(surface, 0.5, 90.0, 12.0)
    surface[:, :5] = np.nan
    np.testing.assert_array_equal(shadow.cast_shadow(surface, 0.5, 90.0, 12.0)[:, 6:], whole[:, 6:])
    assert whole[:, 6:].max() > 5
