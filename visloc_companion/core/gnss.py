"""The GNSS verdict: OK, SUSPECT or DENIED, with reasons, evidence and the probability that the position is false.

Evidence: the receivers and the autopilot of themselves (core/satellites/gnss_receiver.py), GNSS time
(core/satellites/gnss_clock.py), the map before arming (core/satellites/gnss_map.py), and sequential tests of GNSS against vision
(core/satellites/drift.py), odometry (core/satellites/gnss_odometry.py) and barometer (core/satellites/gnss_height.py). Signs must
last `denied_after_s`; the sequential tests have waited already. Trust that was lost comes back after `probation_s` without any
sign in which, where there is vision, GNSS agreed with it (core/satellites/gnss_trust.py); so does a first one to a vehicle that
fixes have placed already.
"""

from __future__ import annotations

import math

from visloc_companion.core.satellites import gnss_odds
from visloc_companion.core.satellites.drift import MAX_BIAS_M, DriftTest
from visloc_companion.core.satellites.gnss_clock import GnssClock
from visloc_companion.core.satellites.gnss_height import HeightTest
from visloc_companion.core.satellites.gnss_map import MapCheck
from visloc_companion.core.satellites.gnss_odometry import RIGHT, Lens, OdometryTest
from visloc_companion.core.satellites.gnss_receiver import (
    Interference,
    Reports,
    Talk,
    autopilot_signs,
    receiver_sign,
    receiver_signs,
)
from visloc_companion.core.satellites.gnss_trust import VISION_AGE_S, Trust
from visloc_companion.core.satellites.gnss_witness import Ground
from visloc_companion.core.settings import GnssSettings
from visloc_companion.types import (
    FIX_3D,
    AutopilotKind,
    Baro,
    Cov2,
    EkfSource,
    EstimatorStatus,
    Gnss,
    GnssIntegrity,
    GnssTime,
    GnssVerdict,
    MapAtGnss,
    Vec2,
    Verdict,
)

MAX_SIGMA_SHARE = 2.0
"""A receiver that states a poor accuracy is believed up to this multiple of `gnss_sigma_m`: no spoofer may widen the gate."""
FALSE_AGAIN_LOG_R = gnss_odds.log_r(0.9)
"""In a probation vision disagrees at the probability of 0.9."""
ODOMETRY, PROBATION = "odometry_disagrees", "probation"
BY_CAMERA = (ODOMETRY, "vision_disagrees")


