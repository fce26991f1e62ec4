from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.geo.camera import FOCAL_SHARE
from visloc_companion.localise.flow import FrameToFrame
from visloc_companion.localise.odometry.base import Blind, FlowSettings, Step
from visloc_companion.types import CameraModel


def run(odo, ground, points, eulers=None, model=None, surface=None, tweak=None, settings=None):
    flow = FrameToFrame(model or odo.MODEL, settings)
    eulers = [(0.0, 0.0, 0.0)] * len(points) if eulers is None else eulers
    steps = []
    for k, (p, euler) in enumerate(zip(points, eulers, strict=True)):
        sight = odo.sight(ground.frame(p, euler, seed=k), k, p, euler)
        steps.append(flow.step(tweak(k, sight) if tweak else sight, surface))
    return steps


def errors(odo, steps, points):
    """(N, 2) error in sigmas, and the largest in metres, of all steps."""
    found = []
    for step in steps:
        o = step.odometry
        true = points[o.t_to_ns // odo.PERIOD_NS] - points[o.t_from_ns // odo.PERIOD_NS]
        off = np.array(o.displacement_ned_m)[:2] - true[:2]
        found.append([*off, *np.sqrt([o.cov_ne_m2[0][0], o.cov_ne_m2[1][1]])])
    e = np.array(found)
    return e[:, :2] / e[:, 2:], float(np.abs(e[:, :2]).max())


@pytest.mark.parametrize("yaw", [0.0, 130.0])
def test_a_straight_flight_is_followed_from_keyframe_to_keyframe(odo, field, yaw: float) -> None:
    points = odo.path(16, (6.0, 3.0, 0.2))
    steps = run(odo, field, points, [(2.0, -4.0, yaw)] * 16)
    first, rest = steps[0], steps[1:]
    assert isinstance(first, Blind)
    assert (first.reason, first.anchored) == (Reason.NO_BASELINE, True)
    assert all(isinstance(step, Step) for step in rest)
    sigmas, off = errors(odo, rest, points)
    assert off < 0.25
    assert np.abs(sigmas).max() < 2
    closing = [step for step in rest if step.closes]
    assert 1 <= len(closing) <= 4
    starts = {step.odometry.t_from_ns for step in rest}
    assert starts - {0} <= {step.odometry.t_to_ns for step in closing}
    assert all(step.odometry.method == "flow" and step.odometry.inlier_share > 0.8 for step in rest)


def test_who_hovers_does_not_drift(odo, field) -> None:
    rng = np.random.default_rng(3)
    points = np.array([0.0, 0.0, -80.0]) + rng.normal(0, 0.3, (25, 3))
    eulers = [tuple(rng.normal(0, 2.0, 3)) for _ in points]
    steps = run(odo, field, points, eulers)[1:]
    assert {step.odometry.t_from_ns for step in steps} == {0}
    last = steps[-1].odometry
    assert np.hypot(*(np.array(last.displacement_ned_m) - (points[-1] - points[0]))[:2]) < 0.05
    assert last.cov_ne_m2[0][0] < 0.3**2


def test_turning_fast_while_moving_is_followed(odo, field) -> None:
    points = odo.path(10, (5.0, 0.0, 0.0))
    eulers = [(25.0, 0.0, 12.0 * k) for k in range(10)]
    steps = run(odo, field, points, eulers)[1:]
    assert all(isinstance(step, Step) for step in steps)
    assert errors(odo, steps, points)[1] < 0.6


def test_a_tilt_of_forty_five_degrees_and_a_distorted_lens(odo) -> None:
    ground = odo.Ground(odo.texture(), 0.5, model=odo.WIDE)
    points = odo.path(6, (4.0, 4.0, 0.0), (0.0, 0.0, -120.0))
    steps = run(odo, ground, points, [(45.0, 3.0, 60.0)] * 6, model=odo.WIDE)[1:]
    assert all(isinstance(step, Step) for step in steps)
    sigmas, off = errors(odo, steps, points)
    assert off < 1.0
    assert np.abs(sigmas).max() < 3


@pytest.mark.parametrize(("height", "texel"), [(30.0, 0.12), (1000.0, 4.0)])
def test_heights_from_thirty_to_a_thousand_metres(odo, height: float, texel: float) -> None:
    ground = odo.Ground(odo.texture(), texel)
    points = odo.path(8, (0.06 * height, 0.0, 0.0), (0.0, 0.0, -height))
    steps = run(odo, ground, points)[1:]
    assert all(isinstance(step, Step) for step in steps)
    assert errors(odo, steps, points)[1] < 0.006 * height


def test_the_autopilots_small_errors_of_attitude_are_found(odo, field) -> None:
    """A turn that the autopilot does not report, one sigma of 0.4 degrees, would pass for 0.7 m of shift."""
    points = odo.path(5, (5.0, 0.0, 0.0))
    eulers = [(0.0, 0.4 if k else 0.0, 0.0) for k in range(5)]
    flow = FrameToFrame(odo.MODEL, FlowSettings(sigma_turn_rad=math.radians(0.4)))
    steps = [flow.step(odo.sight(field.frame(p, e, seed=k), k, p)) for k, (p, e) in enumerate(zip(points, eulers, strict=True))]
    assert errors(odo, steps[1:], points)[1] < 0.25


def test_with_a_surface_a_slope_costs_nothing_and_heights_are_the_maps(odo) -> None:
    ground = odo.Ground(odo.texture(), slope=0.25)
    points = odo.path(8, (6.0, 2.0, -1.0), (-60.0, 0.0, -100.0))

    def on_map(k: int, sight):
        place = (float(points[k, 0]), float(points[k, 1]))
        return replace(
            sight, place_ne_m=place, sigma_up_m=0.5, sigma_place_m=1.0, height_m=math.nan, sigma_height_m=math.inf, ranged=False
        )

    steps = run(odo, ground, points, tweak=on_map, surface=ground.surface())[1:]
    assert all(isinstance(step, Step) for step in steps)
    sigmas, off = errors(odo, steps, points)
    assert off < 0.3
    assert np.abs(sigmas).max() < 2
    assert steps[-1].odometry.sigma_scale == pytest.approx(math.hypot(0.5 / 115, FOCAL_SHARE), rel=0.1)


def on_a_map(odo, points, up_off_m, sigma_up_m: float = 2.0):
    """A tweak: the altitude is off by 12 m, and `up_off_m(k)` of that is left after what was added to it."""

    def given(k: int, sight):
        off = up_off_m(k)
        place = (float(points[k, 0]), float(points[k, 1]))
        return replace(
            sight,
            **{"place_ne_m": place, "up_m": sight.up_m + off, "up_added_m": off - 12.0, "sigma_up_m": sigma_up_m},
            **{"sigma_place_m": 1.0, "height_m": math.nan, "sigma_height_m": math.inf, "ranged": False},
        )

    return given


def test_a_correction_of_the_altitude_is_no_climb(odo, field) -> None:
    """The altitude is 12 m too high until a fix tells so: from then on displacements are right, and nothing seemed to sink."""
    points = odo.path(8, (6.0, 0.0, 0.0))
    late = on_a_map(odo, points, lambda k: 12.0 if k < 3 else 0.0)
    steps = run(odo, field, points, tweak=late, surface=field.surface())[1:]
    assert all(isinstance(step, Step) for step in steps)
    assert steps[1].odometry.displacement_ned_m[0] == pytest.approx(12 * 1.12, rel=0.02)
    after = [step for step in steps[2:] if step.odometry.t_from_ns >= 2 * odo.PERIOD_NS]
    assert len(after) == len(steps[2:])
    assert errors(odo, after, points)[1] < 0.25
    assert all(abs(step.odometry.displacement_ned_m[2]) < 0.3 for step in steps)


def test_a_small_correction_leaves_the_keyframe(odo, field) -> None:
    points = odo.path(5, (3.0, 0.0, 0.0))
    steps = run(odo, field, points, tweak=on_a_map(odo, points, lambda k: 0.02 * k), surface=field.surface())[1:]
    assert {step.odometry.t_from_ns for step in steps} == {0}
    assert errors(odo, steps, points)[1] < 0.15


def test_a_camera_that_swings_claims_what_a_wrong_lens_makes_of_it(odo, field) -> None:
    """1.5 % of focal length: tilted by 15 degrees from frame to frame, the ground seems to move by 0.4 m and more."""
    lens = replace(odo.MODEL, fx_px=odo.MODEL.fx_px / (1 + FOCAL_SHARE), fy_px=odo.MODEL.fy_px / (1 + FOCAL_SHARE))
    points, swing = odo.path(2, (2.0, 0.0, 0.0)), [(0.0, 0.0, 0.0), (0.0, 15.0, 0.0)]
    level, swung = (run(odo, field, points, eulers, model=lens)[1].odometry for eulers in (None, swing))
    assert abs(level.displacement_ned_m[0] - 2.0) < 0.2 < 0.4 < abs(swung.displacement_ned_m[0] - 2.0)
    assert abs(errors(odo, run(odo, field, points, swing, model=lens)[1:], points)[0][0, 0]) < 2.5
    assert swung.cov_ne_m2[0][0] > level.cov_ne_m2[0][0] + (0.3) ** 2 * 0.8
    off_m = swung.displacement_ned_m[0] - level.displacement_ned_m[0]
    assert off_m == pytest.approx(FOCAL_SHARE * swung.per_focal_ne_m[0], rel=0.3)
    assert swung.sigma_focal == FOCAL_SHARE
    assert abs(level.per_focal_ne_m[0]) < 0.01 * abs(swung.per_focal_ne_m[0])


def test_where_the_height_is_hardly_known_the_claim_says_so(odo, field) -> None:
    points = odo.path(6, (6.0, 0.0, 0.0))

    def too_high(k: int, sight):
        return replace(sight, height_m=sight.height_m + 12.0, sigma_height_m=10.0, ranged=False)

    steps = run(odo, field, points, tweak=too_high)[1:]
    last = steps[-1].odometry
    assert last.displacement_ned_m[0] == pytest.approx(30 * 1.12, rel=0.02)
    assert last.sigma_scale == pytest.approx(0.09, rel=0.25)
    assert abs(errors(odo, [steps[-1]], points)[0][0, 0]) < 2


def test_a_short_dark_leaves_the_keyframe_and_a_jump_makes_a_new_one(odo, field) -> None:
    points = odo.path(10, (3.0, 0.0, 0.0))
    points[7:] += np.array([190.0, 130.0, 0.0])

    def spoilt(k: int, sight):
        return replace(sight, pixels=sight.pixels // 20) if k in {3, 4} else sight

    steps = run(odo, field, points, tweak=spoilt)
    assert [step.reason for step in steps if isinstance(step, Blind)][:3] == [Reason.NO_BASELINE, *[Reason.TOO_DARK] * 2]
    assert steps[5].odometry.t_from_ns == 0
    assert errors(odo, steps[5:7], points)[1] < 0.2
    assert isinstance(steps[7], Blind)
    later = [step for step in steps[8:] if isinstance(step, Step)]
    assert not later or min(step.odometry.t_from_ns for step in later) >= 7 * odo.PERIOD_NS


def test_what_cannot_be_seen_is_said(odo, field) -> None:
    clear = field.frame((0.0, 0.0, -100.0))
    flow = FrameToFrame(odo.MODEL)
    flow.step(odo.sight(clear, 0, (0.0, 0.0, -100.0)))
    rng = np.random.default_rng(0)
    fog = np.clip(150 + rng.normal(0, 2, clear.shape), 0, 255).astype(np.uint8)
    cases = {
        Reason.TOO_DARK: clear // 16,
        Reason.OVEREXPOSED: np.full_like(clear, 250),
        Reason.LOW_TEXTURE: fog,
        Reason.BLURRED: cv2.GaussianBlur(clear, (0, 0), 9.0),
        Reason.TOO_FEW_FEATURES: odo.texture(7, 512)[:240, :320],
    }
    for k, (reason, pixels) in enumerate(cases.items(), 1):
        got = flow.step(replace(odo.sight(pixels, k, (1.0, 0.0, -100.0)), t_ns=k * 10_000_000))
        assert isinstance(got, Blind), reason
        assert got.reason is reason, got


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"sigma_height_m": math.inf}, Reason.BAD_INPUT),
        ({"height_m": math.nan}, Reason.BAD_INPUT),
        ({"up_m": math.inf}, Reason.BAD_INPUT),
        ({"sigma_yaw_rad": -0.1}, Reason.BAD_INPUT),
        ({"q_ned_frd": (2.0, 0.0, 0.0, 0.0)}, Reason.BAD_INPUT),
        ({"height_m": 3000.0}, Reason.BAD_INPUT),
        ({"height_m": 5.0}, Reason.TOO_LOW),
        ({"q_ned_frd": (math.cos(0.5), math.sin(0.5), 0.0, 0.0)}, Reason.HORIZON_IN_VIEW),
        ({"pixels": np.zeros((10, 10), np.uint8)}, Reason.BAD_FRAME),
        ({"t_ns": 0}, Reason.IMPLAUSIBLE_TIME),
    ],
)
def test_bad_input_has_a_reason(odo, field, change, reason: Reason) -> None:
    flow = FrameToFrame(odo.MODEL)
    picture = field.frame((0.0, 0.0, -100.0))
    flow.step(odo.sight(picture, 0, (0.0, 0.0, -100.0)))
    answer = flow.step(replace(odo.sight(picture, 1, (0.0, 0.0, -100.0)), **change))
    assert isinstance(answer, Blind)
    assert answer.reason is reason
    good = flow.step(odo.sight(field.frame((1.0, 0.0, -100.0), seed=2), 2, (1.0, 0.0, -100.0)))
    assert isinstance(good, Step)


