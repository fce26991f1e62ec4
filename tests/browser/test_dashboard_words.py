"""Words on the dashboard that run into others or off the map."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.browser.devtools import Page, chromium_page
from tests.browser.test_dashboard_in_chromium import STATE, dashboard, in_thread
from tests.unit.web.snapshots import snapshot
from visloc_companion.app.status import status_server
from visloc_companion.web.daemon_socket import DaemonSocket

pytestmark = pytest.mark.browser

COMPUTER = {"cores": [1.0, 1.0], "ram_used_bytes": 4_900_000_000, "ram_total_bytes": 25_300_000_000, "temperature_c": 91.0}
RECORD_WORDS = """
window.said = [];
const plain = CanvasRenderingContext2D.prototype.fillText;
CanvasRenderingContext2D.prototype.fillText = function (words, x, y) {
  if (this.canvas.id === 'map') window.said.push([words, x, x + this.measureText(words).width, this.canvas.clientWidth]);
  return plain.call(this, words, x, y);
};
true
"""


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with chromium_page(tmp_path_factory.mktemp("profile")) as tab:
        yield tab


@contextmanager
def daemon(path: Path, injections: dict[str, Any] | None = None, **status: Any) -> Iterator[None]:
    looks = [0]

    def look() -> dict[str, Any]:
        looks[0] += 1
        told = snapshot(looks[0] / 4, **status) | {"computer": COMPUTER}
        return told if injections is None else told | {"injections": injections}

    async def run(stop: asyncio.Event) -> None:
        async with status_server(path, look, print):
            await stop.wait()

    with in_thread(run):
        yield


@pytest.mark.parametrize("width", [1280, 360])
def test_parts_and_what_is_said_of_them_do_not_overlap(page: Page, tmp_path: Path, width: int) -> None:
    """The word "computer" ran into its load; one that is hot is written in bold."""
    path = tmp_path / "status.sock"
    with daemon(path), dashboard(DaemonSocket(path)) as url:
        page.open(url, width, 900)
        page.until(f"{STATE} === 'live' && document.getElementById('health').innerText.includes('computer')")
        wide = page.value(
            "[...document.querySelectorAll('#health li span')].map((s) => [s.innerText, s.scrollWidth - s.clientWidth])"
        )
    assert len(wide) >= 10 and [words for words, over in wide if over > 0] == []


@pytest.mark.parametrize("width", [1280, 360])
@pytest.mark.parametrize("why", ["too far outside the map", "set GPS1_TYPE or GPS2_TYPE 14 and reboot, or injection.output auto"])
def test_positions_that_are_kept_back_are_shown_with_why(page: Page, tmp_path: Path, width: int, why: str) -> None:
    path = tmp_path / "status.sock"
    with daemon(path, {"sent": 321, "dropped": 0, "withheld": why}), dashboard(DaemonSocket(path)) as url:
        page.open(url, width, 900)
        page.until(f"{STATE} === 'live' && document.body.innerText.includes('NOT SENT')")
        shown = page.value("document.getElementById('sending').innerText").split("\n")
        assert shown[-1].strip() == (why if width > 1000 else "NOT SENT"), "a phone has room for one word a badge"
        assert "SENDING" not in page.value("document.body.innerText")
        assert page.value("document.getElementById('sending').scrollWidth - document.getElementById('sending').clientWidth") <= 0


@pytest.mark.parametrize(("width", "level_m"), [(1280, 157.0), (360, 103.0), (360, 160.0)])
def test_the_names_of_rings_are_not_cut_off(page: Page, tmp_path: Path, width: int, level_m: float) -> None:
    """Of "level 103 m" a phone showed "level 103 r", of a larger one on a screen "prot"."""
    path = tmp_path / "status.sock"
    with daemon(path, protection_level_m=level_m), dashboard(DaemonSocket(path)) as url:
        page.open(url, width, 900)
        page.until(f"{STATE} === 'live'")
        page.value(RECORD_WORDS)
        page.until(f"window.said.some(([words]) => words.includes('{level_m:.0f} m'))")
        said = page.value("window.said")
    rings = [each for each in said if each[0].endswith(" m") and ("level" in each[0] or "limit" in each[0])]
    assert {f"{level_m:.0f} m", "40 m"} <= {" ".join(words.split()[-2:]) for words, *_ in rings}
    assert [words for words, left, right, most in rings if left < 0 or right > most] == []
