"""What the simulated autopilot's accelerometers and gyroscopes get wrong."""

from __future__ import annotations

from dataclasses import dataclass

from visloc_companion.types import Vec2

TILT_TAU_S = 60.0
"""What gravity itself tells of the tilt bounds its random walk in the long run."""


@dataclass(frozen=True, slots=True)
class Imu:
    """What the accelerometers and gyroscopes get wrong, and what the autopilot's filter assumes of it, per axis.

    `noise_mps2` (forward, right) is white, of a sample of 10 ms. `tilt_psd` is the spectral density, as an acceleration (m²/s⁵),
    of the random walk by which gyroscope noise tilts the attitude: a false pitch accelerates forward, a false roll to the right.
    The filter estimates that tilt where it assumes one (`assumed_tilt_psd`), and the bias of the gyroscope that lets it grow
    (`assumed_drift_psd`, m²/s⁷, of the bias's walk as an acceleration). `assumed_accel_psd` is in m²/s³.
    """

    noise_mps2: Vec2
    tilt_psd: Vec2
    assumed_accel_psd: float
    assumed_tilt_psd: float
    assumed_drift_psd: float = 0.0


QUIET = Imu((0.1, 0.1), (0.0, 0.0), 0.16, 0.0)
"""ArduPilot's simulator: fitted to its error (rms) at several rates of positions (tests/unit/sim/test_autopilot_ardupilot.py)."""
EKF3 = Imu((0.1, 0.1), (0.0, 0.0), 1.5e-3, 2.7e-4, 1.2e-6)
"""The same vehicle with what ArduPilot's filter assumes: 0.35 m/s² (EK3_ACC_P_NSE), 0.015 rad/s (EK3_GYRO_P_NSE) and gyroscopes'
biases that walk by 0.001 rad/s² (EK3_GBIAS_P_NSE), each of a step of 12.4 ms (EKF_TARGET_DT is 12; XKT of its logs). It takes the
false acceleration of a position that goes wrong for a tilt of its own: in the real one's flights the accelerations answer a
correction of 1 m by 0.05 m/s² after 2 s and by half of that after 5 s (decision 21). By four logs of ArduPlane and two of
ArduCopter with a fix in 2 s (EKF against the simulator's truth, on vision) that is 89 and 94 % of what changes the attitude's
error: 0.025 m/s³ a metre of innovation where positions claim 2.2 m, and 0.0235 where 3.13 m; this filter has 0.034 and 0.025, and
without the biases 0.023 and 0.016."""
NOISY = Imu((0.32, 1.08), (1.9e-3, 7.5e-3), 1.2e-3, 2.2e-4, 9.6e-7)
"""PX4's simulator (SIH, sih.cpp of March 2026) draws 0.5 and 1.7 m/s² (forward, right), 0.14 and 0.07 rad/s (about forward: roll,
about right: pitch) at 250 Hz; EKF2 takes 0.35 m/s² (EKF2_ACC_NOISE), 0.015 rad/s (EKF2_GYR_NOISE) and gyroscopes' biases that
walk by 0.001 rad/s² (EKF2_GYR_B_NOISE) at 100 Hz. In flight on vision its roll was off by 1.2°, its pitch by 0.7° (1-sigma)."""