def test_a_frozen_camera_is_not_taken_for_hovering(odo, field) -> None:
    flow, picture = FrameToFrame(odo.MODEL), field.frame((0.0, 0.0, -100.0))
    flow.step(odo.sight(picture, 0, (0.0, 0.0, -100.0)))
    frozen = flow.step(odo.sight(picture.copy(), 1, (0.0, 0.0, -100.0)))
    assert isinstance(frozen, Blind)
    assert frozen.reason is Reason.FROZEN


def test_a_driver_that_hands_out_its_buffers_over_and_over_shows_no_way(odo, field) -> None:
    points = odo.path(4, (2.0, 0.0, 0.0))
    flow, pictures = FrameToFrame(odo.MODEL), [field.frame(p, seed=k) for k, p in enumerate(points)]
    answers = [flow.step(odo.sight(pictures[k % 4], k, points[k % 4])) for k in range(12)]
    assert all(isinstance(answer, Step) for answer in answers[1:4])
    assert all(isinstance(answer, Blind) and answer.reason is Reason.FROZEN for answer in answers[4:])


def test_pixels_may_be_overwritten_once_a_step_is_done(odo, field) -> None:
    points = odo.path(3, (5.0, 0.0, 0.0))
    slot, flow, steps = np.zeros((240, 320), np.uint8), FrameToFrame(odo.MODEL), []
    for k, p in enumerate(points):
        slot[:] = field.frame(p, seed=k)
        steps.append(flow.step(odo.sight(slot, k, p)))
    assert errors(odo, steps[1:], points)[1] < 0.1


