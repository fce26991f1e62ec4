"""Tells once that no autopilot is heard, and what is heard in its place: a daemon without one waits, and says nothing else."""

from __future__ import annotations

from visloc_companion.adapters.mavlink.dialect import AUTOPILOT_COMPONENT

PATIENCE_NS = 10_000_000_000
"""An autopilot says every second that it is there."""
MOST_TOLD = 8
Sender = tuple[int, int]
"""System and component."""


class Unheard:
    """Sans-IO. `others`: who was heard so far that is not the autopilot."""

    def __init__(self) -> None:
        self.others: dict[Sender, bool] = {}
        self._since_ns: int | None = None
        self._told = False

    def other(self, sender: Sender, *, pilot: bool) -> None:
        """Somebody else spoke; `pilot`: as what flies a vehicle."""
        if sender in self.others or len(self.others) < MOST_TOLD:
            self.others[sender] = pilot or self.others.get(sender, False)

    def check(self, heard: bool, wanted: int, now_ns: int) -> str | None:
        """What is to be said now; `heard`: the autopilot ever was; `wanted`: its system id, 0 for any."""
        self._since_ns = now_ns if self._since_ns is None else self._since_ns
        if heard or self._told or now_ns - self._since_ns < PATIENCE_NS:
            return None
        self._told = True
        return f"no autopilot{f' of system id {wanted}' if wanted else ''} is heard: {self._instead()}"

    def _instead(self) -> str:
        if not self.others:
            return "no message arrives; it has to be on, wired (its TX to our RX) and to send to link.url (visloc doctor)"
        aside = [component for (_, component), pilot in self.others.items() if pilot and component != AUTOPILOT_COMPONENT]
        if aside:
            return f"one speaks as component {aside[0]}, which has to be 1 (PX4: MAV_COMP_ID)"
        senders = ", ".join(f"{system}/{component}" for system, component in sorted(self.others))
        return f"others are (system/component {senders}); has its telemetry a way to link.url, and is link.system_id right?"
