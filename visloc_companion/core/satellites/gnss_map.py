"""Before arming: does GNSS put the vehicle on the map, and on its surface?

A position outside the pack means the wrong pack, or a receiver that is led astray; a height far from the surface on which the
vehicle stands means the wrong place, too. Both are asked on the ground only: in flight the vehicle is above the surface.
"""

from __future__ import annotations

from visloc_companion.types import Gnss, MapAtGnss

CHECK_AGE_NS = 5_000_000_000
HEIGHT_M = 30.0
"""Roofs, trees on the surface model, and receivers with a coarse geoid."""
HEIGHT_SIGMA = 3.0


class MapCheck:
    """Keeps the map's last answer while the vehicle is not armed."""

    def __init__(self) -> None:
        self._answer: MapAtGnss | None = None
        self.height_above_surface_m = 0.0

    def on_map(self, answer: MapAtGnss) -> None:
        """Take what the map says of the place where GNSS puts the vehicle."""
        self._answer = answer

    def signs(self, now_ns: int, gnss: Gnss, flies: bool) -> tuple[str, ...]:
        """`off_map` or `off_surface`, while the vehicle does not fly (nor is armed for it) and the answer is fresh."""
        answer = self._answer
        if flies or answer is None or now_ns - answer.t_rx_ns > CHECK_AGE_NS:
            return ()
        if not answer.inside:
            return ("off_map",)
        if answer.surface_amsl_m is None:
            return ()
        self.height_above_surface_m = answer.place.h_amsl_m - answer.surface_amsl_m
        allowed_m = HEIGHT_M + HEIGHT_SIGMA * (gnss.v_acc_m or 0.0)
        return ("off_surface",) if abs(self.height_above_surface_m) > allowed_m else ()
