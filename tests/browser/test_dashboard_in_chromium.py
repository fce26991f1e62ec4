"""The dashboard as Chromium shows it, while a fake daemon answers on a status socket, and while none does."""

from __future__ import annotations

import asyncio
import math
import tempfile
import threading
from collections.abc import Callable, Coroutine, Iterator
from concurrent.futures import Future
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.browser.devtools import Page, chromium_page
from tests.unit.web.snapshots import SNAPSHOT, snapshot
from visloc_companion.app.status import status_server
from visloc_companion.web.daemon_socket import DaemonSocket
from visloc_companion.web.feed import Feed
from visloc_companion.web.guard import own_names
from visloc_companion.web.pictures import MapPictures
from visloc_companion.web.recording import Recording
from visloc_companion.web.serve import listening, serve
from visloc_companion.web.server import application
from visloc_companion.web.source import Source

pytestmark = pytest.mark.browser

TEXT = "document.body.innerText"
STATE = "document.body.dataset.state"
INK = (17, 17, 17)
GRID_ONLY = "no map: start visloc web with --map PACK"


@contextmanager
def in_thread(served: Callable[[asyncio.Event], Coroutine[Any, Any, None]]) -> Iterator[None]:
    """Something that is served in a thread of its own, until the event that it is given is set."""
    loop, stop = asyncio.new_event_loop(), asyncio.Event()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    running = asyncio.run_coroutine_threadsafe(served(stop), loop)
    try:
        yield
    finally:
        loop.call_soon_threadsafe(stop.set)
        running.result(10)
        loop.call_soon_threadsafe(loop.stop)
        thread.join(10)
        loop.close()


@contextmanager
def dashboard(source: Source, pictures: MapPictures | None = None) -> Iterator[str]:
    with listening("127.0.0.1", 0) as listener:

        async def run(stop: asyncio.Event) -> None:
            feed = Feed(source)
            await serve(feed, application(feed, pictures, own_names("127.0.0.1")), listener, stop)

        with in_thread(run):
            yield f"http://127.0.0.1:{listener.getsockname()[1]}/"


@contextmanager
def daemon(path: Path, **status: Any) -> Iterator[None]:
    """A daemon's status socket: the flight goes on with every look, a quarter of a second each."""
    looks = [0]

    def look() -> dict[str, Any]:
        looks[0] += 1
        return snapshot(looks[0] / 4, **status)

    async def run(stop: asyncio.Event) -> None:
        async with status_server(path, look, print):
            await stop.wait()

    with in_thread(run):
        yield


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with chromium_page(tmp_path_factory.mktemp("profile")) as tab:
        yield tab


@pytest.fixture
def quiet(page: Page) -> Iterator[Page]:
    """The tab, whose console and network must have nothing to complain of."""
    page.faults.clear()
    yield page
    assert page.faults == []


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "status.sock"


def drawn(page: Page, tmp_path: Path) -> tuple[np.ndarray, tuple[float, float], float]:
    """The map's pixels (RGB), where its middle is, and CSS pixels a metre by the scale bar's rule in chart.js."""
    box = page.value(
        "(() => { const b = document.getElementById('map').getBoundingClientRect(); return [b.x, b.y, b.width, b.height]; })()"
    )
    shot = cv2.imread(str(page.picture(tmp_path / "shot.png")))
    assert shot is not None
    x, y, width, height = (round(v) for v in box)
    return shot[y : y + height, x : x + width, ::-1], (width / 2, height / 2), min(width, height) / 250.0


def share_inked(pixels: np.ndarray, middle: tuple[float, float], radius_px: float, rgb: tuple[int, int, int]) -> float:
    """Share of the directions in which a pixel of that colour lies within 2 px of the radius."""
    hits = 0
    for k in range(120):
        c, s = math.cos(k * math.pi / 60), math.sin(k * math.pi / 60)
        near = [
            pixels[round(middle[1] + r * s), round(middle[0] + r * c)] for r in np.arange(radius_px - 2, radius_px + 2.1, 0.5)
        ]
        hits += any(np.abs(pixel.astype(int) - rgb).max() < 30 for pixel in near)
    return hits / 120


