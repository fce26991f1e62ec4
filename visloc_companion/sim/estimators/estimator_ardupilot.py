"""ArduPilot's EKF3 as far as position sources, gates, resets and time-outs go (autopilot facts, sections 1 and 5)."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

from visloc_companion.sim.estimators.estimator import Fixed, InertialFilter
from visloc_companion.sim.estimators.estimator_airspeed import WindDeadReckoning
from visloc_companion.sim.estimators.estimator_status import EstimatorHealth, ExternalPosition, GnssMeasurement
from visloc_companion.types import Vec3

SOURCE_GPS, SOURCE_EXTERNAL = 3, 6
RETRY_S, RETRY_WITH_VELOCITY_S, STOP_AIDING_S, GLITCH_AFTER_S = 7.0, 10.0, 15.0, 2.0
PLANE_ABSOLUTE_S = 10.4
GRACE_S = 1.0
"""A position that GNSS velocity carries stays declared until the reset that ends the rejections."""
MIN_INTERVAL_S = 0.02
DEAD_RECKONED_S = 1.0
GPS_POSITION_SIGMA_M, GPS_VELOCITY_SIGMA_MPS, VELOCITY_GATE_SIGMA = 0.5, 0.3, 5.0
FLAGS_GOOD, FLAGS_COASTING, FLAGS_UNAIDED, FLAGS_PLANE_RELATIVE, FLAG_GLITCH = 0x33F, 0x25, 0xA7, 0x12F, 0x8000
HEIGHT_FALLBACK_S = 0.5


def position_error_m(var_ned_m2: tuple[float, float, float], floor_m: float) -> tuple[float, bool]:
    """ArduPilot's single position error of a message, and whether NaN entries raised an internal error.

    posErr = cbrt(c0² + c6² + c11²) held within [floor, 100]; a NaN in c0 counts as unknown, a NaN beside a finite c0 gives
    the middle of the range and an internal error (GCS_Common.cpp:4046, AP_Math.cpp:270).
    """
    if math.isnan(var_ned_m2[0]):
        return floor_m, False
    cubed = sum(v * v for v in var_ned_m2)
    if math.isnan(cubed):
        return (floor_m + 100.0) / 2, True
    return min(max(cubed ** (1 / 3), floor_m), 100.0), False


class ArduPilotEstimator:
    """Fuses what the active source set names, and nothing else; switches only when told (`use_set`)."""

    def __init__(self, filter_: InertialFilter, parameters: Mapping[str, float], plane: bool) -> None:
        self.filter = filter_
        self.active_set = 1
        self._parameters = parameters
        self._wind = WindDeadReckoning() if plane else None
        self._gnss: deque[GnssMeasurement] = deque()
        self._external: deque[ExternalPosition] = deque()
        self._last_pass_s = self._last_velocity_pass_s = self._last_external_s = self._last_height_s = -math.inf
        self._ever_aided, self._stopped, self._reset_wanted, self._started = False, False, True, False
        self._reset_counter: int | None = None
        self._position_ratio = self._velocity_ratio = 0.0
        self._internal_error = self._internal_error_told = False

    def start_aided(self) -> None:
        """Begin as after an alignment on GNSS: the present state counts as accepted."""
        self._ever_aided, self._reset_wanted = True, False
        self._last_pass_s = self._last_velocity_pass_s = self.filter.t_s

    def use_set(self, number: int) -> None:
        """MAV_CMD_SET_EKF_SOURCE_SET: the next sample of the new set's source resets the position."""
        if number != self.active_set:
            self.active_set, self._reset_wanted = number, True

    @property
    def _source(self) -> int:
        return int(self._parameters[f"EK3_SRC{self.active_set}_POSXY"])

    def on_gnss(self, measurement: GnssMeasurement) -> None:
        """Take a receiver's sample."""
        self._gnss.append(measurement)

    def on_external(self, external: ExternalPosition) -> None:
        """Take an external position: at most 50 Hz, finite, and if it is older than the horizon as if it were younger."""
        if external.t_rx_s - self._last_external_s < MIN_INTERVAL_S or not all(map(math.isfinite, external.p_ned_m)):
            return
        self._last_external_s = external.t_rx_s
        self._external.append(external)

    def on_estimate(self, t_s: float, p_ned_m: Vec3, sigma_m: float) -> bool:
        """A position between which a plane dead-reckons: the filter is put there, and nothing counts as fused.

        Refused within a second of the last position fused, and without any aiding (PosVelFusion.cpp:191).
        """
        if self._age_s < DEAD_RECKONED_S or self._stopped or not self._ever_aided:
            return False
        filter_, lag_s = self.filter, self.filter.t_delayed_s - t_s
        north, east = (p_ned_m[0] + filter_.north.v * lag_s, p_ned_m[1] + filter_.east.v * lag_s)
        variance = max(sigma_m, GPS_POSITION_SIGMA_M) ** 2
        filter_.reset_to(Fixed(filter_.t_delayed_s, north, east, variance, variance))
        return True

    @property
    def external_healthy(self) -> bool:
        """Whether a message came within 300 ms (AP_VisualOdom_Backend.cpp:33)."""
        return self.filter.t_s - self._last_external_s < 0.3

    def step(self, air_velocity_ne_mps: tuple[float, float] | None) -> list[str]:
        """Fuse what is due; returns texts for the operator."""
        texts: list[str] = []
        while self._gnss and self._gnss[0].sample.t_s <= self.filter.t_delayed_s:
            measurement = self._gnss.popleft()
            if self._source == SOURCE_GPS and measurement.sample.has_fix:
                self._fuse_gnss(measurement)
        delay_s = min(self._parameters["VISO_DELAY_MS"], 250.0) / 1000
        while self._external and self._external[0].t_s - delay_s <= self.filter.t_delayed_s:
            self._take_external(self._external.popleft())
        self.filter.fuse_baro(use=not self._height_external)
        if self._internal_error and not self._internal_error_told:
            self._internal_error_told = True
            texts.append("Internal Errors 0x400")
        if self._wind is not None and air_velocity_ne_mps is not None:
            self._wind.step(self.filter, air_velocity_ne_mps, self._age_s < 1.0)
        elif self._age_s > STOP_AIDING_S:
            if self._ever_aided and not self._stopped:
                texts.append("EKF3 IMU0 stopped aiding")
            self._stopped = self._reset_wanted = True
            self.filter.hold()
        return texts

    @property
    def _age_s(self) -> float:
        return self.filter.t_s - self._last_pass_s

    @property
    def _retry_s(self) -> float:
        with_velocity = self.filter.t_delayed_s - self._last_velocity_pass_s < 1.0
        return RETRY_WITH_VELOCITY_S if with_velocity else RETRY_S

    @property
    def _height_external(self) -> bool:
        fresh = self.filter.t_s - self._last_height_s < HEIGHT_FALLBACK_S
        return int(self._parameters[f"EK3_SRC{self.active_set}_POSZ"]) == SOURCE_EXTERNAL and fresh

    def _fuse_gnss(self, measurement: GnssMeasurement) -> None:
        sample, filter_ = measurement.sample, self.filter
        v, false_v = sample.v_ned_mps, sample.false_v_ned_mps
        variance_v = GPS_VELOCITY_SIGMA_MPS**2
        self._velocity_ratio = filter_.velocity_ratio(v[0], v[1], variance_v, VELOCITY_GATE_SIGMA)
        if self._velocity_ratio < 1.0:
            filter_.north.correct_velocity(v[0], variance_v, false_v[0])
            filter_.east.correct_velocity(v[1], variance_v, false_v[1])
            self._last_velocity_pass_s = filter_.t_delayed_s
        variance = max(GPS_POSITION_SIGMA_M, sample.h_acc_m) ** 2
        p, false = measurement.p_local_m, sample.false_ned_m
        fix = Fixed(sample.t_s, p[0], p[1], variance, variance, false[0], false[1])
        if self._fuse_position(fix):
            filter_.north.reset_velocity(v[0], variance_v, false_v[0])
            filter_.east.reset_velocity(v[1], variance_v, false_v[1])

    def _take_external(self, external: ExternalPosition) -> None:
        error_m, internal_error = position_error_m(external.var_ned_m2, self._parameters["VISO_POS_M_NSE"])
        if self._source == SOURCE_EXTERNAL:
            self._internal_error |= internal_error
            if external.reset_counter != self._reset_counter:
                self._reset_wanted |= self._reset_counter is not None
                self._reset_counter = external.reset_counter
            p = external.p_ned_m
            self._fuse_position(Fixed(external.t_s, p[0], p[1], error_m**2, error_m**2))
        if int(self._parameters[f"EK3_SRC{self.active_set}_POSZ"]) == SOURCE_EXTERNAL:
            self._last_height_s = self.filter.t_s
            self.filter.down.correct_position(external.p_ned_m[2], min(max(error_m, 0.1), 10.0) ** 2, 0.0)

    def _fuse_position(self, fix: Fixed) -> bool:
        """Fuse, reject or reset; True where the position was reset."""
        filter_, now = self.filter, self.filter.t_delayed_s
        gate = max(self._parameters["EK3_POS_I_GATE"] / 100, 1.0)
        ratio = filter_.ratio(fix, gate)
        self._position_ratio = ratio
        if self._reset_wanted or now - self._last_pass_s > self._retry_s:
            filter_.reset_to(fix)
            self._position_ratio, self._reset_wanted, self._stopped, self._ever_aided = 0.0, False, False, True
            self._last_pass_s = now
            return True
        if ratio >= 1.0 and self._parameters["EK3_GLITCH_RAD"] <= 0:
            fix = Fixed(
                fix.t_s, fix.north_m, fix.east_m, fix.var_north_m2 * ratio, fix.var_east_m2 * ratio,
                fix.false_north_m, fix.false_east_m,
            )  # fmt: skip
        elif ratio >= 1.0:
            return False
        filter_.fuse(fix)
        self._last_pass_s = now
        return False

    def health(self) -> EstimatorHealth:
        """EKF_STATUS_REPORT's flags and ratios. A plane keeps relative position on airspeed after the absolute one."""
        age, plane = self._age_s, self._wind is not None
        if age < (PLANE_ABSOLUTE_S if plane else self._retry_s + (GRACE_S if self._retry_s > RETRY_S else 0.0)):
            flags = FLAGS_GOOD
        elif plane and self._ever_aided:
            flags = FLAGS_PLANE_RELATIVE
        else:
            flags = FLAGS_COASTING if age < STOP_AIDING_S else FLAGS_UNAIDED
        if (
            self._source == SOURCE_GPS
            and self._ever_aided
            and GLITCH_AFTER_S < age < STOP_AIDING_S
            and self._position_ratio >= 1.0
        ):
            flags |= FLAG_GLITCH
        ok = bool(flags & 0x18)
        source = "external" if self._source == SOURCE_EXTERNAL else "gnss"
        return EstimatorHealth(flags, self._position_ratio, self._velocity_ratio, 0.01, ok, source)
