"""Asks an ASGI application as a browser would, without a socket."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from starlette.types import ASGIApp, Message

from visloc_companion.web.source import NoAnswer
from visloc_companion.web.view import Origin


@dataclass(frozen=True)
class Answer:
    status: int
    headers: dict[str, str]
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)


async def ask(app: ASGIApp, path: str, *, method: str = "GET", host: str = "127.0.0.1:8480") -> Answer:
    scope = {
        "type": "http",
        "asgi": {"version": "3.0", "spec_version": "2.3"},
        "http_version": "1.1",
        "method": method,
        "scheme": "http",
        "path": path,
        "raw_path": path.encode(),
        "query_string": b"",
        "root_path": "",
        "headers": [(b"host", host.encode())],
        "client": ("127.0.0.1", 5),
        "server": ("127.0.0.1", 8480),
    }
    got: list[Message] = []

    async def receive() -> Message:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: Message) -> None:
        got.append(message)

    await app(scope, receive, send)
    headers = {name.decode(): value.decode() for name, value in got[0]["headers"]}
    return Answer(got[0]["status"], headers, b"".join(message["body"] for message in got[1:]))


class Said:
    """A source that says what the test says; an exception's text where it says one."""

    def __init__(self, *says: dict[str, Any] | str, recording: bool = False) -> None:
        self.says, self.asked = list(says), 0
        self.origin = Origin("said", 2.0 if recording else None)

    async def ask(self) -> dict[str, Any]:
        said = self.says[min(self.asked, len(self.says) - 1)]
        self.asked += 1
        if isinstance(said, str):
            raise NoAnswer(said)
        return said
