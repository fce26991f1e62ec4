"""What a zoom that was followed makes of odometry while nothing is recognised: it may go on as fast as it did.

Odometry moves by as much more or less as the lens became longer or shorter since the last fix that showed it. Nobody sees that,
so the doubt grows until a fix shows the lens again, also where the zoom is followed no more. It is in the displacements that the
filter takes, along the way; to the side a lens moves nothing, and there GNSS is held against odometry as ever.
"""

from __future__ import annotations

import math
from dataclasses import replace

from visloc_companion.core.filter.lasting import BY_SHAPE
from visloc_companion.types import Fix, NoFix, Odometry

LEAST_SHARE, MOST_SHARE = 0.03, 1.2
"""Of a displacement: in doubt at least while a zoom is followed; and at most, a lens 2.2 times as long or short, as far as frames
are looked at (zoom_tries.py)."""


class UnseenZoom:
    """The fastest that a lens may go on, and since when."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Nothing zooms, or it is known how long the lens is and that it goes on no more."""
        self._seen_ns, self._per_s, self._least = 0, 0.0, 0.0

    def seen(self, t_ns: int, per_s: float) -> None:
        """A fix showed a lens that may go on by so much a second (natural logarithm)."""
        self._seen_ns, self._per_s, self._least = t_ns, per_s, LEAST_SHARE

    def share(self, t_ns: int) -> float:
        """1-sigma of what displacements are off by at a time, a share of them."""
        share = math.expm1(min(1.0, self._per_s * (t_ns - self._seen_ns) * 1e-9))
        return max(self._least, min(share, MOST_SHARE))

    def share_in(self, answer: Fix | NoFix) -> float:
        """The same in what an answer shows of the motion: a frame that is recognised by its picture shows the lens."""
        seen = isinstance(answer, Fix) and answer.method not in BY_SHAPE
        return self._least if seen else self.share(answer.t_ns)

    def goes_on(self, t_ns: int) -> bool:
        """Whether the lens may be another one by a time than the last fix showed."""
        return self.share(t_ns) > LEAST_SHARE


def doubted(seen: Odometry, share: float) -> Odometry:
    """A displacement that may be too long or short by a share (1-sigma) beyond what it claims."""
    (north, east, _), ((nn, ne), (_, ee)), more = seen.displacement_ned_m, seen.cov_ne_m2, share**2
    ne += more * north * east
    cov = (nn + more * north**2, ne), (ne, ee + more * east**2)
    return replace(seen, cov_ne_m2=cov, sigma_scale=math.hypot(seen.sigma_scale, share))