def test_what_the_daemon_says_is_seen(quiet: Page, path: Path, tmp_path: Path) -> None:
    with daemon(path), dashboard(DaemonSocket(path)) as url:
        quiet.open(url)
        quiet.until(f"{STATE} === 'live' && {TEXT}.includes('AIDING') && {TEXT}.includes('{GRID_ONLY}')")  # whichever comes last
        text = quiet.value(TEXT)
        for words in (
            "not trusted",
            "the camera sees the vehicle elsewhere",
            "the receiver reports spoofing",
            "± 12 m",
            "within the alert limits",
            "SENDING",
            "camera against map (deep)",
            "no fix: several places look alike",
            "ArduPilot 4.6.2, armed",
            "visloc: GNSS not trusted, camera says elsewhere",
            "47.400000, 8.550000",
        ):
            assert words in text, words
        assert not quiet.value("document.getElementById('problem').checkVisibility()")
        assert quiet.value("document.title") == "AIDING · visloc"
        quiet.until("document.getElementById('map').clientWidth > 300")


def test_rings_are_drawn_at_their_radii(quiet: Page, path: Path, tmp_path: Path) -> None:
    with daemon(path), dashboard(DaemonSocket(path)) as url:
        quiet.open(url)
        quiet.until(f"{STATE} === 'live'")
        quiet.until("new Promise(done => setTimeout(() => done(true), 500))")
        pixels, middle, per_metre = drawn(quiet, tmp_path)
    assert share_inked(pixels, middle, 12 * per_metre, INK) > 0.8, "the protection level of 12 m"
    assert share_inked(pixels, middle, 18 * per_metre, INK) < 0.3
    assert 0.4 < share_inked(pixels, middle, 40 * per_metre, (0x6A, 0x1B, 0x9A)) < 0.9, "the alert limit of 40 m, dashed"


def test_without_a_daemon_that_is_said_and_nothing_is_made_up(quiet: Page, path: Path) -> None:
    with dashboard(DaemonSocket(path)) as url:
        quiet.open(url)
        quiet.until(f"{TEXT}.includes('No daemon answers at {path}: there is no such socket.')")
        assert quiet.value(STATE) == "absent"
        assert quiet.value("document.querySelector('#mode strong').textContent") == "UNKNOWN"
        assert quiet.value("document.getElementById('place').textContent") == "not known"
        assert quiet.value("document.title") == "NO DATA · visloc"


def test_a_daemon_that_is_lost_is_not_shown_as_current_and_one_that_is_back_is(quiet: Page, path: Path) -> None:
    with dashboard(DaemonSocket(path)) as url:
        with daemon(path):
            quiet.open(url)
            quiet.until(f"{STATE} === 'live'")
        quiet.until(f"{STATE} === 'stale' && {TEXT}.includes('Last heard')")
        assert "line-through" in quiet.value("getComputedStyle(document.querySelector('#mode strong')).textDecorationLine")
        assert quiet.value("document.title") == "NO DATA · visloc"
        with daemon(path, mode="lost"):
            quiet.until(f"{STATE} === 'live' && document.querySelector('#mode strong').textContent === 'LOST'")


def test_a_server_that_is_gone_is_said_by_the_page_itself(page: Page, path: Path) -> None:
    with daemon(path):
        with dashboard(DaemonSocket(path)) as url:
            page.open(url)
            page.until(f"{STATE} === 'live'")
        page.until(f"{STATE} === 'stale' && {TEXT}.includes('server has not answered for')")


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (800, 1000), (360, 740)])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_fits_into_the_window_and_can_be_read(quiet: Page, path: Path, width: int, height: int, scheme: str) -> None:
    """No sideways scrolling, no text cut off, and contrasts of at least 4.5 : 1."""
    with daemon(path), dashboard(DaemonSocket(path)) as url:
        quiet.open(url, width, height, scheme)
        quiet.until(f"{STATE} === 'live'")
        assert quiet.value("document.documentElement.scrollWidth <= innerWidth")
        assert quiet.value(f"({CUT_OFF})()") == []
        assert quiet.value(f"({FAINT})()") == []


CUT_OFF = """() => [...document.querySelectorAll('.badge *, dd, dt, h2, li span, .banner')]
  .filter(e => e.checkVisibility() && e.scrollWidth > e.clientWidth + 1 && getComputedStyle(e).display !== 'inline')
  .map(e => e.textContent)"""
