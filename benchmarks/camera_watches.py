"""How often what watches the camera speaks or corrects without cause, and how soon with one.

    python -m benchmarks.camera_watches [--hours 1] [--minutes 10] [--seed 1] [--cases ...] [--flights copter leaning plane]

Hours of flight without pictures: the watches are given turns between frames, fixes, heights and attitudes with the errors that
they share. Legs of 30 s end in turns of 90 degrees. The autopilot's tilt errs by 0.3 degrees for 20 s and its heading by 1 degree
for 60 s, the map by 0.7 m for 15 s, GNSS by 1 m for 60 s and 1.5 m of height for 120 s; a fix takes half of what the tilt is off
by for another place. Every two minutes there are 2 to 6 s of ground 8 m above the map; a fix is wrong as often as it claims, by
8 m (1-sigma on each axis), for up to three frames. Turns err by 0.1 degrees and 2 % (Student's, 4 degrees of freedom), and by
what relief feigns: a bend of 0.012, another one after each height of way.

Another flight begins every `--minutes`. Of each case: how many flights, and of each watch in how many it spoke, doubted or
corrected, and the median of when, seconds. Zoom: only what heights show of a slow one (scale_drift.py).
"""

from __future__ import annotations

import argparse
import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Literal

import numpy as np

from benchmarks.flown.claims import claimed
from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.camera.aim import Aim
from visloc_companion.core.camera.boresight import Boresight
from visloc_companion.core.camera.camera_time import CameraTime
from visloc_companion.core.camera.distortion_watch import DistortionWatch
from visloc_companion.core.camera.fix_height_watch import FixHeightWatch
from visloc_companion.core.camera.lens_watch import LensSwings, LensWatch
from visloc_companion.core.camera.mount_watch import MountWatch
from visloc_companion.core.camera.scale_drift import SURE, ScaleDrift, Sight
from visloc_companion.core.camera.zoom_ramp import NAMED_SHARE
from visloc_companion.core.filter import fusion
from visloc_companion.core.filter.belief import Position, seeded
from visloc_companion.core.filter.lasting import apart_m
from visloc_companion.core.filter.propagation import Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.geo import se3, wgs84
from visloc_companion.types import Fix, FloatArray, FrameRef, GeoPoint, LocaliseRequest, Notice, PosePrior, Quat, Turn

Kind = Literal["copter", "leaning", "plane"]
HOME = GeoPoint(59.3, 18.1, 40.0)
LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
EVERY_S, ATTITUDE_S, LEG_S, TURN_S = 0.5, 0.1, 30.0, 5.0
HEIGHT_M, SPEED_MPS = {"copter": 100.0, "leaning": 100.0, "plane": 150.0}, {"copter": 10.0, "leaning": 12.0, "plane": 22.0}
LEAN_RAD = {"copter": math.radians(5), "leaning": math.radians(30), "plane": 0.0}
TILT_RAD, TILT_S, HEADING_RAD, HEADING_S = math.radians(0.3), 20.0, math.radians(1.0), 60.0
MAP_M, MAP_S, GNSS_M, GNSS_S, GNSS_H_M, GNSS_H_S = 0.7, 15.0, 1.0, 60.0, 1.5, 120.0
FIX_M, HEIGHT_SIGMA_M, WRONG_M = 0.6, 1.5, 8.0
PATCH_M, PATCH_EVERY_S = 8.0, 120.0
RELIEF, TURN_RAD, TURN_SHARE = 0.012, math.radians(0.1), 0.02
SHARE_OF_TILT = 0.5
TURN_COV = ((1e-6, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 1e-6))
COV = ((FIX_M**2, 0.0), (0.0, FIX_M**2))
S = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Case:
    """What is wrong with a camera: its mounting (roll, pitch, yaw, degrees), when frames are taken after their stamps (s), by
    what share the lens is longer, and k1 that nobody stated; `errors`: whether those that all watches share are there."""

    mount_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    offset_s: float = 0.0
    longer: float = 0.0
    k1: float = 0.0
    errors: bool = True


CASES: dict[str, Case] = {
    "nothing wrong": Case(),
    "nothing wrong, no errors in common": Case(errors=False),
    "tilted by 2 degrees": Case((0.0, 2.0, 0.0)),
    "tilted by 4 degrees": Case((4.0, 0.0, 0.0)),
    "mounted 30 degrees ahead": Case((0.0, 30.0, 0.0)),
    "mounted 90 degrees round": Case((0.0, 0.0, 90.0)),
    "frames 0.15 s late": Case(offset_s=-0.15),
    "lens 3 % longer": Case(longer=0.03),
    "lens 10 % longer": Case(longer=0.1),
    "k1 of 0.05": Case(k1=0.05),
    "k1 of -0.15": Case(k1=-0.15),
}


@dataclass(slots=True)
class Wander:
    """A first-order Gauss-Markov error of `n` axes."""

    sigma: float
    tau_s: float
    rng: np.random.Generator
    n: int = 2
    value: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self.value = self.rng.normal(0.0, self.sigma, self.n)

    def after(self, kept: float) -> FloatArray:
        """The error once a share of it is left."""
        self.value = kept * self.value + self.sigma * math.sqrt(1 - kept**2) * self.rng.standard_normal(self.n)
        return self.value

    def at(self, dt_s: float) -> FloatArray:
        """The error some time later."""
        return self.after(math.exp(-dt_s / self.tau_s))


class Flight:
    """One flight of a camera, by the watches that look at it; `told`: when each spoke first, seconds."""

    def __init__(self, kind: Kind, case: Case, seed: int) -> None:
        self._kind, self._case, self._rng = kind, case, np.random.default_rng([seed, 5])
        self._h_m, self._v_mps, self._lean = HEIGHT_M[kind], SPEED_MPS[kind], LEAN_RAD[kind]
        roll, pitch, yaw = (math.radians(angle) for angle in case.mount_deg)
        self._mount = se3.quat_from_euler(roll, pitch, yaw)
        self._clock, self._attitude = ClockOffset(), AttitudeBuffer()
        self._boresight, self._mounted = Boresight(LEVEL), MountWatch(self._clock, self._attitude, LEVEL)
        self._time, self._bent = CameraTime(self._clock, self._attitude), DistortionWatch(self._clock, self._attitude)
        self._heights, self._lens, self._drift, self._aim = FixHeightWatch(), LensWatch(), ScaleDrift(), Aim()
        self._swings, self._settings = LensSwings(), NavigatorSettings()
        self._belief = seeded(0, (0.0, 0.0), 1.0, 0.3, Drive.AUTOPILOT, self._settings)
        self._tilt, self._yaw = Wander(TILT_RAD, TILT_S, self._rng), Wander(HEADING_RAD, HEADING_S, self._rng, 1)
        self._map, self._gnss = Wander(MAP_M, MAP_S, self._rng), Wander(GNSS_M, GNSS_S, self._rng)
        self._gnss_h, self._relief = Wander(GNSS_H_M, GNSS_H_S, self._rng, 1), Wander(RELIEF, 1.0, self._rng)
        self._patch_s, self._patch_for_s = self._rng.uniform(0.0, PATCH_EVERY_S), self._rng.uniform(2.0, 6.0)
        self._wrong_m, self._wrong_n = np.zeros(2), 0
        self._at_ne_m = np.zeros(2)
        self._before: tuple[int, Quat] | None = None
        self.told: dict[str, float] = {}

    def _heading(self, t_s: float) -> float:
        leg, of_leg_s = divmod(t_s, LEG_S)
        return math.pi / 2 * (leg + min(1.0, max(0.0, (of_leg_s - LEG_S + TURN_S) / TURN_S)))

    def _true(self, t_s: float) -> Quat:
        """The vehicle's attitude: gusts rock it, a plane banks in turns."""
        turning = t_s % LEG_S > LEG_S - TURN_S
        bank = math.radians(30.0) * math.sin(math.pi * (t_s % LEG_S - LEG_S + TURN_S) / TURN_S) if turning else 0.0
        roll = 0.04 * math.sin(1.3 * t_s) + (bank if self._kind == "plane" else 0.0)
        return se3.quat_from_euler(roll, 0.04 * math.cos(0.9 * t_s) - self._lean, self._heading(t_s))

    def _velocity(self, t_s: float) -> FloatArray:
        return self._v_mps * np.array([math.cos(self._heading(t_s)), math.sin(self._heading(t_s))])

    def fly(self, seconds: float) -> dict[str, float]:
        """Fly; when each watch spoke first."""
        steps = round(EVERY_S / ATTITUDE_S)
        for k in range(1, round(seconds / ATTITUDE_S) + 1):
            t_s = k * ATTITUDE_S
            t_ns = round(t_s * S)
            self._at_ne_m = self._at_ne_m + self._velocity(t_s) * ATTITUDE_S
            off = self._tilt.at(ATTITUDE_S) if self._case.errors else np.zeros(2)
            turned = self._yaw.at(ATTITUDE_S)[0] if self._case.errors else 0.0
            q_off = se3.quat_from_vector((float(off[0]), float(off[1]), float(turned)))
            reported = se3.quat_multiply(q_off, self._true(t_s))
            self._clock.on_arrival(t_ns, t_ns)
            self._attitude.add(t_ns, reported, (0.0, 0.0, 0.0))
            if k % steps == 0 and t_s > 3.0:
                self._frame(t_s, reported)
        return self.told

    def _tells(self, name: str, t_s: float, spoke: object) -> None:
        notices = [c for c in spoke if isinstance(c, Notice) and c.to_operator] if isinstance(spoke, list) else spoke
        if notices:
            self.told.setdefault(name, t_s)

    def _frame(self, t_s: float, reported: Quat) -> None:
        t_ns, k = round(t_s * S), round(t_s / EVERY_S)
        rx_ns = t_ns + round(self._rng.uniform(0.02, 0.06) * S)
        frame = self._time.on_frame(FrameRef(rx_ns, t_ns, k, 0, 640, 480, 3))
        true = se3.quat_multiply(self._true(t_s + self._case.offset_s), self._mount)
        v = (*self._velocity(t_s).tolist(), 0.0)
        if self._before is not None:
            turn = self._turn(self._before, (frame.t_ns, true), v)
            self._tells("mount", t_s, self._mounted.on_turn(turn))
            self._tells("distortion", t_s, self._bent.on_turn(turn, LEVEL, v, self._h_m))
            self._tells("distortion doubted", t_s, self._bent.bend > 0)
            self._tells("time", t_s, self._time.on_turn(turn, LEVEL))
        self._before = frame.t_ns, true
        if max(map(abs, self._case.mount_deg)) < 10:  # with others nothing is recognised
            self._fix(t_s, frame, reported, true)

    def _turn(self, before: tuple[int, Quat], now: tuple[int, Quat], v_ned_mps: tuple[float, float, float]) -> Turn:
        seen = se3.quat_multiply(se3.quat_inverse(before[1]), now[1])
        ahead, right, _ = se3.rotate(se3.quat_inverse(now[1]), v_ned_mps)
        way = np.array([ahead, right]) * EVERY_S / self._h_m
        bend = self._relief.after(math.exp(-float(np.hypot(*way)))) if self._case.errors else np.zeros(2)
        bend = bend + np.array([-2 * self._case.k1 * math.cos(self._lean) ** 1.33, 0.0])
        sigma = TURN_RAD + TURN_SHARE * se3.angle_between(seen, LEVEL)
        noise = sigma * self._rng.standard_t(4, 3) / math.sqrt(2)
        by_bend = bend[0] * np.array([way[1], -way[0], 0.0]) + bend[1] * np.array([*way, 0.0])
        turned = se3.quat_multiply(seen, se3.quat_from_vector(tuple((noise + by_bend).tolist())))
        return Turn(before[0], now[0], turned, TURN_COV)

    def _fix(self, t_s: float, frame: FrameRef, reported: Quat, true: Quat) -> None:
        errors, rng = self._case.errors, self._rng
        prior = se3.quat_multiply(reported, self._boresight.q_frd_cambody)
        off = se3.vector_from_quat(se3.quat_multiply(true, se3.quat_inverse(prior)))
        found = se3.quat_multiply(se3.quat_from_vector(tuple(SHARE_OF_TILT * a for a in off)), prior)  # type: ignore[arg-type]
        looked = self._h_m * (_down(true) - _down(found))
        per_focal = self._h_m * _down(found)
        ground_m = self._ground_m(t_s) if errors else 0.0
        map_m, gnss_m = (self._map.at(EVERY_S), self._gnss.at(EVERY_S)) if errors else (np.zeros(2), np.zeros(2))
        gnss_h_m = float(self._gnss_h.at(EVERY_S)[0]) if errors else 0.0
        beside = looked + self._case.longer * per_focal + map_m + FIX_M * rng.standard_normal(2)
        beside = beside + self._velocity(t_s) * self._case.offset_s
        claim = claimed(rng)
        if errors:
            beside = beside + self._mistaken(claim)
        low_m = self._h_m * (1 - 1 / (1 + self._case.longer))
        above_m = ground_m - low_m + HEIGHT_SIGMA_M * float(rng.standard_normal())
        at = self._at_ne_m + beside
        place = wgs84.geo_from_ned((float(at[0]), float(at[1]), -self._h_m - above_m), HOME)
        about = (frame.t_rx_ns, frame.t_ns, frame.frame_id, frame.frame_id, "deep", place)
        pf = float(per_focal[0]), float(per_focal[1])
        fix = Fix(*about, found, COV, HEIGHT_SIGMA_M, 0.02, claim, 60.0, per_focal_ne_m=pf)
        request = LocaliseRequest(frame.frame_id, frame, PosePrior(place, prior, COV, 2.0, 0.03, 0.02), 1)
        self._take(t_s, fix, request, gnss_m - beside)
        self._tells("heights", t_s, self._heights.on_fix(fix, HOME.h_amsl_m + self._h_m + gnss_h_m, self._h_m))
        self._tells("heights doubted", t_s, self._heights.longer_share != 0)
        minus = gnss_m - beside
        sight = Sight(fix.t_ns, (float(at[0]), float(at[1])), COV, pf, (float(minus[0]), float(minus[1])), None)
        self._drift.on_fix(sight, above_m, HEIGHT_SIGMA_M, self._h_m)
        if self._drift.begun:
            self._drift.tell_apart()
            self._tells("zoom", t_s, self._drift.odds > SURE and abs(self._drift.nearer) > NAMED_SHARE)

    def _take(self, t_s: float, fix: Fix, request: LocaliseRequest, minus_ne_m: FloatArray) -> None:
        v = self._velocity(t_s)
        minus, v_ne_mps = (float(minus_ne_m[0]), float(minus_ne_m[1])), (float(v[0]), float(v[1]))
        self._boresight.on_request(request)
        self._tells("boresight", t_s, self._boresight.on_fix(fix, minus, (*v_ne_mps, 0.0), self._h_m))
        self._tells("boresight in use", t_s, bool(np.any(np.abs(self._boresight.used_rad[:2]) > math.radians(0.5))))
        heading = self._heading(t_s)
        told = self._aim.on_fix(fix.t_ns, (-minus[0], -minus[1]), COV, heading, v_ne_mps, self._h_m)
        self._tells("aim", t_s, told)
        self._tells("aim in use", t_s, self._aim.used != 0)
        self._mounted.recognised()
        self._belief = fusion.propagated(self._belief, fix.t_ns, v_ne_mps, self._settings)
        north, east, _ = wgs84.ned_from_geo(fix.place, HOME)
        about = "deep", fix.probability_wrong, 0, apart_m(self._h_m), fix.per_focal_ne_m
        seen = Position(fix.t_ns, (north, east), COV, True, *about)
        self._belief, _ = fusion.observed(self._belief, seen, self._settings)
        self._swings.on_fix(fix.t_ns, fix.per_focal_ne_m, heading, self._h_m)
        self._tells("lens", t_s, self._lens.after(self._belief, self._swings.sigma_share))

    def _ground_m(self, t_s: float) -> float:
        since_s = (t_s - self._patch_s) % PATCH_EVERY_S
        return PATCH_M if since_s < self._patch_for_s else 0.0

    def _mistaken(self, claim: float) -> FloatArray:
        if self._wrong_n == 0 and self._rng.random() < claim:
            self._wrong_n, self._wrong_m = int(self._rng.integers(1, 4)), WRONG_M * self._rng.standard_normal(2)
        if self._wrong_n == 0:
            return np.zeros(2)
        self._wrong_n -= 1
        return self._wrong_m


def _down(q_ned_cambody: Quat) -> FloatArray:
    """(2,) how far the camera looks north and east, over its height."""
    axis = se3.R_from_quat(q_ned_cambody)[:, 2]
    return np.asarray(axis[:2] / axis[2])


WATCHES = (
    "boresight",
    "boresight in use",
    "aim",
    "aim in use",
    "time",
    "mount",
    "zoom",
    "lens",
    "heights",
    "heights doubted",
    "distortion",
    "distortion doubted",
)


def main(argv: Sequence[str] | None = None) -> None:
    """Fly, count, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=1.0, help="of each case and kind of flight")
    parser.add_argument("--minutes", type=float, default=10.0, help="of a flight")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--flights", nargs="+", choices=list(LEAN_RAD), default=list(LEAN_RAD))
    args = parser.parse_args(argv)
    n = max(1, round(args.hours * 60 / args.minutes))
    print("| case, flights | " + " | ".join(WATCHES) + " |")
    print("|" + "---|" * (len(WATCHES) + 1))
    for name in args.cases:
        for kind in args.flights:
            spoke: dict[str, list[float]] = defaultdict(list)
            for k in range(n):
                for watch, t_s in Flight(kind, CASES[name], 1000 * args.seed + k).fly(60 * args.minutes).items():
                    spoke[watch].append(t_s)
            cells = [f"{len(spoke[w])}, {median(spoke[w]):.0f} s" if w in spoke else "0" for w in WATCHES]
            print(f"| {name}, {kind}, {n} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
