"""A serial line that cannot follow, or breaks while it is written to (a pseudo-terminal stands in)."""

import asyncio
import errno
import os
import termios
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from visloc_companion.adapters.mavlink.channels import MAX_UNSENT_BYTES, Listener
from visloc_companion.adapters.mavlink.endpoint import Endpoint, EndpointKind
from visloc_companion.adapters.mavlink.pymavlink_link import PymavlinkLink
from visloc_companion.adapters.mavlink.serial_channel import SerialChannel
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


def open_line(name: str, lost: list[str]) -> SerialChannel:
    return SerialChannel(
        Endpoint(EndpointKind.SERIAL, name, 921600),
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
    assert len(got) >= MAX_UNSENT_BYTES
    channel.close()
    channel.write([b"late"])
    channel.close()


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
