"""What every answer is fenced in by: the names that this server answers to, and headers that let nothing foreign in or out."""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Iterable

from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

CSP = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "content-security-policy": CSP,
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
}


def is_loopback(host: str) -> bool:
    """Whether an address or name is this computer only."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def own_names(host: str, names: Iterable[str] = ()) -> frozenset[str]:
    """Names that a browser may ask for: localhost, those given, and, on a network, the computer's own (also as NAME.local)."""
    own = {"localhost", *names}
    if not is_loopback(host):
        own |= {host, socket.gethostname(), f"{socket.gethostname()}.local"}
    return frozenset(name.lower().rstrip(".") for name in own)


def is_own(host_header: str, names: frozenset[str]) -> bool:
    """Whether a Host header means this server. Addresses do: a foreign page that rebinds its own name asks for that name."""
    host = host_header.strip().lower()
    if host.startswith("["):
        host, _, port = host[1:].partition("]")
        port = port.removeprefix(":")
    else:
        host, _, port = host.partition(":")
    if port and not (port.isascii() and port.isdigit()):
        return False
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return host.rstrip(".") in names
    return True


class Guard:
    """ASGI middleware: refuses foreign Host headers (421), and adds HEADERS to every answer."""

    def __init__(self, app: ASGIApp, names: frozenset[str]) -> None:
        self._app, self._names = app, names

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or pass on."""
        if scope["type"] != "http":
            return

        async def fenced(message: Message) -> None:
            if message["type"] == "http.response.start":
                given = list(message["headers"])
                message = {**message, "headers": [*given, *((k.encode(), v.encode()) for k, v in HEADERS.items())]}
            await send(message)

        hosts = [value.decode("latin-1") for name, value in scope["headers"] if name == b"host"]
        if len(hosts) != 1 or not is_own(hosts[0], self._names):
            words = "This server does not answer to that name; start it with --name NAME, or ask for its address.\n"
            await PlainTextResponse(words, 421)(scope, receive, fenced)
            return
        await self._app(scope, receive, fenced)
