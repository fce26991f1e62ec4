import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from typer.testing import CliRunner

from visloc_companion.cli.map import map_app, repeated
from visloc_companion.errors import CloudError, ConfigError, DatumMissing, HashMismatch, MapError, ModelError
from visloc_companion.maps.crs import map_crs

Visloc = Callable[..., tuple[int, str]]


@pytest.fixture
def visloc() -> Visloc:
    """Run `visloc map ...`; errors of the package are raised, as main() gets them."""

    def run(*args: object) -> tuple[int, str]:
        result = CliRunner().invoke(map_app, [str(arg) for arg in args])
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        return result.exit_code, result.output

    return run


def write(path: Path, values: np.ndarray, east_m: float = 0.0) -> Path:
    shape = {"width": values.shape[1], "height": values.shape[0], "count": 1, "dtype": values.dtype}
    place = rasterio.Affine(1.0, 0.0, 500_000.0 + east_m, 0.0, -1.0, 5_200_000.0)
    with rasterio.open(path, "w", driver="GTiff", crs="EPSG:32633", transform=place, **shape) as out:
        out.write(values, 1)
    return path


@pytest.fixture
def ortho(tmp_path: Path) -> Path:
    return write(tmp_path / "a.tif", np.random.default_rng(1).integers(1, 255, (200, 200)).astype(np.uint8))


def test_build_info_check(tmp_path: Path, ortho: Path, visloc: Visloc) -> None:
    more = write(tmp_path / "b.tif", np.random.default_rng(2).integers(1, 255, (200, 200)).astype(np.uint8), 150.0)
    pack, result = tmp_path / "pack", tmp_path / "result.json"
    options = (
        "--capture-date",
        "2020-02-03",
        "--source",
        "survey",
        "--licence",
        "CC0-1.0",
        "--ground-height-m",
        "12",
        "--json",
        result,
    )
    code, text = visloc("build", "--ortho", ortho, more, "--out", pack, *options)
    assert code == 0 and "350 x 200 px" in text
    built = json.loads(result.read_text())["manifest"]
    assert [entry["file"] for entry in built["inputs"]] == ["a.tif", "b.tif"]
    assert built["heights"]["plane_amsl_m"] == 12.0
    code, text = visloc("info", pack, "--json", result)
    assert code == 0
    for part in ("EPSG:32633", "2020-02-03", "survey", "CC0-1.0", "plane at 12 m", "gradient 1 m to"):
        assert part in text
    assert json.loads(result.read_text())["manifest"] == built
    code, text = visloc("check", pack, "--json", result)
    assert code == 0 and "files are as built" in text
    assert json.loads(result.read_text())["passed"] is True


def test_other_dates_are_stated(tmp_path: Path, visloc: Visloc) -> None:
    rng = np.random.default_rng(5)
    first = cv2.GaussianBlur(rng.integers(0, 255, (200, 200)).astype(np.float32), (0, 0), 2.0)
    a = write(tmp_path / "a.tif", np.clip(8 * first - 900, 1, 254).astype(np.uint8))
    later = [
        write(tmp_path / f"{name}.tif", np.clip(6 * first - 640, 1, 254).astype(np.uint8), east_m)
        for name, east_m in (("b", 4.0), ("c", 0.0))
    ]
    said = [
        "other date b.tif, moved 0.00 m north and 4.00 m west to lie on the first",
        "other date c.tif, which lies on the first",
    ]
    code, text = visloc("build", "--ortho", a, "--other-dates", *later, "--out", tmp_path / "pack", "--model", "none")
    assert code == 0 and all(words in text for words in said)
    assert ", mean over 3 dates\n" in text
    described = visloc("info", tmp_path / "pack")[1]
    assert "other date       b.tif, moved 0.00 m north and 4.00 m west" in described
    with pytest.raises(MapError, match=r"--other-dates b\.tif c\.tif"):
        visloc("features", tmp_path / "pack")


