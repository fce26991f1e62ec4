from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from visloc_companion.errors import MapError, OutsideMap, Reason
from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.se3 import quat_from_euler, quat_from_R
from visloc_companion.geo.wgs84 import geo_from_ned, ned_from_geo
from visloc_companion.localise.around.votes import TwoVotes
from visloc_companion.localise.registration.registry import make_registration
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.localise.structure.history import (
    MAX_AGE_NS,
    MOST_FRAMES,
    SIGMA_RELATIVE_M,
    SPACING,
    FrameHistory,
    relative_sigma_m,
)
from visloc_companion.localise.structure.localiser import StructureLocaliser
from visloc_companion.localise.structure.registered_pose import NED_ENU
from visloc_companion.types import Fix, FrameRef, GeoPoint, LocaliseRequest, NoFix, PosePrior, Vote

HOME = GeoPoint(47.0, 8.0, 0.0)
OFF_NED_M = (6.0, -8.0, 1.5)
HOUSES_M = ((-60, -40), (-25, -50), (10, -45), (50, -35), (-50, 0), (-12, -8), (20, 5), (55, 10), (-35, 40), (0, 45), (40, 50))
NORTHS = (-20.0, -8.0, 4.0, 16.0)


CLIMB = {"norths": NORTHS, "ups": (60.0, 72.0, 84.0, 96.0)}
DESCENT = {"norths": (4.0, 16.0), "ups": (90.0, 76.0), "lost_m2": 6.0}
FLASH, NIGHT = np.full((240, 320), 255, np.uint8), np.zeros((240, 320), np.uint8)
OF_ANOTHER_SIZE = np.random.default_rng(2).integers(60, 200, (120, 160), dtype=np.uint8)


@pytest.fixture(scope="module")
def village(structure):
    """A dozen houses of several heights on level ground, nowhere alike."""
    rng = np.random.default_rng(4)
    boxes = []
    for east, north in HOUSES_M:
        half_e, half_n = rng.uniform(4, 9, 2)
        boxes.append(structure.Box(east - half_e, east + half_e, north - half_n, north + half_n, float(rng.uniform(5, 16))))
    return structure.World(structure.texture(1), tuple(boxes))


def map_of(support, world, shape=True):
    """A map of the world's heights under a picture that has nothing to do with it."""
    v, u = np.mgrid[0:320, 0:320]
    places = np.column_stack([(u - 159.5).ravel(), (159.5 - v).ravel()])
    heights = world.height(places).reshape(u.shape).astype(np.float32)
    flat = support.FlatMap(support.texture(9, 320), heights)
    if not shape:
        return flat

    def cloud_around(center_map_m, radius_m, max_points):
        axis = np.arange(-radius_m, radius_m, 0.5)
        east, north = (a.ravel() for a in np.meshgrid(axis, axis))
        near = np.hypot(east, north) <= radius_m
        en = np.column_stack([east, north])[near]
        return np.column_stack([en, world.height(en + np.array(center_map_m))])

    flat.cloud_around = cloud_around
    return flat


def shots(structure, world, norths=NORTHS, off=OFF_NED_M, vote=Vote.STRUCTURE, ups=None, lost_m2=0.0):
    """Requests and pixels along a line, 90 m or `ups` high, all priors off by the same; their variance grows by `lost_m2`."""
    out = []
    for k, (north, up) in enumerate(zip(norths, ups or [90.0] * len(norths), strict=True)):
        T = structure.pose(2.0, north, up, 1.0, -2.0, 5.0)
        q = quat_from_R(NED_ENU @ T[:3, :3] @ R_FRD_CAM.T)
        true = (north, 2.0, -up)
        variance = 64.0 + lost_m2 * (k + 1 - len(norths))
        place = geo_from_ned(tuple(a + b for a, b in zip(true, off, strict=True)), HOME)
        prior = PosePrior(place, q, ((variance, 0.0), (0.0, variance)), 3.0, math.radians(2), math.radians(0.5))
        frame = FrameRef(0, (k + 1) * 1_000_000_000, k, 0, 320, 240, 1)
        out.append((LocaliseRequest(k, frame, prior, 1, vote), world.render(structure.MODEL, T, seed=k), true))
    return out


