"""A vehicle that is found flying, whose autopilot has no position, beside a receiver that has one.

Something ended the daemon before this one, and PX4 on vision gives its position up 4.6 s later. That GNSS is trusted within
seconds, for nothing contradicts it, but nobody has shown it right: the daemon before may have found it false. So it says no more
than where to look first, as far about it as an attack may lie that a trusted one hides; the filter never starts from it. A fix
that lies where the receiver is starts the filter, at the fix. One that lies elsewhere is evidence against GNSS, and the map is
searched as without any (core/places/place_search.py). Where nothing is recognised for UNSEEN_S, there or elsewhere on the map,
and nothing speaks against GNSS, it is all there is: an autopilot without any position lands where it drifts.
"""

from __future__ import annotations

import math

from visloc_companion.core.covariance import largest_sigma_m
from visloc_companion.core.gnss import GnssMonitor
from visloc_companion.core.gnss_aiding import GnssAiding
from visloc_companion.core.places.first_fixes import GNSS_SIGMA_M, LIES_THERE_SIGMA
from visloc_companion.core.requests import MAX_DRAG_M
from visloc_companion.core.satellites.gnss_track import MAX_GAP_NS
from visloc_companion.core.satellites.gnss_trust import TRUSTED_BELOW
from visloc_companion.core.source.steering import UNSEEN_S
from visloc_companion.core.tracking import Tracker
from visloc_companion.geo import wgs84
from visloc_companion.types import Command, EstimatorStatus, Fix, NavState, Notice, PriorPose, Severity, Vec2, Verdict

LOOK_SIGMA_M = MAX_DRAG_M
"""1-sigma, on each axis, of where frames are looked for about the receiver: three of it are what a trusted one may hide."""
SEED_SIGMA_M = 5.0
"""1-sigma of a place by one fix that a receiver bears out."""
TOLD_M = 10.0
"""An autopilot that tells a global position so near its receiver's has one, whatever its estimator's status says: ArduPilot that
flies on its attitude filter (DCM) reports no flags at all. PX4 tells none while it has none."""


