"""A localiser that knows the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from visloc_companion.errors import Reason
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import Fix, GeoPoint, Image, LocaliseRequest, NoFix, Quat

Truth = Callable[[int], tuple[GeoPoint, Quat]]
"""Place and attitude of the camera's body at a time."""


@dataclass(slots=True)
class FakeLocaliser:
    """Answers with the truth at image time plus noise of `sigma_m` per axis, seeded by the request.

    `claimed_sigma_m` is what it says of itself (None: what is true); `refuses` makes it decline with a reason. What it was asked
    stays in `requests`.
    """

    truth: Truth
    sigma_m: float = 0.5
    claimed_sigma_m: float | None = None
    refuses: Reason | None = None
    elapsed_ms: float = 40.0
    requests: list[LocaliseRequest] = field(default_factory=list)

    @property
    def method(self) -> str:
        """Name for results."""
        return "fake"

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The true pose with noise, or NoFix: OUTSIDE_MAP where the truth lies off the map, and what `refuses` says."""
        self.requests.append(request)
        frame = request.frame
        place, q_ned_frd = self.truth(frame.t_ns)
        reason = self.refuses or (None if ref.covers(place.lat_deg, place.lon_deg) else Reason.OUTSIDE_MAP)
        if reason is not None:
            return NoFix(frame.t_rx_ns, frame.t_ns, request.request_id, frame.frame_id, self.method, reason, self.elapsed_ms)
        noise_m = np.random.default_rng(request.seed).normal(0.0, self.sigma_m, 3)
        claimed = self.sigma_m if self.claimed_sigma_m is None else self.claimed_sigma_m
        return Fix(
            frame.t_rx_ns,
            frame.t_ns,
            request.request_id,
            frame.frame_id,
            self.method,
            geo_from_ned((float(noise_m[0]), float(noise_m[1]), float(noise_m[2])), place),
            q_ned_frd,
            ((claimed**2, 0.0), (0.0, claimed**2)),
            claimed,
            0.01,
            1e-4,
            self.elapsed_ms,
        )
