"""The last minutes: where the vehicle was and how sure of it, in a ring of fixed size."""

from __future__ import annotations

from collections import deque
from typing import Any

KEPT, SPACING_S = 1200, 0.5
"""Ten minutes at two a second."""

Sample = tuple[float, float | None, float | None, str, float | None, float | None, float | None]
"""Time (s), latitude, longitude (deg), mode, 95 % radius, protection level, alert limit (m); None where there is none."""


class History:
    """Samples of live views, oldest first; None between two of them stands for a time in which nothing was heard."""

    def __init__(self, kept: int = KEPT) -> None:
        self._samples: deque[Sample | None] = deque(maxlen=kept)
        self._newest_s: float | None = None
        self.began = 0
        """Counts the times that it was begun anew."""

    def take(self, view: dict[str, Any]) -> Sample | None:
        """Keep a view, where it is live and so much later than the last; time that goes back begins the history anew.

        Returns what was kept, None where nothing was.
        """
        t_s = view["t_s"]
        if view["state"] != "live" or t_s is None:
            if self._samples and self._samples[-1] is not None:
                self._samples.append(None)
            return None
        if self._newest_s is not None and t_s < self._newest_s:
            self._samples.clear()
            self._newest_s = None
            self.began += 1
        if self._newest_s is not None and t_s - self._newest_s < SPACING_S:
            return None
        position, integrity = view["position"] or {}, view["integrity"]
        sample = (
            round(t_s, 3),
            position.get("lat_deg"),
            position.get("lon_deg"),
            view["mode"]["name"],
            position.get("radius_95_m"),
            integrity["protection_level_m"],
            integrity["alert_limit_m"],
        )
        self._newest_s = t_s
        self._samples.append(sample)
        return sample

    def samples(self) -> list[Sample | None]:
        """All that is kept."""
        return list(self._samples)
