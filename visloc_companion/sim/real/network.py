"""A network of its own for a flight: the simulators listen on all interfaces, so they get none but the loopback.

Linux network namespaces (unshare(2)). Whoever calls `enter_own_network` leaves the machine's network for good, with all
processes that it starts afterwards; two flights in two processes may therefore use the same ports.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import socket
import struct

from visloc_companion.errors import ConfigError

_CLONE_NEWUSER, _CLONE_NEWNET = 0x10000000, 0x40000000
_SIOCGIFFLAGS, _SIOCSIFFLAGS = 0x8913, 0x8914
_IFF_UP = 1
_INTERFACE = struct.Struct("16sh14x")


def enter_own_network() -> None:
    """Move this process into a new network namespace whose only interface is the loopback, up.

    Works for root, and for others where user namespaces are allowed (then before any thread was started).
    Raises ConfigError where the system refuses.
    """
    flags = _CLONE_NEWNET if os.geteuid() == 0 else _CLONE_NEWNET | _CLONE_NEWUSER
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(flags) != 0:
        raise ConfigError(
            f"cannot make a network of its own for the simulator: {os.strerror(ctypes.get_errno())}",
            remedy="run as root, or allow unprivileged user namespaces (kernel.unprivileged_userns_clone)",
        )
    _bring_up("lo")


def _bring_up(interface: str) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        asked = _INTERFACE.pack(interface.encode(), 0)
        _, flags = _INTERFACE.unpack(fcntl.ioctl(any_socket, _SIOCGIFFLAGS, asked))
        fcntl.ioctl(any_socket, _SIOCSIFFLAGS, _INTERFACE.pack(interface.encode(), flags | _IFF_UP))
