import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from visloc_companion.errors import MapError
from visloc_companion.geo.wgs84 import distance_m
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.build import build_pack
from visloc_companion.prepare.check import check_pack, on_map, pole_warnings
from visloc_companion.prepare.matchability import matchability
from visloc_companion.prepare.route import Route, read_route
from visloc_companion.types import GeoPoint

UTM, PLACE = "EPSG:32633", (47.0, 15.3)


def textured(rows: int, cols: int) -> np.ndarray:
    """Blobs of some 10 px with edges in all directions, and sensor noise."""
    rng = np.random.default_rng(4)
    v, u = np.mgrid[:rows, :cols]
    waves = sum(
        np.sin((u * np.cos(a) + v * np.sin(a)) / rng.uniform(4, 15) + rng.uniform(0, 6)) for a in rng.uniform(0, np.pi, 24)
    )
    return np.clip(120 + 18 * waves + rng.normal(0, 3, (rows, cols)), 1, 255).astype(np.uint8)


@pytest.fixture
def lake(tmp_path: Path, write_raster) -> PackMap:
    """A map of 1000 m: land in the west half, still water with noise in the east half, a hole of 100 m in the south-west."""
    image = textured(1000, 1000)
    image[:, 500:] = np.clip(60 + np.random.default_rng(5).normal(0, 2, (1000, 500)), 1, 255).astype(np.uint8)
    image[800:900, 100:200] = 0
    write_raster(tmp_path / "a.tif", image, UTM, PLACE, 1.0, nodata=0)
    build_pack([tmp_path / "a.tif"], None, tmp_path / "pack")
    return PackMap.open(tmp_path / "pack")


def place(pack: PackMap, east_m: float, north_m: float) -> GeoPoint:
    easting, northing = pack.T_map_pix @ [499.5, 499.5, 1.0]
    return GeoPoint(*pack.to_geo(easting + east_m, northing + north_m), 0.0)


def write_route(path: Path, points: list[GeoPoint]) -> Path:
    path.write_text("lat_deg,lon_deg\n" + "".join(f"{p.lat_deg:.9f},{p.lon_deg:.9f}\n" for p in points))
    return path


def test_water_is_flat_and_land_is_not(lake: PackMap) -> None:
    cells = matchability(lake)
    assert cells.cell_m == pytest.approx(64, rel=0.01)
    land, water = cells.good[:, :7], cells.flat[:, 9:15]
    assert land[cells.known[:, :7]].mean() > 0.95
    assert water.mean() > 0.95
    result = check_pack(lake, None)
    assert 0.4 < result["matchability"]["share_flat"] < 0.6
    assert any("little texture" in warning for warning in result["warnings"])
    assert result["passed"]
    json.dumps(result, allow_nan=False)


@pytest.mark.parametrize("quality", [None, 75, 90])
def test_noise_is_no_texture(tmp_path: Path, write_raster, quality: int | None) -> None:
    """Still water under a noisy camera has a gradient everywhere, and JPEG stores it as patches."""
    image = textured(700, 700)
    image[:, 320:] = np.clip(70 + np.random.default_rng(5).normal(0, 4, (700, 380)), 1, 255).astype(np.uint8)
    if quality is not None:
        stored = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        image = np.maximum(cv2.imdecode(stored, cv2.IMREAD_GRAYSCALE), 1)
    write_raster(tmp_path / "a.tif", image, UTM, PLACE, 0.3)
    build_pack([tmp_path / "a.tif"], None, tmp_path / "pack")
    cells = matchability(PackMap.open(tmp_path / "pack"))
    assert cells.good.shape == (11, 11) and cells.known.all()
    assert cells.good[:, :5].all() and not cells.good[:, 5:].any()


def test_rows_of_one_direction_are_warned_of(tmp_path: Path, write_raster) -> None:
    v, u = np.mgrid[:900, :900]
    rows = np.clip(120 + 60 * np.sin((u + 0.6 * v) / 9), 1, 255).astype(np.uint8)
    write_raster(tmp_path / "a.tif", rows, UTM, PLACE, 1.0)
    build_pack([tmp_path / "a.tif"], None, tmp_path / "pack")
    result = check_pack(PackMap.open(tmp_path / "pack"), None)
    assert result["matchability"]["share_one_direction"] > 0.8
    assert any("one direction" in warning for warning in result["warnings"])


