"""Our filter and EKF2's in a row, as a model: `python -m benchmarks.two_filters`.

What PX4 makes of our positions depends on both filters, on how late each takes what it is told, and on a loop: accelerations that
drive ours are turned by an attitude that EKF2 corrects by what we send. Here are both, one horizontal axis at a time, linear,
with the gains of their own settings; the truth stands still, so states are errors. Ours: position, velocity, error of the
accelerations; fixes are late. EKF2: position, velocity, tilt (as an acceleration); it takes a position `horizon_s` after it was
true, and its output follows with `tau_s`. Printed is the 95 % horizontal error (of two axes) of what is sent and of what PX4
flies by, and the least that any filter could reach that knew the sensors.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import numpy as np

from visloc_companion.core.filter.fusion import TILT_MPS2_PER_M
from visloc_companion.core.output import stream_sigma_m
from visloc_companion.types import FloatArray

G_MPS2, STEP_S, SENSOR_HZ, EKF_S, SEND_S = 9.81, 0.05, 250.0, 0.01, 0.1
OURS_TAU_S, OURS_WHITE_M2PS3, OURS_WALK_M2PS = 20.0, 0.0144, 0.0025
"""Of our own filter: correlation of the accelerations' error, white noise, walk of the position."""
POSITION, VELOCITY = np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 1.0, 0.0]])


@dataclass(frozen=True, slots=True)
class Sensors:
    """1-sigma at 250 Hz of the accelerometer and the gyroscope of two axes, and what we learn of the accelerations' error."""

    force_mps2: tuple[float, float]
    gyro_radps: tuple[float, float]
    learned_mps2: float


@dataclass(frozen=True, slots=True)
class Fixes:
    """White fixes, `late_s` old when they are taken."""

    every_s: float
    late_s: float
    sigma_m: float = 0.7


@dataclass(frozen=True, slots=True)
class Ekf2:
    """Its settings, and what positions (and velocities, where they are sent) claim. `age_s`: how old a position is made."""

    claimed_m: float = 0.84
    claimed_mps: float | None = None
    acc_noise: float = 0.35
    gyr_noise: float = 0.015
    tau_s: float = 0.25
    horizon_s: float = 0.15
    age_s: float = 0.0


SENSORS = {
    "PX4's simulator": Sensors((1.7, 0.5), (0.14, 0.07), 0.29),
    "medium": Sensors((0.5, 0.5), (0.03, 0.03), 0.1),
    "quiet": Sensors((0.16, 0.16), (0.005, 0.005), 0.05),
}
FLIGHTS = {
    "jam": Fixes(0.25, 0.25),
    "late": Fixes(0.6, 0.55),
    "late_pictures": Fixes(0.25, 0.55),
    "fewer, no later": Fixes(0.6, 0.25),
    "fixes_1_hz": Fixes(1.0, 0.25),
}
SETTINGS = {
    "as it was": Ekf2(),
    "EKF2_TAU_* 0.1": Ekf2(tau_s=0.1),
    "EKF2_ACC_NOISE 1": Ekf2(acc_noise=1.0),
    "EKF2_GYR_NOISE 0.1, EKF2_ACC_NOISE 1": Ekf2(acc_noise=1.0, gyr_noise=0.1),
    "both EKF2_TAU_* and EKF2_ACC_NOISE": Ekf2(acc_noise=1.0, tau_s=0.1),
    "these, 0.5 m claimed": Ekf2(acc_noise=1.0, tau_s=0.1, claimed_m=0.5),
    "these, positions 0.15 s old": Ekf2(acc_noise=1.0, tau_s=0.1, age_s=0.15),
    "0.5 m claimed": Ekf2(claimed_m=0.5),
    "0.3 m claimed": Ekf2(claimed_m=0.3),
    "ODOMETRY, 0.5 m/s claimed": Ekf2(claimed_mps=0.5),
    "ODOMETRY, 0.5 m and 0.5 m/s": Ekf2(claimed_mps=0.5, claimed_m=0.5),
}


