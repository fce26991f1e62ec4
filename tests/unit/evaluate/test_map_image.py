from __future__ import annotations

from types import ModuleType

import cv2
import numpy as np

from visloc_companion.evaluate.map_image import map_image
from visloc_companion.evaluate.record import from_entries
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.testing.fake_map import AnalyticMap
from visloc_companion.types import GeoPoint


def test_the_ground_lies_under_every_track(synthetic: ModuleType) -> None:
    record, baseline = synthetic.make_record(), synthetic.make_baseline()
    image = map_image(AnalyticMap(synthetic.HOME, half_size_m=900.0), record, baseline, width_px=300)
    assert image is not None
    corners = (image.north_west, image.north_east, image.south_west)
    north_west, north_east, south_west = (np.array(ned_from_geo(place, record.origin)) for place in corners)
    for track in (record.truth.p_ned_m, baseline.truth.p_ned_m, record.gnss.p_ned_m):
        assert south_west[0] < track[:, 0].min() < track[:, 0].max() < north_west[0]
        assert north_west[1] < track[:, 1].min() < track[:, 1].max() < north_east[1]


def test_pixels_lie_where_the_corners_say(synthetic: ModuleType) -> None:
    """The grey value at the picture's centre is the map's own at the place that the corners give."""
    record, ground = synthetic.make_record(60.0), AnalyticMap(synthetic.HOME, half_size_m=900.0)
    image = map_image(ground, record, width_px=800)
    assert image is not None
    pixels = cv2.imdecode(np.frombuffer(image.jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert pixels is not None
    assert (pixels.shape[1], pixels.shape[0]) == image.size_px
    north_west, north_east, south_west = (
        np.array(ned_from_geo(place, synthetic.HOME)) for place in (image.north_west, image.north_east, image.south_west)
    )
    u, v = np.meshgrid(np.arange(100, 700, 7), np.arange(100, 600, 7))
    share_e, share_s = (u.ravel() + 0.5) / image.size_px[0], (v.ravel() + 0.5) / image.size_px[1]
    ned = north_west + share_e[:, None] * (north_east - north_west) + share_s[:, None] * (south_west - north_west)
    expected = ground.grey(ned[:, [1, 0]])
    assert np.median(np.abs(expected - pixels[v.ravel(), u.ravel()])) < 8


def test_a_map_of_elsewhere_gives_no_picture(synthetic: ModuleType) -> None:
    elsewhere = AnalyticMap(GeoPoint(10.0, 20.0, 0.0))
    assert map_image(elsewhere, synthetic.make_record(20.0)) is None
    assert map_image(elsewhere, from_entries([])) is None