class WithoutPosition:
    """Whether that is so, and since when. Distances are metres north and east, times the shell's."""

    def __init__(self, tracker: Tracker, monitor: GnssMonitor, aiding: GnssAiding) -> None:
        self._tracker, self._monitor, self._aiding = tracker, monitor, aiding
        self._lacks_since_ns: int | None = None
        self._prior: PriorPose | None = None
        self._seen_ns = 0
        self._said_ns, self._replaced_ne_m = 0, (0.0, 0.0)

    def on_status(self, status: EstimatorStatus) -> None:
        """Take what the autopilot's estimator says of its position."""
        if status.horizontal_position_ok:
            self._lacks_since_ns = None
        elif self._lacks_since_ns is None:
            self._lacks_since_ns = status.t_rx_ns

    def on_prior(self, prior: PriorPose) -> None:
        """Take a global position that the autopilot tells."""
        self._prior = prior

    @property
    def lacks(self) -> bool:
        """Whether the autopilot of a vehicle that was found flying says that it has no position, and tells none."""
        found = self._monitor.found_in_flight and not self._monitor.disarmed
        return self._lacks_since_ns is not None and found and not self._tells_the_receivers

    @property
    def _tells_the_receivers(self) -> bool:
        prior, place, told_ns = self._prior, self._tracker.gnss.newest, self._tracker.gnss.newest_ns
        if prior is None or place is None or told_ns is None or abs(told_ns - prior.t_rx_ns) > MAX_GAP_NS:
            return False
        flown_m = math.hypot(*prior.v_ned_mps[:2]) * abs(told_ns - prior.t_rx_ns) * 1e-9
        return wgs84.distance_m(place, prior.place) <= TOLD_M + flown_m

    @property
    def looks(self) -> bool:
        """Whether frames are looked for about the receiver: there is no filter, and nothing speaks against GNSS."""
        return self.unplaced and self._tracker.belief is None

    @property
    def unplaced(self) -> bool:
        """Whether nothing but an unproven GNSS, against which nothing speaks, and at most the operator's word say where it is."""
        if not (self.lacks and self._monitor.trusted):
            return False  # without a look at the filter, which would be gone through for it
        belief = self._tracker.rests
        return belief is None or (belief.last_fix_ns is None and not self._aiding.followed)

    @property
    def goes_on(self) -> bool:
        """Whether the filter rests on nothing but what the autopilot was sent by the daemon before this one."""
        return self._aiding.goes_on

    @property
    def parted(self) -> bool:
        """Whether that is elsewhere than where GNSS has the vehicle: either may be where it is."""
        return self._monitor.parted and self._aiding.goes_on

    @property
    def found_in_flight(self) -> bool:
        """Whether the vehicle was armed when it was first heard of: GNSS may have been false before that."""
        return self._monitor.found_in_flight

    def about_ne_m(self, t_ns: int) -> Vec2 | None:
        """Where the receiver had the vehicle about a time; None where it has not told lately."""
        place, told_ns, origin = self._tracker.gnss.newest, self._tracker.gnss.newest_ns, self._tracker.origin
        if place is None or told_ns is None or origin is None or abs(t_ns - told_ns) > MAX_GAP_NS:
            return None
        north, east, _ = wgs84.ned_from_geo(place, origin)
        return north, east

    def word_replaced(self, before: NavState | None, t_ns: int) -> None:
        """The operator's word replaced where the filter went on from what the autopilot was sent (`before`, both at a time)."""
        belief, said = self._tracker.rests, self._tracker.at(t_ns)
        if before is not None and belief is not None and said is not None and belief.started_ns != self._said_ns:
            (north, east, _), (said_north, said_east, _) = before.p_ned_m, said.p_ned_m
            self._said_ns, self._replaced_ne_m = belief.started_ns, (north - said_north, east - said_east)

    def elsewhere_ne_m(self, state: NavState) -> tuple[Vec2, ...]:
        """Where else than at the filter's `state` the vehicle may be: where GNSS has it, and what the operator's word replaced,
        which goes on as the filter does, as long as no fix says which."""
        belief, t_ns = self._tracker.rests, state.t_ns
        receiver = self.about_ne_m(t_ns) if self.parted else None
        places = () if receiver is None else (receiver,)
        if belief is None or belief.last_fix_ns is not None or belief.started_ns != self._said_ns:
            return places
        (north, east), (off_north, off_east) = state.p_ned_m[:2], self._replaced_ne_m
        in_view = math.hypot(off_north, off_east) <= 3 * largest_sigma_m(state.cov_ne_m2)
        return places if in_view else (*places, (north + off_north, east + off_east))

    def on_fix(self, fix: Fix, now_ns: int) -> list[Command]:
        """Take a fix: the filter starts there, if the receiver bears it out; nothing is sent before it takes another one."""
        self._seen_ns = now_ns
        beside_ne_m = self._aiding.shown(fix)
        var_m2 = (fix.cov_ne_m2[0][0] + fix.cov_ne_m2[1][1]) / 2 + GNSS_SIGMA_M**2
        agrees = beside_ne_m is not None and math.hypot(*beside_ne_m) <= LIES_THERE_SIGMA * math.sqrt(var_m2)
        if agrees and self._tracker.seed(fix.t_ns, fix.place, max(SEED_SIGMA_M, largest_sigma_m(fix.cov_ne_m2))):
            return [Notice(Severity.INFO, "a fix lies where an unproven GNSS does: the filter starts at the fix")]
        return [Notice(Severity.INFO, "a fix lies elsewhere than an unproven GNSS")]

    def recognised(self, now_ns: int) -> None:
        """A frame was recognised, be it at a place that the search of the map, or the filter after a loss, is not sure of yet: a
        vehicle that hovers shows them no other ground."""
        self._seen_ns = now_ns

    def seen_at(self, place_ne_m: Vec2, now_ns: int) -> None:
        """A vehicle of which no frame is recognised about a receiver was recognised at a place, metres north and east. That may
        be a wrong match, and all that one shows that hovers: it speaks against a GNSS that may have been false before we came."""
        about = self.about_ne_m(now_ns)
        if self.found_in_flight and about is not None and math.dist(about, place_ne_m) > 3 * LOOK_SIGMA_M:
            self._monitor.on_seen_elsewhere()

    def only_gnss(self, now_ns: int) -> bool:
        """Whether an unproven GNSS is all there is for the autopilot, and has been for UNSEEN_S."""
        verdict, since_ns = self._monitor.verdict, self._lacks_since_ns
        if not self.lacks or since_ns is None or verdict.verdict is not Verdict.OK:
            return False
        alone_ns = now_ns - max(since_ns, verdict.since_ns, self._seen_ns)
        return alone_ns >= UNSEEN_S * 1e9 and verdict.probability_false < TRUSTED_BELOW