def test_routes_on_and_off_the_map(lake: PackMap, tmp_path: Path) -> None:
    over_land = check_pack(lake, write_route(tmp_path / "land.csv", [place(lake, -300, 300), place(lake, -150, -100)]))
    assert over_land["passed"] and over_land["route"]["points_outside"] == 0
    assert over_land["route"]["share_matchable"] > 0.9
    assert over_land["route"]["length_m"] == pytest.approx(427.2, abs=0.5)
    over_water = check_pack(lake, write_route(tmp_path / "water.csv", [place(lake, 100, 300), place(lake, 400, -100)]))
    assert over_water["passed"] and any("route" in warning for warning in over_water["warnings"])
    assert over_water["route"]["longest_unmatchable_m"] == pytest.approx(500.0, abs=0.5)
    across = check_pack(lake, write_route(tmp_path / "x.csv", [place(lake, e, 300) for e in (-400, 300, -400)]))["route"]
    assert across["share_matchable"] == pytest.approx(4 / 7, abs=0.05)
    assert across["longest_unmatchable_m"] == pytest.approx(600.0, abs=80.0), "to the far shore's end and back, as cells see it"
    assert over_land["route"]["longest_unmatchable_m"] < 100.0
    away = check_pack(lake, write_route(tmp_path / "away.csv", [place(lake, 0, 0), place(lake, 0, 900), place(lake, 0, 0)]))
    assert not away["passed"]
    beside = check_pack(lake, write_route(tmp_path / "beside.csv", [place(lake, -300, 0), place(lake, -300, 900)]))["route"]
    shown = 1 - beside["points_outside"] / beside["points"]
    assert 0.4 < beside["share_matchable"] <= shown < 0.7, "what lies off the map counts, and cannot be matched"
    first = GeoPoint(**away["route"]["first_outside"], h_amsl_m=0.0)
    assert 490 < distance_m(first, place(lake, 0, 0)) < 540, "between the waypoints, at the edge"
    hole = check_pack(lake, write_route(tmp_path / "hole.csv", [place(lake, -350, -350)]))
    assert not hole["passed"], "a place without content is off the map"
    elsewhere = check_pack(lake, write_route(tmp_path / "else.csv", [GeoPoint(0.0, 100.0, 0.0)]))
    assert not elsewhere["passed"] and elsewhere["route"]["share_matchable"] == 0.0
    json.dumps(elsewhere, allow_nan=False)
    (tmp_path / "twice.csv").write_text("lat_deg,lat_deg,lon_deg\n47,48,8\n")
    with pytest.raises(MapError, match=r"twice\.csv: is no route: its first line names lat_deg more than once"):
        check_pack(lake, tmp_path / "twice.csv")


@pytest.mark.parametrize(
    ("ends_m", "margins_that_it_reaches"), [(60.0, (20, 50)), (180.0, (20, 50, 100, 170)), (240.0, (20, 50, 100, 170, 220))]
)
def test_a_map_that_ends_within_its_own_rectangle_does_not_reach_further(
    tmp_path: Path, write_raster, ends_m: float, margins_that_it_reaches: tuple[int, ...]
) -> None:
    """As orthomosaics of a survey do, whose corners are empty: one that ended 180 m off reached 250 m."""
    image = textured(600, 600)
    image[:, 300 + int(ends_m) :] = 0
    write_raster(tmp_path / "a.tif", image, UTM, PLACE, 1.0, nodata=0)
    build_pack([tmp_path / "a.tif"], None, tmp_path / "pack")
    pack = PackMap.open(tmp_path / "pack")
    middle = place(pack, -200.0, 200.0)
    assert tuple(m for m in (20, 50, 100, 170, 220, 250, 280) if on_map(pack, middle, m)) == margins_that_it_reaches