@pytest.mark.parametrize(
    ("code", "place", "metres_per_unit", "own", "said"),
    [
        ("EPSG:32617", (36.0, -80.0), 1.0, 0.0, None),
        ("EPSG:3857", (36.0, -80.0), 1.236, 0.0, None),
        ("EPSG:26717", (36.0, -80.0), 1.0, 10.0, "NAD27 / UTM zone 17N is tied to WGS 84 to about 10 m"),
        ("EPSG:2264", (36.0, -80.0), 0.3048, 4.0, "NAD83 / North Carolina (ftUS) is tied to WGS 84 to about 4 m"),
    ],
)
def test_maps_that_may_lie_beside_wgs_84_are_warned_of(
    tmp_path: Path, visloc: Visloc, code: str, place: tuple[float, float], metres_per_unit: float, own: float, said: str | None
) -> None:
    """Also where a grid in feet is reprojected to WGS 84: the pack keeps what that grid is off by."""
    image = np.random.default_rng(1).integers(1, 255, (200, 200)).astype(np.uint8)
    easting, northing = map_crs(code).to_map(*place)
    corner = rasterio.Affine(1 / metres_per_unit, 0.0, easting, 0.0, -1 / metres_per_unit, northing)
    shape = {"width": 200, "height": 200, "count": 1, "dtype": "uint8"}
    with rasterio.open(tmp_path / "a.tif", "w", driver="GTiff", crs=code, transform=corner, **shape) as out:
        out.write(image, 1)
    json_file = tmp_path / "found.json"
    built = visloc("build", "--ortho", tmp_path / "a.tif", "--out", tmp_path / "pack", "--model", "none")
    checked = visloc("check", tmp_path / "pack", "--model", "none", "--json", json_file)
    assert (built[0], checked[0]) == (0, 0)
    warning = f"warning: {said}, and every fix may be off by as much: compare the map with surveyed points"
    assert (warning in built[1]) == (said is not None)
    assert (warning in checked[1]) == (said is not None)
    assert json.loads(json_file.read_text())["crs_accuracy_m"] == own
    described = visloc("info", tmp_path / "pack")[1]
    assert f"tied to WGS 84   {f'to {own:g} m' if own else 'by its nature'}" in described


def test_surface_of_another_extent_is_warned_of(tmp_path: Path, ortho: Path, visloc: Visloc) -> None:
    dsm = write(tmp_path / "dsm.tif", np.full((200, 200), 300, np.float32), 100.0)
    code, text = visloc("build", "--ortho", ortho, "--dsm", dsm, "--out", tmp_path / "pack")
    assert code == 0 and "has no height" in text
    assert "content on 100.0% of it\n" in text and "surface 300 to 300 m above sea level\n" in text
    described = visloc("info", tmp_path / "pack")[1]
    assert "heights          300 to 300 m above sea level, made from amsl heights, known on 5" in described


def test_surface_models_of_two_datums_are_warned_of(tmp_path: Path, ortho: Path, visloc: Visloc) -> None:
    dsm = write(tmp_path / "dsm.tif", np.full((200, 200), 300, np.float32), 0.0)
    other = write(tmp_path / "ell.tif", np.full((200, 200), 348, np.float32), 50.0)
    code, text = visloc("build", "--ortho", ortho, "--dsm", dsm, other, "--out", tmp_path / "pack")
    assert code == 0
    assert f"warning: {other} lies 48.0 m above the surface models before it" in text
    assert "lies" not in visloc("build", "--ortho", ortho, "--dsm", dsm, "--out", tmp_path / "pack")[1]


def test_gaps_between_orthophotos_are_stated(tmp_path: Path, ortho: Path, visloc: Visloc) -> None:
    away = write(tmp_path / "b.tif", np.random.default_rng(2).integers(1, 255, (200, 200)).astype(np.uint8), 600.0)
    assert "content on 50.0% of it\n" in visloc("build", "--ortho", ortho, away, "--out", tmp_path / "pack")[1]
    assert "files are as built, content on 50.0% of the map\n" in visloc("check", tmp_path / "pack")[1]


