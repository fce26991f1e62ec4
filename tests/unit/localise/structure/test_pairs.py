import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.localise.structure.base import NoCloud, StereoSettings
from visloc_companion.localise.structure.pairs import Star, choose

BLANK = np.zeros((240, 320), np.uint8)


def chosen(structure, places, **settings):
    frames = [structure.posed(BLANK, structure.pose(*place)) for place in places]
    return choose(frames, structure.MODEL, StereoSettings(**settings))


def test_the_middle_frame_is_matched_with_those_beside_it(structure):
    (star,) = chosen(structure, [(0, 27.0 * k, 90) for k in range(3)])
    assert isinstance(star, Star)
    assert (star.hub, set(star.partners)) == (1, {0, 2})
    assert star.base_to_height == pytest.approx((0.3, 0.3))
    # 240 px of 212.7 px focal length show 1.128 of the height, 0.3 of it are new
    assert star.overlap == pytest.approx((0.73, 0.73), abs=0.05)


def test_of_many_frames_those_at_a_good_base_are_taken(structure):
    star, *_ = chosen(structure, [(0, 5.0 * k, 90) for k in range(12)])
    assert all(0.2 <= ratio <= 0.42 for ratio in star.base_to_height)
    assert star.partners[0] < star.hub < star.partners[1] or star.partners[1] < star.hub < star.partners[0]


def test_as_many_partners_as_are_asked_for(structure):
    assert len(chosen(structure, [(0, 27.0 * k, 90) for k in range(3)], max_partners=1)[0].partners) == 1


def test_further_stars_go_on_over_new_ground_from_a_base_that_they_share(structure):
    stars = chosen(structure, [(0, 13.0 * k, 90) for k in range(8)])
    assert len(stars) == 3
    for number, star in enumerate(stars[1:], 1):
        assert any(star.hub in known.partners and star.partners[0] == known.hub for known in stars[:number])
        assert len(star.partners) == 2
        assert (star.partners[1] > star.hub) == (star.hub > star.partners[0]), "away from the one before"
    assert len(chosen(structure, [(0, 13.0 * k, 90) for k in range(8)], max_stars=1)) == 1


def test_a_star_without_some_of_its_partners(structure):
    (star,) = chosen(structure, [(0, 27.0 * k, 90) for k in range(3)])
    fewer = star.of([False, True])
    assert (fewer.hub, fewer.partners, fewer.base_to_height) == (star.hub, star.partners[1:], star.base_to_height[1:])


@pytest.mark.parametrize(
    ("places", "reason"),
    [
        ([(0, 0, 90), (0, 4, 90)], Reason.NO_BASELINE),
        ([(0, 0, 90), (0, 4, 90, 0, 0, 40)], Reason.NO_PARALLAX),
        ([(0, 0, 90), (0, 80, 90)], Reason.LOW_OVERLAP),
        ([(0, 0, 90), (0, 27, 90, 50)], Reason.LOW_OVERLAP),
    ],
)
def test_refusals(structure, places, reason):
    found = chosen(structure, places)
    assert isinstance(found, NoCloud)
    assert found.reason is reason