@pytest.mark.parametrize("margin_m", [50, 80, 150, 250])
def test_holes_about_the_route_are_seen_and_specks_are_not(tmp_path: Path, write_raster, margin_m: int) -> None:
    """A hole of 60 m, 40 m away, was missed with a margin of 250 m, and found with one of 80 m."""
    image = textured(600, 600)
    image[::53, ::59] = 0
    write_raster(tmp_path / "specks.tif", image, UTM, PLACE, 1.0, nodata=0)
    image[270:330, 340:400] = 0
    write_raster(tmp_path / "hole.tif", image, UTM, PLACE, 1.0, nodata=0)
    for name, reaches in (("specks", True), ("hole", False)):
        build_pack([tmp_path / f"{name}.tif"], None, tmp_path / name)
        pack = PackMap.open(tmp_path / name)
        assert on_map(pack, place(pack, -200.5, 200.5), margin_m) is reaches


def test_margin_around_the_route(lake: PackMap, tmp_path: Path) -> None:
    near_edge = write_route(tmp_path / "r.csv", [place(lake, -440, 200)])
    assert check_pack(lake, near_edge, 40.0)["passed"]
    assert not check_pack(lake, near_edge, 80.0)["passed"]
    near_hole = write_route(tmp_path / "h.csv", [place(lake, -230, -350)])
    assert check_pack(lake, near_hole, 0.0)["passed"]
    assert not check_pack(lake, near_hole, 150.0)["passed"]


