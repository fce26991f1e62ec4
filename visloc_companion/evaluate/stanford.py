"""Every epoch's protection level against its true error and the alert limit (the Stanford diagram's regions), and their counts.

Regions after "The Stanford - ESA Integrity Diagram" (Tossaint, Samson, Toran et al., 2007): a system is judged by how often it
could be used, and by how often it would have misled.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from visloc_companion.evaluate.record import FlightRecord
from visloc_companion.types import FloatArray

DEFAULT_VERTICAL_LIMIT_M = 50.0
"""For flights whose Status states none."""


class Region(IntEnum):
    """Where an epoch lies. Level and limit are compared first: what is not available does not mislead anybody who looks."""

    AVAILABLE = 0
    """error <= level <= limit."""
    UNAVAILABLE = 1
    """error <= level, but the level is beyond the limit."""
    UNAVAILABLE_MISLEADING = 2
    """The error is beyond the level, and the level beyond the limit."""
    MISLEADING = 3
    """The error is beyond the level, both are within the limit."""
    HAZARDOUS = 4
    """The level is within the limit and the error is not: hazardously misleading information (HMI)."""


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """The epochs (N,) with a true error and a level, metres, and their regions; `limit_m` is what most are held against."""

    error_m: FloatArray
    level_m: FloatArray
    region: NDArray[np.int64]
    limit_m: float

    def count(self, region: Region) -> int:
        """Epochs in a region."""
        return int(np.sum(self.region == region))

    def summary(self) -> dict[str, Any] | None:
        """The counts as JSON; None without epochs."""
        if not len(self.region):
            return None
        return {
            "alert_limit_m": self.limit_m,
            "epochs": len(self.region),
            **{region.name.lower(): self.count(region) for region in Region},
            "level_median_m": round(float(np.median(self.level_m)), 4),
            "error_median_m": round(float(np.median(self.error_m)), 4),
        }


def regions(error_m: FloatArray, level_m: FloatArray, limit_m: FloatArray) -> NDArray[np.int64]:
    """The `Region` of each epoch (N,)."""
    within, held = level_m <= limit_m, error_m <= level_m
    available = np.where(held, Region.AVAILABLE, np.where(error_m > limit_m, Region.HAZARDOUS, Region.MISLEADING))
    beyond = np.where(held, Region.UNAVAILABLE, Region.UNAVAILABLE_MISLEADING)
    return np.where(within, available, beyond).astype(np.int64)


def horizontal(record: FlightRecord, alert_limit_m: float) -> Judged:
    """The horizontal levels of a flight against one limit."""
    return _judged(record.error_m, record.protection_level_m, np.full(len(record.t_s), alert_limit_m))


def vertical(record: FlightRecord) -> Judged:
    """The vertical ones, each against the limit that held at its time."""
    stated = record.vertical_alert_limit_m
    limit_m = np.where(np.isfinite(stated), stated, DEFAULT_VERTICAL_LIMIT_M)
    return _judged(record.vertical_error_m, record.vertical_protection_level_m, limit_m)


def _judged(error_m: FloatArray, level_m: FloatArray, limit_m: FloatArray) -> Judged:
    known = np.isfinite(error_m) & np.isfinite(level_m)
    error_m, level_m, limit_m = error_m[known], level_m[known], limit_m[known]
    values, counts = np.unique(limit_m, return_counts=True)
    most = float(values[int(np.argmax(counts))]) if len(values) else DEFAULT_VERTICAL_LIMIT_M
    return Judged(error_m, level_m, regions(error_m, level_m, limit_m), most)
