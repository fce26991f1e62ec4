"""A log's replay over a map: before arming the map is asked where GNSS puts the vehicle, as in flight."""

from __future__ import annotations

from dataclasses import dataclass, replace

import pytest

from tests.unit.evaluate.test_flight import LEVEL, ORIGIN, S_NS, T0_NS
from visloc_companion.app.ground_check import Ground
from visloc_companion.core.settings import CoreSettings
from visloc_companion.evaluate.flight import replay_recording
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    Event,
    Gnss,
    LinkChanged,
    MapAtGnss,
    OriginChanged,
    PriorPose,
    Status,
    Verdict,
)


@dataclass(frozen=True)
class Plane:
    """A map of all places, or of none, at a height."""

    inside: bool
    surface_m: float

    def covers(self, lat_deg: float, lon_deg: float, margin_m: float = 0.0) -> bool:
        return self.inside

    def to_map(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        return lon_deg, lat_deg

    def height_amsl_m(self, easting_m: float, northing_m: float) -> float:
        return self.surface_m


def standing(duration_s: float, armed_at_s: float) -> list[tuple[int, Event]]:
    """On the ground at the origin; disarmed, then armed."""
    up = LinkChanged(T0_NS, True, AutopilotKind.ARDUPILOT, "4.5.7", 1, armed=False)
    events: list[tuple[int, Event]] = [(T0_NS, up), (T0_NS, OriginChanged(T0_NS, ORIGIN))]
    for k in range(round(duration_s * 5)):
        t_ns = T0_NS + k * S_NS // 5
        if k == round(armed_at_s * 5):
            events.append((t_ns, replace(up, t_rx_ns=t_ns, armed=True)))
        events.append((t_ns, Attitude(t_ns, t_ns, LEVEL, (0.0, 0.0, 0.0))))
        events.append((t_ns, PriorPose(t_ns, t_ns, ORIGIN, (0.0, 0.0, 0.0), 0.0)))
        events.append((t_ns, Gnss(t_ns, t_ns, 3, 14, ORIGIN, 1.0, 1.5, (0.0, 0.0, 0.0))))
    return events


@pytest.mark.parametrize(
    ("ground", "verdict"),
    [
        (Plane(True, ORIGIN.h_amsl_m), Verdict.OK),
        (Plane(True, ORIGIN.h_amsl_m - 200.0), Verdict.DENIED),
        (Plane(False, 0.0), Verdict.DENIED),
    ],
)
def test_gnss_off_the_map_or_its_surface_is_not_believed_before_arming(ground: Plane, verdict: Verdict) -> None:
    entries = list(replay_recording(standing(20.0, 14.0), CoreSettings(), ground=Ground(ground, True)))  # type: ignore[arg-type]
    told = [entry for entry in entries if isinstance(entry.event, MapAtGnss)]
    assert [(entry.now_ns - T0_NS) / S_NS for entry in told] == [0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0]
    assert [entry.now_ns for entry in entries] == sorted(entry.now_ns for entry in entries)
    seen = [e.command.verdict for e in entries if isinstance(e.command, Status) and e.now_ns < T0_NS + 14 * S_NS]
    assert seen[-1] is verdict


def test_a_log_that_never_arms_is_not_asked() -> None:
    """It may be one of a flight whose arming was not logged, 100 m above the surface."""
    entries = replay_recording(standing(10.0, 99.0), CoreSettings(), ground=Ground(Plane(False, 0.0), True))  # type: ignore[arg-type]
    assert not any(isinstance(entry.event, MapAtGnss) for entry in entries)


def test_without_a_map_nothing_is_asked() -> None:
    assert not any(isinstance(entry.event, MapAtGnss) for entry in replay_recording(standing(10.0, 4.0), CoreSettings()))
    assert list(replay_recording([], CoreSettings(), ground=Ground(Plane(True, 0.0), True))) == []  # type: ignore[arg-type]
