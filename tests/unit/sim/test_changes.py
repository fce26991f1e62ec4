"""What has changed on the ground is painted where it should be, into pixels and heights alike."""

from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.maps.crs import map_crs
from visloc_companion.sim.changes import Change, along_way, beyond_the_map, changed, ground_below, lies
from visloc_companion.sim.scene import Scene
from visloc_companion.types import GeoPoint

SIZE = 600
WAY = np.array([[100.0, 300.0], [500.0, 300.0], [500.0, 500.0], [100.0, 500.0]])
WOOD = (slice(250, 350), slice(220, 320))


def scene() -> Scene:
    """A slope of 2 %, half a metre a pixel, with a wood 12 m high that has gaps."""
    rng = np.random.default_rng(4)
    dsm = 400.0 + 0.01 * np.mgrid[0:SIZE, 0:SIZE][1].astype(np.float32)
    dsm[WOOD] += np.where(rng.random((100, 100)) < 0.05, 0.0, 12.0).astype(np.float32)
    pixels = rng.integers(80, 120, (SIZE, SIZE, 3)).astype(np.uint8)
    return Scene(pixels, dsm, np.array([[0.5, 0.0, 604_000.0], [0.0, -0.5, 5_350_000.0]]), "EPSG:32632")


def test_a_change_lies_along_the_way_between_its_ends() -> None:
    mask = along_way(scene(), WAY, 50.0, 150.0, 20.0)
    rows, cols = np.nonzero(mask)
    assert cols.min() == pytest.approx(200, abs=3)
    assert cols.max() == pytest.approx(400, abs=3)
    assert (rows.min(), rows.max()) == pytest.approx((260, 340), abs=2)
    assert along_way(scene(), WAY, 550.0, np.inf, 20.0)[400, 100], "the way is closed"


def test_the_ground_below_a_wood_is_found() -> None:
    off = ground_below(scene().dsm_amsl_m, 0.5) - (400.0 + 0.01 * np.arange(SIZE))
    assert np.abs(off[20:-20, 20:-20]).max() < 1.0


def test_felling_takes_away_what_stands_and_leaves_the_rest() -> None:
    before = scene()
    after = changed(before, Change("felled", half_width_m=60.0), WAY, 1)
    standing = after.dsm_amsl_m[WOOD] - (400.0 + 0.01 * np.arange(SIZE)[WOOD[1]])
    assert standing.max() < 2.5
    assert not np.array_equal(after.pixels[WOOD], before.pixels[WOOD])
    assert np.array_equal(after.pixels[:200, 350:], before.pixels[:200, 350:])
    assert np.array_equal(after.dsm_amsl_m[:200], before.dsm_amsl_m[:200])


def test_ploughing_changes_the_picture_of_open_ground_only() -> None:
    before = scene()
    after = changed(before, Change("ploughed", half_width_m=60.0), WAY, 1)
    assert np.array_equal(after.dsm_amsl_m, before.dsm_amsl_m)
    assert (after.pixels[280:320, 400:460] != before.pixels[280:320, 400:460]).mean() > 0.9
    crown = before.dsm_amsl_m[WOOD] > 408.0
    assert np.array_equal(after.pixels[WOOD][crown], before.pixels[WOOD][crown])


def test_an_estate_has_houses_with_shadows() -> None:
    after = changed(scene(), Change("built", half_width_m=60.0), WAY, 1)
    above = after.dsm_amsl_m[260:340, 350:480] - (400.0 + 0.01 * np.arange(SIZE)[350:480])
    assert 5.0 < above.max() < 10.0
    assert 0.05 < (above > 4.0).mean() < 0.4


