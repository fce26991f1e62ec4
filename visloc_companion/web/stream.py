"""The stream of views (server-sent events). A client that does not read is dropped."""

from __future__ import annotations

import asyncio

from starlette.types import Receive, Scope, Send

from visloc_companion.web.feed import Feed

SEND_S = 5.0
"""A view that a client has not taken for so long ends its stream."""
HEADERS = [
    (b"content-type", b"text/event-stream; charset=utf-8"),
    (b"cache-control", b"no-store"),
    (b"x-accel-buffering", b"no"),
]
"""A proxy that collects some pages of views would show the past: nginx reads the last one."""
BUSY = b"as many browsers look at this page as may; close one\n"


class EventStream:
    """ASGI response: the history first, then every view until the client or the server ends."""

    def __init__(self, feed: Feed) -> None:
        self._feed = feed

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one client; who asks for the head alone gets that, and takes no browser's place."""
        if scope["method"] == "HEAD":
            await send({"type": "http.response.start", "status": 200, "headers": HEADERS})
            await send({"type": "http.response.body", "body": b""})
            return
        with self._feed.stream() as admitted:
            if not admitted:
                head = [(b"content-type", b"text/plain; charset=utf-8"), (b"retry-after", b"5")]
                await send({"type": "http.response.start", "status": 503, "headers": head})
                await send({"type": "http.response.body", "body": BUSY})
                return
            await send({"type": "http.response.start", "status": 200, "headers": HEADERS})
            serving = asyncio.create_task(self._serve(send))
            gone = asyncio.create_task(_disconnected(receive))
            try:
                await asyncio.wait({serving, gone}, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for task in (serving, gone):
                    task.cancel()
                await asyncio.gather(serving, gone, return_exceptions=True)

    async def _serve(self, send: Send) -> None:
        message: bytes | None = self._feed.history_message()
        while message is not None:
            try:
                async with asyncio.timeout(SEND_S):
                    await send({"type": "http.response.body", "body": message, "more_body": True})
            except OSError:  # TimeoutError, too
                return
            message = await self._feed.next_message()
        await send({"type": "http.response.body", "body": b"", "more_body": False})


async def _disconnected(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass
