"""How much of this computer is free, and how fast it is: other work, or slow cores, would make a flight in real time late."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from statistics import median

import cv2
import numpy as np

from visloc_companion.types import FloatArray

PROBE = """
import time
end, used = time.monotonic() + {seconds}, time.process_time()
while time.monotonic() < end:
    pass
print((time.process_time() - used) / {seconds})
"""
NEEDED_CORES = 1.5
"""At the demonstration's full speed, twice real time: 200 s of flight take three processes 132 s of CPU, in bursts."""
LEAST_SPEED = 0.4
QUIET_S = 8.36e-3
"""CPU seconds of `search_work_s` on the computer that docs/benchmarks.md states times for, with nothing beside it. That it was
the one of NEEDED_CORES is an assumption."""
SIDE, TIMES = 768, 15


def free_cores(seconds: float = 1.5, most: int = 2) -> float:
    """Cores that processes of ours get, up to `most`: each computes as hard as it can for so long."""
    n = min(most, len(os.sched_getaffinity(0)))
    command = [sys.executable, "-S", "-E", "-c", PROBE.format(seconds=seconds)]
    probes = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(n)]
    return sum(float(probe.communicate()[0]) for probe in probes)


def search_field() -> FloatArray:
    """What `search_work_s` computes with: (768, 768, 2), drawn once and for all."""
    return np.random.default_rng(1).standard_normal((SIDE, SIDE, 2)).astype(np.float32)


def search_work_s(field: FloatArray) -> float:
    """CPU seconds of a fixed piece of work of the map search's kind: a correlation by Fourier transforms."""
    begun = time.process_time()
    spectrum = cv2.dft(field, flags=cv2.DFT_COMPLEX_OUTPUT)
    product = cv2.mulSpectrums(spectrum, spectrum, 0, conjB=True)
    score = cv2.idft(product)[..., 0]
    np.maximum(score, 0.0).max()
    return time.process_time() - begun


def slower() -> float:
    """By what factor a core of this computer takes longer for the search's kind of work than the one of QUIET_S, at least 1."""
    field, threads = search_field(), cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        return max(1.0, median(search_work_s(field) for _ in range(TIMES)) / QUIET_S)
    finally:
        cv2.setNumThreads(threads)


def affordable_speed(most: float, cores: float, longer: float = 1.0) -> float:
    """Times real time that a flight may go on so many free cores, `most` at most; `longer`: by what factor a search takes longer
    on them, which is taken to be half of the CPU time (an assumption)."""
    return min(most, max(LEAST_SPEED, most * cores / (NEEDED_CORES * (1 + longer) / 2)))
