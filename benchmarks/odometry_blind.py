"""What odometry says where nothing can be seen.

    python -m benchmarks.odometry_blind [--seeds 101 102] [--vehicles copter plane] [--keep DIR] [--json FILE]

Rendered flights (odometry_world.py) whose frames 20 to 39 are spoilt: night, starlight, dusk, smear, cloud that drifts, fog,
drops on the lens, or open water in their place: waves of 2 to 20 m that run with the wind, each at its own speed, on the level
plane, with glint.
`blind`: share of these frames that are refused, and why. `wrong`: answered, but off by more than four claimed sigmas (of the
leg). `back after`: so many frames later motion is found again, the longest of all flights; two at least, a keyframe and one more.
"""

from __future__ import annotations

import argparse
import json
import math
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.worlds.odometry_world import MODEL, PERIOD_S, Errors, Flight, flight_of, sights
from visloc_companion.geo.camera import R_FRD_CAM, unproject
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler
from visloc_companion.localise.flow import FrameToFrame
from visloc_companion.localise.odometry.base import Sight, Step
from visloc_companion.types import FloatArray, Image

SPOILT = range(20, 40)
WRONG_SIGMAS = 4.0
WAVES = 48
AMPLIFIED = 20.0
"""1-sigma of a sensor's noise at a gain of 40, grey levels."""
Spoil = Callable[[Flight, int, np.random.Generator], Image]


def night(flight: Flight, k: int, rng: np.random.Generator) -> Image:
    """A twentieth of the light, the sensor's noise as ever."""
    return _noisy(flight.frames[k] * 0.05, rng)


def starlight(flight: Flight, k: int, rng: np.random.Generator) -> Image:
    """A thousandth of the light, amplified by 40."""
    return _noisy(flight.frames[k] * 0.04, rng, AMPLIFIED)


def dusk(flight: Flight, k: int, rng: np.random.Generator) -> Image:
    """A hundredth of the light, amplified by 40, over a pattern of the sensor's own that is half as strong as its noise."""
    own = np.random.default_rng(5).standard_normal(flight.frames[k].shape)
    return _noisy(flight.frames[k] * 0.4 + AMPLIFIED / 2 * own, rng, AMPLIFIED)


def smear(flight: Flight, k: int, rng: np.random.Generator) -> Image:
    """A long exposure while turning: 60 pixels across."""
    return _noisy(cv2.blur(flight.frames[k], (60, 3)).astype(np.float32), rng)


def cloud(flight: Flight, k: int, rng: np.random.Generator) -> Image:
    """Below the craft, drifting past; a twentieth of the ground's contrast is left."""
    veil = cv2.GaussianBlur(np.random.default_rng(7).standard_normal((960, 1280)).astype(np.float32), (0, 0), 60)
    veil = np.roll(veil, 11 * k, 1)[:480, :640] / veil.std()
    return _noisy(0.05 * flight.frames[k] + 175 + 12 * veil, rng)


def fog(flight: Flight, k: int, rng: np.random.Generator) -> Image:
    """A hundredth of the contrast."""
    return _noisy(0.01 * flight.frames[k] + 190, rng)


def lens(flight: Flight, k: int, rng: np.random.Generator) -> Image:
    """Drops on the lens that stay where they are, over a picture of which a tenth of the contrast is left."""
    drops = cv2.GaussianBlur(np.random.default_rng(3).standard_normal((480, 640)).astype(np.float32), (0, 0), 5)
    return _noisy(0.1 * flight.frames[k] + 110 + 25 * drops / drops.std(), rng)


def water(flight: Flight, k: int, rng: np.random.Generator) -> Image:
    """Open water under the true camera."""
    waves = np.random.default_rng(len(flight.name) + int(flight.height_m[0]))
    length = np.exp(waves.uniform(math.log(2.0), math.log(20.0), WAVES))
    angle = waves.normal(0, math.radians(45), WAVES) + waves.uniform(0, 2 * math.pi)
    phase = waves.uniform(0, 2 * math.pi, WAVES)
    number = 2 * math.pi / length
    speed = np.sqrt(9.81 / number)
    ne = _on_plane(flight, k)
    along = [(number[i] * np.array([math.cos(angle[i]), math.sin(angle[i])])).astype(np.float32) for i in range(WAVES)]
    slope = sum(
        np.sin(ne @ a - np.float32(n * c * k * PERIOD_S - p)) for a, n, c, p in zip(along, number, speed, phase, strict=True)
    )
    steep = np.asarray(slope, dtype=np.float32) / math.sqrt(WAVES / 2)
    light = 60 + 10 * steep + 60 * np.maximum(steep - 1.6, 0)
    return _noisy(cv2.resize(light.reshape(240, 320), (640, 480), interpolation=cv2.INTER_LINEAR), rng)


