from __future__ import annotations

import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest

from visloc_companion.evaluate.gate import Check
from visloc_companion.evaluate.record import FlightRecord, Track, from_entries
from visloc_companion.evaluate.report import write_flight_report
from visloc_companion.evaluate.reports.report_charts import time_chart
from visloc_companion.evaluate.reports.report_map import MapImage, View, flight_map, flight_view, view_of
from visloc_companion.evaluate.reports.report_pictures import PicturePair
from visloc_companion.evaluate.reports.report_svg import Scale, decades, nice_step, number, path, thinned, thinned_track, ticks

VOID = {"meta", "link", "line", "circle", "path", "image", "img"}


class Checker(HTMLParser):
    """Collects what a page refers to, and whether its elements are closed in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.references: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.references += [value or "" for name, value in attrs if name in ("href", "src")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.references += [value or "" for name, value in attrs if name in ("href", "src")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def page_of(record: FlightRecord, folder: Path, **options: object) -> str:
    write_flight_report(record, folder / "report.html", title="A <flight> & more", **options)  # type: ignore[arg-type]
    page = (folder / "report.html").read_text(encoding="utf-8")
    checker = Checker()
    checker.feed(page)
    assert checker.open == []
    assert all(reference.startswith("data:") for reference in checker.references)
    assert "url(" not in page.replace("url(#clip", "")
    assert "nan" not in re.sub(r"base64,[^\"]*", "", page).lower().replace("nanum", "")
    return page


def test_the_page_is_whole_and_stands_alone(synthetic: ModuleType, tmp_path: Path) -> None:
    jpeg = cv2.imencode(".jpg", np.full((80, 90, 3), 120, np.uint8))[1].tobytes()
    corners = (synthetic.place((700, -500, 0)), synthetic.place((700, 800, 0)), synthetic.place((-700, -500, 0)))
    checks = [Check("hmi", 0, "= 0", True), Check("p95_m", 14.0, "<= 12", False)]
    page = page_of(
        synthetic.make_record(),
        tmp_path,
        checks=checks,
        baseline=synthetic.make_baseline(),
        map_image=MapImage(jpeg, (90, 80), *corners),
        notes=["seed 1 < 2"],
    )
    assert "A &lt;flight&gt; &amp; more" in page
    assert "seed 1 &lt; 2" in page
    assert '<span class="badge">FAIL</span>' in page
    assert "Not met: p95_m." in page
    assert re.search(r"The same flight without it: \d{3} m from the first at the end", page)
    assert page.count("data:image/jpeg;base64,") == 2
    for words in ("no fix: ambiguous", "disagrees with vision", "dead reckoning", "protection level", "GNSS called bad at 85 s"):
        assert words in page


def test_answers_are_told_by_method_with_their_times_and_how_far_fixes_are_off(synthetic: ModuleType, tmp_path: Path) -> None:
    record = synthetic.make_record(60.0)
    other = replace(record.fixes[0], method="deep", latency_ms=200.0, elapsed_ms=80.0)
    page = page_of(replace(record, fixes=(other, *record.fixes[1:])), tmp_path)
    assert re.search(r"<td>deep</td><td>fix</td><td class=\"n\">1</td><td class=\"n\">[\d.]+ %</td>.*?>200 ms<.*?>80 ms<", page)
    assert "<td>gradient</td><td>fix</td>" in page
    off = re.search(r"Fixes are ([\d.]+) m off \(median\)", page)
    assert off is not None
    assert float(off.group(1)) == pytest.approx(0.8 * math.sqrt(2 * math.log(2)), rel=0.2)
    assert "median latency" not in page_of(record, tmp_path, latency="computation")


def test_pass_needs_every_check(synthetic: ModuleType, tmp_path: Path) -> None:
    record = synthetic.make_record(30.0)
    assert '<span class="badge">PASS</span>' in page_of(record, tmp_path, checks=[Check("hmi", 0, "= 0", True)])
    assert '<span class="badge">NO GATE</span>' in page_of(record, tmp_path)


def test_without_truth_the_estimate_has_the_start_and_the_end(synthetic: ModuleType, tmp_path: Path) -> None:
    entries = synthetic.make_entries(20.0)
    page = page_of(from_entries(entries), tmp_path)
    assert page.count('class="dotstart"') == page.count('class="dotend"') == 2, "on the map and in the legend"
    assert "north and east of 47.400365°, 8.549986°" in page
    empty = page_of(from_entries([]), tmp_path)
    assert 'class="dotstart"' not in empty


def test_an_error_of_nothing_makes_no_huge_ratio(synthetic: ModuleType, tmp_path: Path) -> None:
    record = synthetic.make_record(60.0)
    page = page_of(replace(record, estimate_ned_m=record.truth_ned_m.copy()), tmp_path)
    assert "its median is more than 1000 times the median error" in page


def test_a_flight_without_anything_is_still_a_page(synthetic: ModuleType, tmp_path: Path) -> None:
    page = page_of(from_entries([]), tmp_path, checks=[Check("hmi", None, "= 0", False)])
    assert "No navigator ran" in page
    assert "No frame was localised" in page
    assert "unknown" in page
    assert "true track" in page_of(synthetic.make_baseline(), tmp_path)


def test_a_verdict_has_all_its_reasons(synthetic: ModuleType, tmp_path: Path) -> None:
    """That of its first epoch stood for all: a receiver that had no fix for 86 s was "probation"."""
    record = synthetic.make_record(20.0)
    n = len(record.t_s)
    bad = (("probation",),) * 2 + (("no_fix", "few_satellites"),) * (n - 12) + (("few_satellites",),) * 9 + ((),)
    page = page_of(replace(record, verdicts=("denied",) * (n - 1) + ("ok",), reasons=bad), tmp_path)
    assert re.search(r"<td>denied</td><td[^>]*>\d+\.\d</td><td>few_satellites, no_fix, probation</td>", page)
    assert re.search(r"<td>ok</td><td[^>]*>0\.0</td><td></td>", page)


def test_a_flight_whose_place_nobody_knew_has_no_map_of_one(synthetic: ModuleType, tmp_path: Path) -> None:
    """It had a blank grid, and positions were said to be metres from 0° N 0° E."""
    record = synthetic.make_record(20.0)
    none = Track(np.zeros(0), np.zeros((0, 3)))
    nowhere = np.full_like(record.estimate_ned_m, np.nan)
    page = page_of(replace(record, estimate_ned_m=nowhere, truth_ned_m=nowhere, truth=none, gnss=none, fixes=()), tmp_path)
    assert "Nobody knew a position" in page and "north and east of" not in page and 'aria-label="Map' not in page


def test_the_error_curve_is_where_the_error_is(synthetic: ModuleType, tmp_path: Path) -> None:
    """The highest point of the error's path is the largest error, on the chart's log axis."""
    record = synthetic.make_record()
    page = page_of(record, tmp_path).split("Does the protection level hold?")[0]
    curve = re.search(r'<path class="error" d="([^"]*)"', page)
    assert curve is not None
    points = np.array([[float(v) for v in pair.split()] for pair in re.split("[ML]", curve.group(1)) if pair])
    grid = {
        float(label): float(y) - 4.5 for y, label in re.findall(r'y="([\d.]+)" class="label" text-anchor="end">([\d.]+)<', page)
    }
    per_decade = grid[1.0] - grid[10.0]
    peak = points[np.argmin(points[:, 1])]
    assert 10 ** ((grid[1.0] - peak[1]) / per_decade) == pytest.approx(np.nanmax(record.error_m), rel=0.02)
    share = (peak[0] - 118) / (1182 - 118)
    assert share * record.duration_s == pytest.approx(record.t_s[np.nanargmax(record.error_m)], abs=0.5)


def test_a_replay_states_the_computation_alone(synthetic: ModuleType, tmp_path: Path) -> None:
    record = synthetic.make_record(60.0)
    medians = [
        float(re.findall(r"median (\d+) ms</text>", page_of(record, tmp_path, latency=which))[0])
        for which in ("arrival", "computation")
    ]
    assert medians[0] - medians[1] == pytest.approx(20, abs=1)
    assert ">latency, 95 % below<" in page_of(record, tmp_path)
    assert ">computation of an answer, 95 % below<" in page_of(record, tmp_path, latency="computation")


def test_misleading_epochs_are_those_of_the_epochs_that_could_be_judged(synthetic: ModuleType, tmp_path: Path) -> None:
    record = synthetic.make_record(60.0)
    known = np.arange(len(record.t_s)) % 10 == 9
    few = replace(record, truth_ned_m=np.where(known[:, None], record.truth_ned_m, np.nan))
    assert f"of {int(np.sum(known & np.isfinite(record.protection_level_m)))} epochs with truth<" in page_of(few, tmp_path)


def test_the_worst_fix_of_a_long_flight_is_drawn(synthetic: ModuleType, tmp_path: Path) -> None:
    """One of 20,000 fixes is a kilometre off: among the dots it is the highest."""
    record = synthetic.make_record(60.0)
    n = 20_000
    fixes = [replace(record.fixes[0], t_s=t_s, p_ned_m=(0.5, 0.0, -100.0)) for t_s in np.linspace(10, 50, n)]
    fixes[7_777] = replace(fixes[7_777], p_ned_m=(1000.0, 0.0, -100.0))
    still = replace(record, fixes=tuple(fixes), truth=Track(np.arange(61.0), np.zeros((61, 3))))
    chart = time_chart(still, None, None)
    heights = [float(y) for y in re.findall(r'<circle cx="[\d.]+" cy="([\d.]+)" r="2.2"', chart)]
    assert len(heights) < 2_000
    assert min(heights) < 60 < sorted(heights)[1]


def test_no_line_is_drawn_over_what_nobody_knows(synthetic: ModuleType) -> None:
    t_s = np.concatenate([np.arange(0.0, 20.0, 0.1), np.arange(50.0, 80.0, 0.1)])
    p_ned_m = np.column_stack([10 * t_s, np.zeros((len(t_s), 2))])
    record = synthetic.make_record(10.0)

    def drawn(track: Track) -> str:
        shown = replace(record, truth=track, gnss=Track(t_s[:0], p_ned_m[:0]), estimate_ned_m=record.estimate_ned_m * np.nan)
        return re.findall(r'<path class="truth" d="([^"]*)"', flight_map(shown, view_of([p_ned_m]), "a", None))[0]

    assert drawn(Track(t_s, p_ned_m)).count("M") == 2
    assert drawn(Track(t_s[:200], p_ned_m[:200])).count("M") == 1
    assert drawn(Track(t_s[::100], p_ned_m[::100])).count("M") == 2, "of a sample in ten seconds, thirty are a gap"
    many = np.linspace(0, 5_000, 50_000)
    wide = np.column_stack([np.zeros(50_000), many, many * 0])
    wide[12_345, 0] = 777.0
    one_off = flight_map(replace(record, truth=Track(many, wide)), View(400.0, 2500.0, 6000.0), "a", None)
    path = re.findall(r'<path class="truth" d="([^"]*)"', one_off)[0]
    assert path.count("L") < 2_000
    assert len({y for _, y in re.findall(r"[ML]([\d.]+) ([\d.]+)", path)}) == 2, "the one that is aside is drawn"


def test_scales_and_ticks() -> None:
    scale = Scale(0.1, 1000.0, 340.0, 20.0, log=True)
    assert scale(10.0) == pytest.approx(180.0)
    assert scale(0.001) == 340.0
    assert decades(0.1, 1000.0) == pytest.approx([0.1, 1, 10, 100, 1000])
    assert ticks(0, 200, 10) == pytest.approx([20 * k for k in range(11)])
    assert ticks(-1.3, 1.3, 4) == pytest.approx([-1, 0, 1])
    assert nice_step(0.37, 5) == pytest.approx(0.1)
    assert (number(-0.0), number(0.30000000000000004), number(1000.0)) == ("0", "0.3", "1000")


def test_a_path_breaks_where_nothing_is_known() -> None:
    assert path(np.array([0, 1, np.nan, 3.0]), np.array([0, 1, 2, 3.0]), "x") == '<path class="x" d="M0.0 0.0L1.0 1.0M3.0 3.0"/>'
    assert path(np.array([np.nan]), np.array([1.0]), "x") == ""


def test_thinning_keeps_peaks_and_gaps() -> None:
    t = np.arange(100_000.0)
    values = np.ones_like(t)
    values[54_321], values[70_000:70_500] = 99.0, np.nan
    few_t, few = thinned(t, values)
    assert len(few_t) < 3000
    assert few_t[np.nanargmax(few)] == 54_321
    assert np.isnan(few).any()
    assert (np.diff(few_t) > 0).all()


def test_a_thinned_track_keeps_the_corners_of_all_rounds() -> None:
    """75 rounds of a square, with noise: drawn from corner to corner, not across the middle."""
    side_m, along = 300.0, np.arange(90_000) % 1200.0
    leg, s = along // side_m, along % side_m
    north = np.choose(leg.astype(int), [s, side_m, side_m - s, 0.0])
    east = np.choose(leg.astype(int), [0.0, s, side_m, side_m - s])
    track = np.column_stack([north, east, np.zeros(90_000)]) + np.random.default_rng(0).normal(0, 0.3, (90_000, 3))
    track[40_000:40_100] = np.nan
    kept = thinned_track(track)
    assert kept[0] == 0 and kept[-1] == 89_999 and len(kept) <= 1610 and (np.diff(kept) > 0).all()
    drawn = track[kept]
    middle = (drawn[1:, :2] + drawn[:-1, :2]) / 2
    off = np.minimum(np.abs(middle), np.abs(middle - side_m)).min(axis=1)
    gap = int(np.searchsorted(kept, 40_000))
    assert (kept[gap - 1], kept[gap]) == (39_999, 40_100)
    assert np.delete(off, [gap - 1]).max() < 3.0
    assert len(thinned_track(np.full((5000, 3), np.nan))) == 2


def test_a_view_holds_every_track_and_survives_none() -> None:
    view = view_of([np.array([[0.0, 0, 0], [100, 900, 0]]), np.full((3, 3), np.nan)])
    east, north = view.scales()
    assert east.low < 0 < 900 < east.high
    assert north.low < 0 < 100 < north.high
    assert view_of([]).width_m > 0


def test_who_gave_each_fix_is_shown_where_several_did(synthetic: ModuleType, tmp_path: Path) -> None:
    record = synthetic.make_record()
    alone = page_of(record, tmp_path)
    fixes = tuple(replace(fix, method="structure") if k % 3 == 0 else fix for k, fix in enumerate(record.fixes))
    both = page_of(replace(record, fixes=fixes), tmp_path)
    name = record.fixes[0].method
    assert "fix / none" in alone
    assert "fix / none" not in both
    assert f">{name}</text>" in both
    assert ">structure</text>" in both
    assert "error of single fixes by structure" in both
    assert alone.count('class="dotring"') == 0
    assert both.count('class="dotring"') == len(fixes[::3]) + 1, "one more in the legend"


def test_frames_are_shown_beside_the_map(synthetic: ModuleType, tmp_path: Path) -> None:
    jpeg = cv2.imencode(".jpg", np.full((30, 40, 3), 90, np.uint8))[1].tobytes()
    record = synthetic.make_record()
    assert "Camera and map" not in page_of(record, tmp_path)
    page = page_of(record, tmp_path, pictures=[PicturePair(45.2, jpeg, jpeg)])
    assert page.count("<img ") == 2
    assert "what the camera saw at 45 s" in page
    assert "the map there at 45 s" in page


def test_a_receiver_on_another_continent_leaves_the_flight_to_be_seen(synthetic: ModuleType, tmp_path: Path) -> None:
    record = synthetic.make_record(200.0)
    p_ned_m = record.gnss.p_ned_m.copy()
    p_ned_m[300:] += (0.0, 2_000_000.0, 0.0)
    spoofed = replace(record, gnss=Track(record.gnss.t_s, p_ned_m))
    assert flight_view(spoofed).width_m < 400
    dragged = Track(record.gnss.t_s, record.gnss.p_ned_m + np.array([0.0, 500.0, 0.0]))
    assert flight_view(replace(record, gnss=dragged)).width_m > 800, "what is so near is shown"
    alone = replace(spoofed, truth=Track(p_ned_m[:0, 0], p_ned_m[:0]), estimate_ned_m=record.estimate_ned_m * np.nan)
    assert flight_view(alone).width_m > 2_000_000
    page = page_of(spoofed, tmp_path)
    assert "position that GNSS reported, up to 2,000.0 km off this map" in page
    track = re.findall(r'<path class="gnss" d="([^"]*)"', page)[0]
    xs = [float(x) for x in re.findall(r"[ML](-?[\d.]+) ", track)]
    assert max(xs) > 1e6, "the line leads over the edge, where it is cut"
    assert sum(x > 600 for x in xs) == 1


def test_answers_about_the_ground_below_are_none_of_frames(synthetic: ModuleType, tmp_path: Path) -> None:
    """Of a rangefinder's profile: with them more frames were answered than had been asked for."""
    record = synthetic.make_record(60.0)
    profile = replace(record.fixes[0], method="terrain")
    refused = replace(record.refusals[0], method="terrain")
    page = page_of(replace(record, fixes=(*record.fixes, *[profile] * 3), refusals=(*record.refusals, refused)), tmp_path)
    assert f"{len(record.fixes)} fixes from {record.n_frames} frames and 3 from profiles of the ground." in page
    assert (
        f"{record.n_requests} were asked to be localised, {record.n_requests} were answered. Profiles of the ground: 4 " in page
    )
    plain = page_of(record, tmp_path)
    assert f"{len(record.fixes)} fixes from {record.n_frames} frames." in plain
    assert "Profiles" not in plain


def test_the_map_says_whether_gnss_was_bad_or_called_so(synthetic: ModuleType, tmp_path: Path) -> None:
    record = synthetic.make_record()
    assert "GNSS bad from 60 s" in page_of(record, tmp_path, gnss_faults_s=[(60.0, 200.0)])
    assert "GNSS called bad at 85 s" in page_of(record, tmp_path)


def test_start_and_end_are_the_flights_and_not_those_of_its_truth(synthetic: ModuleType) -> None:
    record = synthetic.make_record(60.0)
    of_a_part = (record.truth.t_s > 20) & (record.truth.t_s < 40)
    short = replace(record, truth=Track(record.truth.t_s[of_a_part], record.truth.p_ned_m[of_a_part]))
    view = View(150.0, 150.0, 800.0)

    def ends(shown: FlightRecord) -> list[tuple[float, float]]:
        found = re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)" r="7"', flight_map(shown, view, "a", None))
        return [(float(x), float(y)) for x, y in found]

    assert np.array(ends(short)) == pytest.approx(np.array(ends(record)), abs=35), (
        "what the estimate is off, and its first seconds"
    )
