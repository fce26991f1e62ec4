"""Where snapshots come from."""

from __future__ import annotations

from typing import Any, Protocol

from visloc_companion.web.view import Origin


class NoAnswer(Exception):
    """There is no snapshot now; the text says why, as a sentence for the page."""


class Source(Protocol):
    """daemon_socket.DaemonSocket, or recording.Recording."""

    @property
    def origin(self) -> Origin:
        """What the page names."""

    async def ask(self) -> dict[str, Any]:
        """The newest snapshot (the daemon's shape: app/live.py). Raises NoAnswer."""