def _on_plane(flight: Flight, k: int) -> FloatArray:
    """(N, 2) north, east that every other pixel sees, float32."""
    v, u = np.mgrid[0:480:2, 0:640:2] + 0.5
    R = R_from_quat(quat_from_euler(*(float(a) for a in flight.euler_rad[k]))) @ R_FRD_CAM
    d = unproject(MODEL, np.column_stack([u.ravel(), v.ravel()])) @ R.T
    height = float(np.median(flight.height_m))
    return np.asarray(flight.p_ned_m[k, :2] + d[:, :2] * (height / np.maximum(d[:, 2:3], 0.1)), dtype=np.float32)


def _noisy(light: FloatArray, rng: np.random.Generator, sigma: float = 2.0) -> Image:
    return np.asarray(np.clip(light + rng.normal(0, sigma, light.shape), 0, 255), dtype=np.uint8)


CASES: dict[str, Spoil] = {case.__name__: case for case in (night, starlight, dusk, smear, cloud, fog, lens, water)}


def judged(flight: Flight, name: str, seed: int) -> dict[str, Any]:
    """Counts of one flight of a case."""
    rng = np.random.default_rng(seed)
    given: list[Sight] = sights(flight, Errors(), rng, "map")
    flow = FrameToFrame(MODEL)
    number = {sight.t_ns: k for k, sight in enumerate(given)}
    reasons, wrong, back = Counter[str](), 0, len(given)
    for k, sight in enumerate(given):
        pixels = CASES[name](flight, k, rng) if k in SPOILT else sight.pixels
        step = flow.step(_with(sight, pixels), flight.surface)
        if isinstance(step, Step):
            wrong += k in SPOILT and _off_sigmas(step, flight, number) > WRONG_SIGMAS
            back = min(back, k) if k > SPOILT[-1] else back
        elif k in SPOILT:
            reasons[step.reason.value] += 1
    return {"frames": len(SPOILT), "blind": sum(reasons.values()), "wrong": wrong, "reasons": reasons, "back": back - SPOILT[-1]}


def _with(sight: Sight, pixels: Image) -> Sight:
    return Sight(pixels, *(getattr(sight, name) for name in Sight.__slots__ if name != "pixels"))


def _off_sigmas(step: Step, flight: Flight, number: dict[int, int]) -> float:
    o = step.odometry
    true = flight.p_ned_m[number[o.t_to_ns]] - flight.p_ned_m[number[o.t_from_ns]]
    e = np.array(o.displacement_ned_m)[:2] - true[:2]
    return float(np.sqrt(e @ np.linalg.solve(np.array(o.cov_ne_m2), e)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[101, 102])
    parser.add_argument("--vehicles", nargs="+", default=["copter", "plane"])
    parser.add_argument("--cases", nargs="+", default=list(CASES))
    parser.add_argument("--keep", type=Path, default=Path("odometry-flights"), help="folder that keeps rendered flights")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    rows = []
    print("| case | frames | blind | wrong | back after | reasons |\n|---|---|---|---|---|---|")
    for name in options.cases:
        some = [judged(flight_of(v, s, options.keep), name, s) for v in options.vehicles for s in options.seeds]
        frames, blind, wrong = (sum(one[what] for one in some) for what in ("frames", "blind", "wrong"))
        reasons: Counter[str] = sum((one["reasons"] for one in some), Counter())
        rows.append({"case": name, "frames": frames, "blind": blind, "wrong": wrong, "reasons": dict(reasons)})
        back = max(one["back"] for one in some)
        why = ", ".join(f"{reason} {n}" for reason, n in reasons.most_common())
        print(f"| {name} | {frames} | {blind / frames:.0%} | {wrong} | {back} | {why} |", flush=True)
    if options.json:
        options.json.write_text(
            json.dumps({"schema": 1, "seeds": options.seeds, "rows": rows}, indent=1) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main()
