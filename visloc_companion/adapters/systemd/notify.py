"""systemd's notification protocol (sd_notify(3)): one datagram to the socket that NOTIFY_SOCKET names."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping


class Notifier:
    """Tells systemd how the service is. Without NOTIFY_SOCKET every call does nothing and returns False."""

    def __init__(self, environment: Mapping[str, str] | None = None) -> None:
        environment = os.environ if environment is None else environment
        self._address = _address(environment.get("NOTIFY_SOCKET", ""))
        self.watchdog_s = _watchdog_s(environment)

    def ready(self) -> bool:
        """Start-up is done."""
        return self._send("READY=1")

    def stopping(self) -> bool:
        """Shutting down."""
        return self._send("STOPPING=1")

    def watchdog(self) -> bool:
        """The beat that keeps systemd from restarting the service; due at least every `watchdog_s`."""
        return self._send("WATCHDOG=1")

    def status(self, text: str) -> bool:
        """One line for `systemctl status`."""
        return self._send("STATUS=" + " ".join(text.splitlines()))

    def _send(self, message: str) -> bool:
        if self._address is None:
            return False
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
                sender.setblocking(False)
                sender.sendto(message.encode(), self._address)
        except OSError:
            return False  # systemd is busy or gone, or no descriptor is left: the next beat comes soon
        return True


def _address(name: str) -> str | None:
    """Path or abstract address (leading @) of the socket; other kinds (vsock) are not for services on one machine."""
    if name.startswith("@"):
        return "\0" + name[1:]
    return name if name.startswith("/") else None


def _watchdog_s(environment: Mapping[str, str]) -> float | None:
    """Seconds within which a beat is due (WATCHDOG_USEC), None where no watchdog runs or it is another process's."""
    if environment.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return None
    text = environment.get("WATCHDOG_USEC", "")
    return int(text) / 1e6 if text.isdecimal() and int(text) > 0 else None