def localiser(structure, most_wrong: float = 1.0) -> StructureLocaliser:
    settings = LocaliserSettings(max_probability_wrong=most_wrong)
    return StructureLocaliser(structure.MODEL, settings, make_registration("height-search", most_wrong))


def asked(structure, world, reference, most_wrong=1.0, every=False, **other) -> tuple[Fix | NoFix, tuple[float, float, float]]:
    """The answer to the last frame of a flight; `every`: those before are asked about, too."""
    structural, answer, true = localiser(structure, most_wrong), None, (0.0, 0.0, 0.0)
    flown = shots(structure, world, **other)
    for k, (request, pixels, true) in enumerate(flown, 1):  # noqa: B007 (the last one counts)
        structural.remember(request, pixels, reference)
        if every or k == len(flown):
            answer = structural.localise(request, pixels, reference)
    assert answer is not None
    return answer, true


@pytest.fixture(scope="module")
def flown(structure, support, village):
    """What is answered to the last of four frames, of which each was asked about, and the truth."""
    return asked(structure, village, map_of(support, village), every=True)


def test_shape_alone_corrects_a_prior_that_is_ten_metres_off(flown) -> None:
    answer, true = flown
    assert isinstance(answer, Fix), answer
    assert (answer.method, answer.frame_id, answer.t_ns) == ("structure", 3, 4_000_000_000)
    error = np.subtract(ned_from_geo(answer.place, HOME), true)
    assert np.hypot(*error[:2]) < 1.0
    assert abs(error[2]) < 4.0
    assert 0.05 < math.sqrt(answer.cov_ne_m2[0][0]) < 3.0


@pytest.mark.parametrize("climb", [CLIMB, DESCENT], ids=["climb", "descent, the baseline hardly known"])
def test_a_climb_is_no_other_scale_and_no_other_picture(structure, support, village, climb) -> None:
    answer, _ = asked(structure, village, map_of(support, village), **climb)
    assert isinstance(answer, Fix), answer
    true = climb["norths"][answer.frame_id], 2.0, -climb["ups"][answer.frame_id]
    north, east, down = np.subtract(ned_from_geo(answer.place, HOME), true)
    assert np.hypot(north, east) < 1.0
    assert abs(down) < min(2.0, 3 * answer.sigma_h_m)


def test_a_frame_of_a_valley_below_the_ground_of_now_is_left_out(structure, support, village, monkeypatch) -> None:
    structural, reference = localiser(structure), map_of(support, village)
    (low, _, _), *others = shots(structure, village, norths=(-30.0, *NORTHS), ups=(-5.0, *[90.0] * 4))
    with monkeypatch.context() as valley:
        valley.setattr(reference, "height_amsl_m", lambda *_: -60.0)
        structural.remember(low, others[0][1], reference)
    for request, pixels, _ in others:
        structural.remember(request, pixels, reference)
    answer = structural.localise(request, pixels, reference)
    assert isinstance(answer, Fix), answer


@pytest.mark.parametrize("spoilt", [FLASH, NIGHT, OF_ANOTHER_SIZE], ids=["bright", "dark", "another size"])
def test_a_frame_that_shows_nothing_does_not_cost_those_about_it_their_cloud(structure, support, village, spoilt) -> None:
    structural, reference = localiser(structure), map_of(support, village)
    for k, (request, pixels, _) in enumerate(shots(structure, village, norths=(*NORTHS, 28.0))):
        shown = spoilt if k == 2 else pixels
        structural.remember(request, shown, reference)
        if k == 2:
            assert isinstance(structural.localise(request, shown, reference), NoFix)
    answer = structural.localise(request, shown, reference)
    assert isinstance(answer, Fix), answer
    assert answer.frame_id == 4


