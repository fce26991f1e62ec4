"""What the memory of the tilt tells of a fix's claim: the mounting's part, and what its localiser cannot know."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from tests.unit.core.camera.test_tilt_memory import FAST, HEIGHT_M, LEVEL, STATED_RAD, STILL, fix_of, request_of
from visloc_companion.core.camera.tilt_memory import ATTITUDE_S, ATTITUDE_SIGMA_RAD, MOUNTING, NOTHING_TOLD, TiltMemory
from visloc_companion.types import Fix, FloatArray


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
    assert memory.told(replace(fix, tilt=None), FAST, HEIGHT_M) == NOTHING_TOLD
    assert memory.told(replace(fix, request_id=99), FAST, HEIGHT_M) == NOTHING_TOLD
    assert memory.told(fix, FAST, 0.0) == NOTHING_TOLD


SLOPE_RAD, SEEN_RAD = math.radians(1.5), math.radians(0.3)


def over_sloping_land(seed: int) -> FloatArray:
    """(K, 3) of fixes straight ahead over land that slopes as much as they claim: by how much the tilt is off that its localiser
    makes of each, by how much once that is set right, and its claim on an axis, rad."""
    rng, memory, found = np.random.default_rng(seed), TiltMemory(STATED_RAD), []
    tilt, slope = rng.normal(0, STATED_RAD, 2), rng.normal(0, SLOPE_RAD, 2)
    var_rad2 = SLOPE_RAD**2 + SEEN_RAD**2
    for k in range(1, 100):
        known, request = memory.known(k * 500_000_000, LEVEL), request_of(k, LEVEL, 0.5 * k)
        memory.asked(replace(request, prior=replace(request.prior, tilt=known)), LEVEL)
        fix = fix_of(k, tilt + slope + rng.normal(0, SEEN_RAD, 2), 0.5 * k, math.sqrt(var_rad2))
        told = memory.told(fix, STILL, HEIGHT_M)
        if known is not None and fix.tilt is not None:
            by_picture = known.sigma_rad**2 / (known.sigma_rad**2 + var_rad2)
            off = known.turn_ne_rad + by_picture * np.subtract(fix.tilt.turn_ne_rad, known.turn_ne_rad) - tilt
            claims_rad = math.sqrt(by_picture * var_rad2 + told.more_rad2)
            found += [(a, b, claims_rad) for a, b in zip(off, off + told.turn_ne_rad, strict=True)]
        memory.taken(fix, STILL, HEIGHT_M)
    return np.array(found)


def test_a_fix_is_set_right_by_the_slope_that_earlier_ones_saw() -> None:
    flights = np.concatenate([over_sloping_land(seed) for seed in range(40)])
    by_localiser, set_right, claimed = np.square(flights).mean(axis=0)
    assert set_right < 0.9 * by_localiser
    assert 0.75 * claimed < set_right < 1.4 * claimed  # 1.5 by the localiser: of each slope the memory takes a part for news


def test_a_fix_over_ground_whose_heights_are_known_is_as_its_localiser_has_it() -> None:
    for claims_deg, as_it_is in ((0.5, True), (1.6, False)):
        memory, _ = seen_again((claims_deg,), 40, STILL)
        told = memory.told(fix_of(40, np.radians([1.0, -0.5]), 10.0, math.radians(claims_deg)), STILL, HEIGHT_M)
        assert (told.turn_ne_rad == (0.0, 0.0)) == as_it_is
        assert told.mounting_rad > 0
        if as_it_is:  # and claims what its localiser errs by, not the 0.309 degrees of one that is set right
            assert math.degrees(math.sqrt(told.more_rad2)) > 0.315


def test_the_first_fix_is_as_its_localiser_has_it() -> None:
    memory, _ = seen_again((1.6,), 1, STILL)
    told = memory.told(fix_of(1, np.radians([1.0, -0.5]), 0.25, math.radians(1.6)), STILL, HEIGHT_M)
    assert np.abs(told.turn_ne_rad).max() < math.radians(0.02)


def test_little_of_the_mounting_is_in_a_fix_whose_picture_tells_the_tilt() -> None:
    """The sum of mounting and attitude is seen, so that where the one is held wrong the other is by as much the other way."""
    parts_rad = []
    for claims_deg in (0.15, 0.5, 1.6):
        memory, fix = seen_again((claims_deg,), 80, FAST)
        parts_rad.append(memory.told(fix, FAST, HEIGHT_M).mounting_rad)
    sure, usual, by_slope = parts_rad
    assert sure < 0.25 * by_slope
    assert usual < 0.5 * by_slope


def by_known_ground(seed: int) -> FloatArray:
    """(K, 2, 3) of fixes over ground of known heights, whose errors go by with the way: on each axis by how much the tilt is off
    that its localiser makes of each, the mounting that the memory has less the true one, and what is told of that, rad."""
    rng, memory, found = np.random.default_rng(seed), TiltMemory(STATED_RAD), []
    mounting = rng.normal(0, math.sqrt(STATED_RAD**2 - ATTITUDE_SIGMA_RAD**2), 2)
    attitude, ground = rng.normal(0, ATTITUDE_SIGMA_RAD, 2), np.zeros(2)
    kept, alike = math.exp(-0.5 / ATTITUDE_S), math.exp(-0.5 * 10.0 / 60.0)
    for k in range(1, 80):
        attitude = kept * attitude + math.sqrt(1 - kept**2) * rng.normal(0, ATTITUDE_SIGMA_RAD, 2)
        ground = alike * ground + math.sqrt(1 - alike**2) * rng.normal(0, SEEN_RAD, 2)
        known, request = memory.known(k * 500_000_000, LEVEL), request_of(k, LEVEL, 0.5 * k)
        memory.asked(replace(request, prior=replace(request.prior, tilt=known)), LEVEL)
        fix = fix_of(k, mounting + attitude + ground, 0.5 * k, SEEN_RAD)
        part_rad = memory.told(fix, FAST, HEIGHT_M).mounting_rad
        if known is not None and fix.tilt is not None:
            by_picture = known.sigma_rad**2 / (known.sigma_rad**2 + SEEN_RAD**2)
            off = known.turn_ne_rad + by_picture * np.subtract(fix.tilt.turn_ne_rad, known.turn_ne_rad) - mounting - attitude
            found.append(np.stack([off, memory._x[MOUNTING] - mounting, np.full(2, part_rad)], axis=-1))
        memory.taken(fix, FAST, HEIGHT_M)
    return np.array(found)


def test_the_mountings_part_is_what_fixes_over_known_ground_err_by_it() -> None:
    flights = np.stack([by_known_ground(seed) for seed in range(200)])[:, 40:]
    off, held, part_rad = flights[..., 0], flights[..., 1], float(flights[..., 2].mean())
    mounting_rad = math.sqrt((held**2).mean())
    shown_rad = float((off * held).mean()) / mounting_rad
    assert part_rad < 0.5 * mounting_rad
    assert 0.6 * part_rad < shown_rad < 1.2 * part_rad