def test_route_that_leaves_the_map_fails_the_gate(tmp_path: Path, ortho: Path, visloc: Visloc) -> None:
    visloc("build", "--ortho", ortho, "--out", tmp_path / "pack")
    route = tmp_path / "r.csv"
    lat, lon = map_crs("EPSG:32633").to_geo(500_100.0, 5_199_900.0)
    for end, code in ((lat, 0), (lat + 0.01, 1)):
        route.write_text(f"lat_deg,lon_deg\n{lat},{lon}\n{end},{lon}\n")
        got, text = visloc("check", tmp_path / "pack", "--route", route)
        assert got == code, text
        assert "% of it over ground that can be matched, " in text and "km on end at most without such" in text
        assert ("leaves the map at" in text) == bool(code)


def test_a_route_along_the_edge_of_the_map_lacks_the_margin_that_is_asked_for(
    tmp_path: Path, ortho: Path, visloc: Visloc
) -> None:
    """50 m from the western edge."""
    visloc("build", "--ortho", ortho, "--out", tmp_path / "pack")
    west, route = 500_000.0, tmp_path / "r.csv"
    ends = [map_crs("EPSG:32633").to_geo(west + 50.0, north) for north in (5_199_910.0, 5_199_890.0)]
    route.write_text("lat_deg,lon_deg\n" + "".join(f"{lat},{lon}\n" for lat, lon in ends))
    for margin_m, code in ((0, 0), (40, 0), (60, 1)):
        got, text = visloc("check", tmp_path / "pack", "--route", route, "--margin-m", margin_m)
        assert got == code, text


def test_ellipsoidal_heights_through_the_options(tmp_path: Path, ortho: Path, visloc: Visloc) -> None:
    dsm = write(tmp_path / "dsm.tif", np.full((200, 200), 300, np.float32))
    command = ("build", "--ortho", ortho, "--dsm", dsm, "--out", tmp_path / "pack", "--vertical-datum", "ellipsoidal")
    with pytest.raises(DatumMissing, match="--geoid-undulation-m"):
        visloc(*command)
    visloc(*command, "--geoid-undulation-m", "-20.5", "--json", tmp_path / "r.json")
    assert json.loads((tmp_path / "r.json").read_text())["manifest"]["heights"]["geoid_undulation_m"] == -20.5


@pytest.mark.parametrize(
    ("undulation_m", "ground_m", "wrong"),
    [(46.5, 432, False), (-46.5, 432, True), (-46.5, None, False), (46.5, 380, False), (-46.5, 600, False), (-2.0, 480, False)],
)
def test_a_sign_that_the_grounds_height_contradicts_is_told(
    tmp_path: Path, ortho: Path, visloc: Visloc, undulation_m: float, ground_m: float | None, wrong: bool
) -> None:
    """480 m above the ellipsoid, 433.5 m above the sea: with the sign turned all heights were 93 m off, without a word."""
    dsm = write(tmp_path / "dsm.tif", np.linspace(470, 490, 200 * 200, dtype=np.float32).reshape(200, 200))
    command = ["build", "--ortho", ortho, "--dsm", dsm, "--out", tmp_path / "pack", "--vertical-datum", "ellipsoidal"]
    ground = [] if ground_m is None else ["--ground-height-m", ground_m]
    text = visloc(*command, "--model", "none", "--geoid-undulation-m", undulation_m, *ground)[1]
    assert ("warning: --geoid-undulation-m -46.5 puts the surface 517 to 536 m above sea level, 46.5 puts" in text) is wrong
    assert ("its sign is wrong" in text) is wrong
    side = f"the geoid {abs(undulation_m):g} m {'above' if undulation_m > 0 else 'below'} the ellipsoid"
    assert f"m above sea level, {side}\n" in text
    assert f"made from ellipsoidal heights, {side}" in visloc("info", tmp_path / "pack")[1]


