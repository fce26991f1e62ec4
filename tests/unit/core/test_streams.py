from __future__ import annotations

import pytest

from visloc_companion.core.settings import CoreSettings
from visloc_companion.core.streams import requests_for
from visloc_companion.types import AutopilotKind, RequestMessage


@pytest.mark.parametrize(
    ("kind", "status"), [(AutopilotKind.ARDUPILOT, {193}), (AutopilotKind.PX4, {230}), (AutopilotKind.UNKNOWN, {193, 230})]
)
def test_asks_for_what_each_autopilot_sends(kind: AutopilotKind, status: set[int]) -> None:
    wanted = requests_for(kind, CoreSettings(attitude_rate_hz=40.0))
    ids = {w.message_id for w in wanted if isinstance(w, RequestMessage)}
    assert ids == {2, 26, 29, 30, 32, 33, 24, 49} | status
    assert RequestMessage(30, 40.0) in wanted
    assert RequestMessage(49, 0.0) in wanted


@pytest.mark.parametrize("terrain", [True, False])
def test_distances_to_the_ground_are_asked_for_only_where_they_are_used(terrain: bool) -> None:
    wanted = requests_for(AutopilotKind.ARDUPILOT, CoreSettings(terrain=terrain))
    assert any(isinstance(w, RequestMessage) and w.message_id == 132 for w in wanted) is terrain


def test_odometry_asks_for_distances_to_the_ground_too() -> None:
    wanted = requests_for(AutopilotKind.PX4, CoreSettings(rangefinder=True))
    assert RequestMessage(132, 10.0) in wanted
