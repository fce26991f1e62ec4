"""Signs against GNSS in what the receivers and the autopilot say of themselves: pure functions of their latest reports."""

from __future__ import annotations

import math
from dataclasses import dataclass

from visloc_companion.core.settings import GnssSettings
from visloc_companion.core.validate import is_place
from visloc_companion.geo import wgs84
from visloc_companion.types import EkfSource, EstimatorStatus, Gnss, GnssIntegrity

TELEMETRY_GAP_NS = 1_000_000_000
RATIO_REJECTED = 1.0
STATUS_AGE_S = 3.0
INTEGRITY_AGE_S = 10.0
JAMMING = "receiver_jamming"
INTERFERENCE = ("receiver_spoofing", "receiver_authentication", JAMMING)
RECEIVER_AGE_S = 1.0
"""Two receivers are compared where their reports are no further apart."""
COMPARED_S = 3.0
"""What that showed stands for so long: a second receiver may be streamed more slowly than the first."""
ANTENNAS_APART_M, DELAY_S = 5.0, 0.5
"""Between the antennas, and by how much one receiver may be later than the other beside its stamps."""
APART_SIGMA = 4.0


@dataclass(slots=True)
class Reports:
    """The latest of each kind; None before the first. `compared`: the latest of both receivers that were of one time."""

    gnss: Gnss | None = None
    second: Gnss | None = None
    compared: tuple[Gnss, Gnss] | None = None
    status: EstimatorStatus | None = None

    def on_gnss(self, gnss: Gnss) -> None:
        """Take a report of either receiver."""
        if gnss.receiver == 0:
            self.gnss = gnss
        else:
            self.second = gnss
        first, second = self.gnss, self.second
        if first is not None and second is not None and abs(first.t_rx_ns - second.t_rx_ns) <= RECEIVER_AGE_S * 1e9:
            self.compared = first, second

    def without_fix(self, least_type: int) -> bool:
        """Whether the first receiver says that it has no fix of a type, and the second has not said lately that it has one."""
        first, second = self.gnss, self.second
        if first is None or first.fix_type >= least_type:
            return False
        return second is None or second.fix_type < least_type or first.t_rx_ns - second.t_rx_ns > COMPARED_S * 1e9


class Interference:
    """What the receivers say of interference. Each speaks for itself, and what one does not know it has not taken back: a state
    stands until its receiver reports another, or for INTEGRITY_AGE_S."""

    def __init__(self) -> None:
        self._said: dict[tuple[str, int], tuple[int, bool]] = {}

    def on_report(self, report: GnssIntegrity) -> None:
        """Take a report."""
        forged = None if report.authentic is None else not report.authentic
        for sign, bad in zip(INTERFERENCE, (report.spoofed, forged, report.jammed), strict=True):
            if bad is not None:
                self._said[sign, report.receiver] = (report.t_rx_ns, bad)

    def signs(self, now_ns: int, vision_agrees: bool) -> tuple[str, ...]:
        """What any receiver says now.

        Jamming that leaves a position which vision confirms is no sign: receivers report it long before it does harm.
        """
        if not self._said:
            return ()
        bad = {sign for (sign, _), (t_ns, is_bad) in self._said.items() if is_bad and now_ns - t_ns <= INTEGRITY_AGE_S * 1e9}
        if vision_agrees:
            bad.discard(JAMMING)
        return tuple(sign for sign in INTERFERENCE if sign in bad)


class Talk:
    """Tells a receiver that is silent from a link that is: when nothing comes at all, the link is at fault, not GNSS."""

    def __init__(self) -> None:
        self._heard_ns: int | None = None
        self._since_ns = 0

    def heard(self, t_rx_ns: int) -> None:
        """Something else came from the autopilot."""
        if self._heard_ns is None or t_rx_ns - self._heard_ns > TELEMETRY_GAP_NS:
            self._since_ns = t_rx_ns
        self._heard_ns = t_rx_ns

    def silent(self, now_ns: int, gnss_ns: int, silence_s: float) -> bool:
        """Whether the receiver's last report is too old although the autopilot talks."""
        if self._heard_ns is None:
            return now_ns - gnss_ns > silence_s * 1e9
        talking = now_ns - self._heard_ns <= TELEMETRY_GAP_NS
        return talking and now_ns - max(gnss_ns, self._since_ns) > silence_s * 1e9


def receiver_signs(gnss: Gnss, limits: GnssSettings) -> tuple[str, ...]:
    """What GPS_RAW_INT itself shows: no fix (or one at no place, 0, 0), few satellites, poor accuracy."""
    signs = []
    if gnss.fix_type < limits.min_fix_type or not is_place(gnss.place):
        signs.append("no_fix")
    if gnss.n_satellites is not None and gnss.n_satellites < limits.min_satellites:
        signs.append("few_satellites")
    if gnss.h_acc_m is not None and gnss.h_acc_m > limits.max_h_acc_m:
        signs.append("accuracy")
    return tuple(signs)


def receivers_apart_m(first: Gnss, second: Gnss, limits: GnssSettings) -> float | None:
    """Horizontal distance of two receivers' positions at one time, as the first one moves; None where they cannot be compared:
    one that says of itself that it is poor is no witness against the other."""
    if receiver_signs(first, limits) or receiver_signs(second, limits):
        return None
    north, east, _ = wgs84.ned_from_geo(second.place, first.place)
    v_north, v_east, _ = first.v_ned_mps or (0.0, 0.0, 0.0)
    later_s = _later_s(first, second)
    return math.hypot(north - v_north * later_s, east - v_east * later_s)


def _later_s(first: Gnss, second: Gnss) -> float:
    """By how much the second report is of a later time than the first: by the autopilot's stamps where both have one."""
    by_arrival_s = (second.t_rx_ns - first.t_rx_ns) * 1e-9
    if not (first.t_boot_ns and second.t_boot_ns):
        return by_arrival_s
    stamped_s = (second.t_boot_ns - first.t_boot_ns) * 1e-9
    return stamped_s if abs(stamped_s - by_arrival_s) <= RECEIVER_AGE_S else by_arrival_s


def receiver_sign(compared: tuple[Gnss, Gnss] | None, now_ns: int, sigma_m: float, limits: GnssSettings) -> tuple[str, ...]:
    """Two receivers that see different places; `sigma_m` is that of each. What is allowed covers antennas and delays."""
    if compared is None or now_ns - min(report.t_rx_ns for report in compared) > COMPARED_S * 1e9:
        return ()
    first, second = compared
    apart_m = receivers_apart_m(first, second, limits)
    speed = 0.0 if first.v_ned_mps is None else math.hypot(first.v_ned_mps[0], first.v_ned_mps[1])
    allowed_m = ANTENNAS_APART_M + DELAY_S * speed + APART_SIGMA * math.sqrt(2) * sigma_m
    return ("receivers_differ",) if apart_m is not None and apart_m > allowed_m else ()


def autopilot_signs(status: EstimatorStatus | None, now_ns: int, source: EkfSource) -> tuple[str, ...]:
    """The autopilot's glitch bit and innovation ratio, which tell of GNSS only while it flies on GNSS."""
    if source is not EkfSource.GNSS or status is None or now_ns - status.t_rx_ns > STATUS_AGE_S * 1e9:
        return ()
    rejects = status.position_ratio is not None and status.position_ratio > RATIO_REJECTED
    return (("autopilot_glitch",) if status.gnss_glitch else ()) + (("autopilot_rejects",) if rejects else ())
