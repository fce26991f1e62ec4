"""Whether the autopilot is there, what it is, and where its local frame begins."""

from __future__ import annotations

from visloc_companion.adapters.mavlink.link_state import LinkState
from visloc_companion.adapters.mavlink.two_senders import RESTART_NS
from visloc_companion.types import Attitude, Event, GeoPoint, LinkChanged, LocalPose, OriginChanged, PriorPose, TimesyncSample

_NS_PER_S = 1_000_000_000
_STALL_NS = _NS_PER_S // 2


class Presence:
    """Sans-IO. `origin` is the autopilot's EKF origin, None while it is not known; `heard_ns` is when it was last heard."""

    def __init__(self, timeout_s: float) -> None:
        self.origin: GeoPoint | None = None
        self._link = LinkState()
        self._timeout_ns = round(timeout_s * _NS_PER_S)
        self.heard_ns = self._polled_ns = 0
        self._newest_ns: dict[bool, int] = {}
        """Of the clock of TIMESYNC, which need not count from the boot, and of that of telemetry, which does."""

    @property
    def link(self) -> LinkChanged:
        """The autopilot as far as it is known; `up` tells whether it is heard."""
        return self._link.known

    def heard(self, now_ns: int) -> None:
        """A message of the autopilot came."""
        self.heard_ns = now_ns

    def silent(self, now_ns: int) -> bool:
        """Whether the autopilot has been silent for too long; asked twice a second or more.

        A longer pause is a stall of our own: what came meanwhile is not read yet.
        """
        if now_ns - self._polled_ns > _STALL_NS:
            self.heard_ns += now_ns - self._polled_ns
        self._polled_ns = now_ns
        return self.link.up and now_ns - self.heard_ns > self._timeout_ns

    def take_link(self, event: LinkChanged) -> tuple[LinkChanged | None, bool]:
        """What is new of the autopilot, if anything, and whether it came up with that."""
        was_up = self.link.up
        changed = self._link.heard(event)
        came = changed is not None and not was_up
        if came:
            self._newest_ns.clear()
        return changed, came

    def take_origin(self, event: OriginChanged) -> bool:
        """Whether an origin is another one than before."""
        moved = event.origin != self.origin
        self.origin = event.origin
        return moved

    def restarted(self, event: Event) -> bool:
        """Whether the autopilot's clock went back: it was restarted without falling silent.

        One that was sends no telemetry until it is asked for anew, but answers what its clock says.
        """
        if asked := isinstance(event, TimesyncSample):
            clock_ns = event.t_remote_ns
        elif isinstance(event, Attitude | LocalPose | PriorPose):
            clock_ns = event.t_boot_ns
        else:
            return False
        newest_ns = self._newest_ns.get(asked, clock_ns)
        if clock_ns < newest_ns - RESTART_NS:
            self._newest_ns = {asked: clock_ns}
            return True
        self._newest_ns[asked] = max(newest_ns, clock_ns)
        return False

    def down(self, now_ns: int) -> LinkChanged | None:
        """The link is down; None where it was before."""
        self.origin = None
        return self._link.down(now_ns)
