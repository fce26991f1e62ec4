"""The channel through MAVSDK, with a library that stands for it."""

import asyncio
import json
import threading
from types import SimpleNamespace

import pytest

from visloc_companion.adapters.mavlink.channels import Listener
from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.endpoint import parse_endpoint
from visloc_companion.adapters.mavlink.framing import Framer
from visloc_companion.adapters.mavlink.mavsdk_channel import CAPACITY, Inbox, MavsdkOpener
from visloc_companion.adapters.mavlink.mavsdk_translate import Spoken


class FakeLibrary:
    """Notes what is asked of MAVSDK."""

    class MavsdkError(Exception):
        pass

    ComponentType = SimpleNamespace(COMPANION_COMPUTER=2)

    def __init__(self):
        self.urls, self.sent, self.callbacks, self.systems, self.destroyed = [], [], [], [1], 0
        self.configurations = []
        self.refuse_url = self.refuse_message = False
        library = self

        class Configuration:
            @staticmethod
            def create_with_component_type(kind):
                assert kind == 2
                library.configurations.append(SimpleNamespace(system_id=0, component_id=0, destroy=lambda: None))
                return library.configurations[-1]

        class Mavsdk:
            def __init__(self, configuration):
                self.found = None

            def subscribe_on_new_system(self, callback):
                library.found = lambda: callback(None)

            def add_any_connection_with_handle(self, url):
                if library.refuse_url:
                    raise FakeLibrary.MavsdkError("no such device")
                library.urls.append(url)

            def get_systems(self):
                return [SimpleNamespace(get_system_id=lambda n=n: n) for n in library.systems]

            def destroy(self):
                library.destroyed += 1

        class MavlinkDirect:
            def __init__(self, system):
                pass

            def subscribe_message(self, name, callback):
                assert name == ""
                library.callbacks.append(callback)

            def send_message(self, message):
                if library.refuse_message:
                    raise FakeLibrary.MavsdkError("busy")
                library.sent.append(message)

        self.Configuration, self.Mavsdk, self.MavlinkDirect = Configuration, Mavsdk, MavlinkDirect
        self.MavlinkMessage = lambda *parts: parts


class Bench:
    """A channel, its library, and what its listener heard."""

    def __init__(self):
        self.library, self.data, self.lost = FakeLibrary(), [], []
        self.opener = MavsdkOpener(0, 197, self.library)
        self.listener = Listener(lambda data, _: self.data.append(data), self.lost.append, lambda: False, lambda _: None)

    async def open(self, url="tcp:127.0.0.1:5760"):
        channel = await self.opener(parse_endpoint(url), self.listener)
        self.library.found()
        await asyncio.sleep(0)
        return channel


def heartbeat(system=1):
    return bytes(mav.MAVLink_heartbeat_message(18, 8, 0, 0, 3, 3).pack(mav.MAVLink(None, system, 197)))


def attitude(n, system=1):
    fields = dict.fromkeys(("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed"), 0.5)
    text = json.dumps(fields | {"message_id": 30, "time_boot_ms": n})
    return SimpleNamespace(message_name="ATTITUDE", system_id=system, component_id=1, fields_json=text)


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        ("udpin:0.0.0.0:14550", "udpin://0.0.0.0:14550"),
        ("udpout:10.0.0.1:14550", "udpout://10.0.0.1:14550"),
        ("tcp:10.0.0.1:5760", "tcpout://10.0.0.1:5760"),
        ("tcpin:0.0.0.0:5760", "tcpin://0.0.0.0:5760"),
        ("serial:/dev/ttyAMA0:921600", "serial:///dev/ttyAMA0:921600"),
    ],
)
async def test_urls(ours, theirs):
    bench = Bench()
    (await bench.open(ours)).close()
    assert bench.library.urls == [theirs]


