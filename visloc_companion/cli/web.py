"""`visloc web`: the dashboard."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from visloc_companion.errors import ConfigError, MapError

if TYPE_CHECKING:
    from visloc_companion.web.pictures import MapPictures
    from visloc_companion.web.source import Source

SOCKET = Path("/run/visloc/status.sock")


def web(
    status_socket: Annotated[
        Path | None, typer.Option("--socket", metavar="PATH", help=f"The daemon's status socket; else {SOCKET}.")
    ] = None,
    config: Annotated[Path | None, typer.Option("--config", help="The daemon's configuration: names socket and map.")] = None,
    map_pack: Annotated[
        Path | None, typer.Option("--map", help="Map pack; else that of --config or --journal, or a grid.")
    ] = None,
    host: Annotated[str, typer.Option("--host", help="Address to listen on; 0.0.0.0 is the whole network.")] = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", min=1, max=65535, help="TCP port.")] = 8480,
    name: Annotated[
        list[str] | None, typer.Option("--name", metavar="NAME", help="Answer to this host name, too; may be repeated.")
    ] = None,
    journal: Annotated[Path | None, typer.Option("--journal", metavar="FILE", help="Show a recorded flight instead.")] = None,
    speed: Annotated[float, typer.Option("--speed", min=0.1, max=50.0, help="Of --journal: times as fast as flown.")] = 1.0,
) -> None:
    """Show the daemon's state on a page, until SIGTERM or Ctrl-C. Exit codes: 0 ok, 2 usage, 3 data."""
    from visloc_companion.web.extra import require_web

    require_web()
    import asyncio
    import signal

    from visloc_companion.web.feed import Feed
    from visloc_companion.web.guard import is_loopback, own_names
    from visloc_companion.web.serve import listening, serve
    from visloc_companion.web.server import application

    if journal is not None and (status_socket is not None or config is not None):
        raise ConfigError("shows a recorded flight", where="--journal", remedy="leave --socket and --config out")
    if journal is None and speed != 1.0:
        raise ConfigError("is of a recorded flight", where="--speed", remedy="give it with --journal")
    source, pack = _live(status_socket, config) if journal is None else _recorded(journal, speed)
    pictures, problem = _pictures(map_pack, pack)

    async def run() -> None:
        feed = Feed(source)
        app = application(feed, pictures, own_names(host, name or ()), problem)
        stop = asyncio.Event()
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            if signal.getsignal(number) is not signal.SIG_IGN:  # nohup
                asyncio.get_running_loop().add_signal_handler(number, stop.set)
        _say(host, port, source.origin.name, open_to_all=not is_loopback(host))
        await serve(feed, app, listener, stop)

    with listening(host, port) as listener:
        asyncio.run(run())


def _live(status_socket: Path | None, config: Path | None) -> tuple[Source, Path | None]:
    from visloc_companion.config import load_config
    from visloc_companion.web.daemon_socket import DaemonSocket

    settings = None if config is None else load_config(config)
    if status_socket is None and settings is not None and not settings.status.socket:
        raise ConfigError(
            "status.socket is empty: the daemon tells nothing", where=str(config), remedy=f'set status.socket = "{SOCKET}"'
        )
    path = status_socket or (SOCKET if settings is None else Path(settings.status.socket))
    return DaemonSocket(path), Path(settings.map.pack) if settings is not None and settings.map.pack else None


def _recorded(journal: Path, speed: float) -> tuple[Source, Path | None]:
    """The flight, and the pack that it was flown with, wherever that was."""
    from visloc_companion.app.journal import header_left
    from visloc_companion.web.reading import part, text
    from visloc_companion.web.recording import Recording

    pack = text(part(header_left(journal).configuration, "map").get("pack"))
    return Recording(journal, speed), Path(pack) if pack else None


def _pictures(asked: Path | None, configured: Path | None) -> tuple[MapPictures | None, str]:
    """The map that is asked for, or that of the flight; without the latter there is still a page."""
    pack = asked or configured
    if pack is None:
        return None, ""
    from visloc_companion.web.pictures import MapPictures

    try:
        return MapPictures(pack), ""
    except MapError as why:
        if asked is not None:
            raise
        sys.stderr.write(f"warning: no map is shown: {why}\n")
        return None, str(why)


def _say(host: str, port: int, shown: str, *, open_to_all: bool) -> None:
    shown_host = f"[{host}]" if ":" in host else host
    sys.stderr.write(f"{shown} at http://{shown_host}:{port}/ (Ctrl-C ends it)\n")
    if open_to_all:
        sys.stderr.write("warning: anyone on that network sees where the vehicle is; there is no password (docs/dashboard.md)\n")