def test_attitudes_that_are_claimed_to_be_exact_are_no_fault(structure, support, village) -> None:
    reference, structural, answer = map_of(support, village), localiser(structure), None
    for request, pixels, _ in shots(structure, village):
        exact = replace(request, prior=replace(request.prior, sigma_tilt_rad=0.0, sigma_yaw_rad=0.0))
        structural.remember(exact, pixels, reference)
        answer = structural.localise(exact, pixels, reference)
    assert isinstance(answer, Fix), answer


def test_the_same_frames_give_the_same_answer(structure, support, village, flown) -> None:
    """Whether those before the last were asked about or not."""
    one, other = flown[0], asked(structure, village, map_of(support, village))[0]
    assert one.place == other.place
    assert one.cov_ne_m2 == other.cov_ne_m2


@pytest.mark.parametrize(("norths", "reason"), [((0.0,), Reason.NO_PARALLAX), ((0.0, 0.2, 0.4), Reason.NO_BASELINE)])
def test_without_a_base_line_there_is_no_cloud(structure, support, village, norths, reason) -> None:
    answer, _ = asked(structure, village, map_of(support, village), norths=norths)
    assert isinstance(answer, NoFix)
    assert answer.reason is reason


def test_level_ground_says_nothing_of_the_place(structure, support) -> None:
    plain = structure.World(structure.texture(1))
    answer, _ = asked(structure, plain, map_of(support, plain), 0.05)
    assert isinstance(answer, NoFix)


def test_a_map_without_a_shape_is_told(structure, support, village) -> None:
    answer, _ = asked(structure, village, map_of(support, village, shape=False))
    assert isinstance(answer, NoFix)
    assert (answer.reason, answer.detail) == (Reason.BAD_INPUT, "the map has no shape to compare with")


class Picture:
    """An image localiser that says that it was asked."""

    method = "picture"

    def localise(self, request, pixels, ref):
        return NoFix(0, request.frame.t_ns, request.request_id, request.frame.frame_id, "picture", Reason.NO_MATCH, 0.0)


def test_the_request_says_who_votes_and_structure_sees_every_frame(structure, support, village) -> None:
    both, reference = TwoVotes(Picture(), localiser(structure)), map_of(support, village)
    assert both.method == "picture"
    for request, pixels, _ in shots(structure, village, vote=Vote.IMAGE)[:-1]:
        assert both.localise(request, pixels, reference).method == "picture"
    request, pixels, _ = shots(structure, village)[-1]
    answer = both.localise(request, pixels, reference)
    assert isinstance(answer, Fix)
    assert answer.method == "structure"


def test_over_a_map_without_shape_the_image_is_asked_and_no_frame_is_kept(structure, support, village) -> None:
    shaped, plane = map_of(support, village), map_of(support, village, shape=False)
    asked = Mock(side_effect=MapError("the map has no shape: its ground is a plane"))
    refusing = SimpleNamespace(to_map=shaped.to_map, cloud_around=asked)
    for reference in (plane, refusing):
        vote = Mock()
        both = TwoVotes(Picture(), vote)
        for each, pixels, _ in shots(structure, village):
            assert both.localise(each, pixels, reference).method == "picture"
        vote.remember.assert_not_called()
        vote.localise.assert_not_called()
    asked.assert_called_once()


def test_off_the_map_nothing_is_said_of_its_shape(structure, support, village) -> None:
    """A first request from beside the map leaves the vote to those that follow."""
    points = np.zeros((1, 3))
    asked = Mock(side_effect=[OutsideMap("outside"), points])
    reference = SimpleNamespace(to_map=map_of(support, village).to_map, cloud_around=asked)
    vote = Mock()
    both = TwoVotes(Picture(), vote)
    for each, pixels, _ in shots(structure, village):
        both.localise(each, pixels, reference)
    assert asked.call_count == 2
    assert vote.remember.call_count == len(NORTHS) - 1