def test_a_surface_that_does_not_lie_below_is_no_ground(odo, field) -> None:
    picture = field.frame((0.0, 0.0, -100.0))
    on_map = {"sigma_up_m": 1.0, "sigma_place_m": 2.0}
    for surface, change, reason in (
        (field.surface(), {"place_ne_m": (5000.0, 0.0)}, Reason.OUTSIDE_MAP),
        (field.surface(), {"up_m": -20.0}, Reason.TOO_LOW),
        (replace(field.surface(), up_m=np.full((121, 121), np.nan, np.float32)), {}, Reason.OUTSIDE_MAP),
    ):
        answer = FrameToFrame(odo.MODEL).step(odo.sight(picture, 0, (0.0, 0.0, -100.0), **{**on_map, **change}), surface)
        assert isinstance(answer, Blind)
        assert (answer.reason, answer.anchored) == (reason, False)


def test_it_is_deterministic(odo, field) -> None:
    points = odo.path(4, (5.0, 1.0, 0.0))
    one, other = (run(odo, field, points) for _ in range(2))
    assert one == other


def test_waves_are_not_ground_and_ground_is_believed_again_after_a_while(odo, field) -> None:
    """Waves of 2 to 20 m, each at its own speed, are found again for a moment, all moved by metres."""
    rng = np.random.default_rng(5)
    length, angle, phase = np.exp(rng.uniform(0.7, 3.0, 40)), rng.normal(1.0, 0.8, 40), rng.uniform(0, 6.28, 40)
    number = 2 * math.pi / length
    v, u = (grid.ravel() * 100.0 / 220 for grid in np.mgrid[0:240, 0:320])

    def sea(k: int):
        t = k * odo.PERIOD_NS * 1e-9
        along = number * (u[:, None] * np.sin(angle) - v[:, None] * np.cos(angle))
        steep = np.sin(along - np.sqrt(9.81 * number) * t + phase).sum(1) / 4.5
        light = 60 + 10 * steep + 60 * np.maximum(steep - 1.6, 0) + rng.normal(0, 1.5, len(u))
        return np.clip(light, 0, 255).astype(np.uint8).reshape(240, 320)

    points = odo.path(22, (0.0, 0.0, 0.0))
    steps = run(odo, field, points, tweak=lambda k, sight: replace(sight, pixels=sea(k)) if 2 <= k < 12 else sight)
    assert not any(isinstance(step, Step) for step in steps[2:12])
    assert Reason.MOVING_SURFACE in {step.reason for step in steps[2:12]}
    again = next(k for k in range(12, 22) if isinstance(steps[k], Step))
    assert again <= 19  # patience and doubt together: 1.7 s
    assert errors(odo, steps[again:], points)[1] < 0.1


