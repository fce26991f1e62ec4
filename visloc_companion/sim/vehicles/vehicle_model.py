"""What a simulated vehicle, its air and its sensors are like: one set for this project's flights, one for each maker's simulator.

The makers' simulators are kinder than real vehicles in some things (accelerometers without a bias that wanders, air without slow
gusts) and harsher in others. Beside their flights the built-in autopilot has their vehicle; elsewhere it has `USUAL`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from visloc_companion.sim.vehicles.imu import EKF3, NOISY, QUIET, Imu
from visloc_companion.types import Vec3

BITS_PER_BYTE = 10
"""Start bit, eight bits, stop bit."""


@dataclass(frozen=True, slots=True)
class Drag:
    """A copter's drag against the air, each horizontal axis for itself: `per_s` x v + `per_m` x |v| v, in m/s² (v in m/s).

    The default is the linear drag of rotors as a real quadrotor of 2014 shows it (decision 27).
    """

    per_s: float = 0.23
    per_m: float = 0.0


LEAN_RAD = math.radians(30)
"""ArduCopter's ANGLE_MAX."""
BANK_RAD = math.radians(40)
"""Of a plane in its turns; ArduPlane's ROLL_LIMIT_DEG is 45."""


@dataclass(frozen=True, slots=True)
class Accelerometers:
    """1-sigma per axis of what is streamed: a bias that wanders (m/s², in `bias_s`), and white noise of a sample (forward, right,
    down m/s²). The noise of 0.5 is what a real copter's samples show (0.5 to 0.6 m/s² at 50 Hz)."""

    bias_mps2: float = 0.15
    bias_s: float = 100.0
    noise_mps2: Vec3 = (0.5, 0.5, 0.5)


@dataclass(frozen=True, slots=True)
class Tube:
    """A pitot tube: mean and 1-sigma (over flights) of its scale, white noise of a sample in m/s."""

    scale: float = 1.0
    scale_sigma: float = 0.03
    noise_mps: float = 0.3


@dataclass(frozen=True, slots=True)
class AttitudeErrors:
    """1-sigma and correlation times of the estimated attitude's errors, beside the tilt of the filter (sim/vehicles/imu.py)."""

    tilt_rad: float = math.radians(0.3)
    tilt_s: float = 20.0
    yaw_rad: float = math.radians(1.0)
    yaw_s: float = 60.0


@dataclass(frozen=True, slots=True)
class VehicleModel:
    """The whole set. `lean_rad`: what a copter leans at most, `bank_rad` what a plane banks; `gust_share`: 1-sigma of the gusts
    over the mean wind's speed.

    `stamped_early_s`: by how much earlier than it came ArduPilot takes a message to have come: the time that its bytes, and those
    behind it that came at once, would have taken on a line of SERIALn_BAUD (GCS_Common.cpp:7049, receive_time_constraint_us). On
    a real line they did take it.
    """

    imu: Imu = QUIET
    drag: Drag = field(default_factory=Drag)
    lean_rad: float = LEAN_RAD
    bank_rad: float = BANK_RAD
    accelerometers: Accelerometers = field(default_factory=Accelerometers)
    tube: Tube = field(default_factory=Tube)
    attitude: AttitudeErrors = field(default_factory=AttitudeErrors)
    gust_share: float = 0.1
    stamped_early_s: float = 0.0


USUAL = VehicleModel()

POSITION_BYTES, STATUS_BYTES, SITL_BAUD = 129, 250, 921600
"""VISION_POSITION_ESTIMATE and, at once with it every second, ONBOARD_COMPUTER_STATUS, with frames; SERIAL1_BAUD as users are
told to set it (4 ms early; 66 ms with its default of 57600). The least lag of a hundred messages counts (autopilot_clock.py), so
that the second's pair decides for all."""

ARDUPILOT_SITL = VehicleModel(
    imu=EKF3,
    drag=Drag(per_s=0.24, per_m=0.034),
    bank_rad=math.radians(65),
    accelerometers=Accelerometers(bias_mps2=0.0, noise_mps2=(0.15, 0.07, 0.4)),
    tube=Tube(scale=0.906, scale_sigma=0.0, noise_mps=0.63),
    attitude=AttitudeErrors(tilt_rad=0.0, yaw_rad=math.radians(0.6), yaw_s=10.0),
    gust_share=0.0,
    stamped_early_s=(POSITION_BYTES + STATUS_BYTES) * BITS_PER_BYTE / SITL_BAUD,
)
"""SITL of July 2025, from its sources. Drag: momentum drag (SIM_Motor.cpp, coefficient 0.2, disc of 0.385 m², 3 kg) and what is
left of 45 degrees at 15.1 m/s (SIM_Frame.cpp). Accelerometers have no bias (SIM_ACC1_BIAS 0); their noise is that of the streamed
samples' differences (copter). SIM_ARSPD_RATIO is 1.99 where an incompressible flow has 2 / 1.225. Turbulence has another
direction at each step of 0.8 ms (SIM_Aircraft.cpp, update_wind): no gust lasts, but the tube feels 0.7 m/s at each sample.
Its gyroscopes do not tilt it: what its own logs show of tilt on vision (roll and pitch 0.15 to 0.2°, plane 0.25 to 0.29°,
1-sigma; on GNSS the copter's 0.06°) is what its filter makes of positions. Heading: its own logs. Bank: ROLL_LIMIT_DEG of the
flights."""

PX4_SIH = VehicleModel(
    imu=replace(NOISY, assumed_accel_psd=1e-2),
    drag=Drag(per_s=1.0),
    lean_rad=math.radians(45),
    bank_rad=math.radians(50),
    accelerometers=Accelerometers(bias_mps2=0.0, noise_mps2=(0.5, 1.7, 1.4)),
    tube=Tube(scale_sigma=0.0, noise_mps=0.2),
    gust_share=0.0,
)
"""SIH of March 2026, from its sources: SIH_KDV 1.0 over SIH_MASS 1.0, sih.cpp's noise, no air that moves; MPC_TILTMAX_AIR 45,
FW_R_LIM 50. EKF2_ACC_NOISE is 1.0 m/s² at 100 Hz, as in the flights (sim/real/px4.py)."""