def test_a_belief_beyond_the_maps_crs_is_off_the_map_and_no_fault(structure, support, village) -> None:
    """Where UTM has no coordinates (90 degrees off its meridian, on the equator) either vote raised."""
    reference, structural = map_of(support, village), localiser(structure)
    both = TwoVotes(Picture(), structural)
    (before, pixels, _), (far, beyond, _) = shots(structure, village)[:2]
    both.localise(replace(before, vote=Vote.IMAGE), pixels, reference)
    reference.to_map = Mock(side_effect=OutsideMap("no coordinates"))
    reference.projection_at = Mock(side_effect=OutsideMap("no coordinates"))
    assert both.localise(replace(far, vote=Vote.IMAGE), beyond, reference).reason is Reason.NO_MATCH
    answer = both.localise(far, beyond, reference)
    assert isinstance(answer, NoFix)
    assert answer.reason is Reason.OUTSIDE_MAP


def test_the_points_that_the_map_hands_out_stay_as_they_are(structure, support, village) -> None:
    reference, handed_out = map_of(support, village), []

    def read_only(*where: object) -> np.ndarray:
        points = map_of(support, village).cloud_around(*where)
        points.setflags(write=False)
        handed_out.append(points)
        return points

    reference.cloud_around = read_only
    assert isinstance(asked(structure, village, reference)[0], Fix)
    assert handed_out


def request(north: float, t_s: float) -> LocaliseRequest:
    prior = PosePrior(geo_from_ned((north, 0.0, -90.0), HOME), quat_from_euler(0, 0, 0), ((1.0, 0.0), (0.0, 1.0)), 1, 0.1, 0.1)
    return LocaliseRequest(0, FrameRef(0, round(t_s * 1e9), round(10 * t_s), 0, 4, 3, 1), prior, 1)


def times(history: FrameHistory) -> list[float]:
    return [seen.request.frame.t_ns * 1e-9 for seen in history.frames()]


def test_frames_too_near_each_other_give_way_to_the_newest() -> None:
    history, pixels = FrameHistory(), np.zeros((3, 4), np.uint8)
    for k in range(80):
        history.add(request(0.5 * k, 0.1 * k), pixels, 100.0)
    assert times(history)[-1] == pytest.approx(7.9)
    apart_s = np.diff(times(history)[:-1])
    assert len(apart_s) > 1
    assert (apart_s >= 20 * SPACING - 1e-6).all(), "at 5 m/s, 100 m up"


def test_frames_are_copied_bounded_and_forgotten_with_age_and_a_step_back() -> None:
    history, pixels = FrameHistory(), np.zeros((3, 4), np.uint8)
    history.add(request(0.0, 1.0), pixels, 100.0)
    pixels[:] = 7
    assert not history.frames()[0].pixels.any()
    for k in range(1, 30):
        history.add(request(20.0 * k, 1.0 + 0.2 * k), pixels, 100.0)
    assert len(history.frames()) == MOST_FRAMES
    history.add(request(900.0, 1e-9 * MAX_AGE_NS + 7.0), pixels, 100.0)
    assert len(history.frames()) == 1
    history.add(request(920.0, 3.0), pixels, 100.0)
    assert times(history) == [3.0]


def prior_of(variance_m2: float) -> PosePrior:
    return PosePrior(HOME, quat_from_euler(0, 0, 0), ((variance_m2, 0.0), (0.0, variance_m2)), 1, 0.1, 0.1)


def test_frames_lie_to_each_other_as_well_as_the_filter_s_variance_stayed_the_same() -> None:
    assert relative_sigma_m([prior_of(100.0)] * 4) == SIGMA_RELATIVE_M  # all are off by the same
    lost = relative_sigma_m([prior_of(100.0), prior_of(104.0)])
    corrected = relative_sigma_m([prior_of(100.0), prior_of(1.0), prior_of(1.0)])
    assert lost == pytest.approx(math.sqrt(SIGMA_RELATIVE_M**2 + 8.0))
    assert corrected == pytest.approx(math.sqrt(SIGMA_RELATIVE_M**2 + 198.0))
