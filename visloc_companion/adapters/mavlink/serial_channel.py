"""Bytes over a serial line on the running asyncio loop: pyserial opens and configures it, the loop watches its descriptor.

What waits for a line that cannot follow, here and in the driver, would each be later than the one before, up to many seconds, and
nobody downstream can tell: ArduPilot takes what is older than its filter's horizon for younger.
"""

from __future__ import annotations

import asyncio
import os
import termios

import serial

from visloc_companion.adapters.mavlink.channels import Address, Listener
from visloc_companion.adapters.mavlink.endpoint import Endpoint

_READ_BYTES = 4096
MAX_WAIT_S = 0.2
"""No packet is sent behind more than the line carries in this time: PX4 drops what is older (EKF2_DELAY_MAX)."""
_BITS_A_BYTE = 10
"""With start and stop."""


class SerialChannel:
    """An open serial line. Raises OSError (serial.SerialException is one) where it cannot be opened."""

    port: int | None = None

    def __init__(self, endpoint: Endpoint, listener: Listener) -> None:
        self.dropped = self.overflowed = 0
        self._listener = listener
        self._unsent = bytearray()
        self._most_bytes = endpoint.number / _BITS_A_BYTE * MAX_WAIT_S
        self._loop = asyncio.get_running_loop()
        try:
            self._serial = serial.Serial(endpoint.place, endpoint.number, timeout=0, exclusive=True)
        except (termios.error, ValueError) as why:  # it went while it was being set up, or has no such baud rate
            raise OSError(f"{endpoint.place} cannot be set up: {why}") from why
        self._fd: int | None = self._serial.fileno()
        self._loop.add_reader(self._fd, self._readable)

    def write(self, packets: list[bytes]) -> None:
        """Send packets, or drop them where the line cannot follow."""
        for packet in packets:
            if self._fd is None:
                self.dropped += 1
            elif len(self._unsent) + self._in_driver() > self._most_bytes:
                self.dropped += 1
                self.overflowed += 1
            else:
                self._unsent += packet
                self._writable()

    def speak_to(self, source: Address | None) -> None:
        """There is one other side only."""

    def close(self) -> None:
        """Release the port."""
        if self._fd is not None:
            self._loop.remove_reader(self._fd)
            self._loop.remove_writer(self._fd)
            self._fd = None
            self._serial.close()

    def _readable(self) -> None:
        assert self._fd is not None
        try:
            data = os.read(self._fd, _READ_BYTES)
        except BlockingIOError:
            return
        except OSError as why:
            self._lost(str(why))
            return
        if data:
            self._listener.on_data(data, None)
        else:
            self._lost("the device is gone")

    def _in_driver(self) -> int:
        """Bytes that the driver has taken and not sent yet; 0 where it does not tell."""
        try:
            return int(self._serial.out_waiting)
        except OSError:
            return 0

    def _writable(self) -> None:
        if self._fd is None or not self._unsent:
            return
        try:
            written = os.write(self._fd, self._unsent)
        except BlockingIOError:
            written = 0
        except OSError as why:
            self._lost(str(why))
            return
        del self._unsent[:written]
        if self._unsent:
            self._loop.add_writer(self._fd, self._writable)
        else:
            self._loop.remove_writer(self._fd)

    def _lost(self, why: str) -> None:
        self.close()
        self._listener.on_lost(why)
