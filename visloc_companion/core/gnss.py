"""The GNSS verdict: OK, SUSPECT or DENIED, with reasons and evidence.

Three kinds of evidence: the receiver's own state (GPS_RAW_INT: fix type, satellites, accuracy; silence), the autopilot's
estimator (glitch bit, innovation ratios, while it uses GNSS), and the difference from vision (core/drift.py). Bad signs must
last `denied_after_s` to count, except the sequential test, which has waited already. Trust that was lost comes back after
`probation_s` without any bad sign in which, where there is vision, GNSS agreed with it; after a disagreement with vision
only agreement with vision restores it. Without vision the position must be where dead reckoning allows it to be.
"""

from __future__ import annotations

import math

from visloc_companion.core.drift import MAX_BIAS_M, DriftTest
from visloc_companion.core.settings import GnssSettings
from visloc_companion.types import Cov2, EkfSource, EstimatorStatus, Gnss, GnssVerdict, Vec2, Verdict

MAX_SIGMA_SHARE = 2.0
"""A receiver that states a poor accuracy is believed up to this multiple of `gnss_sigma_m`: no spoofer may widen the gate."""
TIMING_SIGMA_S = 0.1
"""1-sigma of the receiver's own delay, which acts along the track."""
VISION_AGE_S = 5.0
"""Vision counts as present while its last comparison is younger."""
RATIO_REJECTED = 1.0
STATUS_AGE_S = 3.0
TELEMETRY_GAP_NS = 1_000_000_000

DENYING = ("no_data", "silence", "no_fix", "few_satellites")
"""Reasons that mean there is no position at all; every other reason makes it suspect."""