class GnssMonitor:
    """Collects the evidence; `update` gives the verdict."""

    def __init__(self, settings: GnssSettings) -> None:
        self._settings = settings
        self._reports, self._interference = Reports(), Interference()
        self._first_weights_s = gnss_odds.BEFORE_S, gnss_odds.BEFORE_S
        self._drift = DriftTest(settings.gnss_sigma_m, None, *self._first_weights_s)
        self._odometry, self._height = OdometryTest(), HeightTest()
        self._clock, self._map = GnssClock(), MapCheck()
        self._trust = Trust(settings)
        self._disagreed: tuple[str, ...] = ()
        self._disagreed_ns, self._must_agree = 0, False
        self._decided = (-math.inf, -math.inf, -math.inf)
        self._anew = False
        self._vision_ns: int | None = None
        self._vision_sigma = 0.0
        self._out_of_reach = self._rests_on_fixes = self._parted = self._seen_elsewhere = False
        self._armed: bool | None = None
        self.found_in_flight = False
        """Whether the vehicle was armed when it was first heard of."""
        self._aloft = False
        self._clock_follows = True
        self._talk = Talk()
        self._verdict = GnssVerdict(Verdict.DENIED, 0, ("no_data",), ())

    @property
    def verdict(self) -> GnssVerdict:
        """The verdict of the last `update`."""
        return self._verdict

    @property
    def trusted(self) -> bool:
        """Whether GNSS may feed the filter."""
        return self._trust.trusted

    @property
    def disarmed(self) -> bool:
        """Whether the autopilot has said that the vehicle is not armed."""
        return self._armed is False

    @property
    def armed_without_fix(self) -> bool:
        """Whether the vehicle is armed and none of its receivers has a position that an autopilot would fly on."""
        return self._armed is True and self._reports.without_fix(min(self._settings.min_fix_type, FIX_3D))

    @property
    def ever_trusted(self) -> bool:
        """Whether it was trusted at any time of this flight."""
        return self._trust.ever

    @property
    def returned(self) -> bool:
        """Whether it is trusted because it came through a probation."""
        return self._trust.returned

    def sigma_m(self, gnss: Gnss) -> float:
        """1-sigma of a receiver's horizontal position per axis, as far as it is believed."""
        stated = self._settings.gnss_sigma_m if gnss.h_acc_m is None else gnss.h_acc_m
        return min(max(stated, self._settings.gnss_sigma_m), MAX_SIGMA_SHARE * self._settings.gnss_sigma_m)

    # ------------------------------------------------------------------------------------------------------- the evidence

    def on_telemetry(self, t_rx_ns: int) -> None:
        """Something else came from the autopilot: the link is alive."""
        self._talk.heard(t_rx_ns)

    def on_gnss(self, gnss: Gnss) -> None:
        """Take a receiver's report; the first receiver is judged, the second is held against it."""
        self._reports.on_gnss(gnss)
        if gnss.receiver != 0:
            return
        if receiver_signs(gnss, self._settings):
            self._height.learn_anew()  # with four satellites heights are tens of metres off, and nobody relies on them
        else:
            self._height.on_gnss(gnss.t_rx_ns, gnss.place.h_amsl_m, gnss.v_acc_m)

    def on_evidence(self, event: EstimatorStatus | GnssIntegrity | GnssTime | MapAtGnss | Baro) -> None:
        """Take what else bears on GNSS."""
        match event:
            case EstimatorStatus():
                self._reports.status = event
            case GnssIntegrity():
                self._interference.on_report(event)
            case GnssTime():
                self._clock.on_time(event)
            case MapAtGnss():
                self._map.on_map(event)
            case _:
                self._height.on_baro(event)

    def on_vehicle(self, armed: bool, autopilot: AutopilotKind) -> None:
        """Whether the vehicle is armed: before that only the map is asked, and ArduPilot's clock follows GNSS. One that is so
        when it is first heard of may fly beside a GNSS that has been false for long."""
        if self._armed is None and armed:
            self.found_in_flight = True
            self._first_weights_s = gnss_odds.found_in_flight_s()
            self._drift = self._drift_anew()
        self._armed, self._clock_follows = armed, not armed or autopilot is not AutopilotKind.ARDUPILOT

    def _drift_anew(self) -> DriftTest:
        return DriftTest(self._settings.gnss_sigma_m, self._drift.grounds, *self._first_weights_s)

    def on_height(self, *, low: bool) -> None:
        """Whether the vehicle is as low as on the ground: one that was armed higher up flies until it is low and disarmed."""
        if self._armed is True:
            self._aloft |= not low
        elif low:
            self._aloft = False

    def on_reach(self, out_of_reach: bool, *, rests_on_fixes: bool = False, goes_on: bool = False) -> None:
        """Whether the position is further from the navigator's own than both covariances allow, and whether that one
        `rests_on_fixes`: then a GNSS that was not there before is no first one; or `goes_on` from what the autopilot was sent by
        the daemon before: then one that was found elsewhere is tried for as long as one that comes back."""
        self._out_of_reach, self._rests_on_fixes = out_of_reach, rests_on_fixes
        self._parted = goes_on and (self._parted or out_of_reach)

    @property
    def parted_before(self) -> bool:
        """Whether GNSS was out of reach of a filter that goes on from what the autopilot was sent, and still is or not."""
        return self._parted

    @property
    def parted(self) -> bool:
        """Whether GNSS lies elsewhere than a filter that goes on from what the autopilot was sent: one of both is far off."""
        return self._parted and self._out_of_reach

    def on_seen_elsewhere(self) -> None:
        """A vehicle of which no frame is recognised about a GNSS that nobody has shown right was recognised elsewhere."""
        self._seen_elsewhere = self._trust.trusted

    def on_vision(
        self,
        t_ns: int,
        difference_ne_m: Vec2,
        fix_cov_m2: Cov2,
        map_sigma_m: float,
        v_ne_mps: Vec2,
        ground: Ground | None = None,
        over: float = 1.0,
    ) -> None:
        """Take a comparison: GNSS minus an accepted fix, at the fix's image time, while the receiver has a position; the ground
        that the fix looked at, all of whose fixes are one witness; by what factor its covariance is more than it claims."""
        fix_var = (fix_cov_m2[0][0] + fix_cov_m2[1][1]) / 2
        gnss, own_var = self._reports.gnss, self._settings.gnss_sigma_m**2
        poor_var = 0.0 if gnss is None else self.sigma_m(gnss) ** 2 - own_var
        block = self._drift.add(t_ns, difference_ne_m, fix_var, map_sigma_m**2 + poor_var, v_ne_mps, ground, over)
        if block is None:
            return
        self._vision_ns, self._vision_sigma = t_ns, block.distance_sigma
        if block.distance_sigma > self._settings.suspect_sigma:
            self._trust.interrupt()

    def on_displacement(
        self,
        t_from_ns: int,
        t_to_ns: int,
        gnss_ne_m: Vec2,
        odometry_ne_m: Vec2,
        var_m2: float,
        lens: Lens = RIGHT,
    ) -> None:
        """Take what GNSS and odometry moved over an interval, with the variance per axis that odometry claims, and a lens that is
        doubted."""
        self._odometry.add(t_from_ns, t_to_ns, gnss_ne_m, odometry_ne_m, var_m2, lens)

    def disown_camera(self, *, right_until_ns: int = 0, in_use: bool = False) -> bool:
        """What the camera said was wrong since a time, 0: all along; whether it alone spoke against GNSS, which is then on
        probation. Where it stays `in_use`, believed less, a GNSS that it spoke against comes back only by agreeing with it."""
        self._odometry, self._drift = OdometryTest(), self._drift_anew()
        self._vision_ns, self._vision_sigma = None, 0.0
        said = bool(self._disagreed)
        if said and self._disagreed_ns >= right_until_ns:
            by_others = tuple(reason for reason in self._disagreed if reason not in BY_CAMERA)
            self._must_agree = in_use and (self._must_agree or by_others != self._disagreed)
            self._disagreed = by_others
        elif not in_use and not right_until_ns:
            self._must_agree = False
        if not self._trust.trusted:
            self._trust.interrupt()
            self._begin_tests()
        return said and not self._disagreed

    # -------------------------------------------------------------------------------------------------------- the verdict

    def update(self, now_ns: int, source: EkfSource) -> GnssVerdict:
        """The verdict now. `source` is what the autopilot is flying on: its ratios tell of GNSS only while that is GNSS."""
        trust = self._trust
        lasting, against = trust.lasting(now_ns, self._signs(now_ns, source)), self._against()
        if trust.trusted and (lasting or against or self.parted):
            trust.lose()
            self._drift.lose()
            self._begin_tests()
        self._seen_elsewhere = False
        if against:
            self._disagreed_ns = self._disagreed_ns if self._disagreed else now_ns
            self._disagreed = tuple(dict.fromkeys((*self._disagreed, *against)))
            self._decided = self._log_r()
            trust.interrupt()
            self._begin_tests()
        elif not trust.trusted:
            self._consider(now_ns)
        reasons = self._reasons(lasting)
        verdict = trust.verdict(now_ns, reasons)
        since = self._verdict.since_ns if verdict is self._verdict.verdict else now_ns
        log_r = self._log_r()
        self._verdict = GnssVerdict(verdict, since, reasons, self._evidence(now_ns, log_r), self._probability(log_r))
        return self._verdict

    def _consider(self, now_ns: int) -> None:
        """Count the time without anything against GNSS and trust it (again) at the end of the probation."""
        trust = self._trust
        blind = self._needs_vision and not self._sees(now_ns)
        if trust.signs or blind or (self._returns and self._out_of_reach) or self.parted:
            trust.interrupt()
            self._anew = True
            return
        trust.begin(now_ns)
        if self._anew and (self._returns or self._disagreed):
            self._begin_tests()
        need_s = self._settings.probation_s if self._returns or self._parted else self._settings.denied_after_s
        if trust.earned(now_ns, gnss_odds.probability_false(*self._log_r()), need_s, returns=self._returns):
            self._drift.regain()
            self._disagreed, self._must_agree = (), False

    def _begin_tests(self) -> None:
        """A probation begins: the tests forget what spoke against GNSS, and weigh that it may be false from now on."""
        prior = gnss_odds.FALSE_AFTER_DISAGREEMENT if self._disagreed else gnss_odds.FALSE_RETURN
        self._anew = False
        self._drift.probation(gnss_odds.first_weight_s(prior))
        self._odometry.forget()
        self._height.forget()

    @property
    def _returns(self) -> bool:
        """Whether GNSS comes to a vehicle that knew its place before, by a trusted GNSS or by fixes without any."""
        return self._trust.ever or self._rests_on_fixes

    @property
    def _needs_vision(self) -> bool:
        return self._must_agree or any(reason != "height_disagrees" for reason in self._disagreed)

    def _log_r(self) -> tuple[float, float, float]:
        return self._drift.log_r, self._odometry.log_r, self._height.log_r

    def _against(self) -> tuple[str, ...]:
        """The sequential tests that have decided against GNSS."""
        limit, log_r = self._settings.drift_threshold, self._log_r()
        if max(log_r) <= limit:  # nearly always
            return BY_CAMERA[1:] if self._seen_elsewhere else ()
        vision = max(limit, FALSE_AGAIN_LOG_R) if self._drift.in_probation else limit
        tests = zip(("vision", "odometry", "height"), log_r, (vision, limit, limit), strict=True)
        decided = tuple(f"{name}_disagrees" for name, value, most in tests if value > most)
        return decided or (BY_CAMERA[1:] if self._seen_elsewhere else ())

    def _probability(self, log_r: tuple[float, float, float]) -> float:
        """Of a false position. What is not compared yet since trust was lost has what decided that, or the prior's."""
        if not self._drift.in_probation or self._drift.log_r > -math.inf:
            return gnss_odds.probability_false(*log_r)
        return gnss_odds.probability_false(*self._decided) if self._disagreed else gnss_odds.FALSE_RETURN

    def _signs(self, now_ns: int, source: EkfSource) -> tuple[str, ...]:
        reports, limits = self._reports, self._settings
        gnss = reports.gnss
        if gnss is None:
            return ("no_data",)
        if self._talk.silent(now_ns, gnss.t_rx_ns, limits.silence_s):
            return ("silence",)
        agrees = self._sees(now_ns) and self._vision_sigma <= limits.suspect_sigma
        return (
            *receiver_signs(gnss, limits),
            *self._interference.signs(now_ns, agrees),
            *receiver_sign(reports.compared, now_ns, self.sigma_m(gnss), limits),
            *(self._clock.signs(now_ns) if self._clock_follows else ()),
            *self._map.signs(now_ns, gnss, self._armed is True or self._aloft),
            *autopilot_signs(reports.status, now_ns, source),
        )

    def _sees(self, now_ns: int) -> bool:
        return self._vision_ns is not None and now_ns - self._vision_ns <= VISION_AGE_S * 1e9

    def _reasons(self, lasting: tuple[str, ...]) -> tuple[str, ...]:
        if self._trust.trusted:
            return ()
        reach = ("out_of_reach",) if self.parted or (self._out_of_reach and self._returns) else ()
        return (*lasting, *self._disagreed, *reach) or (PROBATION,)

    def _evidence(self, now_ns: int, log_r: tuple[float, float, float]) -> tuple[tuple[str, float, float], ...]:
        limits, gnss = self._settings, self._reports.gnss
        sums = self._decided if self._disagreed else log_r
        tests = zip(("drift_sum", "odometry_sum", "height_sum"), sums, strict=True)
        items = [(name, value, limits.drift_threshold) for name, value in tests if value > -math.inf]
        items.append(("vision_sigma", self._vision_sigma, limits.suspect_sigma))
        items.append(("bias_m", math.hypot(*self._drift.bias_m), MAX_BIAS_M))
        if gnss is not None:
            items.append(("age_s", (now_ns - gnss.t_rx_ns) * 1e-9, limits.silence_s))
            items.append(("fix_type", float(gnss.fix_type), float(limits.min_fix_type)))
        return tuple(items)
