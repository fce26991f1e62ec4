"""A serial line that cannot follow, or breaks while it is written to (a pseudo-terminal stands in)."""

import asyncio
import errno
import os
import termios
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from visloc_companion.adapters.mavlink import serial_channel
from visloc_companion.adapters.mavlink.channels import Listener
from visloc_companion.adapters.mavlink.endpoint import Endpoint, EndpointKind
from visloc_companion.adapters.mavlink.pymavlink_link import PymavlinkLink
from visloc_companion.adapters.mavlink.serial_channel import MAX_WAIT_S, SerialChannel
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.app.clock import MonotonicClock


@pytest.fixture
def line() -> Iterator[tuple[int, str]]:
    controller, device = os.openpty()
    tty.setraw(device)
    os.set_blocking(controller, False)
    yield controller, os.ttyname(device)
    os.close(device)
    os.close(controller)


def open_line(name: str, lost: list[str], baud: int = 921600) -> SerialChannel:
    return SerialChannel(
        Endpoint(EndpointKind.SERIAL, name, baud),
        Listener(lambda _data, _source: None, lost.append, lambda: False, lost.append),
    )


def descriptors() -> int:
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


async def test_what_does_not_fit_waits_then_is_dropped_whole(line):
    controller, name = line
    channel = open_line(name, [])
    packets = [i.to_bytes(4, "big") * 25 for i in range(2000)]
    for packet in packets:
        channel.write([packet])
    assert channel.dropped > 0
    got = bytearray()
    while len(got) < 100 * (len(packets) - channel.dropped):
        try:
            got += os.read(controller, 65536)
        except BlockingIOError:
            await asyncio.sleep(0.001)
    numbers = [int.from_bytes(got[at : at + 4], "big") for at in range(0, len(got), 100)]
    assert bytes(got) == b"".join(packets[number] for number in numbers)
    assert numbers == sorted(set(numbers))
    assert len(got) >= 921600 / 10 * MAX_WAIT_S
    channel.close()
    channel.write([b"late"])
    channel.close()


class SlowLine:
    """A driver with 4 kB of its own, and a line of 57600 baud that carries what is in it as time goes by."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.driver, self.came = bytearray(), bytearray()
        monkeypatch.setattr(serial_channel.os, "write", self._write)
        monkeypatch.setattr(serial_channel.serial.Serial, "out_waiting", property(lambda _: len(self.driver)))

    def _write(self, _descriptor: int, data: bytes) -> int:
        taken = data[: 4096 - len(self.driver)]
        if not taken:
            raise BlockingIOError
        self.driver += taken
        return len(taken)

    def carry(self, seconds: float) -> None:
        n = round(5760 * seconds)
        self.came += self.driver[:n]
        del self.driver[:n]


@pytest.mark.parametrize("rate_hz", [10, 20, 40])
async def test_what_comes_over_a_line_that_cannot_follow_is_never_old(line, monkeypatch, rate_hz):
    """ODOMETRY is 245 bytes: 20 of them a second, with the rest of the conversation 6 kB, are more than 57600 baud carry."""
    slow, n_bytes = SlowLine(monkeypatch), 300
    channel = open_line(line[1], [], baud=57600)
    oldest_s = 0.0
    for number in range(20 * rate_hz):
        channel.write([number.to_bytes(4, "big") * (n_bytes // 4)])
        slow.carry(1 / rate_hz)
        channel._writable()  # as the loop does when the line is free
        if len(slow.came) >= n_bytes:
            at = len(slow.came) // n_bytes * n_bytes - n_bytes
            oldest_s = max(oldest_s, (number + 1 - int.from_bytes(slow.came[at : at + 4], "big")) / rate_hz)
    assert oldest_s <= MAX_WAIT_S + n_bytes / 5760 + 2 / rate_hz  # it waits, is carried, and time goes by in steps
    assert (channel.dropped > 0) == (rate_hz * n_bytes > 5760)
    assert len(slow.came) > 0.9 * min(rate_hz * n_bytes, 5760) * 20
    channel.close()


async def test_a_line_that_cannot_follow_is_told_once(line, monkeypatch):
    SlowLine(monkeypatch)  # which carries nothing
    told: list[str] = []
    link = PymavlinkLink(f"serial:{line[1]}:1200", SessionSettings(heartbeat_s=0.05), MonotonicClock(), on_warning=told.append)
    link.open()
    async with asyncio.timeout(20):
        while not told:  # noqa: ASYNC110 - heartbeats wait, one behind the other
            await asyncio.sleep(0.02)
    await asyncio.sleep(0.3)
    counted = link.left_out
    assert counted > 1
    link._connection_lost("unplugged")
    async with asyncio.timeout(20):
        while link.reconnects < 1:  # noqa: ASYNC110 - the count outlives the connection
            await asyncio.sleep(0.02)
    assert link.left_out >= counted
    await link.close()
    told = [text for text in told if "unplugged" not in text]
    assert told == [f"serial:{line[1]}:1200 cannot carry all that is sent, some is left out: raise the baud rate on both sides"]


async def test_a_line_that_breaks_is_lost_once(line):
    controller, device = os.openpty()
    tty.setraw(device)
    lost: list[str] = []
    channel = open_line(os.ttyname(device), lost)
    os.close(device)
    os.close(controller)
    channel.write([b"x"])
    channel.write([b"y"])
    await asyncio.sleep(0.05)
    assert len(lost) == 1
    assert channel.dropped == 1
    assert channel.overflowed == 0, "a line that is gone is not one that is too slow"


async def test_a_device_that_is_not_there(tmp_path):
    with pytest.raises(OSError, match="nothing"):
        open_line(str(tmp_path / "nothing"), [])


@pytest.mark.parametrize("fault", [termios.error(errno.EIO, "Input/output error"), ValueError("Failed to set custom baud rate")])
async def test_a_device_that_goes_while_it_is_opened_is_opened_again(line, monkeypatch, fault):
    """As a plug that bounces, or a supply that dips: pyserial lets the system's error through, which is no OSError."""
    _, name = line
    sets, tried, said = termios.tcsetattr, [], []

    def bounces(*attributes: object) -> None:
        tried.append(1)
        if len(tried) <= 2:
            raise fault
        sets(*attributes)

    monkeypatch.setattr(termios, "tcsetattr", bounces)
    open_before = descriptors()
    link = PymavlinkLink(f"serial:{name}:57600", SessionSettings(reconnect_s=0.05), MonotonicClock(), on_warning=said.append)
    events = asyncio.create_task(anext(aiter(link.events()), None))
    async with asyncio.timeout(20):
        while len(tried) < 3 and not events.done():  # noqa: ASYNC110
            await asyncio.sleep(0.01)
    assert len(tried) == 3
    assert [text.partition(": ")[2] for text in said] == [f"{name} cannot be set up: {fault}; trying again"] * 2
    await link.close()
    await events
    assert descriptors() == open_before
