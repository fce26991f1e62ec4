"""The routes. All of them read; none changes anything."""

from __future__ import annotations

import asyncio
import json
from concurrent.futures import ThreadPoolExecutor
from importlib import resources
from typing import TYPE_CHECKING, Any

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from visloc_companion.errors import OutsideMap
from visloc_companion.web.feed import Feed
from visloc_companion.web.guard import Guard
from visloc_companion.web.metrics import metrics_text
from visloc_companion.web.stream import EventStream

if TYPE_CHECKING:  # without a map none of its libraries is loaded
    from visloc_companion.web.pictures import MapPictures

INDEX = "index.html"
MEDIA = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
TILES_WAITING = 32
NO_STORE = {"cache-control": "no-store"}
FOR_GOOD = {"cache-control": "private, max-age=86400, immutable"}
"""A tile's address names the pack, so it never changes."""
PROMETHEUS = "text/plain; version=0.0.4; charset=utf-8"


def page_files() -> dict[str, bytes]:
    """The page's own files by name, as the wheel holds them."""
    folder = resources.files("visloc_companion.web") / "page"
    return {file.name: file.read_bytes() for file in folder.iterdir() if file.name.rpartition(".")[2] in MEDIA}


def application(feed: Feed, pictures: MapPictures | None, names: frozenset[str], map_problem: str = "") -> Starlette:
    """The ASGI application. `map_problem` is what the page says where a map was configured and cannot be opened."""
    files, tiles = page_files(), None if pictures is None else _Tiles(pictures)

    async def page(request: Request) -> Response:
        name = request.path_params.get("name", INDEX)
        if name not in files or request.path_params.get("name") == INDEX:  # its addresses are relative to "/"
            return PlainTextResponse("there is no such file\n", 404)
        return Response(files[name], headers={"cache-control": "no-cache"}, media_type=MEDIA[name.rpartition(".")[2]])

    async def status(_: Request) -> Response:
        return _json(feed.view())

    async def metrics(_: Request) -> Response:
        if feed.recording:
            return PlainTextResponse("a recording has no metrics\n", 404)
        return Response(metrics_text(feed.view(), feed.streams), headers={**NO_STORE, "content-type": PROMETHEUS})

    async def chart(_: Request) -> Response:
        found: dict[str, Any] | None = None if pictures is None else pictures.description()
        return _json({"map": found, "problem": map_problem})

    async def tile(request: Request) -> Response:
        asked = request.path_params
        if tiles is None or asked["identity"] != tiles.identity:
            return PlainTextResponse("there is no such map\n", 404)
        return await tiles.answer(asked["level"], asked["col"], asked["row"])

    routes = [
        Route("/", page),
        Route("/page/{name}", page),
        Route("/api/status", status),
        Route("/api/stream", EventStream(feed), methods=["GET"]),
        Route("/api/map", chart),
        Route("/api/map/{identity}/{level:int}/{col:int}/{row:int}.webp", tile),
        Route("/metrics", metrics),
    ]
    return Starlette(routes=routes, middleware=[Middleware(Guard, names=names)])


def _json(data: dict[str, Any]) -> Response:
    """As the stream writes it, in ASCII: names of files that are no UTF-8 have no other form."""
    return Response(json.dumps(data, allow_nan=False), headers=NO_STORE, media_type="application/json")


class _Tiles:
    """Renders tiles one at a time in a thread of its own: the files may not be read by two, and the daemon needs the cores."""

    def __init__(self, pictures: MapPictures) -> None:
        self.identity = pictures.identity
        self._pictures, self._waiting = pictures, 0
        self._thread = ThreadPoolExecutor(1, "tiles")

    async def answer(self, level: int, col: int, row: int) -> Response:
        """The tile; 404 where there is none such, 503 where too many wait."""
        if self._waiting >= TILES_WAITING:
            return PlainTextResponse("too many tiles are asked for\n", 503, {"retry-after": "2"})
        self._waiting += 1
        try:
            loop = asyncio.get_running_loop()
            data = await loop.run_in_executor(self._thread, self._pictures.tile, level, col, row)
        except OutsideMap as why:
            return PlainTextResponse(f"{why}\n", 404)
        finally:
            self._waiting -= 1
        return Response(data, headers=FOR_GOOD, media_type="image/webp")
