"""Where the sun stands, kept from the frames that show it."""

from __future__ import annotations

import pytest

from visloc_companion.core.camera.sun_memory import FEWEST, KEPT_NS, MOST, SunMemory
from visloc_companion.types import Sun


def memory_of(azimuths_deg, t_ns=0):
    memory = SunMemory()
    for k, azimuth_deg in enumerate(azimuths_deg):
        memory.seen(t_ns + k, Sun(azimuth_deg, 30.0 + k % 3))
    return memory


def test_few_frames_tell_nothing():
    assert memory_of([200.0] * (FEWEST - 1)).known(100) is None
    assert memory_of([200.0] * FEWEST).known(100) == Sun(200.0, 31.0)


def test_one_that_went_wrong_is_outvoted():
    known = memory_of([196.0, 203.0, 20.0, 199.0, 205.0]).known(100)
    assert known is not None
    assert known.azimuth_deg == 203.0


def test_frames_that_disagree_tell_nothing():
    assert memory_of([10.0, 100.0, 190.0, 280.0, 200.0]).known(100) is None


def test_north_is_no_border():
    known = memory_of([355.0, 2.0, 358.0, 4.0, 1.0]).known(100)
    assert known is not None
    assert known.azimuth_deg in (358.0, 1.0, 2.0)


def test_the_sun_goes_on():
    memory = memory_of([200.0] * FEWEST)
    assert memory.known(KEPT_NS) is not None
    assert memory.known(KEPT_NS + FEWEST + 1) is None


def test_the_newest_frames_count():
    assert memory_of([100.0] * MOST + [200.0] * MOST).known(100) == Sun(pytest.approx(200.0), 31.0)