def test_a_share_of_the_parcels_changes_and_the_seed_says_which() -> None:
    before = scene()
    half, again, other = (changed(before, Change("ploughed", half_width_m=100.0, share=0.5), WAY, seed) for seed in (1, 1, 2))
    share = [(after.pixels != before.pixels).any(2).mean() for after in (half, other)]
    whole = (changed(before, Change("ploughed", half_width_m=100.0), WAY, 1).pixels != before.pixels).any(2).mean()
    assert all(0.15 < each / whole < 0.85 for each in share)
    assert np.array_equal(half.pixels, again.pixels)
    assert not np.array_equal(half.pixels, other.pixels)


def test_water_is_level() -> None:
    after = changed(scene(), Change("water", 50.0, 150.0, 20.0), WAY, 1)
    assert np.ptp(after.dsm_amsl_m[300, 210:390]) == 0.0


def test_all_else_is_changed_but_the_way_before() -> None:
    change = Change("water", 100.0, half_width_m=20.0, all_else=True)
    land = lies(change, scene(), WAY) == 0
    (first_v, first_u), along = WAY[0][::-1], np.array([-45, -35, 90, 190, 210, 450])
    assert [bool(land[round(first_v), round(first_u + u)]) for u in along] == [False, True, True, True, False, False]
    assert not land[:200].any(), "the way that comes back is not land"
    flooded = changed(scene(), change, WAY, 1)
    assert np.ptp(flooded.dsm_amsl_m[~land]) == 0.0
    assert np.array_equal(flooded.dsm_amsl_m[land], scene().dsm_amsl_m[land])


def test_beyond_the_map_the_land_goes_on_mirrored_and_stays_where_it_was() -> None:
    before, margin = scene(), 100
    after = beyond_the_map(before, margin * 0.5)
    assert after.size_px == (SIZE + 2 * margin, SIZE + 2 * margin)
    inside = (slice(margin, -margin), slice(margin, -margin))
    assert np.array_equal(after.pixels[inside], before.pixels)
    assert np.array_equal(after.pixels[margin - 5, margin : margin + 50], before.pixels[4, :50])
    assert after.T_map_pix @ [margin, margin, 1.0] == pytest.approx(before.T_map_pix @ [0.0, 0.0, 1.0])


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:3857", "EPSG:32632", "EPSG:2225"])
def test_ways_widths_and_margins_are_metres_whatever_the_pixels_are(crs: str) -> None:
    """A raster in degrees was taken for one of millionths of a metre a pixel (terabytes were asked for), Mercator's metres and
    feet for metres on the ground."""
    place = GeoPoint(39.5, -122.0, 0.0) if crs == "EPSG:2225" else GeoPoint(47.4, 8.5, 0.0)
    here = map_crs(crs).linearised_at(place)
    side = 0.6 * here.J_map_ne[0, 1]
    size_m = np.array([side / here.J_map_ne[0, 1], side / here.J_map_ne[1, 0]])
    T = np.array([[side, 0.0, here.origin_map_m[0] - 300 * side], [0.0, -side, here.origin_map_m[1] + 300 * side]])
    before = Scene(scene().pixels, scene().dsm_amsl_m, T, crs)
    mask = along_way(before, WAY, 50.0, 150.0, 20.0)
    rows, cols = np.nonzero(mask)
    east_m, north_m = (cols - 100.0) * size_m[0], (300.0 - rows) * size_m[1]
    assert (east_m.min(), east_m.max()) == pytest.approx((50.0, 150.0), abs=2.0)
    assert (north_m.min(), north_m.max()) == pytest.approx((-20.0, 20.0), abs=1.5)
    after = beyond_the_map(before, 60.0)
    more = np.array(after.size_px) - before.size_px
    assert more / 2 * size_m == pytest.approx(60.0, abs=1.0)
    assert after.center_map == pytest.approx(before.center_map, abs=1e-6 * side)
    for kind in ("felled", "ploughed", "built", "water"):
        ground = changed(before, Change(kind, half_width_m=60.0), WAY, 1)  # type: ignore[arg-type]
        assert not np.array_equal(ground.dsm_amsl_m if kind == "water" else ground.pixels, scene().pixels)
