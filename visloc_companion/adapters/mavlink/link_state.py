"""What is known of the autopilot at the other end, merged from HEARTBEAT and AUTOPILOT_VERSION."""

from __future__ import annotations

from dataclasses import replace

from visloc_companion.types import AutopilotKind, LinkChanged


class LinkState:
    """Merges the partial LinkChanged events of `codec.decode` and passes on only what is new (log readers use it too)."""

    def __init__(self) -> None:
        self._known = LinkChanged(0, up=False)

    @property
    def known(self) -> LinkChanged:
        """What is known now; `up` False before the first heartbeat and after `down`."""
        return self._known

    def heard(self, event: LinkChanged) -> LinkChanged | None:
        """Take a LinkChanged of the codec; the merged one where something changed, else None.

        A version that comes before the first heartbeat is kept and does not bring the link up.
        """
        known = self._known
        from_heartbeat = event.version == ""
        merged = LinkChanged(
            event.t_rx_ns,
            up=known.up or from_heartbeat,
            autopilot=known.autopilot if event.autopilot is AutopilotKind.UNKNOWN else event.autopilot,
            version=event.version or known.version,
            system_id=event.system_id,
            armed=event.armed if from_heartbeat else known.armed,
        )
        self._known = merged
        return None if not merged.up or merged == replace(known, t_rx_ns=event.t_rx_ns) else merged

    def down(self, t_ns: int) -> LinkChanged | None:
        """The link fell silent; the event, or None where it was down already. Kind, version and system id stay known."""
        if not self._known.up:
            return None
        self._known = replace(self._known, t_rx_ns=t_ns, up=False)
        return self._known
