from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rasterio
from rasterio import Affine
from rasterio.enums import ColorInterp

from visloc_companion.errors import CasesError
from visloc_companion.train.augment import mixed_bands
from visloc_companion.train.imagery import read_imagery
from visloc_companion.train.sources import dates_stack, paired_stack

ROWS, COLS = 120, 150
Write = Callable[..., Path]


def land(seed: int = 0, bands: int = 3) -> np.ndarray:
    noise = np.random.default_rng(seed).integers(1, 255, (ROWS, COLS, bands)).astype(np.uint8)
    return np.clip(cv2.GaussianBlur(noise, (0, 0), 1.5).reshape(ROWS, COLS, bands), 1, 254)


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def to(name: str, values: np.ndarray, *, corner: float = 600_000.0, gsd: float = 1.0, epsg: int = 32632, **more: Any) -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        meanings = more.pop("meanings", None)
        rows, cols, count = values.shape
        where = {"crs": f"EPSG:{epsg}", "transform": Affine(gsd, 0.0, corner, 0.0, -gsd, 5_200_000.0)}
        with rasterio.open(
            path, "w", driver="GTiff", height=rows, width=cols, count=count, dtype=values.dtype, **where, **more
        ) as out:
            out.write(values.transpose(2, 0, 1))
            if meanings:
                out.colorinterp = meanings
        return path

    return to


@pytest.mark.parametrize(
    ("other", "why"),
    [
        ({"corner": 600_020.0}, r"its corners are off by up to 20 px"),
        ({"corner": 600_000.3}, r"its corners are off by up to 0\.3 px"),
        ({"gsd": 2.0}, r"its pixels have 2 units instead of 1"),
        ({"epsg": 32633}, r"it is in EPSG:32633 instead of EPSG:32632"),
        ({"values": land()[:-10]}, r"it has 150 x 110 px instead of 150 x 120"),
    ],
)
def test_dates_that_do_not_lie_on_one_grid_are_refused(tmp_path: Path, write: Write, other: dict[str, Any], why: str) -> None:
    write("own/2019.tif", land())
    write("own/2022.tif", **{"values": land(), **other})
    with pytest.raises(CasesError, match=rf"2022\.tif: does not lie on the grid of 2019\.tif: {why}; remedy: .*gdalwarp"):
        dates_stack(tmp_path / "own")


def test_a_hundredth_of_a_pixel_is_the_same_grid_and_every_spelling_of_tif_is_read(tmp_path: Path, write: Write) -> None:
    for name, corner in (("2019.tif", 600_000.0), ("2020.TIF", 600_000.01), ("2021.tiff", 600_000.0)):
        write(f"own/{name}", land(), corner=corner)
    (tmp_path / "own" / "2022.tif.aux.xml").write_text("<PAMDataset/>", encoding="utf-8")
    stack = dates_stack(tmp_path / "own")
    assert len(stack.dates) == 3
    assert stack.valid.all()


@pytest.mark.parametrize("dtype", [np.uint16, np.int16, np.float32])
def test_values_of_other_types_are_refused_and_not_wrapped(write: Write, dtype: Any) -> None:
    path = write("a.tif", (land().astype(np.float64) * 20).astype(dtype))
    with pytest.raises(CasesError, match=rf"a\.tif: holds {np.dtype(dtype)} values.*gdal_translate -ot Byte -scale"):
        read_imagery(path)


def test_a_colour_table_is_refused(write: Write) -> None:
    path = write("a.tif", land(bands=1))
    with rasterio.open(path, "r+") as out:
        out.write_colormap(1, {k: (k, 255 - k, 0, 255) for k in range(256)})
    with pytest.raises(CasesError, match=r"has a colour table.*-expand rgb"):
        read_imagery(path)


def test_a_date_whose_grey_counts_from_white_is_learned_from_as_what_it_shows(tmp_path: Path) -> None:
    grey = land(bands=1)
    place = {"crs": "EPSG:32632", "transform": Affine(1, 0, 500_000, 0, -1, 5_000_000), "photometric": "MINISWHITE"}
    shape = {"driver": "GTiff", "width": COLS, "height": ROWS, "count": 1, "dtype": "uint8"}
    with rasterio.open(tmp_path / "a.tif", "w", **shape, **place) as out:
        out.write(255 - grey[..., 0], 1)
    assert np.array_equal(read_imagery(tmp_path / "a.tif").bands, grey)


