"""A lens that frames are tried through: what decides that it is there, and what does not."""

from __future__ import annotations

import pytest

from visloc_companion.core.camera.zoom_tries import PAUSE_NS
from visloc_companion.core.camera.zoom_watch import HITS, LEAST_HEIGHTS, MISSES, ZoomWatch
from visloc_companion.core.satellites.gnss_track import GnssTrack
from visloc_companion.errors import Reason
from visloc_companion.types import Command, Fix, FrameRef, GeoPoint, LocaliseRequest, NoFix, PosePrior

S, HEIGHT_M = 1_000_000_000, 100.0
COV, LEVEL = ((1.0, 0.0), (0.0, 1.0)), (1.0, 0.0, 0.0, 0.0)
BELIEVED = GeoPoint(59.3, 18.1, 140.0)


class Flight:
    """A frame each second, over one place; `zoom` enlarges pictures."""

    def __init__(self) -> None:
        self.watch, self.zoom, self.t_s = ZoomWatch(), 1.0, 0
        self.said: list[Command] = []

    def fix(self, factor: float) -> Fix:
        """Lower by as much as the picture is larger beyond a lens."""
        place = GeoPoint(BELIEVED.lat_deg, BELIEVED.lon_deg, BELIEVED.h_amsl_m + HEIGHT_M * (factor / self.zoom - 1))
        return Fix(0, self.t_s * S, self.t_s, 1, "test", place, LEVEL, COV, 1.0, 0.05, 0.001, 1.0)

    def see(self, *, recognised: bool) -> float | None:
        """Through which lens the frame was tried."""
        self.t_s += 1
        tried = self.watch.next(self.t_s * S, GnssTrack())
        frame = FrameRef(self.t_s * S, self.t_s * S, 1, 0, 640, 480, 1)
        self.watch.asked(LocaliseRequest(self.t_s, frame, PosePrior(BELIEVED, LEVEL, COV, 1.0, 0.05, 0.02), 1), HEIGHT_M)
        zoomed = None if tried is None else self.fix(tried)
        refused = NoFix(0, self.t_s * S, self.t_s, 1, "test", Reason.NO_MATCH, 1.0, zoomed=zoomed)
        self.said += self.watch.answered(self.fix(1.0) if recognised else refused, 10.0)
        return tried


@pytest.mark.parametrize(("zoom", "found"), [(1.3, True), (1.05, False)])
def test_looks_through_a_lens_that_is_nearly_the_believed_one_end_the_tries_for_a_while(zoom: float, *, found: bool) -> None:
    """Three of them agree on the place and the enlargement, by less than is told: it is no zoom that hides the ground."""
    flight = Flight()
    for _ in range(LEAST_HEIGHTS + 1):
        assert flight.see(recognised=True) is None
    flight.zoom = zoom
    tried = [flight.see(recognised=False) for _ in range(MISSES + HITS)]
    assert tried[:MISSES] == [None] * MISSES
    assert None not in tried[MISSES:]
    assert bool(flight.said) is found
    assert (flight.watch.found is not None) is found
    assert flight.watch.factor == (pytest.approx(zoom, rel=0.01) if found else 1.0)
    if not found:
        pause = [flight.see(recognised=False) for _ in range(PAUSE_NS // S + 2)]
        assert pause[: PAUSE_NS // S - 1] == [None] * (PAUSE_NS // S - 1)
        assert pause[-1] is not None or pause[-2] is not None
