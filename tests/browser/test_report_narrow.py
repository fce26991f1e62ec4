"""Reports on narrow screens: what has no blanks (paths, names of figures) is broken, nothing is wider than the window."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.browser.devtools import chromium_page
from visloc_companion.errors import Reason
from visloc_companion.evaluate.gate import Check
from visloc_companion.evaluate.images.image_metrics import CaseResult
from visloc_companion.evaluate.images.image_report import _cases_table
from visloc_companion.evaluate.report import write_flight_report
from visloc_companion.evaluate.reports.report_parts import case_section, figures_table, html_page, sigma_scatter, tiles

pytestmark = pytest.mark.browser

PATH = "/var/lib/visloc/journals/visloc-20260714T103000Z.mcap/and/more/of/it/without/blanks/at/all/to/the/end.mcap"
NAME = "integrity.horizontal.hazardously_misleading_probability_per_hour"
WIDTH = "document.documentElement.scrollWidth"


@pytest.fixture(scope="module")
def pages(synthetic: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("reports")
    checks = [Check("median error without GNSS", "12.77 m", "≤ 50 m", True), Check(NAME, 0.9, "denied or suspect", False)]
    write_flight_report(synthetic.make_record(), folder / "flight.html", title=f"Replay of {PATH}", checks=checks, notes=[PATH])
    parts = [f"<h1>{PATH}</h1>", tiles([(PATH, NAME)]), figures_table({NAME: 1.0}), sigma_scatter([(1.0, 9.0, True)])]
    parts.append(case_section(PATH, NAME, PATH, [(np.zeros((9, 9, 3), np.uint8), PATH)]))
    (folder / "parts.html").write_text(html_page("Cases", parts, PATH), encoding="utf-8")
    return sorted(folder.glob("*.html"))


def test_no_page_is_wider_than_the_window(pages: list[Path], tmp_path: Path) -> None:
    with chromium_page(tmp_path / "profile") as page:
        wider = []
        for file in pages:
            for width in (320, 375, 768, 1440):
                page.open(file.as_uri(), width)
                page.until(f"document.readyState == 'complete' && innerWidth == {width}")
                wider += [(file.name, width, found) for found in [page.value(WIDTH)] if found > width]
    assert wider == []


def test_what_was_met_is_seen_at_320_px(pages: list[Path], tmp_path: Path) -> None:
    with chromium_page(tmp_path / "profile") as page:
        page.open(pages[0].as_uri(), 320)
        page.until("document.querySelectorAll('.checks td').length == 8")
        met = "[...document.querySelectorAll('.checks td:last-child')].map(cell => cell.getBoundingClientRect().right)"
        assert max(page.value(met)) <= 320


def test_words_of_a_limit_are_not_broken_at_320_px(pages: list[Path], tmp_path: Path) -> None:
    lines = """[...document.querySelectorAll('.checks td:nth-child(3)')].map(cell => {
        const range = document.createRange();
        range.selectNodeContents(cell);
        return [new Set([...range.getClientRects()].map(line => line.top)).size, cell.innerText.split(/\\s+/).length];
    })"""
    with chromium_page(tmp_path / "profile") as page:
        page.open(pages[0].as_uri(), 320)
        page.until("document.querySelectorAll('.checks td').length == 8")
        found = page.value(lines)
    assert len(found) == 2
    assert all(shown <= words for shown, words in found), found


def test_a_long_name_of_a_case_hides_no_column(tmp_path: Path) -> None:
    fix = CaseResult("field-" + "x" * 150, None, Reason.NO_MATCH, 3.0)
    file = tmp_path / "cases.html"
    file.write_text(html_page("Cases", [_cases_table([fix], {}), sigma_scatter([(1.0, 9.0, True)])], ""), encoding="utf-8")
    with chromium_page(tmp_path / "profile") as page:
        for width in (768, 1280):
            page.open(file.as_uri(), width)
            page.until(f"document.readyState == 'complete' && innerWidth == {width}")
            assert page.value("document.querySelector('table').getBoundingClientRect().right") <= width
        assert page.value("document.querySelector('svg').textContent.includes('2 sigma')")
