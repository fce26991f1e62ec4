"""PX4's EKF2 as far as GNSS, external vision, resets and time-outs go (autopilot facts, sections 2 and 6)."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import replace

from visloc_companion.sim.estimators.estimator import Fixed, InertialFilter
from visloc_companion.sim.estimators.estimator_airspeed import WindDeadReckoning
from visloc_companion.sim.estimators.estimator_status import AuxiliaryPosition, EstimatorHealth, ExternalPosition, GnssMeasurement

START_GAP_S, STOP_GAP_S = 0.2, 0.4
GNSS_TIMEOUT_S, RESET_AFTER_S, MAX_RESETS = 7.0, 1.0, 5
COAST_EXTERNAL_S, COAST_CONTROL_S, COAST_LOST_S = 4.6, 4.0, 5.1
"""How long the position stays valid: after the last external sample, after EKF2_GPS_CTRL = 0, after the fix was lost."""
GPS_POSITION_SIGMA_M, GPS_VELOCITY_SIGMA_MPS, GATE_SIGMA = 0.5, 0.3, 5.0
BIAS_TAU_S = 1.0
STAMP_TOLERANCE_S = 0.011
AUXILIARY_SILENCE_S = 5.0
FLAGS_ALWAYS, FLAGS_HORIZONTAL = 0x25, 0x1A
FLAG_CONSTANT, FLAG_AIDED, FLAG_GNSS, FLAG_GLITCH = 0x80, 0x100, 0x200, 0x400


class Px4Estimator:
    """Fuses GNSS while EKF2_GPS_CTRL allows it and external positions beside it (bias removed) or alone (as they are)."""

    def __init__(self, filter_: InertialFilter, parameters: Mapping[str, float], plane: bool) -> None:
        self.filter = filter_
        self._parameters = parameters
        self._wind = WindDeadReckoning() if plane else None
        self._gnss: deque[GnssMeasurement] = deque()
        self._external: deque[ExternalPosition] = deque()
        self._auxiliary: deque[AuxiliaryPosition] = deque()
        self._auxiliary_pass_s = self._last_auxiliary_s = -math.inf
        self._gnss_active = self._external_active = False
        self._gnss_reset_wanted, self._external_reset_wanted = True, True
        self._last_fix_s = self._gnss_pass_s = self._external_pass_s = self._last_external_s = -math.inf
        self._previous_stamp_s = -math.inf
        self._valid_until_s = -math.inf
        self._bias = self._bias_pull = (0.0, 0.0)
        self._resets = 0
        self._reset_counter: int | None = None
        self._position_ratio = self._velocity_ratio = 0.0

    def start_aided(self) -> None:
        """Begin as after an alignment on GNSS."""
        self._gnss_active, self._gnss_reset_wanted = True, False
        self._last_fix_s = self._gnss_pass_s = self.filter.t_s
        self._valid_until_s = self.filter.t_s + COAST_LOST_S

    def on_gnss(self, measurement: GnssMeasurement) -> None:
        """Take a receiver's sample."""
        self._gnss.append(measurement)

    def on_external(self, external: ExternalPosition) -> None:
        """Take an external position; any NaN among x, y, z discards it whole, and so does an age beyond the horizon."""
        if not (int(self._parameters["EKF2_EV_CTRL"]) & 1) or not all(map(math.isfinite, external.p_ned_m)):
            return
        external = replace(external, t_s=external.t_s - self._parameters["EKF2_EV_DELAY"] / 1000)
        if external.t_s > self.filter.t_delayed_s - STAMP_TOLERANCE_S:
            self._external.append(external)

    def on_auxiliary(self, position: AuxiliaryPosition) -> None:
        """Take an auxiliary global position."""
        if int(self._parameters["EKF2_AGP0_CTRL"]) & 1 and all(map(math.isfinite, (*position.p_ned_m, position.sigma_m))):
            self._auxiliary.append(position)

    @property
    def external_healthy(self) -> bool:
        """Whether external positions are being fused."""
        return self._external_active

    def step(self, air_velocity_ne_mps: tuple[float, float] | None) -> list[str]:
        """Fuse what is due; PX4 sends no text of its own here."""
        while self._gnss and self._gnss[0].sample.t_s <= self.filter.t_delayed_s:
            self._take_gnss(self._gnss.popleft())
        self._stop_gnss()
        while self._external and self._external[0].t_s <= self.filter.t_delayed_s:
            self._take_external(self._external.popleft())
        while self._auxiliary and self._auxiliary[0].t_s <= self.filter.t_delayed_s:
            self._take_auxiliary(self._auxiliary.popleft())
        if self._external_active and self.filter.t_s - self._last_external_s > STOP_GAP_S:
            self._external_active, self._previous_stamp_s = False, -math.inf
        self.filter.fuse_baro()
        if self._wind is not None and air_velocity_ne_mps is not None:
            self._wind.step(self.filter, air_velocity_ne_mps, self._aided)
        elif not self.health().position_ok and (self.filter.at_rest or self._valid_until_s > -math.inf):
            self.filter.hold()  # in the air, before there was any position, it goes on from its accelerations
        return []

    @property
    def _controlled_on(self) -> bool:
        return bool(int(self._parameters["EKF2_GPS_CTRL"]) & 1)

    def _stop_gnss(self) -> None:
        if self._gnss_active and (not self._controlled_on or self.filter.t_s - self._last_fix_s > GNSS_TIMEOUT_S):
            if not self._controlled_on and not self._external_active:
                self._valid_until_s = min(self._valid_until_s, self.filter.t_s + COAST_CONTROL_S)
            self._gnss_active, self._gnss_reset_wanted, self._external_reset_wanted = False, True, True

    def _take_gnss(self, measurement: GnssMeasurement) -> None:
        sample, filter_ = measurement.sample, self.filter
        if not (self._controlled_on and sample.has_fix):
            return
        self._gnss_active, self._last_fix_s = True, filter_.t_s
        v, false_v, p, false = sample.v_ned_mps, sample.false_v_ned_mps, measurement.p_local_m, sample.false_ned_m
        variance_v = GPS_VELOCITY_SIGMA_MPS**2
        variance = max(GPS_POSITION_SIGMA_M, sample.h_acc_m) ** 2
        fix = Fixed(sample.t_s, p[0], p[1], variance, variance, false[0], false[1])
        self._velocity_ratio = filter_.velocity_ratio(v[0], v[1], variance_v, GATE_SIGMA)
        self._position_ratio = filter_.ratio(fix, GATE_SIGMA)
        if self._gnss_reset_wanted or filter_.t_s - self._gnss_pass_s > GNSS_TIMEOUT_S:
            filter_.reset_to(fix)
            filter_.north.reset_velocity(v[0], variance_v, false_v[0])
            filter_.east.reset_velocity(v[1], variance_v, false_v[1])
            self._gnss_reset_wanted, self._position_ratio = False, 0.0
            self._passed_gnss()
            return
        if self._velocity_ratio < 1.0:
            filter_.north.correct_velocity(v[0], variance_v, false_v[0])
            filter_.east.correct_velocity(v[1], variance_v, false_v[1])
            self._extend(COAST_LOST_S)
        if self._position_ratio < 1.0:
            filter_.fuse(fix)
            self._passed_gnss()

    def _passed_gnss(self) -> None:
        self._gnss_pass_s = self.filter.t_s
        self._extend(COAST_LOST_S)

    def _extend(self, coast_s: float) -> None:
        """Something horizontal was fused: the position is good for so long after the sample."""
        self._valid_until_s = self.filter.t_delayed_s + coast_s

    def _take_external(self, external: ExternalPosition) -> None:
        filter_, gap_s = self.filter, external.t_s - self._previous_stamp_s
        self._previous_stamp_s, self._last_external_s = external.t_s, filter_.t_s
        if not self._external_active:
            if gap_s >= START_GAP_S:
                return
            self._external_active, self._resets = True, 0
            self._external_reset_wanted, self._external_pass_s = True, filter_.t_s
            self._bias = (external.p_ned_m[0] - filter_.north.p, external.p_ned_m[1] - filter_.east.p)
        floor = self._parameters["EKF2_EVP_NOISE"] ** 2
        unknown = any(map(math.isnan, external.var_ned_m2))
        var_n, var_e = (floor if unknown else max(v, floor) for v in external.var_ned_m2[:2])
        fix = Fixed(external.t_s, external.p_ned_m[0], external.p_ned_m[1], var_n, var_e)
        bumped = self._reset_counter is not None and external.reset_counter != self._reset_counter
        self._reset_counter = external.reset_counter
        if self._gnss_active:
            self._fuse_beside_gnss(fix, bumped)
        else:
            self._fuse_alone(fix, bumped)

    def _fuse_beside_gnss(self, fix: Fixed, bumped: bool) -> None:
        """GNSS decides where we are: the difference is a bias, learnt while samples with a fix come."""
        filter_ = self.filter
        raw = (fix.north_m - filter_.north.p, fix.east_m - filter_.east.p)
        if bumped:
            self._bias = raw
        if filter_.t_s - self._last_fix_s < 1.0:
            share = 0.1 / BIAS_TAU_S
            self._bias = (self._bias[0] + share * (raw[0] - self._bias[0]), self._bias[1] + share * (raw[1] - self._bias[1]))
            self._bias_pull = (filter_.north.pull_p, filter_.east.pull_p)
            return
        north, east = fix.north_m - self._bias[0], fix.east_m - self._bias[1]
        fix = Fixed(fix.t_s, north, east, fix.var_north_m2, fix.var_east_m2, *self._bias_pull)
        self._position_ratio = filter_.ratio(fix, max(self._parameters["EKF2_EVP_GATE"], 1.0))
        if self._position_ratio < 1.0:
            filter_.fuse(fix)
            self._passed_external()

    def _fuse_alone(self, fix: Fixed, bumped: bool) -> None:
        filter_ = self.filter
        self._position_ratio = filter_.ratio(fix, max(self._parameters["EKF2_EVP_GATE"], 1.0))
        failing = filter_.t_s - self._external_pass_s > RESET_AFTER_S and self._resets < MAX_RESETS
        if self._external_reset_wanted or bumped or failing:
            self._resets += failing and not (self._external_reset_wanted or bumped)
            filter_.reset_to(fix)
            self._external_reset_wanted, self._position_ratio = False, 0.0
            self._passed_external()
        elif self._position_ratio < 1.0:
            filter_.fuse(fix)
            self._passed_external()

    def _take_auxiliary(self, position: AuxiliaryPosition) -> None:
        """Fused beside whatever else is; it begins with a reset where nothing else is, and after 7 s without acceptance."""
        filter_ = self.filter
        variance = max(position.sigma_m, self._parameters["EKF2_AGP0_NOISE"]) ** 2
        fix = Fixed(position.t_s, position.p_ned_m[0], position.p_ned_m[1], variance, variance)
        ratio = filter_.ratio(fix, max(self._parameters["EKF2_AGP0_GATE"], 1.0))
        alone = not (self._gnss_active or self._external_active)
        begins = filter_.t_s - self._last_auxiliary_s > AUXILIARY_SILENCE_S
        self._last_auxiliary_s = filter_.t_s
        if alone and (begins or filter_.t_s - self._auxiliary_pass_s > GNSS_TIMEOUT_S):
            filter_.reset_to(fix)
            ratio = 0.0
        elif ratio < 1.0:
            filter_.fuse(fix)
        if alone:
            self._position_ratio = ratio
        if ratio < 1.0:
            self._auxiliary_pass_s = filter_.t_s
            self._extend(COAST_EXTERNAL_S)

    def _passed_external(self) -> None:
        self._external_pass_s = self.filter.t_s
        self._extend(COAST_EXTERNAL_S)

    @property
    def _aided(self) -> bool:
        return self.filter.t_s - max(self._gnss_pass_s, self._external_pass_s, self._auxiliary_pass_s) < 1.0

    def health(self) -> EstimatorHealth:
        """ESTIMATOR_STATUS's flags and ratios. A plane stays valid on airspeed (not measured)."""
        now = self.filter.t_s
        plane_coasting = self._wind is not None and self._valid_until_s > -math.inf
        ok = now < self._valid_until_s or plane_coasting
        gnss_in_use = self._gnss_active and now - self._last_fix_s < 1.0
        flags = FLAGS_ALWAYS | (FLAGS_HORIZONTAL if ok else 0) | (FLAG_CONSTANT if self.filter.at_rest else 0)
        auxiliary = now - self._auxiliary_pass_s < 1.0
        flags |= FLAG_AIDED if gnss_in_use or self._external_active or auxiliary else 0
        flags |= FLAG_GNSS if gnss_in_use or auxiliary else 0
        flags |= FLAG_GLITCH if self._gnss_active and now - self._gnss_pass_s > 1.0 and self._position_ratio >= 1.0 else 0
        source = "gnss" if self._gnss_active else "external" if self._external_active or auxiliary else "none"
        return EstimatorHealth(flags, self._position_ratio, self._velocity_ratio, 0.01, ok, source)
