"""What a flight against a real simulator leaves behind, sampled whenever the simulator tells its truth."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from visloc_companion.types import GeoPoint, Quat, Vec2, Vec3
from visloc_companion.whole_file import write_result


@dataclass(frozen=True, slots=True)
class RealSample:
    """One instant, `t_s` on the autopilot's boot clock.

    Positions are NED about the EKF origin in the autopilot's own projection. `estimate_*` is the autopilot's own estimate
    (LOCAL_POSITION_NED; None while it has none), `global_v_ned_mps` that of GLOBAL_POSITION_INT. `injected_p_ned_m` is what the
    daemon last sent, None before the first. `offset_ne_m`: what fixes are off by on purpose. `ratio`: the innovation test ratio
    of position (above 1 is rejected).
    """

    t_s: float
    phase: str
    true_place: GeoPoint
    true_p_ned_m: Vec3
    true_v_ned_mps: Vec3
    q_ned_frd: Quat
    estimate_p_ned_m: Vec3 | None
    estimate_v_ned_mps: Vec3 | None
    global_v_ned_mps: Vec3 | None
    injected_p_ned_m: Vec3 | None
    offset_ne_m: Vec2
    ratio: float | None
    position_ok: bool | None
    mode: int
    armed: bool


@dataclass(slots=True)
class RealLog:
    """A flight: samples, what the autopilot said, its failsafes, when things happened and positions went out (s of its clock).

    `version` is what the autopilot says it is, `build` the hash of its sources. `round_trips`: when the daemon's TIMESYNC
    requests were answered, and how long each took, s.
    """

    program: str = ""
    version: str = ""
    build: str = ""
    speed: float = 0.0
    samples: list[RealSample] = field(default_factory=list)
    texts: list[tuple[float, str]] = field(default_factory=list)
    failsafes: list[tuple[float, str]] = field(default_factory=list)
    marks: list[tuple[float, str]] = field(default_factory=list)
    injected_s: list[float] = field(default_factory=list)
    round_trips: list[tuple[float, float]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def at(self, mark: str) -> float | None:
        """When something first happened, None if it did not."""
        return next((t_s for t_s, name in self.marks if name == mark), None)


COLUMNS = (
    "t_s", "phase", "true_n_m", "true_e_m", "true_d_m", "true_vn_mps", "true_ve_mps", "true_vd_mps",
    "local_n_m", "local_e_m", "local_d_m", "local_vn_mps", "local_ve_mps", "local_vd_mps",
    "global_vn_mps", "global_ve_mps", "global_vd_mps", "injected_n_m", "injected_e_m",
    "qw", "qx", "qy", "qz", "position_ratio", "mode",
)  # fmt: skip


def write_csv(samples: Sequence[RealSample], path: Path) -> None:
    """One row a sample; what is not known is empty."""
    nothing = ("", "", "")
    file = io.StringIO(newline="")
    writer = csv.writer(file)
    writer.writerow(COLUMNS)
    for s in samples:
        injected = nothing if s.injected_p_ned_m is None else s.injected_p_ned_m
        row = (
            *s.true_p_ned_m, *s.true_v_ned_mps, *(s.estimate_p_ned_m or nothing), *(s.estimate_v_ned_mps or nothing),
            *(s.global_v_ned_mps or nothing), *injected[:2], *s.q_ned_frd,
        )  # fmt: skip
        ratio = "" if s.ratio is None else f"{s.ratio:.4f}"
        numbers = (value if value == "" else f"{value:.4f}" for value in row)
        writer.writerow((f"{s.t_s:.3f}", s.phase, *numbers, ratio, s.mode))
    write_result(path, file.getvalue().encode())