def test_a_ground_that_nobody_stated_is_told(tmp_path: Path, ortho: Path, visloc: Visloc) -> None:
    """Without --dsm, --cloud and --ground-height-m the ground lay at 0 m, 430 m below the place, without a word."""
    base = ("build", "--ortho", ortho, "--out", tmp_path / "pack", "--model", "none")
    want = "of --dsm, --cloud and --ground-height-m: frames are scaled by it\n"
    assert f"ground plane at 0 m above sea level, for want {want}" in visloc(*base)[1]
    assert "ground plane at 0 m above sea level\n" in visloc("check", tmp_path / "pack", "--model", "none")[1]
    assert "ground plane at 0 m above sea level\n" in visloc(*base, "--ground-height-m", 0)[1]
    assert "ground plane at 430 m above sea level\n" in visloc(*base, "--ground-height-m", 430)[1]
    dsm = write(tmp_path / "dsm.tif", np.full((200, 200), 300, np.float32))
    for command in ((*base, "--dsm", dsm), ("check", tmp_path / "pack", "--model", "none")):
        assert "plane at" not in visloc(*command)[1]


def test_a_datum_of_heights_that_are_not_there_is_refused(tmp_path: Path, ortho: Path, visloc: Visloc) -> None:
    """The ground's height counts above sea level whatever is said: whoever gave an ellipsoidal one got it 47 m too high."""
    base = ("build", "--ortho", ortho, "--out", tmp_path / "pack", "--model", "none", "--ground-height-m", 477)
    with pytest.raises(DatumMissing, match=r"--vertical-datum ellipsoidal: .*; remedy: --ground-height-m"):
        visloc(*base, "--vertical-datum", "ellipsoidal")
    assert visloc(*base, "--vertical-datum", "amsl")[0] == 0


def test_wrong_options_are_named(tmp_path: Path, ortho: Path, visloc: Visloc) -> None:
    base = ("build", "--ortho", ortho, "--out", tmp_path / "pack")
    with pytest.raises(ConfigError, match=r"--vertical-datum.*amsl or ellipsoidal"):
        visloc(*base, "--vertical-datum", "sea")
    for date in ("last summer", "20240630", "2024-W26-7", "30.06.2024"):
        with pytest.raises(ConfigError, match=r"--capture-date.*YYYY-MM-DD"):
            visloc(*base, "--capture-date", date)
    with pytest.raises(ConfigError, match=r"--capture-date: 2924-06-30 is still to come; remedy"):
        visloc(*base, "--capture-date", "2924-06-30")
    for height in ("nan", "1e6"):
        with pytest.raises(ConfigError, match=r"--ground-height-m.*remedy"):
            visloc(*base, "--ground-height-m", height)
    with pytest.raises(ConfigError, match=r"its folder does not exist.*--json"):
        visloc(*base, "--json", "/nowhere/pack.json")
    with pytest.raises(CloudError, match=r"c\.laz: there is no such file"):
        visloc(*base, "--dsm", ortho, "--cloud", "c.laz")
    assert visloc("build", "--out", tmp_path / "pack")[0] == 2
    assert visloc(*base, "--vertical-datum", "amsl")[0] == 0


def test_damaged_pack_is_found(tmp_path: Path, ortho: Path, visloc: Visloc) -> None:
    visloc("build", "--ortho", ortho, "--out", tmp_path / "pack")
    raw = bytearray((tmp_path / "pack" / "ortho.tif").read_bytes())
    raw[-100] ^= 4
    (tmp_path / "pack" / "ortho.tif").write_bytes(raw)
    with pytest.raises(HashMismatch, match=r"ortho\.tif"):
        visloc("check", tmp_path / "pack")
    with pytest.raises(MapError, match=r"manifest\.json"):
        visloc("info", tmp_path)


