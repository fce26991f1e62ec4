"""Whether fixes are as near as they claim: innovations tell, and fixes that claim too little are believed less.

A fix that claims 0.2 m and errs by 1 m is off by five sigmas again and again, though none is a wrong match; the filter would
follow each of them. Covariance matching (Mehra, "Approaches to adaptive filtering", 1972): a factor on the claimed covariances
grows while normalised innovations are larger than they may be, and goes back to 1 while they are not.
"""

from __future__ import annotations

HONEST = 1.0
SHARE = 0.1
"""Weight of the latest fix."""
ALLOWED = 1.5
"""Normalised squared innovations, each over its mean of 2, may be so large on average: by chance the mean of a dozen is above 1
as often as not, and a factor that grew by chance must go back."""
MOST = 4.0
"""A single fix counts for no more, for it may be a wrong match."""
LARGEST = 100.0
"""A tenth of the true sigma is the least that is put right."""


def audited(factor: float, nis: float) -> float:
    """The factor on the next fix's covariance, after one whose normalised squared innovation was `nis` with this factor."""
    ratio = min(nis / 2, MOST)
    return min(LARGEST, max(HONEST, factor * (1 + SHARE * (ratio - ALLOWED))))
