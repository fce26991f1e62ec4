"""How high the vehicle is above its home: by the autopilot's global position, and by its local one where that has ended.

PX4 without aiding ends its global position and goes on with the local one. The last height would stand for ever: a vehicle that
had just taken off would count as too low for its camera, however high it climbs, one that lands as flying.
"""

from __future__ import annotations

ENDED_NS = 2_000_000_000
"""A global position that has not come for so long has ended."""
TOGETHER_NS = 500_000_000
"""A local and a global position that arrive no further apart tell where in the local frame home is."""


class HomeHeight:
    """Keeps where home lies in the autopilot's local frame, m down; all times are arrivals on the shell's clock, ns."""

    def __init__(self) -> None:
        self._told_ns: int | None = None
        self._local: tuple[int, float] | None = None
        self._home_down_m: float | None = None

    def told(self, t_rx_ns: int, above_home_m: float) -> None:
        """The autopilot says how high it is."""
        self._told_ns = t_rx_ns
        if self._local is not None and t_rx_ns - self._local[0] <= TOGETHER_NS:
            self._home_down_m = self._local[1] + above_home_m

    def by_local(self, t_rx_ns: int, down_m: float, *, disarmed: bool) -> float | None:
        """The height above home by a local position, m; None where the autopilot's own word counts or home is not known.

        Before any global position, and after the last one, home is the ground on which a disarmed vehicle stands.
        """
        self._local = t_rx_ns, down_m
        if self._told_ns is not None and t_rx_ns - self._told_ns <= ENDED_NS:
            return None
        if disarmed:
            self._home_down_m = down_m
        return None if self._home_down_m is None else self._home_down_m - down_m

    def forget(self) -> None:
        """The autopilot restarted: its local frame is another one."""
        self._local = self._home_down_m = None
