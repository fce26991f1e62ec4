"""What a check before the flight says of the link's address, and a start goes on with."""

from __future__ import annotations

import socket

import pytest

from visloc_companion.app.link_address import check_address
from visloc_companion.app.preflight import preflight
from visloc_companion.config import parse_config
from visloc_companion.errors import LinkError

ELSEWHERE = "192.0.2.7"
"""TEST-NET-1 (RFC 5737): nobody's."""


@pytest.mark.parametrize(
    ("url", "told"),
    [
        ("udpin:127.0.0.1:0", "port 0 is another one at each start"),
        ("tcpin:127.0.0.1:0", "port 0 is another one at each start"),
        (f"udpin:{ELSEWHERE}:14550", rf"cannot listen on udpin:{ELSEWHERE}:14550.*an address of this computer.*udpout:"),
        (f"tcpin:{ELSEWHERE}:5760", rf"cannot listen on tcpin:{ELSEWHERE}:5760.*with tcp:"),
        ("udpout:nobody.invalid:14550", "nobody.invalid is not known"),
        ("tcp:nobody.invalid:5760", "nobody.invalid is not known"),
    ],
)
def test_an_address_that_cannot_be_used_is_a_problem(url: str, told: str) -> None:
    problems, _ = preflight(parse_config({"link": {"url": url}}))
    assert [(type(problem), problem.where) for problem in problems] == [(LinkError, "link.url")]
    with pytest.raises(LinkError, match=told):
        check_address(url)


@pytest.mark.parametrize("url", [f"udpout:{ELSEWHERE}:14550", f"tcp:{ELSEWHERE}:5760", "udpin:[::]:14571", "serial:/none:9600"])
def test_what_may_be_there_later_or_is_looked_at_elsewhere_is_none(url: str) -> None:
    check_address(url)


@pytest.mark.parametrize(("kind", "scheme"), [(socket.SOCK_DGRAM, "udpin"), (socket.SOCK_STREAM, "tcpin")])
def test_nor_is_a_port_that_the_running_daemon_has(kind: int, scheme: str) -> None:
    with socket.socket(socket.AF_INET, kind) as daemon:
        daemon.bind(("127.0.0.1", 0))
        check_address(f"{scheme}:127.0.0.1:{daemon.getsockname()[1]}")


def test_one_of_a_names_addresses_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    """`localhost` is ::1 first, also where IPv6 is switched off."""
    found = [(socket.AF_INET, socket.SOCK_DGRAM, 0, "", (host, 0)) for host in (ELSEWHERE, "127.0.0.1")]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
    check_address("udpin:localhost:14571")
