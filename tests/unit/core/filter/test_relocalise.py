from __future__ import annotations

import pytest

from visloc_companion.core.filter.relocalise import MEMORY, Candidate, Restart, remembered, restart
from visloc_companion.core.settings import NavigatorSettings

SETTINGS = NavigatorSettings()
S = 1_000_000_000
UNIT = ((1.0, 0.0), (0.0, 1.0))


def candidates(*points: tuple[float, float, float], input_mps: float = 30.0) -> tuple[Candidate, ...]:
    """From anchors, under a velocity input to the north."""
    return tuple(Candidate(round(t * S), (n + input_mps * t, e), (n, e), UNIT) for t, n, e in points)


def test_four_that_coincide_restart() -> None:
    four = candidates((0, 100, 0), (1, 101, 1), (2, 99, 0), (3, 100, -1))
    assert restart(four[:3], 0.3, SETTINGS) is None
    assert restart(four, 0.3, SETTINGS) == Restart((0.0, 0.0), 0.0)
    assert restart(candidates((-1, 500, 500)) + four, 0.3, SETTINGS) == Restart((0.0, 0.0), 0.0)


def test_one_stray_among_them_does_not() -> None:
    assert restart(candidates((0, 100, 0), (1, 101, 1), (2, 60, 0), (3, 100, -1)), 0.3, SETTINGS) is None


def test_six_on_a_line_restart_with_the_velocitys_error() -> None:
    """The input is 20 m/s too fast to the north: anchors fall back by 20 m each second."""
    line = candidates(*((0.5 * k, 300.0 - 10.0 * k, 5.0) for k in range(6)))
    assert restart(line[:5], 0.3, SETTINGS) is None
    got = restart(line, 0.3, SETTINGS)
    assert got is not None
    assert got.velocity_error_ne_mps == pytest.approx((20.0, 0.0), abs=1e-9)
    assert got.sigma_mps > 0


@pytest.mark.parametrize(
    "points",
    [
        [(0.5 * k, 300.0 - 60.0 * k, 0.0) for k in range(6)],  # 120 m/s: no vehicle's error
        [(0.1 * k, 300.0 - 10.0 * k, 0.0) for k in range(6)],  # half a second tells no slope
        [(0.5 * k, 300.0 - 10.0 * k + 30.0 * (k % 2), 0.0) for k in range(6)],  # no line
    ],
)
def test_what_is_no_line_does_not(points: list[tuple[float, float, float]]) -> None:
    assert restart(candidates(*points), 0.3, SETTINGS) is None


def test_a_frozen_camera_is_no_line() -> None:
    """The vehicle flies on with 10 m/s, the fixes stay: their anchors fall back by 10 m each second."""
    line = [(0.5 * k, 300.0 - 5.0 * k, 0.0) for k in range(6)]
    assert restart(candidates(*line, input_mps=10.0), 0.3, SETTINGS) is None
    assert restart(candidates(*line, input_mps=20.0), 0.3, SETTINGS) is not None


def test_memory_is_bounded_in_number_and_time() -> None:
    kept: tuple[Candidate, ...] = ()
    for k in range(30):
        (new,) = candidates((k, 0, 0))
        kept = remembered(kept, new)
    assert len(kept) == MEMORY
    (late,) = candidates((100, 0, 0))
    assert remembered(kept, late) == (late,)