class GnssMonitor:
    """Collects the evidence; `update` gives the verdict."""

    def __init__(self, settings: GnssSettings) -> None:
        self._settings = settings
        self._drift = DriftTest(settings.suspect_sigma, settings.drift_threshold)
        self._gnss: Gnss | None = None
        self._status: EstimatorStatus | None = None
        self._bad_since_ns: dict[str, int] = {}
        self._trusted, self._ever_trusted, self._vision_disagreed = False, False, False
        self._clean_since_ns: int | None = None
        self._vision_ns: int | None = None
        self._vision_sigma = 0.0
        self._out_of_reach = False
        self._telemetry_ns: int | None = None
        self._talking_since_ns = 0
        self._verdict = GnssVerdict(Verdict.DENIED, 0, ("no_data",), ())

    @property
    def verdict(self) -> GnssVerdict:
        """The verdict of the last `update`."""
        return self._verdict

    @property
    def trusted(self) -> bool:
        """Whether GNSS may feed the filter."""
        return self._trusted

    def sigma_m(self, gnss: Gnss) -> float:
        """1-sigma of a receiver's horizontal position per axis, as far as it is believed."""
        stated = self._settings.gnss_sigma_m if gnss.h_acc_m is None else gnss.h_acc_m
        return min(max(stated, self._settings.gnss_sigma_m), MAX_SIGMA_SHARE * self._settings.gnss_sigma_m)

    def on_telemetry(self, t_rx_ns: int) -> None:
        """Something else came from the autopilot: the link is alive."""
        if self._telemetry_ns is None or t_rx_ns - self._telemetry_ns > TELEMETRY_GAP_NS:
            self._talking_since_ns = t_rx_ns
        self._telemetry_ns = t_rx_ns

    def on_gnss(self, gnss: Gnss) -> None:
        """Take a receiver's report."""
        self._gnss = gnss

    def on_status(self, status: EstimatorStatus) -> None:
        """Take the autopilot's estimator health."""
        self._status = status

    def on_reach(self, out_of_reach: bool) -> None:
        """Whether the position is further from the navigator's own than both covariances allow."""
        self._out_of_reach = out_of_reach

    def on_vision(self, t_ns: int, difference_ne_m: Vec2, fix_cov_m2: Cov2, map_sigma_m: float, speed_mps: float) -> None:
        """Take a comparison: GNSS minus an accepted fix, at the fix's image time, while the receiver has a position."""
        sigma_m = self._settings.gnss_sigma_m if self._gnss is None else self.sigma_m(self._gnss)
        white = (fix_cov_m2[0][0] + fix_cov_m2[1][1]) / 2
        common = sigma_m**2 + map_sigma_m**2 + (TIMING_SIGMA_S * speed_mps) ** 2
        block = self._drift.add(t_ns, difference_ne_m, white, common, learn=self._trusted)
        if block is None:
            return
        self._vision_ns, self._vision_sigma = t_ns, block.distance_sigma
        if block.largest_sum > self._settings.drift_threshold:
            self._vision_disagreed = True
        if block.distance_sigma > self._settings.suspect_sigma or self._vision_disagreed_now():
            self._clean_since_ns = None

    def _vision_disagreed_now(self) -> bool:
        return self._drift.largest_sum > self._settings.drift_threshold

    def update(self, now_ns: int, source: EkfSource) -> GnssVerdict:
        """The verdict now. `source` is what the autopilot is flying on: its ratios tell of GNSS only while that is GNSS."""
        lasting = self._lasting(now_ns, self._bad_signs(now_ns, source))
        if self._trusted and (lasting or self._vision_disagreed_now()):
            self._trusted, self._clean_since_ns = False, None
        if not self._trusted:
            self._consider_trust(now_ns)
        reasons = self._reasons(lasting)
        verdict = _verdict(self._trusted, self._ever_trusted, reasons)
        since = self._verdict.since_ns if verdict is self._verdict.verdict else now_ns
        self._verdict = GnssVerdict(verdict, since, reasons, self._evidence(now_ns))
        return self._verdict

    def _bad_signs(self, now_ns: int, source: EkfSource) -> tuple[str, ...]:
        gnss, limits = self._gnss, self._settings
        if gnss is None:
            return ("no_data",)
        if self._silent(now_ns, gnss):
            return ("silence",)
        signs = []
        if gnss.fix_type < limits.min_fix_type:
            signs.append("no_fix")
        if gnss.n_satellites is not None and gnss.n_satellites < limits.min_satellites:
            signs.append("few_satellites")
        if gnss.h_acc_m is not None and gnss.h_acc_m > limits.max_h_acc_m:
            signs.append("accuracy")
        return (*signs, *self._autopilot_signs(now_ns, source))

    def _silent(self, now_ns: int, gnss: Gnss) -> bool:
        """The receiver is silent while the autopilot talks; when nothing comes at all, the link is at fault, not GNSS."""
        if self._telemetry_ns is None:
            return now_ns - gnss.t_rx_ns > self._settings.silence_s * 1e9
        talking = now_ns - self._telemetry_ns <= TELEMETRY_GAP_NS
        return talking and now_ns - max(gnss.t_rx_ns, self._talking_since_ns) > self._settings.silence_s * 1e9

    def _autopilot_signs(self, now_ns: int, source: EkfSource) -> tuple[str, ...]:
        status = self._status
        if source is not EkfSource.GNSS or status is None or now_ns - status.t_rx_ns > STATUS_AGE_S * 1e9:
            return ()
        rejects = status.position_ratio is not None and status.position_ratio > RATIO_REJECTED
        return (("autopilot_glitch",) if status.gnss_glitch else ()) + (("autopilot_rejects",) if rejects else ())

    def _lasting(self, now_ns: int, signs: tuple[str, ...]) -> tuple[str, ...]:
        """The signs that have been there for `denied_after_s` (silence has waited by itself)."""
        self._bad_since_ns = {sign: self._bad_since_ns.get(sign, now_ns) for sign in signs}
        if signs:
            self._clean_since_ns = None
        after_ns = self._settings.denied_after_s * 1e9
        return tuple(s for s in signs if s in ("silence", "no_data") or now_ns - self._bad_since_ns[s] >= after_ns)

    def _consider_trust(self, now_ns: int) -> None:
        """Count the time without bad signs and trust again at the end of the probation."""
        if self._bad_since_ns or self._vision_disagreed_now() or (self._ever_trusted and self._out_of_reach):
            self._clean_since_ns = None
            return
        vision = self._vision_ns is not None and now_ns - self._vision_ns <= VISION_AGE_S * 1e9
        if self._vision_disagreed and not vision:
            self._clean_since_ns = None
            return
        if self._clean_since_ns is None:
            self._clean_since_ns = now_ns
        probation_s = self._settings.probation_s if self._ever_trusted else self._settings.denied_after_s
        if now_ns - self._clean_since_ns >= probation_s * 1e9:
            self._trusted, self._ever_trusted, self._vision_disagreed = True, True, False

    def _reasons(self, lasting: tuple[str, ...]) -> tuple[str, ...]:
        if self._trusted:
            return ()
        vision = ("vision_disagrees",) if self._vision_disagreed else ()
        reach = ("out_of_reach",) if self._out_of_reach and self._ever_trusted else ()
        return (*lasting, *vision, *reach) or ("probation",)

    def _evidence(self, now_ns: int) -> tuple[tuple[str, float, float], ...]:
        limits, gnss = self._settings, self._gnss
        items = [("drift_sum", self._drift.largest_sum, limits.drift_threshold)]
        items.append(("vision_sigma", self._vision_sigma, limits.suspect_sigma))
        items.append(("bias_m", math.hypot(*self._drift.bias_m), MAX_BIAS_M))
        if gnss is not None:
            items.append(("age_s", (now_ns - gnss.t_rx_ns) * 1e-9, limits.silence_s))
            items.append(("fix_type", float(gnss.fix_type), float(limits.min_fix_type)))
        return tuple(items)


def _verdict(trusted: bool, ever_trusted: bool, reasons: tuple[str, ...]) -> Verdict:
    if trusted:
        return Verdict.OK
    if not ever_trusted or any(reason in DENYING for reason in reasons):
        return Verdict.DENIED
    return Verdict.SUSPECT