def test_dirt_on_the_lens_is_not_ground(odo, field) -> None:
    rng = np.random.default_rng(6)
    dirt = 60 * cv2.GaussianBlur(rng.standard_normal((240, 320)), (0, 0), 3) / 0.1
    points = odo.path(6, (4.0, 0.0, 0.0))
    eulers = [(2.0 * (k % 2), 0.0, 1.5 * k) for k in range(6)]

    def dirty(k: int, sight):
        pixels = 0.1 * sight.pixels + 100 + dirt + rng.normal(0, 1.5, dirt.shape)
        return replace(sight, pixels=np.clip(pixels, 0, 255).astype(np.uint8))

    steps = run(odo, field, points, eulers, tweak=dirty)
    assert not any(isinstance(step, Step) for step in steps)
    assert Reason.INCONSISTENT_WITH_PRIOR in {step.reason for step in steps[1:]}


def test_large_frames_that_are_soft_and_noisy_are_followed_as_well(odo, field) -> None:
    large = CameraModel(2560, 1920, 1760.0, 1760.0, 1279.5, 959.5)
    rng, points = np.random.default_rng(5), odo.path(3, (6.0, 3.0, 0.0))
    flow, steps = FrameToFrame(large), []
    for k, p in enumerate(points):
        sharp = cv2.resize(field.frame(p, seed=k, noise=0.0), (2560, 1920), interpolation=cv2.INTER_CUBIC)
        soft = cv2.GaussianBlur(sharp, (0, 0), 6.0)
        pixels = np.clip(soft + rng.normal(0, 12, soft.shape), 0, 255).astype(np.uint8)
        steps.append(flow.step(odo.sight(pixels, k, p)))
    assert all(isinstance(step, Step) for step in steps[1:]), steps
    assert errors(odo, steps[1:], points)[1] < 0.25