def test_unknown_heights_are_warned_of(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", textured(400, 400), UTM, PLACE, 1.0)
    heights = np.full((400, 400), 100, np.float32)
    heights[:, 200:] = -9999
    write_raster(tmp_path / "dsm.tif", heights, UTM, PLACE, 1.0, nodata=-9999)
    build_pack([tmp_path / "a.tif"], tmp_path / "dsm.tif", tmp_path / "pack")
    pack = PackMap.open(tmp_path / "pack")
    result = check_pack(pack, None)
    assert any("no height" in warning for warning in result["warnings"])
    assert result["share_with_height"] == pytest.approx(0.53, abs=0.05)


def test_small_packs_are_judged_at_their_coarsest_level(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", textured(70, 70), UTM, PLACE, 1.0)
    build_pack([tmp_path / "a.tif"], None, tmp_path / "pack")
    assert matchability(PackMap.open(tmp_path / "pack")).good.any()


def test_csv(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_bytes(b"\xef\xbb\xbfname,lat_deg,lon_deg\na,47.1,15.2\nb,46.3,15.9\n")
    assert read_route(path).places == [GeoPoint(47.1, 15.2, 0.0), GeoPoint(46.3, 15.9, 0.0)]


def test_waypoints(tmp_path: Path) -> None:
    """Home, take-off without a place, waypoint, region of interest (not flown to), return to launch."""
    path = tmp_path / "r.waypoints"
    path.write_text(
        "QGC WPL 110\n"
        "0\t1\t0\t16\t0\t0\t0\t0\t-35.363\t149.165\t584\t1\n"
        "1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t20\t1\n"
        "2\t0\t3\t16\t0\t0\t0\t0\t-35.36\t149.17\t100\t1\n"
        "3\t0\t3\t201\t0\t0\t0\t0\t-30.0\t140.0\t0\t1\n"
        "4\t0\t3\t20\t0\t0\t0\t0\t0\t0\t0\t1\n"
    )
    home = GeoPoint(-35.363, 149.165, 0.0)
    assert read_route(path).places == [home, GeoPoint(-35.36, 149.17, 0.0), home]


def test_waypoints_without_home(tmp_path: Path) -> None:
    path = tmp_path / "r.txt"
    path.write_text(
        "QGC WPL 110\n0 1 0 16 0 0 0 0 0 0 0 1\n1 0 3 16 0 0 0 0 47.0 15.0 50 1\n2 0 3 16 0 0 0 0 47.1 15.0 50 1\n"
        "3 0 3 20 0 0 0 0 0 0 0 1\n"
    )
    first, second = GeoPoint(47.0, 15.0, 0.0), GeoPoint(47.1, 15.0, 0.0)
    assert read_route(path) == Route([first, second, first], [], lacks_home=True)


@pytest.mark.parametrize("home", ["0\t0", "47.0\t15.0"])
def test_a_jump_is_followed_there_and_back(tmp_path: Path, home: str) -> None:
    """The leg from the last place before it to where it leads is flown, and no other item shows it."""
    corners = [GeoPoint(47.0 + north, 15.001 + east, 0.0) for north, east in ((0.0, 0.0), (0.01, 0.0), (0.01, 0.01))]
    lines = [f"0\t1\t0\t16\t0\t0\t0\t0\t{home}\t0\t1", "1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t20\t1"]
    lines += [f"{n}\t0\t3\t16\t0\t0\t0\t0\t{at.lat_deg}\t{at.lon_deg}\t50\t1" for n, at in enumerate(corners, 2)]
    lines += ["5\t0\t3\t177\t2\t3\t0\t0\t0\t0\t0\t1", "6\t0\t3\t16\t0\t0\t0\t0\t47.02\t15.02\t50\t1"]
    (tmp_path / "r.waypoints").write_text("QGC WPL 110\n" + "\n".join(lines) + "\n")
    want = [*corners, corners[0], corners[2], GeoPoint(47.02, 15.02, 0.0)]
    assert read_route(tmp_path / "r.waypoints").places[-6:] == want
    items = [
        {"type": "SimpleItem", "command": 16, "doJumpId": 2 + k, "params": [0, 0, 0, None, at.lat_deg, at.lon_deg, 50]}
        for k, at in enumerate(corners)
    ]
    items.append({"type": "SimpleItem", "command": 177, "doJumpId": 5, "params": [2, 3, 0, 0, 0, 0, 0]})
    (tmp_path / "r.plan").write_text(json.dumps({"mission": {"plannedHomePosition": [0, 0, 0], "items": items}}))
    assert read_route(tmp_path / "r.plan") == Route(want[:-1], [])


def test_plan(tmp_path: Path) -> None:
    simple = {"type": "SimpleItem", "command": 16, "params": [0, 0, 0, None, 47.001, 15.001, 50]}
    survey = {
        "type": "ComplexItem",
        "TransectStyleComplexItem": {
            "Items": [{"type": "SimpleItem", "command": 16, "params": [0, 0, 0, None, 47.002, 15.002, 50]}]
        },
    }
    camera = {"type": "SimpleItem", "command": 206, "params": [20, 0, 1, 0, 0, 0, 0]}
    plan = {"fileType": "Plan", "mission": {"plannedHomePosition": [47.0, 15.0, 400], "items": [simple, survey, camera]}}
    path = tmp_path / "r.plan"
    path.write_text(json.dumps(plan))
    assert [(p.lat_deg, p.lon_deg) for p in read_route(path).places] == [(47.0, 15.0), (47.001, 15.001), (47.002, 15.002)]


@pytest.mark.parametrize("kind", ["fwLandingPattern", "vtolLandingPattern"])
@pytest.mark.parametrize("approach", ["landingApproachCoordinate", "loiterCoordinate"])
def test_landing_patterns_of_plans_are_flown_to(tmp_path: Path, kind: str, approach: str) -> None:
    """QGroundControl writes them without commands; before version 4 it called the approach after its loiter."""
    landing = {
        "type": "ComplexItem",
        "complexItemType": kind,
        approach: [47.001, 15.001, 40],
        "landCoordinate": [47.002, 15.002, 0],
    }
    (tmp_path / "R.PLAN").write_text(json.dumps({"mission": {"plannedHomePosition": [47.0, 15.0, 400], "items": [landing]}}))
    places = [(p.lat_deg, p.lon_deg) for p in read_route(tmp_path / "R.PLAN").places]
    assert places == [(47.0, 15.0), (47.001, 15.001), (47.002, 15.002)]


def test_columns_may_have_spaces_and_a_plan_another_name(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text("lat_deg, lon_deg\n47.1, 15.2\n")
    item = {"type": "SimpleItem", "command": 16, "params": [0, 0, 0, None, 47.1, 15.2, 50]}
    (tmp_path / "r.json").write_text(json.dumps({"mission": {"items": [item]}}))
    assert read_route(tmp_path / "r.csv") == read_route(tmp_path / "r.json") == Route([GeoPoint(47.1, 15.2, 0.0)], [])


@pytest.mark.parametrize(
    ("name", "text", "what"),
    [
        ("r.csv", "latitude,longitude\n47,15\n", "its first line names no column lat_deg and lon_deg"),
        ("r.csv", "lat_deg;lon_deg\n47;15\n", "its first line names no column lat_deg and lon_deg"),
        ("r.kml", "<?xml version='1.0'?>\n<kml/>\n", "its first line names no column"),
        ("r.gpx", "<?xml version='1.0'?><gpx/>", "its first line names no column"),
        ("r.csv", "lat_deg,lon_deg\n47,15\nnorth,east\n", "line 3: 'north' is no number"),
        ("r.csv", "lat_deg,lon_deg\n47,15\n47\n", "line 3: 'nothing' is no number"),
        ("r.csv", "lat_deg,lon_deg\n470,15\n", "470.0, 15.0 is no latitude, longitude"),
        ("r.csv", "lat_deg,lon_deg\nnan,15\n", "nan, 15.0 is no latitude, longitude"),
        ("r.csv", "lat_deg,lon_deg\n", "holds no place"),
        ("r.csv", "", "its first line names no column"),
        ("r.csv", "lat_deg,lon_deg\n47,1,15,2\n", "line 2: has more values than the first line names columns; decimals"),
        ("r.csv", 'lat_deg,lon_deg\n"47.1"x,15\n', "',' expected after"),
        ("r.csv", 'lat_deg,lon_deg\n"47.1,15\n', "unexpected end of data"),
        ("r.csv", "lat_deg,lon_deg\n" + "1" * 200_000 + ",15\n", "field larger than"),
        ("r.plan", "{", "line 1 column 2"),
        ("r.plan", '{"fileType": "Plan", "geoFence": {}}', "it holds no mission"),
        ("r.plan", '{"mission": {"items": [{"type": "SimpleItem"}]}}', "params"),
        ("r.plan", '{"mission": {"items": [{"type": "ComplexItem"}]}}', "item 1 .* does not say where it flies"),
        (
            "r.plan",
            '{"mission": {"items": [{"type": "ComplexItem", "complexItemType": "StructureScan", "polygon": [[47, 15]]}]}}',
            r"item 1 \(StructureScan\) does not say where it flies: send the plan",
        ),
        ("r.plan", "[]", "it holds no mission"),
        ("r.plan", "17", "TypeError"),
        ("r.waypoints", "QGC WPL 110\n0 1 0\n", "line 2: is not twelve numbers"),
        ("r.waypoints", "QGC WPL 110\n0\t1\t0\t16\t0\t0\t0\t0\t47,1\t15,2\t584\t1\n", "line 2: is not twelve numbers"),
        ("r.waypoints", "QGC WPL 110\n", "holds no place"),
        ("r.plan", '{"mission": {"items": [{"type": "SimpleItem", "command": 177, "params": [1e999, 1]}]}}', "infinity"),
        ("r.waypoints", "QGC WPL 110\n0\t1\t0\t177\tinf\t0\t0\t0\t0\t0\t0\t1\n", "infinity"),
        ("r.plan", '{"mission": {"items": []}, "rallyPoints": {"points": [[47]]}}', "IndexError"),
    ],
)
def test_what_is_no_route_is_named(tmp_path: Path, name: str, text: str, what: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(MapError, match=rf"{name}: .*{what}.*remedy"):
        read_route(tmp_path / name)


def test_unreadable_route(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_bytes(b"\xff\xfe\x00lat")
    for name, what in (("r.csv", "cannot be read"), ("absent.csv", "there is no such file")):
        with pytest.raises(MapError, match=f"{name}: {what}.*remedy"):
            read_route(tmp_path / name)


def test_a_leg_that_no_map_holds_is_told(tmp_path: Path) -> None:
    """Latitude and longitude exchanged in the second line: two million points were looked at."""
    (tmp_path / "r.csv").write_text("lat_deg,lon_deg\n47.0,15.3\n15.3,47.0\n")
    with pytest.raises(MapError, match=r"r\.csv: 15\.3, 47\.0 lies \d{4} km from 47\.0, 15\.3 before it; remedy"):
        read_route(tmp_path / "r.csv")


def test_where_the_vehicle_may_go_besides_is_looked_at(lake: PackMap, tmp_path: Path) -> None:
    """Rally points, the way back where no home is named; not what the camera looks at."""
    on, off = place(lake, -300, 0), place(lake, -300, 600)
    at = [[p.lat_deg, p.lon_deg, 50.0] for p in (on, off)]
    look = {"type": "SimpleItem", "command": 80, "params": [0, 0, 0, 0, off.lat_deg, off.lon_deg, 0]}
    fly = {"type": "SimpleItem", "command": 16, "params": [0, 0, 0, 0, on.lat_deg, on.lon_deg, 50]}
    back = {"type": "SimpleItem", "command": 20, "params": [0, 0, 0, 0, 0, 0, 0]}
    plan = {"mission": {"items": [look, fly, back]}, "rallyPoints": {"points": at}}
    (tmp_path / "r.plan").write_text(json.dumps(plan))
    result = check_pack(lake, tmp_path / "r.plan")
    assert result["passed"], "what is looked at may lie beside the map"
    said = [warning for warning in result["warnings"] if "rally" in warning or "home" in warning]
    assert len(said) == 2 and f"{off.lat_deg:.6f}, {off.lon_deg:.6f} is off the map" in said[0]
    assert said[1].startswith("the route names no home")
    plan["mission"]["plannedHomePosition"] = at[0]
    plan["rallyPoints"]["points"] = at[:1]
    (tmp_path / "r.plan").write_text(json.dumps(plan))
    warnings = check_pack(lake, tmp_path / "r.plan")["warnings"]
    assert not any("rally" in warning or "home" in warning for warning in warnings)


@pytest.mark.parametrize("commands", [(), (22, 20)])
def test_a_mission_that_leads_nowhere_is_told_of(lake: PackMap, tmp_path: Path, commands: tuple[int, ...]) -> None:
    """Saved empty, or taking off and returning: all of its places, the home alone, lie on the map."""
    home = place(lake, -300, 0)
    items = [{"type": "SimpleItem", "command": command, "params": [0, 0, 0, 0, 0, 0, 50]} for command in commands]
    plan = {"mission": {"plannedHomePosition": [home.lat_deg, home.lon_deg, 10], "items": items}}
    (tmp_path / "r.plan").write_text(json.dumps(plan))
    assert any("the route holds one place alone" in warning for warning in check_pack(lake, tmp_path / "r.plan")["warnings"])
    there = write_route(tmp_path / "there.csv", [home, place(lake, -250, 0)])
    assert not any("alone" in warning for warning in check_pack(lake, there)["warnings"])


@pytest.mark.parametrize(("lat_deg", "n_told"), [(88.9, 0), (89.1, 1)])
def test_a_map_beside_a_pole_says_that_no_position_is_given_there(
    tmp_path: Path, write_raster, lat_deg: float, n_told: int
) -> None:
    write_raster(tmp_path / "a.tif", textured(200, 200), "EPSG:5041", (lat_deg, 20.0), 1.0)
    build_pack([tmp_path / "a.tif"], None, tmp_path / "pack")
    pack = PackMap.open(tmp_path / "pack")
    told = [warning for warning in check_pack(pack, None)["warnings"] if "latitude" in warning]
    assert told == pole_warnings(pack.manifest.bounds) and len(told) == n_told
    assert all("it reaches 89.10 degrees of latitude: beyond 89 no position is given" in warning for warning in told)
