"""The address of a MAVLink connection, as it is written in the configuration."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from visloc_companion.errors import ConfigError

VALID_FORMS = "udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT or serial:DEVICE:BAUD"


class EndpointKind(StrEnum):
    """How bytes travel: `udpin` and `tcpin` listen, `udpout` and `tcp` connect."""

    UDPIN = "udpin"
    UDPOUT = "udpout"
    TCP = "tcp"
    TCPIN = "tcpin"
    SERIAL = "serial"


@dataclass(frozen=True, slots=True)
class Endpoint:
    """`number` is the port, or the baud rate of a serial line; `place` is the host or the device."""

    kind: EndpointKind
    place: str
    number: int

    def __str__(self) -> str:
        return f"{self.kind}:{self.place}:{self.number}"


def parse_endpoint(url: str) -> Endpoint:
    """Read a link URL; an IPv6 host stands in brackets. Raises ConfigError naming the URL and the valid forms."""
    scheme, _, rest = url.partition(":")
    place, _, number = rest.rpartition(":")
    place = place.removeprefix("[").removesuffix("]")
    try:
        kind = EndpointKind(scheme)
    except ValueError:
        raise _wrong(url, f"{scheme!r} is no kind of connection") from None
    if not place:
        raise _wrong(url, "a part is missing")
    if not (number.isascii() and number.isdigit()):
        raise _wrong(url, f"{number!r} is no whole number")
    value = int(number)
    if "\0" in place or (kind is not EndpointKind.SERIAL and not _is_host(place)):
        raise _wrong(url, f"{place!r} is no name of a {'device' if kind is EndpointKind.SERIAL else 'host'}")
    if kind is EndpointKind.SERIAL:
        if not 0 < value <= 10_000_000:
            raise _wrong(url, f"{value} is no baud rate")
    elif value > 65535 or (value == 0 and kind in (EndpointKind.UDPOUT, EndpointKind.TCP)):
        raise _wrong(url, f"{value} is no port to connect to")
    return Endpoint(kind, place, value)


def _is_host(name: str) -> bool:
    """Whether a name can be looked up at all: no part of it is empty, or longer than 63 characters."""
    try:
        name.encode("idna")
    except UnicodeError:
        return False
    return True


def _wrong(url: str, why: str) -> ConfigError:
    return ConfigError(f"the link URL {url!r} is not valid: {why}", where="link.url", remedy=f"write {VALID_FORMS}")
