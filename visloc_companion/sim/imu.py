"""What the simulated autopilot's accelerometers and gyroscopes get wrong."""

from __future__ import annotations

from dataclasses import dataclass

TILT_TAU_S = 60.0
"""What gravity itself tells of the tilt bounds its random walk in the long run."""


@dataclass(frozen=True, slots=True)
class Imu:
    """What the accelerometers and gyroscopes get wrong, and what the autopilot's filter assumes of it, per axis.

    `noise_mps2` is white, of a sample of 10 ms. `tilt_psd` is the spectral density, as an acceleration (m²/s⁵), of the random
    walk by which gyroscope noise tilts the attitude; the filter estimates that tilt where it assumes one (`assumed_tilt_psd`).
    `assumed_accel_psd` is in m²/s³.
    """

    noise_mps2: float
    tilt_psd: float
    assumed_accel_psd: float
    assumed_tilt_psd: float


QUIET = Imu(0.1, 0.0, 0.16, 0.0)
"""ArduPilot's simulator: fitted to its error (rms) at several rates of positions (tests/unit/sim/test_autopilot_ardupilot.py)."""
EKF3 = Imu(0.1, 0.0, 1.2e-3, 2.2e-4)
"""The same vehicle with what ArduPilot's filter assumes: 0.35 m/s² (EK3_ACC_P_NSE) and 0.015 rad/s (EK3_GYRO_P_NSE) at 100 Hz. It
takes the false acceleration of a position that goes wrong for a tilt of its own: in the real one's flights the accelerations
answer a correction of 1 m by 0.05 m/s² after 2 s and by half of that after 5 s (decision 21)."""
NOISY = Imu(0.79, 4.7e-3, 1.2e-3, 2.2e-4)
"""PX4's simulator (SIH, sih.cpp of March 2026) draws 0.5 and 1.7 m/s², 0.14 and 0.07 rad/s (forward, right) at 250 Hz; EKF2 takes
0.35 m/s² (EKF2_ACC_NOISE) and 0.015 rad/s (EKF2_GYR_NOISE) at 100 Hz. In flight on vision its roll was off by 1.2° (1-sigma)."""
