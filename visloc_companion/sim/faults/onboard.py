"""What goes wrong inside the autopilot and the companion, and between them."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CompassError:
    """The autopilot's heading goes wrong by `error_rad` within `ramp_s` (iron near by; its filter follows a compass slowly)."""

    start_s: float
    error_rad: float
    ramp_s: float = 10.0
    end_s: float = math.inf


@dataclass(frozen=True, slots=True)
class BaroDrift:
    """The barometer's height goes wrong by `error_m` (up) within `ramp_s`: weather, or air that streams past the port."""

    start_s: float
    error_m: float
    ramp_s: float
    end_s: float = math.inf


@dataclass(frozen=True, slots=True)
class AutopilotClockStep:
    """All time stamps of the autopilot jump by so many seconds."""

    at_s: float
    by_s: float


@dataclass(frozen=True, slots=True)
class CompanionClockStep:
    """The companion's clock jumps by so many seconds."""

    at_s: float
    by_s: float


@dataclass(frozen=True, slots=True)
class LinkGap:
    """Nothing passes between autopilot and companion, either way; what is sent meanwhile is lost."""

    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class WorkerCrash:
    """The localising process dies, with what it was asked, and is there again after `restart_s`, remembering nothing."""

    at_s: float
    restart_s: float = 4.0


OnboardFault = CompassError | BaroDrift | AutopilotClockStep | CompanionClockStep | LinkGap | WorkerCrash


def ramped(fault: CompassError | BaroDrift, t_s: float) -> float:
    """How much of the fault there is at a time, 0 to 1; it goes as it came."""
    if t_s < fault.start_s:
        return 0.0
    risen = 1.0 if fault.ramp_s <= 0 else min(1.0, (min(t_s, fault.end_s) - fault.start_s) / fault.ramp_s)
    fallen = 0.0 if t_s < fault.end_s else 1.0 if fault.ramp_s <= 0 else (t_s - fault.end_s) / fault.ramp_s
    return max(0.0, risen - fallen)
