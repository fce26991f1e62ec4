from __future__ import annotations

import pytest

from visloc_companion.app.first_position import At, FirstPosition
from visloc_companion.errors import ConfigError
from visloc_companion.types import GeoPoint, LocalPose, OperatorFix, OriginChanged, PriorPose, Tick

HOME = GeoPoint(47.0, 8.0, 600.0)


@pytest.mark.parametrize(
    ("text", "sigma_m", "what"),
    [
        ("47.0", 50.0, "no latitude and longitude"),
        ("47.0,8.0,600", 50.0, "no latitude and longitude"),
        ("north,east", 50.0, "no latitude and longitude"),
        ("97.0,8.0", 50.0, "no place"),
        ("0,0", 50.0, "no place"),
        ("nan,8", 50.0, "no place"),
        ("47,8", 0.0, "--sigma"),
        ("47,8", 1e5, "--sigma"),
        ("47,8", float("nan"), "--sigma"),
    ],
)
def test_what_is_no_place_is_refused_with_the_remedy(text: str, sigma_m: float, what: str) -> None:
    with pytest.raises(ConfigError, match=what) as refused:
        At.parsed(text, sigma_m)
    assert "--at LAT,LON" in str(refused.value.remedy)


@pytest.mark.parametrize(
    "pose", [PriorPose(9, 9, HOME, (0.0, 0.0, 0.0), 50.0), LocalPose(9, 9, (0.0, 0.0, -50.0), (0.0, 0.0, 0.0))]
)
def test_the_navigator_is_told_once_when_origin_and_height_are_known(pose: PriorPose | LocalPose) -> None:
    first = FirstPosition(At.parsed(" 47.01, 8.02", 30.0))
    assert first.heard(pose) is None
    assert first.heard(OriginChanged(5, HOME)) is None
    assert first.heard(Tick(6)) is None
    assert first.heard(pose) == OperatorFix(9, GeoPoint(47.01, 8.02, 0.0), 30.0)
    assert first.heard(pose) is None


def test_nobody_said_anything() -> None:
    first = FirstPosition(None)
    first.heard(OriginChanged(5, HOME))
    assert first.heard(PriorPose(9, 9, HOME, (0.0, 0.0, 0.0), 50.0)) is None
