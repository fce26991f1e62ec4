"""What the memory of the tilt tells of a fix's claim: the mounting's part, and what its localiser cannot know."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from tests.unit.core.camera.test_tilt_memory import FAST, HEIGHT_M, LEVEL, STATED_RAD, STILL, fix_of, request_of
from visloc_companion.core.camera.tilt_memory import TiltMemory
from visloc_companion.types import Fix


def seen_again(claims_deg: tuple[float, ...], n: int, v: tuple[float, float]) -> tuple[TiltMemory, Fix]:
    """A memory after fixes over one ground that claim so much of the tilt in turn, and the next of them, not yet taken."""
    memory, fix = TiltMemory(STATED_RAD), fix_of(0, np.zeros(2), 0.0)
    for k in range(1, n + 1):
        known = memory.known(k * 250_000_000, LEVEL)
        request = request_of(k, LEVEL, 0.25 * k)
        memory.asked(replace(request, prior=replace(request.prior, tilt=known)), LEVEL)
        fix = fix_of(k, np.zeros(2), 0.25 * k, math.radians(claims_deg[k % len(claims_deg)]))
        if k < n:
            memory.taken(fix, v, HEIGHT_M)
    return memory, fix


def test_a_fix_claims_the_slope_that_was_taken_for_a_tilt_before() -> None:
    """Its localiser takes the picture for news, but the frames before saw the same slope."""
    once, first = seen_again((1.6,), 1, STILL)
    assert once.told(first, STILL, HEIGHT_M).more_rad2 < (0.1 * STATED_RAD) ** 2
    memory, fix = seen_again((1.6,), 80, STILL)
    assert memory.told(fix, STILL, HEIGHT_M).more_rad2 > (0.15 * STATED_RAD) ** 2


def test_a_fix_that_saw_no_tilt_claims_nothing_of_it() -> None:
    memory, fix = seen_again((0.5,), 4, FAST)
    assert memory.told(fix, FAST, HEIGHT_M).mounting_rad > 0
    assert memory.told(replace(fix, tilt=None), FAST, HEIGHT_M) == (0.0, 0.0)
    assert memory.told(replace(fix, request_id=99), FAST, HEIGHT_M) == (0.0, 0.0)
    assert memory.told(fix, FAST, 0.0) == (0.0, 0.0)