@pytest.mark.parametrize(
    ("args", "want"),
    [
        (["--ortho", "a", "b", "--out", "p"], ["--ortho", "a", "--ortho", "b", "--out", "p"]),
        (["--dsm", "a", "b", "--out", "p"], ["--dsm", "a", "--dsm", "b", "--out", "p"]),
        (["--cloud", "a", "b", "c"], ["--cloud", "a", "--cloud", "b", "--cloud", "c"]),
        (["--ortho", "a", "--ortho", "b"], ["--ortho", "a", "--ortho", "b"]),
        (["--ortho=a", "b", "--dsm=c"], ["--ortho=a", "--ortho", "b", "--dsm=c"]),
        (["--out", "p", "q"], ["--out", "p", "q"]),
        (["--json", "-20", "--ortho"], ["--json", "-20", "--ortho"]),
    ],
)
def test_options_that_take_many_files(args: list[str], want: list[str]) -> None:
    assert repeated(args) == want


def test_features_of_a_network(tmp_path: Path, ortho: Path, network: Path, visloc: Visloc) -> None:
    pack, result = tmp_path / "pack", tmp_path / "r.json"
    code, text = visloc("build", "--ortho", ortho, "--out", pack, "--model", "none")
    assert code == 0 and "features gradient" in text and "MB/km²" in text and "warning" not in text
    assert "computed in flight" in visloc("check", pack, "--model", network)[1]
    assert "computed in flight" not in visloc("check", pack, "--model", "none")[1]
    code, text = visloc("features", pack, "--model", network, "--finest-features-m", 2, "--json", result)
    assert code == 0
    levels = [level for level in json.loads(result.read_text())["manifest"]["features"] if level["name"] != "gradient"]
    assert levels[0]["gsd_m"] == pytest.approx(2.0, rel=1e-3) and levels[0]["name"] in text
    assert "computed in flight" not in visloc("check", pack, "--model", network)[1]
    assert visloc("build", "--ortho", ortho, "--out", tmp_path / "other", "--model", network)[0] == 0
    assert "computed in flight" not in visloc("check", tmp_path / "other", "--model", network)[1]
    code, text = visloc("features", pack, "--model", "none", "--replace")
    assert code == 0 and levels[0]["name"] not in text
    with pytest.raises(ConfigError, match="--model none stores nothing"):
        visloc("features", pack, "--model", "none")
    with pytest.raises(ModelError, match="absent"):
        visloc("build", "--ortho", ortho, "--out", tmp_path / "third", "--model", tmp_path / "absent")


def test_several_dates_are_named_again_as_the_remedy_writes_them(
    tmp_path: Path, ortho: Path, network: Path, visloc: Visloc
) -> None:
    pack = tmp_path / "pack"
    assert visloc("build", "--ortho", ortho, "--other-dates", ortho, ortho, "--out", pack, "--model", "none")[0] == 0
    with pytest.raises(MapError, match=r"--other-dates a\.tif a\.tif$"):
        visloc("features", pack, "--model", network)
    code, text = visloc("features", pack, "--other-dates", ortho, ortho, "--model", network)
    assert code == 0 and text.count("mean over 3 dates") == 2


def test_the_folder_that_one_works_in_becomes_a_pack(
    tmp_path: Path, ortho: Path, visloc: Visloc, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It takes the folder's place, so that what "." led to is gone: the pack was whole, and the command ended with 3."""
    pack = tmp_path / "field"
    pack.mkdir()
    monkeypatch.chdir(pack)
    assert visloc("build", "--ortho", ortho, "--out", ".", "--model", "none")[0] == 0
    assert json.loads((pack / "manifest.json").read_text())["name"] == "field"


def test_a_result_that_could_not_be_written_is_named_before_the_work(tmp_path: Path, ortho: Path, visloc: Visloc) -> None:
    nowhere = tmp_path / "missing" / "r.json"
    for command in (("check", tmp_path / "none"), ("features", tmp_path / "none")):
        with pytest.raises(ConfigError, match=r"its folder does not exist.*--json"):
            visloc(*command, "--json", nowhere)


def test_without_a_network_packs_are_built_with_a_warning(
    tmp_path: Path, ortho: Path, visloc: Visloc, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("visloc_companion.prepare.shipped.shipped_networks", lambda: ((), "there is no model"))
    code, text = visloc("build", "--ortho", ortho, "--out", tmp_path / "pack")
    assert code == 0 and "warning: no network's features: there is no model" in text
