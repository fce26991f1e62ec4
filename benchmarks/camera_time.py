"""How soon and how well the time offset of a camera is found in flight, from rendered frames, and what one pair of frames costs.

    python -m benchmarks.camera_time [--seeds 11 12 13 14] [--vehicles copter plane] [--seconds 90] [--latencies -200 0 150 300]
        [--jitter 0 100] [--keep DIR] [--json FILE]

Flights of camera_time_world.py. A frame arrives `latency` after it was taken and bears the time of its arrival (a negative
latency: the configured one is too large), plus a jitter drawn evenly from +- `jitter` ms. Its turn is seen by the worker's code
with the prior attitude that the core gives it, and answered 150 ms later. Odd seeds fly at 10 m/s (copter) and 20 m/s (plane),
even ones at 20 and 25 m/s. Seeds below 10 served for tuning and for the factor of the claims.

found after: when the estimate's 1-sigma is below 10 ms for the first time, median and slowest; unknown: flights in which it
never was. error: of the times that are given to frames from five seconds later on, root mean square and largest; error/sigma:
root mean square. CPU: process time of the worker's part for a frame, beside that of SIFT on the same pictures, and of the core's.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

import cv2
import numpy as np

from benchmarks.worlds.camera_time_world import MODEL, Flight, flight_of
from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.camera.camera_time import SURE_S, CameraTime
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.localise.odometry.rotation import TurnWatch
from visloc_companion.types import FloatArray, FrameRef, Turn

ANSWER_S, CONFIGURED_S, SETTLE_S = 0.15, 0.25, 5.0
START_NS = 10_000_000_000
LEVEL = (1.0, 0.0, 0.0, 0.0)
STILL = (0.0, 0.0, 0.0)


@dataclass(slots=True)
class Learned:
    """One flight: when the offset was known (s, None: never), errors and sigmas of the times given to frames since (s), CPU of
    worker and core for each frame (ms), and the share of frames with a turn."""

    found_s: float | None = None
    error_s: list[float] = field(default_factory=list)
    sigma_s: list[float] = field(default_factory=list)
    worker_ms: float = 0.0
    core_ms: float = 0.0
    turns: float = 0.0


class Pipeline:
    """A camera whose frames arrive late, the worker's part, and the core's."""

    def __init__(self, flight: Flight, latency_s: float, jitter_s: float, seed: int) -> None:
        self._flight, self._latency_s = flight, latency_s
        rng = Random(seed)
        self._configured_s = CONFIGURED_S if latency_s < 0 else 0.0
        late_s = latency_s + self._configured_s
        self._arrivals = [(float(t) + late_s + rng.uniform(-jitter_s, jitter_s), k) for k, t in enumerate(flight.frame_s)]
        self._clock, self._attitude = ClockOffset(), AttitudeBuffer()
        self._camera, self._watch = CameraTime(self._clock, self._attitude), TurnWatch(MODEL)
        self._answers: list[tuple[float, Turn | None]] = []
        self.result = Learned()

    def run(self) -> Learned:
        """Everything in the order of its arrival."""
        flight, result = self._flight, self.result
        moments = [(float(t), 0, k) for k, t in enumerate(flight.attitude_s)]
        moments += [(t, 1, k) for t, k in self._arrivals]
        for t_s, kind, k in sorted(moments):
            if kind == 0:
                self._clock.on_arrival(_ns(t_s), _ns(t_s))
                self._attitude.add(_ns(t_s), tuple(flight.told_q[k]), STILL)
                self._answered(t_s)
            else:
                self._frame(t_s, k)
        frames = len(flight.frames)
        result.worker_ms, result.core_ms, result.turns = (v / frames for v in (result.worker_ms, result.core_ms, result.turns))
        return result

    def _frame(self, t_s: float, k: int) -> None:
        size = (MODEL.width_px, MODEL.height_px, 1)
        started = time.process_time()
        frame = self._camera.on_frame(FrameRef(_ns(t_s), _ns(t_s - self._configured_s), k + 1, 0, *size))
        self.result.core_ms += 1e3 * (time.process_time() - started)
        found_s = self.result.found_s
        if found_s is None and self._camera.estimate.sigma_s <= SURE_S:
            self.result.found_s = t_s
        if found_s is not None and t_s > found_s + SETTLE_S:
            self.result.error_s.append((frame.t_ns - START_NS) * 1e-9 - float(self._flight.frame_s[k]))
            self.result.sigma_s.append(self._camera.sigma_s)
        newest = self._attitude.newest_boot_ns() or 0
        prior = self._attitude.at(frame.t_ns) or self._attitude.at(newest)
        if prior is None:
            return
        started = time.process_time()
        turn = self._watch.step(self._flight.frames[k], frame.t_ns, prior).since_last
        self.result.worker_ms += 1e3 * (time.process_time() - started)
        self.result.turns += turn is not None
        self._answers.append((t_s + ANSWER_S, turn))

    def _answered(self, t_s: float) -> None:
        while self._answers and self._answers[0][0] <= t_s:
            started = time.process_time()
            self._camera.on_turn(self._answers.pop(0)[1], LEVEL)
            self.result.core_ms += 1e3 * (time.process_time() - started)


def _ns(t_s: float) -> int:
    return START_NS + round(t_s * 1e9)


def figures(some: list[Learned]) -> dict[str, Any]:
    """Figures of a row."""
    found = [r.found_s for r in some if r.found_s is not None]
    error, sigma = (np.concatenate([getattr(r, name) for r in some]) for name in ("error_s", "sigma_s"))
    return {
        "flights": len(some),
        "unknown": len(some) - len(found),
        "found_s": [float(np.median(found)), max(found)] if found else None,
        "error_ms": [1e3 * _rms(error), 1e3 * float(np.abs(error).max())] if len(error) else None,
        "error_over_sigma": _rms(error / sigma) if len(error) else None,
        "turns": float(np.mean([r.turns for r in some])),
        "worker_ms": float(np.median([r.worker_ms for r in some])),
        "core_ms": float(np.median([r.core_ms for r in some])),
    }


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def sift_ms(flight: Flight) -> float:
    """Process time of SIFT (detection and description) on some of the pictures."""
    sift = cv2.SIFT_create()
    times = []
    for frame in flight.frames[:: len(flight.frames) // 3]:
        started = time.process_time()
        sift.detectAndCompute(frame, None)
        times.append(1e3 * (time.process_time() - started))
    return float(np.median(times))


def line(row: dict[str, Any]) -> str:
    """Markdown."""
    found = "never" if row["found_s"] is None else "{:.0f}, {:.0f} s".format(*row["found_s"])
    error = "" if row["error_ms"] is None else "{:.1f}, {:.1f} ms".format(*row["error_ms"])
    ratio = "" if row["error_over_sigma"] is None else f"{row['error_over_sigma']:.2f}"
    cost = f"{row['worker_ms']:.1f}, {row['worker_ms'] / row['sift_ms']:.3f}, {row['core_ms']:.2f}"
    head = f"| {row['vehicle']} | {row['latency_ms']:.0f} | {row['jitter_ms']:.0f} | {row['flights']} | {row['unknown']} "
    return f"{head}| {found} | {error} | {ratio} | {row['turns']:.0%} | {cost} |"


HEAD = [
    "| flight | latency ms | jitter ms | flights | unknown | found after | error | error/sigma | turns | CPU ms, of SIFT, core |",
    "|---|---|---|---|---|---|---|---|---|---|---|",
]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[11, 12, 13, 14])
    parser.add_argument("--vehicles", nargs="+", default=["copter", "plane"])
    parser.add_argument("--seconds", type=float, default=90.0)
    parser.add_argument("--latencies", type=float, nargs="+", default=[-200.0, 0.0, 150.0, 300.0])
    parser.add_argument("--jitter", type=float, nargs="+", default=[0.0, 100.0])
    parser.add_argument("--keep", type=Path, default=Path("camera-time-flights"), help="folder that keeps rendered flights")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    rows: list[dict[str, Any]] = []
    print("\n".join(HEAD), flush=True)
    for vehicle in options.vehicles:
        flights = [flight_of(vehicle, seed, options.seconds, options.keep) for seed in options.seeds]
        sift = float(np.median([sift_ms(flight) for flight in flights]))
        for jitter in options.jitter:
            for latency in options.latencies:
                some = [
                    Pipeline(f, 1e-3 * latency, 1e-3 * jitter, seed).run() for f, seed in zip(flights, options.seeds, strict=True)
                ]
                rows.append({"vehicle": vehicle, "latency_ms": latency, "jitter_ms": jitter, "sift_ms": sift, **figures(some)})
                print(line(rows[-1]), flush=True)
    if options.json:
        text = json.dumps({"schema": 1, "seeds": options.seeds, "rows": rows}, indent=1, allow_nan=False)
        options.json.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
