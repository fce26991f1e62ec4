"""Cases whose frames show landing gear, with and without the mask that says so."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.unit.landing_gear import legs, with_gear
from visloc_companion.evaluate.cases import COLUMNS, read_cases
from visloc_companion.evaluate.images.image import evaluate_image
from visloc_companion.maps.crs import map_crs
from visloc_companion.types import Image

LAT, LON, SIDE = 47.0, 9.0, 600
WIDTH, HEIGHT = 200, 160


def texture() -> Image:
    rng = np.random.default_rng(4)
    image = np.full((SIDE, SIDE), 110, np.uint8)
    for _ in range(1100):
        box = cv2.boxPoints((tuple(rng.uniform(0, SIDE, 2)), tuple(rng.uniform(4, 40, 2)), rng.uniform(0, 180)))
        cv2.fillPoly(image, [box.astype(np.int32)], (float(rng.uniform(30, 220)),))
    return cv2.GaussianBlur(image, (0, 0), 0.8).astype(np.uint8)


@pytest.fixture
def folder(tmp_path: Path, write_raster) -> Path:
    """Frames of 1 m/px, nadir, in the middle of a map of 1 m/px and beside it, priors 8 m off; gear in half of each."""
    image = texture()
    write_raster(tmp_path / "map.tif", image, "EPSG:32632", (LAT, LON), 1.0)
    crs = map_crs("EPSG:32632")
    easting, northing = crs.to_map(LAT, LON)
    rng = np.random.default_rng(7)
    rows, truths = [], []
    for k, (row, col) in enumerate([(300, 300), (240, 350), (360, 260), (280, 400)]):
        frame = image[row - HEIGHT // 2 : row + HEIGHT // 2, col - WIDTH // 2 : col + WIDTH // 2]
        faded = np.clip(110 + 0.12 * (frame - 110.0) + rng.normal(0, 5, frame.shape), 0, 255).astype(np.uint8)
        cv2.imwrite(str(tmp_path / f"f{k}.png"), with_gear(faded))
        lat, lon = crs.to_geo(easting + col - SIDE / 2, northing - row + SIDE / 2)
        prior_lat, prior_lon = crs.to_geo(easting + col - SIDE / 2 + 6, northing - row + SIDE / 2 - 5)
        rows.append(
            dict.fromkeys(COLUMNS, "0")
            | {"id": f"c{k}", "frame": f"f{k}.png", "ortho": "map.tif", "dsm": "", "distortion": ""}
            | {"fx_px": "150", "fy_px": "150", "cx_px": str(WIDTH / 2 - 0.5), "cy_px": str(HEIGHT / 2 - 0.5)}
            | {"prior_lat_deg": repr(prior_lat), "prior_lon_deg": repr(prior_lon), "prior_h_m": "151", "prior_yaw_deg": "1"}
            | {"sigma_horizontal_m": "40", "sigma_h_m": "2", "sigma_yaw_deg": "6", "sigma_tilt_deg": "0.1"}
        )
        truths.append({"id": f"c{k}", "lat_deg": repr(lat), "lon_deg": repr(lon), "gsd_m": "1"})
    cv2.imwrite(str(tmp_path / "gear.png"), (~legs(WIDTH, HEIGHT) * 255).astype(np.uint8))
    write(tmp_path / "cases.csv", rows)
    write(tmp_path / "truth.csv", truths)
    return tmp_path


def write(path: Path, rows: list[dict[str, str]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, rows[0])
        writer.writeheader()
        writer.writerows(rows)


def name_mask(folder: Path, *names: str) -> None:
    with (folder / "cases.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    write(folder / "cases.csv", [row | {"mask": name} for row, name in zip(rows, names, strict=True)])


def test_gear_in_view_does_no_harm_where_a_mask_tells_of_it(folder: Path) -> None:
    bare = evaluate_image(folder, "gradient")[0]["summary"]
    name_mask(folder, *["gear.png"] * 4)
    masked = evaluate_image(folder, "gradient")[0]["summary"]
    assert (bare["n_fix"], masked["n_fix"]) == (0, 4)
    assert masked["error_m"]["max"] < 0.5


def test_a_mask_that_is_none_is_named_and_costs_the_other_cases_nothing(folder: Path) -> None:
    (folder / "text.png").write_text("no picture")
    cv2.imwrite(str(folder / "small.png"), np.full((HEIGHT, WIDTH - 1), 255, np.uint8))
    cv2.imwrite(str(folder / "inverted.png"), np.where(np.arange(WIDTH) < WIDTH // 5, 255, np.zeros((HEIGHT, 1))))
    name_mask(folder, "absent.png", "text.png", "small.png", "inverted.png")
    told = [result.detail for result in evaluate_image(folder, "gradient")[1]]
    assert [text.partition(";")[0].removeprefix(f"mask = {folder}/") for text in told] == [
        "absent.png: cannot be read: No such file or directory",
        "text.png: is no PNG",
        "small.png: has 199 x 160 pixels, frames have 200 x 160",
        "inverted.png: 80 % of what is looked at are black, at most 70 % may be",
    ]
    assert all("; remedy: " in text for text in told)
    name_mask(folder, "", "gear.png", "text.png", "a\0.png")
    statuses = [case["status"] for case in evaluate_image(folder, "gradient")[0]["cases"]]
    assert statuses == ["no_fix", "fix", "no_fix", "no_fix"]


def test_without_a_mask_cases_are_what_they_were(folder: Path) -> None:
    without = read_cases(folder)
    name_mask(folder, *[""] * 4)
    assert read_cases(folder) == without and [case.mask for case in without] == [None] * 4  # type: ignore[union-attr]
