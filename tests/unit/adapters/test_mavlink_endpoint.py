"""Link URLs, and the queue between the link and its reader."""

import pytest

from visloc_companion.adapters.mavlink.endpoint import Endpoint, EndpointKind, parse_endpoint
from visloc_companion.adapters.mavlink.event_queue import EventQueue
from visloc_companion.errors import ConfigError
from visloc_companion.types import LinkChanged, Tick


@pytest.mark.parametrize(
    ("url", "endpoint"),
    [
        ("udpin:127.0.0.1:14550", Endpoint(EndpointKind.UDPIN, "127.0.0.1", 14550)),
        ("udpin:0.0.0.0:0", Endpoint(EndpointKind.UDPIN, "0.0.0.0", 0)),
        ("udpout:drone.local:14540", Endpoint(EndpointKind.UDPOUT, "drone.local", 14540)),
        ("tcp:[::1]:5760", Endpoint(EndpointKind.TCP, "::1", 5760)),
        ("tcpin:0.0.0.0:5760", Endpoint(EndpointKind.TCPIN, "0.0.0.0", 5760)),
        ("serial:/dev/ttyAMA0:921600", Endpoint(EndpointKind.SERIAL, "/dev/ttyAMA0", 921600)),
        (
            "serial:/dev/serial/by-id/usb-3D:FMU:if00:57600",
            Endpoint(EndpointKind.SERIAL, "/dev/serial/by-id/usb-3D:FMU:if00", 57600),
        ),
    ],
)
def test_valid_urls(url, endpoint):
    assert parse_endpoint(url) == endpoint


@pytest.mark.parametrize(
    "url",
    ["", "udp:1.2.3.4:5", "udpin:14550", "udpin::14550", "tcp:host:port", "tcp:host:0", "udpout:host:70000", "serial:/dev/x",
     "serial:/dev/x:0", "serial::57600", "tcp:host:-1", "tcp:host:²",
     "udpout:192.168..5:14550", f"udpin:{'x' * 64}:14550", "tcp:ho\0st:5760", "serial:/dev/\0tty:57600"],
)  # fmt: skip
def test_wrong_urls_are_named_with_the_valid_forms(url):
    with pytest.raises(ConfigError) as caught:
        parse_endpoint(url)
    assert repr(url) in str(caught.value)
    assert "udpin:HOST:PORT" in str(caught.value)
    assert "serial:DEVICE:BAUD" in str(caught.value)


async def test_a_full_queue_keeps_the_newest_and_every_change_of_state():
    queue = EventQueue(3)
    queue.put(LinkChanged(0, up=True))
    for i in range(1, 6):
        queue.put(Tick(i))
    queue.close()
    assert [event.t_rx_ns async for event in queue] == [0, 4, 5]
    assert queue.dropped == 3


async def test_a_queue_of_changes_only_stays_bounded():
    queue = EventQueue(2)
    for i in range(5):
        queue.put(LinkChanged(i, up=True))
    assert (len(queue), queue.dropped) == (2, 3)


async def test_a_failure_comes_out_after_what_was_left():
    queue = EventQueue(2)
    queue.put(Tick(1))
    queue.close(RuntimeError("broken"))
    assert (await anext(queue)).t_rx_ns == 1
    with pytest.raises(RuntimeError, match="broken"):
        await anext(queue)
