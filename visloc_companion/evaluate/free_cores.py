"""How much of this computer is free: other work on it would make a flight in real time late."""

from __future__ import annotations

import os
import subprocess
import sys

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


def free_cores(seconds: float = 1.5, most: int = 2) -> float:
    """Cores that processes of ours get, up to `most`: each computes as hard as it can for so long."""
    n = min(most, len(os.sched_getaffinity(0)))
    command = [sys.executable, "-S", "-E", "-c", PROBE.format(seconds=seconds)]
    probes = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(n)]
    return sum(float(probe.communicate()[0]) for probe in probes)


def affordable_speed(most: float, cores: float) -> float:
    """Times real time that a flight may go on so many free cores, `most` at most."""
    return min(most, max(LEAST_SPEED, most * cores / NEEDED_CORES))