def test_alpha_is_no_band_and_near_infrared_is_one_even_where_it_is_called_alpha(write: Write) -> None:
    rgba = (ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha)
    full = np.full((ROWS, COLS, 1), 255, np.uint8)
    full[:, :50] = 0
    transparent = read_imagery(write("a.tif", np.dstack([land(), full]), meanings=rgba))
    assert transparent.bands.shape == (ROWS, COLS, 3)
    assert np.array_equal(transparent.valid, full[..., 0] > 0)
    infrared = read_imagery(write("b.tif", np.dstack([land(), land(1, bands=1)]), meanings=rgba))
    assert infrared.bands.shape == (ROWS, COLS, 4)
    assert infrared.valid.all()


@pytest.mark.parametrize("nodata", [None, 0])
def test_only_land_that_all_dates_show_is_trained_on(tmp_path: Path, write: Write, nodata: int | None) -> None:
    first, second = land(1), land(2)
    first[:, :30] = 0
    second[100:] = 0
    for year, values in ((2019, first), (2022, second)):
        write(f"own/{year}.tif", values, nodata=nodata)
    stack = dates_stack(tmp_path / "own")
    assert stack.valid.shape == (100, 120)
    assert stack.valid.all()
    assert np.array_equal(stack.dates[0], first[:100, 30:])
    first[:, 30:] = 0
    write("own/2019.tif", first, nodata=0)
    with pytest.raises(CasesError, match="no pixel shows land on all dates"):
        dates_stack(tmp_path / "own")


def test_rows_beyond_last_row_are_out_of_reach(tmp_path: Path, write: Write) -> None:
    for year in (2019, 2022):
        values = land(year)
        values[80:] = 255
        values[:10] = 255
        write(f"own/{year}.tif", values, nodata=7)
    stack = dates_stack(tmp_path / "own", 10, 80)
    assert stack.dates[0].shape == (70, COLS, 3)
    assert max(date.max() for date in stack.dates) < 255


def test_a_folder_with_one_date_says_how_many_it_needs(tmp_path: Path, write: Write) -> None:
    write("own/2019.tif", land())
    with pytest.raises(CasesError, match=r"own: holds 1 GeoTIFFs .*at least two"):
        dates_stack(tmp_path / "own")


@pytest.mark.parametrize("bands", [1, 3])
def test_the_shift_of_a_pair_is_measured_and_where_it_has_no_land_is_known(tmp_path: Path, write: Write, bands: int) -> None:
    content = land(bands=bands)
    shifted = np.roll(content, (-2, 3), (0, 1))
    shifted[:, :20] = 0
    write("own/p/a.tif", content, nodata=0)
    write("own/p/b.tif", shifted, nodata=0)
    (stack,) = paired_stack(tmp_path / "own", ("p",))
    assert stack.shift_px.tolist() == [[0.0, 0.0], [3.0, -2.0]]
    assert stack.valid.all()
    assert stack.valid.shape == (ROWS, COLS - 17)
    assert np.array_equal(stack.dates[0], content[:, 17:])


@pytest.mark.parametrize("shift_px", [7, 15, -20])
def test_a_pair_that_is_shifted_too_far_is_refused(tmp_path: Path, write: Write, shift_px: int) -> None:
    write("own/p/a.tif", land())
    write("own/p/b.tif", np.roll(land(), shift_px, 1))
    with pytest.raises(CasesError, match=rf"p/b\.tif: is shifted against a\.tif by {abs(shift_px)} px"):
        paired_stack(tmp_path / "own", ("p",))


def test_a_pair_of_two_sizes_is_refused(tmp_path: Path, write: Write) -> None:
    write("own/p/a.tif", land())
    write("own/p/b.tif", land()[:-10])
    with pytest.raises(CasesError, match=r"p/b\.tif: does not lie on the grid of a\.tif: it has 150 x 110 px"):
        paired_stack(tmp_path / "own", ("p",))


@pytest.mark.parametrize("bands", [1, 2])
def test_fewer_bands_than_three_are_grey(bands: int) -> None:
    image = land(bands=bands)
    seen = [mixed_bands(np.random.default_rng(seed), image) for seed in range(8)]
    assert any(np.array_equal(grey, image[..., 0].astype(np.float32)) for grey in seen)
    assert all(grey.shape == (ROWS, COLS) for grey in seen)
