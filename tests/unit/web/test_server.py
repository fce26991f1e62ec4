"""The routes: what they give, that they only read, and what fences them in."""

from __future__ import annotations

import asyncio
import json
import re

import cv2
import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families
from starlette.applications import Starlette

from tests.unit.web.asking import Said, ask
from tests.unit.web.snapshots import snapshot
from visloc_companion.web.feed import Feed
from visloc_companion.web.guard import HEADERS, is_own, own_names
from visloc_companion.web.server import application, page_files

NAMES = own_names("127.0.0.1")
ROUTES = ("/", "/page/main.js", "/api/status", "/api/map", "/metrics", "/nothing", "/page/none.js")


async def served(*says: dict[str, object] | str, recording: bool = False) -> Starlette:
    feed = Feed(Said(*says, recording=recording))
    await feed.round()
    return application(feed, None, NAMES)


async def test_the_status_is_the_view_as_json() -> None:
    answer = await ask(await served(snapshot()), "/api/status")
    assert answer.status == 200
    assert answer.headers["cache-control"] == "no-store"
    assert answer.json["mode"]["name"] == "aiding"
    assert answer.json["state"] == "live"


async def test_names_that_are_no_utf_8_are_told() -> None:
    feed = Feed(Said("No daemon answers at /caf\udce9/s."))
    await feed.round()
    app = application(feed, None, NAMES, "/caf\udce9/pack: there is no such file")
    assert (await ask(app, "/api/status")).json["says"] == "No daemon answers at /caf\udce9/s."
    assert (await ask(app, "/api/map")).json["problem"] == "/caf\udce9/pack: there is no such file"


async def test_every_answer_is_fenced_in() -> None:
    app = await served(snapshot())
    for path in ROUTES:
        answer = await ask(app, path)
        assert {name: answer.headers.get(name) for name in HEADERS} == HEADERS, path
        assert not [name for name in answer.headers if name.startswith("access-control")], path
    assert "unsafe" not in HEADERS["content-security-policy"]
    assert "http" not in HEADERS["content-security-policy"]


async def test_nothing_can_be_changed() -> None:
    app = await served(snapshot())
    for path in ("/", "/page/main.js", "/api/status", "/api/stream", "/api/map", "/metrics", "/api/map/x/0/0/0.webp"):
        for method in ("POST", "PUT", "PATCH", "DELETE", "OPTIONS"):
            assert (await ask(app, path, method=method)).status == 405, (method, path)


async def test_the_head_of_the_stream_ends_and_takes_no_browsers_place() -> None:
    """`curl -I` hung, and sixteen of them shut all browsers out."""
    feed = Feed(Said(snapshot()), max_streams=0)
    answer = await asyncio.wait_for(ask(application(feed, None, NAMES), "/api/stream", method="HEAD"), 5)
    assert (answer.status, answer.headers["content-type"], answer.body) == (200, "text/event-stream; charset=utf-8", b"")
    assert answer.headers["cache-control"] == "no-store"


async def test_a_foreign_name_is_refused_before_anything_is_told() -> None:
    app = await served(snapshot())
    for host in ("evil.example", "evil.example:8480", "127.0.0.1.evil.example", "localhost.evil.example", "", "a:b"):
        answer = await ask(app, "/api/status", host=host)
        assert answer.status == 421, host
        assert b"47.4" not in answer.body
        assert answer.headers["content-security-policy"] == HEADERS["content-security-policy"]


@pytest.mark.parametrize(
    "host", ["localhost", "LOCALHOST:8480", "127.0.0.1:8480", "[::1]:8480", "192.168.1.20:9000", "localhost."]
)
def test_own_names_and_addresses_are_answered(host: str) -> None:
    assert is_own(host, NAMES)


def test_on_a_network_the_computers_own_name_is_answered_and_on_loopback_it_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("socket.gethostname", lambda: "drone7")
    assert is_own("drone7.local:8480", own_names("0.0.0.0"))
    assert not is_own("drone7.local:8480", own_names("127.0.0.1"))
    assert is_own("companion.lan", own_names("127.0.0.1", ["companion.lan"]))


async def test_only_the_pages_own_files_are_served() -> None:
    app = await served(snapshot())
    for path in (
        "/page/..%2fserver.py",
        "/page/../server.py",
        "/page/%2e%2e/feed.py",
        "/page/",
        "/server.py",
        "/page/__init__.py",
        "/page/index.html",
    ):
        assert (await ask(app, path)).status == 404, path


