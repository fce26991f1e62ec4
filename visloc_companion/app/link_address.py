"""Whether the network address of a link can be used on this computer, before a flight.

The daemon itself goes on without: a network may come up later. A port that is taken is no fault, for the daemon may be running.
"""

from __future__ import annotations

import errno
import socket

from visloc_companion.adapters.mavlink.endpoint import EndpointKind, parse_endpoint
from visloc_companion.errors import LinkError

_LISTENING = (EndpointKind.UDPIN, EndpointKind.TCPIN)
_DATAGRAMS = (EndpointKind.UDPIN, EndpointKind.UDPOUT)


def check_address(url: str) -> None:
    """A host has to be known, one that is listened on to be this computer, at a port that the autopilot can be told.

    Of a serial line nothing is looked at. Raises LinkError, ConfigError for a URL that is not valid.
    """
    endpoint = parse_endpoint(url)
    if endpoint.kind is EndpointKind.SERIAL:
        return
    if endpoint.kind in _LISTENING and endpoint.number == 0:
        remedy = "name the one that the autopilot sends to, often 14550 or 14540"
        raise LinkError("port 0 is another one at each start, which no autopilot can know", where="link.url", remedy=remedy)
    kind = socket.SOCK_DGRAM if endpoint.kind in _DATAGRAMS else socket.SOCK_STREAM
    try:
        found = socket.getaddrinfo(endpoint.place, endpoint.number, type=kind)
    except OSError as why:
        remedy = "check the name, and that this computer is on its network"
        raise LinkError(f"{endpoint.place} is not known: {why.strerror}", where="link.url", remedy=remedy) from why
    if endpoint.kind in _LISTENING:
        faults = [_fault(family, kind, address) for family, _, _, _, address in found]
        if None not in faults:
            connecting = EndpointKind.UDPOUT if endpoint.kind is EndpointKind.UDPIN else EndpointKind.TCP
            remedy = f"listen on 0.0.0.0 or an address of this computer (ip addr), or connect to another one with {connecting}:"
            raise LinkError(f"cannot listen on {endpoint}: {faults[0]}", where="link.url", remedy=remedy)


def _fault(family: int, kind: int, address: tuple[object, ...]) -> str | None:
    """Why it cannot be listened on; None where it can, or somebody does. Of a name's addresses some may be no use (IPv6)."""
    try:
        with socket.socket(family, kind) as probe:
            probe.bind(address)
    except OSError as why:
        return None if why.errno == errno.EADDRINUSE else why.strerror or str(why)
    return None