async def test_messages_go_both_ways():
    bench = Bench()
    channel = await bench.open()
    bench.library.callbacks[0](attitude(7), None)
    await asyncio.sleep(0)
    (message,) = Framer().feed(b"".join(bench.data))
    assert (message.get_type(), message.time_boot_ms, message.get_srcSystem()) == ("ATTITUDE", 7, 1)
    channel.write([heartbeat()])
    assert [(name, system, component) for name, system, component, *_ in bench.library.sent] == [("HEARTBEAT", 1, 197)]
    channel.close()
    assert bench.library.destroyed == 1


async def test_every_vehicle_is_listened_to_once():
    bench = Bench()
    channel = await bench.open()
    bench.library.systems = [1, 2]
    for _ in range(2):
        bench.library.found()
        await asyncio.sleep(0)
    assert len(bench.library.callbacks) == 2
    channel.close()


async def test_nothing_is_sent_before_a_vehicle_is_heard_or_where_mavsdk_refuses():
    bench = Bench()
    bench.library.systems = []
    channel = await bench.open()
    channel.write([heartbeat()])
    bench.library.systems = [1]
    bench.library.found()
    await asyncio.sleep(0)
    bench.library.refuse_message = True
    channel.write([heartbeat()])
    assert (bench.library.sent, channel.dropped) == ([], 2)
    channel.close()


async def test_it_begins_again_to_speak_as_the_vehicle():
    bench = Bench()
    first = await bench.open()
    first.write([heartbeat(system=9), heartbeat(system=9)])
    assert bench.library.sent == []
    assert len(bench.lost) == 1
    first.close()
    second = await bench.open()
    second.write([heartbeat(system=9)])
    assert [one.system_id for one in bench.library.configurations] == [1, 9]
    assert len(bench.library.sent) == 1
    second.close()


async def test_a_connection_that_cannot_be_made():
    bench = Bench()
    bench.library.refuse_url = True
    with pytest.raises(OSError, match="no such device"):
        await bench.open()
    assert bench.library.destroyed == 1


@pytest.mark.parametrize("refused", [False, True])
async def test_a_connection_that_is_given_up_is_let_go_when_mavsdk_has_done_with_it(refused):
    """A daemon that is stopped while a host does not answer: destroyed under its own thread MAVSDK may crash."""
    bench, begun, go_on = Bench(), threading.Event(), threading.Event()

    def connect(_self, url):
        begun.set()
        assert go_on.wait(30)
        if refused:
            raise FakeLibrary.MavsdkError("no answer")

    bench.library.Mavsdk.add_any_connection_with_handle = connect
    opening = asyncio.create_task(bench.open())
    assert await asyncio.to_thread(begun.wait, 30)
    opening.cancel()
    with pytest.raises(asyncio.CancelledError):
        await opening
    assert bench.library.destroyed == 0
    go_on.set()
    for _ in range(500):
        if bench.library.destroyed:
            break
        await asyncio.sleep(0.01)
    assert bench.library.destroyed == 1


async def test_a_closed_channel_is_deaf():
    bench = Bench()
    channel = await bench.open()
    bench.library.callbacks[0](attitude(1), None)
    channel.close()
    bench.library.found()
    await asyncio.sleep(0)
    assert bench.data == []
    assert len(bench.library.callbacks) == 1


async def test_the_inbox_keeps_the_newest_and_wakes_the_loop_once():
    woken = []
    inbox = Inbox(asyncio.get_running_loop(), lambda: woken.append(len(inbox.drain())))
    spoken = [Spoken(str(n), 1, 1, "{}") for n in range(CAPACITY + 100)]

    def flood():
        for one in spoken:
            inbox.put(one)

    await asyncio.to_thread(flood)
    await asyncio.sleep(0)
    assert sum(woken) + inbox.dropped == len(spoken)
    flood()
    assert inbox.dropped >= 100
    assert inbox.drain() == spoken[-CAPACITY:]
    await asyncio.sleep(0)


async def test_an_inbox_outlives_its_loop():
    loop = asyncio.new_event_loop()
    loop.close()
    Inbox(loop, lambda: None).put(Spoken("ATTITUDE", 1, 1, "{}"))
