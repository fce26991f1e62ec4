"""The sun over a picture of a wood, and the map under another one. Pictures are lit by rays that are followed step by step."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.localise.dense import gradient_localiser
from visloc_companion.localise.mapped.light import Light, Relief, relit, sun_over
from visloc_companion.localise.settings import LocaliserSettings, Looks
from visloc_companion.types import CameraModel, Fix, GeoPoint, Sun

HOME = GeoPoint(47.0, 8.0, 0.0)
MODEL = CameraModel(320, 240, 280.0, 280.0, 159.5, 119.5)
MORNING, EVENING = Sun(120.0, 40.0), Sun(235.0, 30.0)
SIDE, LEVEL = 260, (0.0, 0.0, 0.6)
Raster = NDArray[np.float32]


def wood(seed: int, side: int = SIDE, share: float = 1.0) -> Raster:
    """Round crowns of 8 to 16 m, on level ground at 100 m; over a share of it from the left."""
    rng, up = np.random.default_rng(seed), np.full((side, side), 100.0, np.float32)
    v, u = np.mgrid[0:side, 0:side].astype(np.float32)
    for _ in range(round(share * side * side / 60)):
        x, y, radius, top = *rng.uniform(0, side, 2) * (share, 1.0), rng.uniform(2.5, 5.0), rng.uniform(8, 16)
        near = slice(max(0, int(y) - 6), int(y) + 7), slice(max(0, int(x) - 6), int(x) + 7)
        crown = 100 + top * np.sqrt(np.clip(1 - ((u[near] - x) ** 2 + (v[near] - y) ** 2) / radius**2, 0, 1))
        up[near] = np.maximum(up[near], crown)
    return up


def photograph(up: Raster, sun: Sun, seed: int = 0) -> Raster:
    """Pixels of 1 m: paler ground than crowns, Lambert's light, shadow where a ray towards the sun meets something."""
    azimuth, elevation = math.radians(sun.azimuth_deg), math.radians(sun.elevation_deg)
    east, north, rise = math.sin(azimuth) * math.cos(elevation), math.cos(azimuth) * math.cos(elevation), math.sin(elevation)
    down_v, along_u = np.gradient(up)
    normal = np.stack([-along_u, down_v, np.ones_like(up)]) / np.sqrt(1 + along_u**2 + down_v**2)
    direct = np.clip(normal[0] * east + normal[1] * north + normal[2] * rise, 0, None)
    v, u = np.mgrid[0 : up.shape[0], 0 : up.shape[1]].astype(np.float32)
    for step in range(1, 45):
        run = step / math.hypot(east, north)
        there = cv2.remap(
            up, u + np.float32(east * run), v - np.float32(north * run), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        direct[there > up + rise * run] = 0
    ground = cv2.GaussianBlur(np.random.default_rng(seed).standard_normal(up.shape), (0, 0), 3)
    albedo = np.where(up > 102, 90.0, 130.0) + 40 * ground / ground.std() * (up <= 102)
    return np.asarray(np.clip(albedo * (0.45 + 0.8 * direct), 0, 255), dtype=np.float32)


def everywhere(up: Raster) -> NDArray[np.bool_]:
    return np.ones(up.shape, np.bool_)


@pytest.mark.parametrize("azimuth_deg", [10.0, 120.0, 180.0, 235.0, 300.0])
@pytest.mark.parametrize("elevation_deg", [20.0, 45.0])
def test_a_wood_shows_from_where_it_is_lit(azimuth_deg, elevation_deg):
    up = wood(1)
    sun = sun_over(photograph(up, Sun(azimuth_deg, elevation_deg)), everywhere(up), up, 1.0)
    assert sun is not None
    assert abs((sun.azimuth_deg - azimuth_deg + 180) % 360 - 180) < 15
    assert abs(sun.elevation_deg - elevation_deg) < 20


def test_a_picture_that_is_not_yet_in_place_shows_it_too():
    up = wood(2)
    sun = sun_over(np.roll(photograph(up, EVENING), (2, -2), (0, 1)), everywhere(up), up, 1.0)
    assert sun is not None
    assert abs(sun.azimuth_deg - EVENING.azimuth_deg) < 20


def test_finer_pixels_show_the_same():
    up = wood(1)
    fine = [np.kron(a, np.ones((2, 2), np.float32)) for a in (photograph(up, MORNING), up)]
    sun = sun_over(fine[0], everywhere(fine[0]), fine[1], 0.5)
    assert sun is not None
    assert abs(sun.azimuth_deg - MORNING.azimuth_deg) < 15


def level() -> tuple[Raster, Raster]:
    up = np.full((SIDE, SIDE), 100.0, np.float32)
    return photograph(up, MORNING), up


def another_wood() -> tuple[Raster, Raster]:
    return photograph(wood(3), MORNING), wood(4)


def overcast() -> tuple[Raster, Raster]:
    up = wood(1)
    noise = np.random.default_rng(5).normal(0, 4, up.shape)
    return np.asarray(np.where(up > 102, 90, 130) + noise, dtype=np.float32), up


@pytest.mark.parametrize("of", [level, another_wood, overcast])
def test_nothing_is_claimed_of_a_sun_that_does_not_show(of):
    grey, up = of()
    assert sun_over(grey, everywhere(up), up, 1.0) is None


@pytest.mark.parametrize(("gsd_m", "side"), [(2.5, SIDE), (1.0, 50)])
def test_pixels_too_coarse_or_too_few_are_not_asked(gsd_m, side):
    up = wood(1)[:side, :side]
    assert sun_over(photograph(up, MORNING), everywhere(up), up, gsd_m) is None


def test_only_what_is_seen_is_asked():
    up, seen = wood(1), np.zeros((SIDE, SIDE), np.bool_)
    grey = photograph(up, MORNING)
    grey[:, 130:] = photograph(up, EVENING)[:, 130:]
    seen[:, 130:] = True
    sun = sun_over(grey, seen, up, 1.0)
    assert sun is not None
    assert abs(sun.azimuth_deg - EVENING.azimuth_deg) < 20


def test_level_ground_in_the_sun_is_lit_by_one():
    assert Relief(level()[1], 1.0).light(EVENING) == pytest.approx(1.0, abs=1e-5)


def test_a_map_under_another_sun_looks_like_the_picture_taken_under_it():
    up = wood(6)
    morning, evening = photograph(up, MORNING), photograph(up, EVENING)
    under = relit(morning, up, 1.0, Light(MORNING, EVENING))

    def alike(a, b):
        return np.corrcoef(a.ravel(), b.ravel())[0, 1]

    assert alike(morning, evening) < 0.45
    assert alike(under, evening) > 0.8
    assert relit(morning, up, 1.0, Light(MORNING, MORNING)) == pytest.approx(morning)


@pytest.fixture(scope="module")
def two_hours(support):
    """A wood as the map has it, in the morning, and as it is flown over in the evening, with hardly anything else."""
    up = wood(7, 700, 0.9)
    maps = [support.FlatMap(np.asarray(photograph(up, sun, 3), dtype=np.uint8), up) for sun in (MORNING, EVENING)]
    return maps[0], maps[1]


def off_m(support, two_hours, looks, sun=None):
    known, flown = two_hours
    errors = []
    for k in range(6):
        truth = (-130.0 + 50 * k, 100.0 - 45 * k, -270.0)
        frame = support.render(flown, MODEL, truth, LEVEL)
        request = support.request_at((truth[0] + 4.0, truth[1] - 3.0, truth[2]), LEVEL, sigma_m=6.0)
        request = replace(request, prior=replace(request.prior, sun=sun, sigma_tilt_rad=math.radians(0.1)))
        answer = gradient_localiser(MODEL, LocaliserSettings(max_probability_wrong=0.9, looks=looks)).localise(
            request, frame, known
        )
        assert isinstance(answer, Fix)
        errors.append((np.array(ned_from_geo(answer.place, HOME)[:2]) - truth[:2], answer))
    return np.array([e for e, _ in errors]), [answer for _, answer in errors]


def test_a_wood_under_another_sun_is_found_where_it_is(support, two_hours):
    plain, _ = off_m(support, two_hours, Looks.FIRST)
    off, answers = off_m(support, two_hours, Looks.BOTH)
    lit = np.array([dict(answer.evidence)["lit"] for answer in answers]) > 0
    assert lit.sum() >= 5  # one is too far off to show its sun
    assert np.hypot(*off[lit].T).max() < 0.35 < np.hypot(*plain[lit].T).min()
    suns = [answer.sun for answer in answers if answer.sun is not None]
    assert len(suns) == lit.sum()
    assert all(abs(sun.azimuth_deg - EVENING.azimuth_deg) < 20 for sun in suns)


def test_a_sun_that_is_told_is_not_looked_for(support, two_hours):
    told, answers = off_m(support, two_hours, Looks.BOTH, EVENING)
    assert all(dict(answer.evidence)["lit"] == 1.0 and answer.sun is None for answer in answers)
    plain, _ = off_m(support, two_hours, Looks.FIRST)
    assert np.hypot(*told.T).mean() < 0.5 * np.hypot(*plain.T).mean()


def test_a_frame_under_the_maps_sun_shows_it_and_nothing_is_relit(support, two_hours):
    _, flown = two_hours
    off, answers = off_m(support, (flown, flown), Looks.BOTH)
    assert all(dict(answer.evidence)["lit"] == 0.0 for answer in answers)
    suns = [answer.sun for answer in answers if answer.sun is not None]
    assert len(suns) >= 5
    assert all(abs(sun.azimuth_deg - EVENING.azimuth_deg) < 20 for sun in suns)
    assert np.hypot(*off.T).max() < 0.05