def moving(dt_s: float, keeps: float = 1.0) -> FloatArray:
    """Transition (3, 3) of position, velocity and acceleration, of which a share stays."""
    return np.array([[1.0, dt_s, dt_s**2 / 2], [0.0, 1.0, dt_s], [0.0, 0.0, keeps]])


def _taken(P: FloatArray, H: FloatArray, variance: float) -> tuple[FloatArray, FloatArray]:
    gain = (P @ H.T / (H @ P @ H.T + variance)).ravel()
    return gain, P - np.outer(gain, H @ P)


def our_gain(fixes: Fixes, sensors: Sensors) -> FloatArray:
    """The steady gain (3,) of a fix."""
    keeps = float(np.exp(-STEP_S / OURS_TAU_S))
    F, noise = moving(STEP_S, keeps), sensors.learned_mps2**2 * (1 - keeps**2)
    Q, P = np.diag([OURS_WALK_M2PS * STEP_S, OURS_WHITE_M2PS3 * STEP_S, noise]), np.eye(3)
    gain = np.zeros(3)
    for _ in range(300):
        for _ in range(round(fixes.every_s / STEP_S)):
            P = F @ P @ F.T + Q
        before = P[0, 0]
        gain, P = _taken(P, POSITION, fixes.sigma_m**2)
        P[2, 2] += TILT_MPS2_PER_M**2 * (before - P[0, 0])
    return gain


def ekf2_gains(told: Ekf2) -> tuple[FloatArray, FloatArray]:
    """The steady gains (3,) of a position and of a velocity (zeros where none is sent), ten a second."""
    F, P = moving(EKF_S), np.eye(3)
    Q = np.diag([0.0, (told.acc_noise * EKF_S) ** 2, (told.gyr_noise * EKF_S * G_MPS2) ** 2])
    position = velocity = np.zeros(3)
    for _ in range(1500):
        for _ in range(round(SEND_S / EKF_S)):
            P = F @ P @ F.T + Q
        if told.claimed_mps is not None:
            velocity, P = _taken(P, VELOCITY, told.claimed_mps**2)
        position, P = _taken(P, POSITION, told.claimed_m**2)
    return position, velocity