FAINT = """() => {
  const rgb = (text) => text.match(/[\\d.]+/g).map(Number);
  const light = ([r, g, b]) => [r, g, b].map(v => v / 255).map(v => v <= 0.04 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, k) => sum + v * [0.2126, 0.7152, 0.0722][k], 0);
  const behind = (e) => {
    for (; e; e = e.parentElement) {
      const c = rgb(getComputedStyle(e).backgroundColor);
      if (c.length === 3 || c[3] > 0.8) return c;
    }
    return [255, 255, 255];
  };
  const texts = '.badge *, dd, dt, h2, #health span, #notices span, time, footer, footer a, .key span, button, summary';
  return [...document.querySelectorAll(texts)]
    .filter(e => e.checkVisibility() && e.textContent.trim())
    .map(e => [e.textContent, light(rgb(getComputedStyle(e).color)), light(behind(e))])
    .filter(([, a, b]) => (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05) < 4.5);
}"""


def test_the_map_lies_under_the_vehicle_and_can_be_panned_and_followed(
    quiet: Page, path: Path, tmp_path: Path, tiny_pack: Path
) -> None:
    pictures = MapPictures(tiny_pack)
    places = pictures.description()["places"]
    lat_deg, lon_deg = places[len(places) // 2]
    here = {"lat_deg": lat_deg, "lon_deg": lon_deg, "h_amsl_m": 400.0}
    with daemon(path, place=here), dashboard(DaemonSocket(path), pictures) as url:
        quiet.open(url)
        quiet.until(f"{STATE} === 'live' && performance.getEntriesByType('resource').some(e => e.name.endsWith('.webp'))")
        quiet.until("new Promise(done => setTimeout(() => done(true), 1000))")
        pixels, (x, y), per_metre = drawn(quiet, tmp_path)
        east, west = (pixels[round(y + 60 * per_metre), round(x + side * 20 * per_metre)] for side in (1, -1))
        assert east[0] > 150 and west[2] > 150, "east of the middle the map is red, west of it blue"
        assert not quiet.value("document.getElementById('map-note').checkVisibility()")
        for name, dx in (("mousePressed", 0), ("mouseMoved", 120), ("mouseReleased", 120)):
            quiet.call("Input.dispatchMouseEvent", type=name, x=400 + dx, y=400, button="left", buttons=1, clickCount=1)
        quiet.until("document.getElementById('follow').getAttribute('aria-pressed') === 'false'")
        quiet.value("document.getElementById('follow').click()")
        assert quiet.value("document.getElementById('follow').getAttribute('aria-pressed')") == "true"


@pytest.fixture(scope="module")
def tiny_pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """600 x 600 m, the west half blue, the east half red."""
    from visloc_companion.prepare.build import build_pack
    from visloc_companion.sim.scene import Scene

    folder = tmp_path_factory.mktemp("map")
    pixels = np.zeros((600, 600, 3), np.uint8)
    pixels[:, :300, 2] = pixels[:, 300:, 0] = 220
    T_map_pix = np.array([[1.0, 0.0, 500_000.0], [0.0, -1.0, 5_250_000.0]])
    ortho, dsm = Scene(pixels, np.full((600, 600), 300.0, np.float32), T_map_pix, "EPSG:32632").save(folder)
    build_pack([ortho], dsm, folder / "pack", capture_date="2026-01-01")
    return folder / "pack"


def test_a_recording_says_on_the_page_that_it_is_one(quiet: Page, tmp_path: Path) -> None:
    from visloc_companion.app.journal import JournalHeader, JournalWriter
    from visloc_companion.app.serialise import from_dict

    journal = tmp_path / "flight.mcap"
    writer = JournalWriter(journal.open("xb"), JournalHeader({}), path=journal)
    for k in range(400):
        said = snapshot(k / 10)
        writer.command(said["t_ns"], from_dict(said["status"]))  # type: ignore[arg-type]
    writer.close()
    with dashboard(Recording(journal, 2.0)) as url:
        quiet.open(url)
        quiet.until(f"{TEXT}.includes('RECORDING of flight.mcap, 2 × real time: not what happens now')")
        quiet.until(f"{TEXT}.includes('AIDING')")
        assert quiet.value("document.title").startswith("recording · ")


def test_names_without_blanks_are_not_wider_than_the_window(quiet: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    """A path, a build's version and an operator's notice as long as they may be: at 320 px the page was 607 wide."""
    problem = "/var/lib/visloc/visloc-20260714T103000Z.mcap/cannot/be/written"
    monkeypatch.setitem(SNAPSHOT, "journal", {"dropped": 0, "problem": problem})
    monkeypatch.setitem(SNAPSHOT, "notices", [{"severity": "critical", "text": f"visloc:{'x' * 43}", "age_s": 3.0}])
    monkeypatch.setitem(SNAPSHOT, "autopilot", {"kind": "px4", "version": f"1.17.0-{'x' * 30}", "armed": True})
    with tempfile.TemporaryDirectory() as folder:  # that of pytest is as long as a socket's path may be
        path = Path(folder, "s" * 40)
        with daemon(path), dashboard(DaemonSocket(path)) as url:
            for width in (320, 768, 1440):
                quiet.open(url, width=width)
                quiet.until(f"{STATE} == 'live' && {TEXT}.includes('cannot/be/written')")
                assert quiet.value("document.documentElement.scrollWidth") == width


def test_a_screen_reader_is_told_once_and_not_every_second(quiet: Page, path: Path) -> None:
    spoken = "document.getElementById('spoken').textContent"
    with dashboard(DaemonSocket(path)) as url:
        with daemon(path):
            quiet.open(url)
            quiet.until(f"{STATE} == 'live'")
            assert quiet.value(spoken) == ""
        quiet.until(f"{STATE} == 'stale'")
        quiet.value(
            "window.told = 0; new MutationObserver(() => window.told++).observe(document.getElementById('spoken'),"
            "{ childList: true, characterData: true, subtree: true }); 0"
        )
        first = quiet.value("document.getElementById('problem').textContent")
        quiet.until(f"document.getElementById('problem').textContent != {first!r}")
        assert "Last heard a while ago" in quiet.value(spoken)
        assert quiet.value("window.told") == 0


@contextmanager
def under_a_prefix(url: str, prefix: bytes) -> Iterator[str]:
    """A reverse proxy as nginx's `location PREFIX/ { proxy_pass URL/; }`; what is asked for beside the prefix is 404."""
    host, port = url.removeprefix("http://").rstrip("/").split(":")
    serving = set[asyncio.Task[None] | None]()

    async def passed_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        serving.add(asyncio.current_task())
        with closing(writer), suppress(OSError, asyncio.IncompleteReadError, asyncio.CancelledError):  # the browser left
            method, path, rest = (await reader.readuntil(b"\r\n\r\n")).split(b" ", 2)
            if not path.startswith(prefix + b"/"):
                writer.write(b"HTTP/1.1 404 Not Found\r\ncontent-length: 0\r\nconnection: close\r\n\r\n")
                return
            version, *lines = rest.split(b"\r\n")
            lines = [version, b"connection: close", *(line for line in lines if not line.lower().startswith(b"connection:"))]
            answer, asked = await asyncio.open_connection(host, int(port))
            with closing(asked):
                asked.write(b" ".join([method, path.removeprefix(prefix), b"\r\n".join(lines)]))
                while part := await answer.read(65536):
                    writer.write(part)
                    await writer.drain()

    ready = Future[int]()

    async def run(stop: asyncio.Event) -> None:
        async with await asyncio.start_server(passed_on, "127.0.0.1", 0) as server:
            ready.set_result(server.sockets[0].getsockname()[1])
            await stop.wait()
            server.close()
            for task in serving - {None}:  # from Python 3.12 on the server waits for them
                task.cancel()
            await asyncio.gather(*serving, return_exceptions=True)

    with in_thread(run):
        yield f"http://127.0.0.1:{ready.result(10)}{prefix.decode()}/"


def test_behind_a_proxys_prefix_it_is_whole(quiet: Page, tmp_path: Path) -> None:
    """Several vehicles under one address: style, stream, map and links are those below the prefix."""
    with daemon(tmp_path / "s"), dashboard(DaemonSocket(tmp_path / "s")) as url, under_a_prefix(url, b"/drone1") as outside:
        quiet.open(outside)
        quiet.until(f"{STATE} === 'live'")
        assert quiet.value("getComputedStyle(document.querySelector('main')).display") == "grid"
        links = quiet.value(
            "[...document.querySelectorAll('a, link, script')].map(one => one.href ?? one.src).filter(one => one)"
        )
        assert [link for link in links if not link.startswith(outside)] == []
        quiet.open("about:blank")  # a proxy that ends breaks the stream off
        quiet.until("location.href === 'about:blank'")
