"""Cases whose place is told to a pixel, or told wrongly, and what is counted of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from visloc_companion.evaluate.cases import Truth
from visloc_companion.evaluate.images.image_metrics import CaseResult
from visloc_companion.geo.wgs84 import geo_from_ned, ned_from_geo
from visloc_companion.types import Fix, GeoPoint

PLACE = GeoPoint(47.0, 8.0, 300.0)
GSD_M = 5.0


@pytest.fixture
def source(tmp_path, load) -> Path:
    folder = tmp_path / "low64"
    folder.mkdir()
    told = {"ortho": "/map.tif", "dsm": "", "sigma_h_m": 12.0, "sigma_horizontal_m": 173.0, "prior_yaw_deg": 40.0}
    cases = [{"id": f"c{k}", "frame": f"frames/c{k}.png"} | told for k in range(300)]
    truth = {"lat_deg": PLACE.lat_deg, "lon_deg": PLACE.lon_deg, "h_m": 300.0, "roll_deg": 0.0, "pitch_deg": 2.0}
    truths = [{"id": case["id"], **truth, "yaw_deg": 359.0, "gsd_m": GSD_M} for case in cases]
    return load("image_cases.cases").write_tables(folder, cases, truths)


@pytest.mark.parametrize("beside", [False, True])
def test_priors_are_off_by_what_they_state_or_by_far_more(load, source, tmp_path, beside):
    module = load("known_places")
    folder = module.told(source, tmp_path / "told", beside=beside, n=250)
    rows = load("image_cases.cases").read_table(folder / "cases.csv")
    assert len(rows) == 250
    assert rows[0]["frame"] == str(source / "frames" / "c0.png")
    off_m = np.array(
        [ned_from_geo(GeoPoint(float(r["prior_lat_deg"]), float(r["prior_lon_deg"]), 300.0), PLACE)[:2] for r in rows]
    )
    assert {float(r["sigma_horizontal_m"]) for r in rows} == {GSD_M}
    if beside:
        low, high = (limit * GSD_M for limit in module.BESIDE_PX)
        assert low <= np.hypot(*off_m.T).min() < np.hypot(*off_m.T).max() <= high + 0.1
        assert abs(off_m.mean(0)).max() < 20.0
    else:
        assert off_m.std(0) == pytest.approx([GSD_M, GSD_M], rel=0.15)
    assert np.std([float(r["prior_h_m"]) - 300.0 for r in rows]) == pytest.approx(float(rows[0]["sigma_h_m"]), rel=0.15)
    turned = [(float(r["prior_yaw_deg"]) - 359.0 + 180) % 360 - 180 for r in rows]
    assert np.std(turned) == pytest.approx(float(rows[0]["sigma_yaw_deg"]), rel=0.15)
    assert module.told(source, folder, beside=not beside, n=1) == folder


def test_a_row_counts_what_is_accepted_where_nothing_is_right(load):
    def judged(name: str, off_m: float, p: float) -> tuple[CaseResult, Truth]:
        place = geo_from_ned((off_m, 0.0, 0.0), PLACE)
        fix = Fix(0, 0, 1, 1, "deep", place, (1.0, 0.0, 0.0, 0.0), ((1.0, 0.0), (0.0, 1.0)), 1.0, 0.1, p, 5.0)
        truth = Truth(PLACE.lat_deg, PLACE.lon_deg, 300.0, 0.0, GSD_M, True)
        return CaseResult(name, fix, None, map_gsd_m=GSD_M), truth

    pairs = [judged("a", 2.0, 0.01), judged("b", 80.0, 0.02), judged("c", 3.0, 0.4), judged("d", 90.0, 0.97)]
    cells = [cell.strip() for cell in load("known_places").row("low64", "right", pairs).strip("|").split("|")]
    assert cells[:8] == ["low64", "right", "4", "50.0 %", "25.0 %", "1", "1.4", "2"]
    assert load("known_places").HEADER.count("|") == len(cells) + 1
