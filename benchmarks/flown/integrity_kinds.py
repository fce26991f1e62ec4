"""What benchmarks.integrity flies, and what it counts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.flown.same_ground import lasts_m


@dataclass(frozen=True, slots=True)
class Vote:
    """A localiser: how often it answers, its 1-sigma range (metres), and how often it has nothing to say for a while."""

    method: str
    period_s: float
    sigma_m: tuple[float, float]
    outage_share: float = 0.05


ODOMETRY = "odometry"
VOTES = {
    "image": Vote("deep", 0.5, (0.3, 1.2)),
    "structure": Vote("structure", 5.0, (0.3, 1.0)),
    "terrain": Vote("terrain", 30.0, (2.0, 6.0), 0.3),
}


@dataclass(frozen=True, slots=True)
class Flight:
    """What is flown: `speed_mps`, the votes, the way after which half of what is wrong has ended (m), and the velocity's 1-sigma
    error (m/s).

    `inertial`: accelerations drive the filter, with the slow error that the daemon learns them to have; else the
    autopilot's velocity does, which rests on what we inject.
    """

    speed_mps: float = 10.0
    votes: tuple[str, ...] = ("image",)
    lasts_m: float = lasts_m(100.0)
    velocity_sigma_mps: float = 0.8
    duration_s: float = 300.0
    inertial: bool = True


@dataclass(slots=True)
class Tally:
    """Counts and the figures of every epoch: true horizontal error and protection level, metres."""

    n_fixes: int = 0
    n_wrong: int = 0
    n_wrong_taken: int = 0
    n_rejected: int = 0
    errors: list[float] = field(default_factory=list)
    levels: list[float] = field(default_factory=list)

    def add(self, other: Tally) -> None:
        """Count another flight, too."""
        self.n_fixes += other.n_fixes
        self.n_wrong += other.n_wrong
        self.n_wrong_taken += other.n_wrong_taken
        self.n_rejected += other.n_rejected
        self.errors += other.errors
        self.levels += other.levels

    def figures(self, alert_limit_m: float) -> dict[str, Any]:
        """What is printed."""
        error, level = np.array(self.errors), np.array(self.levels)
        return {
            "epochs": len(error),
            "fixes": self.n_fixes,
            "wrong": self.n_wrong,
            "wrong_taken": self.n_wrong_taken,
            "rejected": self.n_rejected,
            "misleading": int((error > level).sum()),
            "hmi": int(((error > alert_limit_m) & (level <= alert_limit_m)).sum()),
            "availability": float((level <= alert_limit_m).mean()),
            "error_median_m": float(np.median(error)),
            "error_p95_m": float(np.percentile(error, 95)),
            "level_median_m": float(np.median(level)),
            "level_over_error": float(np.median(level) / np.median(error)),
        }
