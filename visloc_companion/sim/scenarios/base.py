"""What a scenario is: what goes wrong, when, over which ground, and what must come out."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

from visloc_companion.errors import ConfigError
from visloc_companion.sim.changes import Change
from visloc_companion.sim.faults import FaultSchedule
from visloc_companion.sim.land.season import Date
from visloc_companion.sim.vehicles.gimbal import GimbalPlan
from visloc_companion.types import Mode, Verdict

Course = Literal["loop", "zigzag", "over_the_edge", "out_to_sea"]
BAD_GNSS: tuple[Verdict, ...] = (Verdict.DENIED, Verdict.SUSPECT)


@dataclass(frozen=True, slots=True)
class Expectation:
    """Limits on what a flight with the daemon must show. None switches a limit off.

    Errors are those of the navigator's position against truth while GNSS is denied or spoofed and positions are injected
    (without any GNSS the first of them are the operator's). Where `dead_reckoning_m` is given, it is the limit while there
    are no fixes, and the other two hold while there are. `verdict_within_s` counts from the first fault of GNSS;
    `final_verdicts` are allowed in the last second. At least `structure_share` of the fixes of that time are the structure's.

    From the first fault of GNSS on, `modes` are gone through in this order (others may lie between), and the last second's are
    `final_modes`. At no time is the error beyond the protection level. No fix that the navigator took
    is further off than `wrong_fix_m`. A scenario that cannot be solved has a `failsafe`: the autopilot's own is allowed, once
    the daemon has said that it is lost. `plane_max_error_m`: in place of `max_error_m` for a plane, which is 2.5 times as fast.
    A plane that ends aiding may end dead reckoning: banked by 40 degrees for 8 s of a turn, it is not recognised for seconds.
    """

    median_error_m: float | None = 2.0
    max_error_m: float | None = 10.0
    dead_reckoning_m: float | None = None
    verdict_within_s: float | None = 5.0
    pulled_m: float = 30.0
    injection_gap_s: float = 0.2
    final_verdicts: tuple[Verdict, ...] = BAD_GNSS
    structure_share: float = 0.0
    modes: tuple[Mode, ...] = (Mode.AIDING,)
    final_modes: tuple[Mode, ...] = (Mode.AIDING,)
    wrong_fix_m: float = 10.0
    failsafe: bool = False
    plane_max_error_m: float | None = None

    @property
    def of_a_plane(self) -> Expectation:
        """The same with a plane's limits."""
        max_error_m = self.max_error_m if self.plane_max_error_m is None else self.plane_max_error_m
        banked = Mode.AIDING in self.final_modes and Mode.DEAD_RECKONING not in self.final_modes
        final_modes = (*self.final_modes, Mode.DEAD_RECKONING) if banked else self.final_modes
        return replace(self, max_error_m=max_error_m, final_modes=final_modes)


@dataclass(frozen=True, slots=True)
class Scenario:
    """A flight: its faults, its length, what is expected of it, and the world that it is flown over.

    `date` is that on which the procedural world is seen, `changes` what has happened to any world since the map was made.
    `course` is the way that is flown, `height_m` its height above home (None: what suits the map). The camera takes
    `frame_rate_hz` and is mounted at `mount_pitch_rad`, as configured, on the airframe or on a `gimbal`. `pictures` False:
    nothing in it depends on what is seen. Raises ConfigError for a length, rate or height that is none.
    """

    name: str
    summary: str
    duration_s: float
    faults: FaultSchedule
    expected: Expectation = field(default_factory=Expectation)
    operator_fix_at_s: float | None = None
    date: Date = "flight"
    changes: tuple[Change, ...] = ()
    course: Course = "loop"
    height_m: float | None = None
    frame_rate_hz: float = 4.0
    mount_pitch_rad: float = 0.0
    pictures: bool = False
    gimbal: GimbalPlan | None = None

    def __post_init__(self) -> None:
        for key, value in (("duration_s", self.duration_s), ("frame_rate_hz", self.frame_rate_hz), ("height_m", self.height_m)):
            if value is not None and not 0 < value < math.inf:
                raise ConfigError(f"{key} is {value}", where=f"scenario {self.name}", remedy="give a number above 0")

    @property
    def fault_start_s(self) -> float:
        """When GNSS first goes wrong, 0 for a flight that never had it, infinity for one that always has it."""
        start = self.faults.gnss_start_s
        return math.inf if start is None else max(start, 0.0)


def by_name(*scenarios: Scenario) -> dict[str, Scenario]:
    """Scenarios by their names."""
    return {scenario.name: scenario for scenario in scenarios}