def flown(fixes: Fixes, sensors: Sensors, told: Ekf2, axis: int, n: int = 64, seconds: float = 220.0) -> FloatArray:
    """Errors (steps, 2, n) of the position that is sent and of the one that PX4 flies by, in n flights along an axis."""
    rng, ours, (ekf_p, ekf_v) = np.random.default_rng(axis), our_gain(fixes, sensors), ekf2_gains(told)
    white = sensors.force_mps2[axis] * np.sqrt(STEP_S / SENSOR_HZ)
    walk = sensors.gyro_radps[axis] * G_MPS2 * np.sqrt(STEP_S / SENSOR_HZ)
    fix_n, late_n, send_n, age_n = (round(s / STEP_S) for s in (fixes.every_s, fixes.late_s, SEND_S, told.age_s))
    horizon_n = max(round(told.horizon_s / STEP_S), age_n)
    F1, F2 = moving(STEP_S, float(np.exp(-STEP_S / OURS_TAU_S))), moving(STEP_S)
    sent, theirs, output = np.zeros((late_n + age_n + 1, 3, n)), np.zeros((horizon_n + 1, 3, n)), np.zeros((3, n))
    follows = np.array([STEP_S / told.tau_s] * 2 + [min(1.0, STEP_S / (2 * told.horizon_s))])[:, None]
    queue: list[tuple[int, FloatArray]] = []
    errors = []
    for step in range(round(seconds / STEP_S)):
        shaken, tilted = white * rng.standard_normal(n), walk * rng.standard_normal(n)
        driven = np.stack((STEP_S**2 / 2 * output[2], STEP_S * output[2] + shaken, np.zeros(n)))
        sent = np.concatenate(((F1 @ sent[0] + driven)[None], sent[:-1]))
        disturbed = np.stack((np.zeros(n), shaken, tilted))
        theirs, output = np.concatenate(((F2 @ theirs[0] + disturbed)[None], theirs[:-1])), F2 @ output + disturbed
        if step % fix_n == 0:
            innovation = fixes.sigma_m * rng.standard_normal(n) - sent[late_n, 0]
            sent = _corrected(sent, F1, late_n, np.outer(ours, innovation))
        if step % send_n == 0:
            queue.append((step - age_n, sent[age_n].copy()))
        while queue and queue[0][0] + horizon_n <= step:
            told_now = queue.pop(0)[1]
            theirs = _corrected(theirs, F2, horizon_n, np.outer(ekf_v, told_now[1] - theirs[horizon_n, 1]))
            theirs = _corrected(theirs, F2, horizon_n, np.outer(ekf_p, told_now[0] - theirs[horizon_n, 0]))
        output = output + follows * (theirs[0] - output)
        errors.append((sent[0, 0], output[0]))
    return np.array(errors)[len(errors) // 10 :]


def _corrected(history: FloatArray, F: FloatArray, at: int, by: FloatArray) -> FloatArray:
    """States (steps back, 3, n) with a correction of the one `at` steps ago carried to all others."""
    changed, forward = history.copy(), by
    back: FloatArray = by
    for k in range(at, -1, -1):
        changed[k] += forward
        forward = F @ forward
    for k in range(at + 1, len(history)):
        back = np.linalg.solve(F, back)
        changed[k] += back
    return changed


def least_sigma_m(fixes: Fixes, sensors: Sensors, axis: int) -> float:
    """1-sigma of the present position of the best filter along an axis, in the mean over the time between two fixes."""
    F, P = moving(STEP_S), np.eye(3)
    walk = (sensors.gyro_radps[axis] * G_MPS2) ** 2
    Q = np.diag([0.0, sensors.force_mps2[axis] ** 2, walk]) * STEP_S / SENSOR_HZ
    for _ in range(2000):
        for _ in range(round(fixes.every_s / STEP_S)):
            P = F @ P @ F.T + Q
        _, P = _taken(P, POSITION, fixes.sigma_m**2)
    variances = []
    for k in range(round((fixes.late_s + fixes.every_s) / STEP_S)):
        P = F @ P @ F.T + Q
        variances.append(P[0, 0] if k * STEP_S >= fixes.late_s else np.nan)
    return float(np.sqrt(np.nanmean(variances)))


def p95_m(north: FloatArray, east: FloatArray) -> float:
    """95 % of horizontal errors, m."""
    return float(np.percentile(np.hypot(north, east), 95))


def main() -> None:
    """Print a table for each kind of sensors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensors", nargs="*", choices=SENSORS, default=list(SENSORS))
    parser.add_argument("--flights-an-axis", type=int, default=64)
    args = parser.parse_args()
    for name in args.sensors:
        sensors = SENSORS[name]
        white = np.random.default_rng(0).standard_normal((2, 100_000))
        least = [p95_m(*(white[a] * least_sigma_m(f, sensors, a) for a in (0, 1))) for f in FLIGHTS.values()]
        print(f"\n{name}: 95 % m, sent and flown by\n\n| settings | {' | '.join(FLIGHTS)} |\n|---|{'---|' * len(FLIGHTS)}")
        print(f"| least possible | {' | '.join(f'{value:.2f}' for value in least)} |")
        for setting, told in SETTINGS.items():
            cells = []
            for fixes in FLIGHTS.values():
                ours_m = max(told.claimed_m, _claim_m(fixes, sensors)) if told.claimed_m == Ekf2().claimed_m else told.claimed_m
                both = [flown(fixes, sensors, replace(told, claimed_m=ours_m), axis, args.flights_an_axis) for axis in (0, 1)]
                cells.append(" and ".join(f"{p95_m(both[0][:, k], both[1][:, k]):.2f}" for k in (0, 1)))
            print(f"| {setting} | {' | '.join(cells)} |", flush=True)


def _claim_m(fixes: Fixes, sensors: Sensors) -> float:
    """What positions claim at least."""
    return stream_sigma_m(fixes.sigma_m**2 * fixes.every_s, sensors.learned_mps2, 1 / SEND_S)


if __name__ == "__main__":
    main()
