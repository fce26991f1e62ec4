"""The fakes keep what they promise: they stand in for the real parts in everybody's tests."""

import math

import numpy as np
import pytest

from visloc_companion.app.clock import ManualClock, MonotonicClock
from visloc_companion.errors import CameraError, OutsideMap, Reason
from visloc_companion.geo.wgs84 import distance_m
from visloc_companion.protocols import AutopilotLink, Camera, Localiser, ReferenceMap
from visloc_companion.testing.fake_camera import FakeCamera
from visloc_companion.testing.fake_link import FakeLink
from visloc_companion.testing.fake_localiser import FakeLocaliser
from visloc_companion.testing.fake_map import AnalyticMap
from visloc_companion.types import (
    CameraModel,
    Fix,
    FrameRef,
    GeoPoint,
    LinkChanged,
    LocaliseRequest,
    NoFix,
    OriginChanged,
    PosePrior,
    Tick,
)

ORIGIN = GeoPoint(47.0, 8.0, 500.0)
LEVEL = (1.0, 0.0, 0.0, 0.0)
MODEL = CameraModel(8, 6, 10.0, 10.0, 3.5, 2.5)


class Slots:
    def __init__(self) -> None:
        self.written: list[np.ndarray] = []

    def write(self, pixels: np.ndarray) -> int:
        self.written.append(pixels.copy())
        return len(self.written) - 1

    def read(self, frame: FrameRef) -> np.ndarray:
        return self.written[frame.slot]


def request(place: GeoPoint, seed: int = 1, t_ns: int = 5) -> LocaliseRequest:
    prior = PosePrior(place, LEVEL, ((1.0, 0.0), (0.0, 1.0)), 1.0, 0.1, 0.01)
    return LocaliseRequest(7, FrameRef(10, t_ns, 3, 0, 8, 6, 1), prior, seed)


def test_they_are_what_they_stand_in_for():
    assert isinstance(FakeLink(ManualClock()), AutopilotLink)
    assert isinstance(FakeCamera(MODEL, [], ManualClock()), Camera)
    assert isinstance(AnalyticMap(ORIGIN), ReferenceMap)
    assert isinstance(FakeLocaliser(lambda _: (ORIGIN, LEVEL)), Localiser)


@pytest.mark.parametrize("heading_rad", [0.0, 0.7, -2.5])
@pytest.mark.parametrize("gsd_m", [0.5, 1.3])
def test_the_maps_pixels_are_those_of_its_formula(heading_rad, gsd_m):
    ref = AnalyticMap(ORIGIN)
    patch = ref.patch((30.0, -20.0), (41, 31), gsd_m, heading_rad)
    assert (patch.pixels.shape, patch.valid.all()) == ((31, 41), True)
    u, v = 33, 4
    ahead_m, right_m = (15 - v) * gsd_m, (u - 20) * gsd_m
    east = 30.0 + ahead_m * math.sin(heading_rad) + right_m * math.cos(heading_rad)
    north = -20.0 + ahead_m * math.cos(heading_rad) - right_m * math.sin(heading_rad)
    assert patch.pixels[v, u] == round(float(ref.grey(np.array([east, north]))))
    assert patch.dsm_amsl_m[v, u] == pytest.approx(ref.height_amsl_m(east, north), abs=1e-3)


def test_the_map_has_an_edge():
    ref = AnalyticMap(ORIGIN, half_size_m=100.0)
    patch = ref.patch((95.0, 0.0), (41, 41), 0.5, 0.0)
    assert patch.valid[:, 0].all()
    assert not patch.valid[:, -1].any()
    assert not patch.pixels[~patch.valid].any()
    assert math.isnan(ref.height_amsl_m(101.0, 0.0))
    with pytest.raises(OutsideMap):
        ref.patch((500.0, 0.0), (41, 41), 0.5, 0.0)


def test_the_maps_places_go_there_and_back():
    ref = AnalyticMap(ORIGIN, half_size_m=100.0)
    lat, lon = ref.to_geo(60.0, -30.0)
    assert ref.to_map(lat, lon) == pytest.approx((60.0, -30.0), abs=1e-6)
    assert ref.projection_at(GeoPoint(lat, lon, 0.0)).origin_map_m == pytest.approx((60.0, -30.0), abs=1e-6)
    assert ref.covers(lat, lon)
    far = ref.to_geo(130.0, 0.0)
    assert (ref.covers(*far), ref.covers(*far, margin_m=40.0)) == (False, True)


async def test_the_camera_delivers_in_its_own_time_and_can_break():
    clock, slots = MonotonicClock(100.0), Slots()
    now_ns = clock.now_ns()
    shots = [(now_ns + i * 100_000_000, np.full((6, 8), i, np.uint8)) for i in range(3)]
    camera = FakeCamera(MODEL, shots, clock, breaks=True)
    frames = []
    with pytest.raises(CameraError):
        async for frame in camera.frames(slots):
            frames.append(frame)
    assert [frame.t_ns for frame in frames] == [t_ns for t_ns, _ in shots]
    assert all(frame.t_rx_ns >= frame.t_ns + camera.latency_ns for frame in frames)
    assert [int(slots.read(frame)[0, 0]) for frame in frames] == [0, 1, 2]
    assert (frames[0].width_px, frames[0].height_px, frames[0].channels) == (8, 6, 1)


async def test_a_closed_camera_delivers_no_more():
    clock, slots = MonotonicClock(100.0), Slots()
    camera = FakeCamera(MODEL, [(clock.now_ns(), np.zeros((6, 8, 3), np.uint8))] * 3, clock)
    frames = []
    async for frame in camera.frames(slots):
        frames.append(frame)
        await camera.close()
    assert [frame.channels for frame in frames] == [3]


def test_the_localiser_errs_as_much_as_it_says():
    localiser, ref = FakeLocaliser(lambda _: (ORIGIN, LEVEL), sigma_m=2.0), AnalyticMap(ORIGIN)
    pixels = np.zeros((6, 8), np.uint8)
    fixes = [localiser.localise(request(ORIGIN, seed), pixels, ref) for seed in range(400)]
    errors_m = [distance_m(fix.place, ORIGIN) for fix in fixes if isinstance(fix, Fix)]
    assert math.sqrt(np.mean(np.square(errors_m)) / 2) == pytest.approx(2.0, rel=0.1)
    assert localiser.localise(request(ORIGIN, 5), pixels, ref) == fixes[5]
    assert len(localiser.requests) == 401


def test_the_localiser_declines():
    pixels, ref = np.zeros((6, 8), np.uint8), AnalyticMap(ORIGIN)
    dark = FakeLocaliser(lambda _: (ORIGIN, LEVEL), refuses=Reason.TOO_DARK).localise(request(ORIGIN), pixels, ref)
    assert isinstance(dark, NoFix)
    assert (dark.reason, dark.request_id, dark.frame_id) == (Reason.TOO_DARK, 7, 3)
    away = FakeLocaliser(lambda _: (GeoPoint(0.0, 0.0, 0.0), LEVEL)).localise(request(ORIGIN), pixels, ref)
    assert isinstance(away, NoFix)
    assert away.reason is Reason.OUTSIDE_MAP


async def test_the_link_passes_what_is_fed_in_order():
    link = FakeLink(ManualClock(), origin=ORIGIN)
    events = link.events()
    link.feed(Tick(1))
    await link.close()
    assert [type(event) async for event in events] == [LinkChanged, OriginChanged, Tick]
