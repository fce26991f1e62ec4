"""Image cases over a pack: the column `ortho` names its folder."""

import csv
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from rasterio.warp import reproject
from rasterio.windows import Window

from visloc_companion.errors import MapError
from visloc_companion.evaluate.cases import COLUMNS, read_cases, read_truth
from visloc_companion.evaluate.images.case_map import open_case_map, picture_of
from visloc_companion.evaluate.images.image import evaluate_image
from visloc_companion.evaluate.images.image_pictures import case_pictures
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.build import build_pack

UTM, WEST, NORTH, SIDE = "EPSG:32632", 500_000.0, 5_205_000.0, 320


def picture(seed: int) -> np.ndarray:
    """Lasting edges, and half as strong those of a year."""
    fields = [cv2.GaussianBlur(np.random.default_rng(s).standard_normal((SIDE, SIDE)), (0, 0), 5.0) > 0 for s in (0, seed)]
    return (60 + 80 * fields[0] + 40 * fields[1]).astype(np.uint8)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A frame of a third year over packs of one and of two years, nadir, 100 m above the plane."""
    root = tmp_path_factory.mktemp("case_map")
    for name, seed in (("a.tif", 1), ("b.tif", 2)):
        shape = {"width": SIDE, "height": SIDE, "count": 1, "dtype": "uint8"}
        place = rasterio.Affine(1.0, 0.0, WEST, 0.0, -1.0, NORTH)
        with rasterio.open(root / name, "w", driver="GTiff", crs=UTM, transform=place, **shape) as out:
            out.write(picture(seed), 1)
    build_pack([root / "a.tif"], None, root / "one")
    build_pack([root / "a.tif"], None, root / "two", other_dates=[root / "b.tif"])
    cv2.imwrite(str(root / "f.png"), picture(3)[110:210, 100:220])
    lat, lon = map_crs(UTM).to_geo(WEST + 160, NORTH - 160)
    east, north = map_crs(UTM).to_geo(WEST + 166, NORTH - 156)
    case = dict.fromkeys(COLUMNS, "0") | {"frame": "f.png", "dsm": "", "distortion": "", "fx_px": "100", "fy_px": "100"}
    case |= {"cx_px": "59.5", "cy_px": "49.5", "prior_lat_deg": repr(east), "prior_lon_deg": repr(north), "prior_h_m": "101"}
    case |= {"sigma_horizontal_m": "6", "sigma_h_m": "2", "sigma_yaw_deg": "1.5", "sigma_tilt_deg": "0.1"}
    rows = [case | {"id": name, "ortho": name} for name in ("one", "two", "a.tif")]
    rows += [case | {"id": "heights", "ortho": "two", "dsm": "a.tif"}, case | {"id": "folder", "ortho": "."}]
    truth = {"lat_deg": repr(lat), "lon_deg": repr(lon), "h_m": "100", "roll_deg": "0", "pitch_deg": "0", "yaw_deg": "0"}
    for name, table in (("cases.csv", rows), ("truth.csv", [{"id": row["id"]} | truth for row in rows])):
        with (root / name).open("w", newline="") as stream:
            writer = csv.DictWriter(stream, table[0])
            writer.writeheader()
            writer.writerows(table)
    return root


def test_a_frame_is_found_over_packs_as_over_their_picture(folder: Path) -> None:
    document, results = evaluate_image(folder, "gradient")
    truth = read_truth(folder)
    by_id = {result.case_id: result for result in results}
    for name in ("one", "two", "a.tif"):
        fix = by_id[name].fix
        assert fix is not None, by_id[name].detail
        off_m = math.hypot(fix.place.lat_deg - truth[name].lat_deg, fix.place.lon_deg - truth[name].lon_deg) * 111_000
        assert off_m < 1.0
    assert by_id["two"].evidence["score"] > by_id["one"].evidence["score"] + 0.02, "the mean is nearer to a third year"
    assert "is given beside a pack" in by_id["heights"].detail and "leave the column empty" in by_id["heights"].detail
    assert "there is no such file" in by_id["folder"].detail and "manifest.json" in by_id["folder"].detail
    assert document["summary"]["n"] == 5


def test_pictures_of_a_case_over_a_pack_are_drawn(folder: Path) -> None:
    _, results = evaluate_image(folder, "gradient")
    case = next(case for case in read_cases(folder) if case.case_id == "two")
    drawn = case_pictures(case, read_truth(folder)["two"], next(r for r in results if r.case_id == "two"))
    assert drawn is not None and drawn.map_at_answer is not None


def test_the_map_of_a_case_is_a_pack_where_it_is_a_folder(folder: Path) -> None:
    assert isinstance(open_case_map(folder / "one", None), PackMap)
    assert picture_of(folder / "one") == folder / "one" / "ortho.tif"
    assert picture_of(folder / "a.tif") == folder / "a.tif"
    with pytest.raises(MapError, match="no such file"):
        picture_of(folder)


def test_a_frame_at_the_seam_of_a_map_around_the_earth_is_found(folder: Path, tmp_path: Path) -> None:
    """Of a global image half of what lay about the antimeridian was no map."""
    utm, cols, rows, wide = "EPSG:32660", 36_000_000, 512, 512
    east, north = map_crs(utm).to_map(-16.8, 180.0)
    here, step = rasterio.Affine(1.0, 0.0, east - 160, 0.0, -1.0, north + 160), 360 / cols
    to = rasterio.Affine(step, 0, 180 - step * wide / 2, 0, -step, -16.8 + step * rows / 2)
    about = np.zeros((rows, wide), np.uint8)
    reproject(picture(1), about, src_transform=here, src_crs=utm, dst_transform=to, dst_crs="EPSG:4326")
    profile = {"width": cols, "height": rows, "count": 1, "dtype": "uint8", "crs": "EPSG:4326", "nodata": 0, "SPARSE_OK": True}
    place = rasterio.Affine(step, 0, -180, 0, -step, to.f)
    with rasterio.open(tmp_path / "globe.tif", "w", "GTiff", transform=place, tiled=True, **profile) as out:
        out.write(about[:, : wide // 2], 1, window=Window(cols - wide // 2, 0, wide // 2, rows))
        out.write(about[:, wide // 2 :], 1, window=Window(0, 0, wide // 2, rows))
    with (folder / "cases.csv").open(newline="") as stream:
        case = next(csv.DictReader(stream)) | {"ortho": "globe.tif", "frame": str(folder / "f.png"), "sigma_yaw_deg": "3"}
    case |= {"prior_lat_deg": "-16.80003", "prior_lon_deg": "-179.99996"}
    with (tmp_path / "cases.csv").open("w", newline="") as stream:
        writer = csv.DictWriter(stream, case)
        writer.writeheader()
        writer.writerow(case)
    _, (result,) = evaluate_image(tmp_path, "gradient")
    assert result.fix is not None, result.detail
    at = map_crs(utm).to_map(result.fix.place.lat_deg, result.fix.place.lon_deg)
    assert math.hypot(at[0] - east, at[1] - north) < 1.0
    assert result.evidence["blocks"] > 35, "of all of the frame, of half of it 24"