def test_the_page_asks_for_nothing_from_elsewhere_and_holds_no_script_of_its_own() -> None:
    files = {name: data.decode() for name, data in page_files().items()}
    assert {"index.html", "main.js", "page.css", "icon.svg"} <= set(files)
    for name, text in files.items():
        assert not re.findall(r"(?:https?:)?//[a-z]", text.replace("http://www.w3.org/2000/svg", "")), name
    assert not re.findall(r"<script(?![^>]*src=)|<style|style=|\son\w+=", files["index.html"])
    named = re.findall(r'(?:src|href)="page/([\w.]+)"', files["index.html"]) + [
        part for name, text in files.items() if name.endswith(".js") for part in re.findall(r'from "\./([\w.]+)"', text)
    ]
    assert set(named) <= set(files)
    assert {name for name in files if name != "index.html"} == set(named)


def test_all_that_the_page_asks_for_is_relative() -> None:
    """Behind a proxy's prefix "/" is another place than the page's."""
    for name, data in page_files().items():
        assert not re.findall(r"""(?:["'`]|url\()/\w+""", data.decode()), name


async def test_metrics_are_what_prometheus_reads() -> None:
    answer = await ask(await served(snapshot()), "/metrics")
    assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    found = {
        (sample.name, *sample.labels.values()): sample.value
        for family in text_string_to_metric_families(answer.body.decode())
        for sample in family.samples
    }
    assert found[("visloc_up",)] == 1
    assert found[("visloc_mode", "aiding")] == 1
    assert found[("visloc_mode", "lost")] == 0
    assert found[("visloc_gnss_verdict", "suspect")] == 1
    assert found[("visloc_protection_level_meters",)] == 12.0
    assert found[("visloc_injections_total",)] == 321
    assert found[("visloc_line_left_out_total",)] == 7
    assert found[("visloc_fix_age_seconds",)] == pytest.approx(0.8, abs=0.1)
    assert found[("visloc_part_healthy", "camera")] == 1


async def test_metrics_of_a_daemon_that_does_not_answer_state_nothing_old() -> None:
    feed = Feed(Said(snapshot(), "No daemon answers."), clock_s=iter([0.0, 0.0, 60.0, 60.0, 60.0]).__next__)
    await feed.round()
    await feed.round()
    answer = await ask(application(feed, None, NAMES), "/metrics")
    lines = [line for line in answer.body.decode().splitlines() if not line.startswith("#")]
    assert lines == ["visloc_up 0.0", "visloc_web_streams 0.0"]


async def test_a_recording_has_no_metrics() -> None:
    assert (await ask(await served(snapshot(), recording=True), "/metrics")).status == 404


async def test_without_a_map_that_is_said_and_no_tile_is_there() -> None:
    feed = Feed(Said(snapshot()))
    app = application(feed, None, NAMES, "pack: is damaged")
    assert (await ask(app, "/api/map")).json == {"map": None, "problem": "pack: is damaged"}
    assert (await ask(app, "/api/map/abc/0/0/0.webp")).status == 404


class Checkered:
    """Pictures of no pack: one tile, and a fault behind the next."""

    identity = "abc"

    def description(self) -> dict[str, object]:
        return {"identity": self.identity}

    def tile(self, level: int, col: int, row: int) -> bytes:
        from visloc_companion.errors import OutsideMap

        if (level, col, row) != (0, 0, 0):
            raise OutsideMap("no such tile")
        return cv2.imencode(".webp", np.zeros((4, 4, 3), np.uint8))[1].tobytes()


async def test_tiles_may_be_kept_for_good_because_their_address_names_the_pack() -> None:
    app = application(Feed(Said(snapshot())), Checkered(), NAMES)  # type: ignore[arg-type]
    tile = await ask(app, "/api/map/abc/0/0/0.webp")
    assert (tile.status, tile.headers["content-type"]) == (200, "image/webp")
    assert "immutable" in tile.headers["cache-control"]
    assert (await ask(app, "/api/map/other/0/0/0.webp")).status == 404
    assert (await ask(app, "/api/map/abc/0/1/0.webp")).status == 404
    assert (await ask(app, "/api/map/abc/0/-1/0.webp")).status == 404
    assert json.loads((await ask(app, "/api/map")).body)["map"] == {"identity": "abc"}
