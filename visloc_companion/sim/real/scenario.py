"""What happens in a flight against a real simulator, and what is expected of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from visloc_companion.sim.real.oracle import OracleSettings
from visloc_companion.sim.real.pilot import HOME, Route
from visloc_companion.types import GeoPoint

DRAG_STEP_S = 0.5


@dataclass(frozen=True, slots=True)
class Brake:
    """A copter brakes as hard as it can at `at_s`, stands for `hold_s` and goes on."""

    at_s: float
    hold_s: float = 4.0


@dataclass(frozen=True, slots=True)
class Operator:
    """Switches the position source as the daemon's texts ask, so long after each: he hurries to vision only."""

    to_vision_s: float = 2.0
    to_gnss_s: float = 15.0


@dataclass(frozen=True, slots=True)
class SeenWorld:
    """The pack of the daemon, and orthophoto and surface model of what its camera sees: another date of the same place."""

    pack: Path
    ortho: Path
    dsm: Path | None


@dataclass(frozen=True, slots=True)
class RealScenario:
    """What happens, in seconds since the circuit was begun; None is never.

    `drag_mps` (north, east) pulls the receiver's position away from `drag_at_s` on. The flight lasts `duration_s`, then lands
    where `lands`. `restarts`: when the daemon dies without a word; another one starts `down_s` later. Without `gnss_at_boot`
    there is never any GNSS: the ground station sets the origin, a pilot takes off by hand, and the circuit begins when the
    autopilot has a position. `p95_limit_m`: what is asked instead of the usual limit; infinite where nothing is. The
    vehicle stands at `home`. With `seen` frames are rendered and localised as in flight; without, fixes come from the truth.
    `drag_per_s`: of PX4's quadrotor against the air, where it is not as its makers have it. With an `operator` the daemon may
    not switch the source (as by default), and asks.
    """

    name: str
    route: Route
    duration_s: float
    jam_at_s: float | None = None
    gnss_back_at_s: float | None = None
    drag_at_s: float | None = None
    drag_mps: tuple[float, float] = (0.0, 1.0)
    brakes: tuple[Brake, ...] = ()
    restarts: tuple[float, ...] = ()
    down_s: float = 3.0
    gnss_at_boot: bool = True
    with_daemon: bool = True
    lands: bool = True
    oracle: OracleSettings = field(default_factory=OracleSettings)
    p95_limit_m: float | None = None
    seed: int = 1
    home: GeoPoint = HOME
    seen: SeenWorld | None = None
    drag_per_s: float | None = None
    operator: Operator | None = None

    @property
    def with_odometry(self) -> bool:
        """Whether answers bring the camera's motion."""
        return self.seen is not None or self.oracle.odometry


def timeline(scenario: RealScenario) -> Sequence[tuple[float, str]]:
    """What is done when, in order."""
    deeds: list[tuple[float, str]] = [(at_s, "restart") for at_s in scenario.restarts]
    if scenario.jam_at_s is not None:
        deeds.append((scenario.jam_at_s, "jam"))
    if scenario.gnss_back_at_s is not None:
        deeds.append((scenario.gnss_back_at_s, "back"))
    if scenario.drag_at_s is not None:
        ends_s = scenario.duration_s if scenario.jam_at_s is None else scenario.jam_at_s
        steps = int((ends_s - scenario.drag_at_s) / DRAG_STEP_S)
        deeds += [(scenario.drag_at_s + n * DRAG_STEP_S, "drag") for n in range(steps)]
    for brake in scenario.brakes:
        deeds += [(brake.at_s, "brake"), (brake.at_s + brake.hold_s, "resume")]
    return sorted(deed for deed in deeds if deed[0] < scenario.duration_s)
