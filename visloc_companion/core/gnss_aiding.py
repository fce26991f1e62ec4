"""Where GNSS and the filter meet: GNSS keeps an idle filter near while it is trusted; fixes and odometry are held against it.

GNSS positions enter the filter only while nothing is injected and the verdict is OK, and only when vision has given nothing
for GNSS_AFTER_NS: with fixes coming GNSS would hide a drag, without them the prior would drift away from a position that is
known. A filter that keeps refusing a trusted GNSS, and takes no fix meanwhile, starts again from it.
"""

from __future__ import annotations

from collections import deque

from visloc_companion.core.camera.scale_watch import ScaleWatch
from visloc_companion.core.filter import claims, votes
from visloc_companion.core.filter.lasting import apart_m
from visloc_companion.core.filter.motion import Motion
from visloc_companion.core.filter.refused import DRAGGED
from visloc_companion.core.gnss import GnssMonitor
from visloc_companion.core.modes import INJECTING
from visloc_companion.core.requests import dragged_m
from visloc_companion.core.satellites.gnss_odometry import Lens
from visloc_companion.core.satellites.gnss_witness import Ground
from visloc_companion.core.satellites.map_offset import GNSS_SIGMA_M, Beside, MapOffset
from visloc_companion.core.settings import CoreSettings
from visloc_companion.core.tracking import Tracker
from visloc_companion.core.validate import is_place
from visloc_companion.geo import wgs84
from visloc_companion.types import Command, Cov2, Fix, GeoPoint, Gnss, Mode, NavState, Notice, Rejected, Severity, Vec2, Verdict

GNSS_AFTER_NS = 5_000_000_000
GNSS_INTERVAL_NS = 1_000_000_000
RESEED_AFTER_REJECTIONS = 5
NEAR_SIGMA = 2.0
"""Once GNSS was found out of reach of what the autopilot was sent, it is within reach again from so near on: 150 m off at 2 sigma
it is false with 0.05, where one found in flight is so with 0.1 beforehand and false ones scatter by 300 m, at 4 with 0.8."""
ROUNDED_NS = 1000
MOTIONS_WAITING = 64
"""Intervals wait for the receiver's position after them; more than these are dropped."""


class GnssAiding:
    """Feeds the monitor and, under these rules, the filter."""

    def __init__(self, settings: CoreSettings, tracker: Tracker, monitor: GnssMonitor) -> None:
        self._settings = settings
        self._tracker, self._monitor = tracker, monitor
        self._fused_ns: int | None = None
        self._rejected, self._rejected_since_ns, self._was_trusted = 0, 0, False
        self._beside_ns: int | None = None
        self._by_fixes_ns: int | None = None
        self._by_gnss_ns: int | None = None
        """When fixes, and when GNSS, last had a part in where the filter is."""
        self._gone_on_ns: int | None = None
        self._reference: GeoPoint | None = None
        self.began_anew = False
        """Whether the last report made a filter that kept refusing GNSS start again from it: one of both was far off."""
        self._odometry: deque[tuple[Motion, float]] = deque(maxlen=MOTIONS_WAITING)
        self._map, self._scale = MapOffset(settings.navigator.map_sigma_m), ScaleWatch()
        self._told: list[Command] = []

    def on_gnss(self, event: Gnss, t_ns: int, mode: Mode, *, holds: bool = True) -> list[Command]:
        """Take a receiver's report; `t_ns` is its time of validity. Only the first receiver may feed the filter, where GNSS may
        hold it (`holds`)."""
        self.began_anew = False
        self._monitor.on_gnss(event)
        if event.receiver != 0:
            return []
        if event.fix_type < self._settings.gnss.min_fix_type or not is_place(event.place):
            self._tracker.gnss.interrupted()
            return []
        self._tracker.gnss.add(t_ns, event.place)
        self._compare_odometry()
        rests, goes_on = self._tracker.rests, self.goes_on
        gate_sigma = NEAR_SIGMA if goes_on and self._monitor.parted_before else self._settings.navigator.gate_sigma
        out = self._tracker.out_of_reach(t_ns, event.place, self._monitor.sigma_m(event), gate_sigma)
        self._monitor.on_reach(out, rests_on_fixes=rests is not None and rests.last_fix_ns is not None, goes_on=goes_on)
        if holds and self._monitor.trusted:
            self._tell_level(event, t_ns)
        told, self._told = self._told, []
        return [*told, *(self._keep_near(event, t_ns, mode) if holds else [])]

    def _tell_level(self, event: Gnss, t_ns: int) -> None:
        """Once a second, where the filter is if GNSS is right."""
        if self._beside_ns is None or t_ns - self._beside_ns >= GNSS_INTERVAL_NS:
            self._beside_ns = t_ns
            self._tracker.beside_gnss(t_ns, event.place, max(GNSS_SIGMA_M, self._monitor.sigma_m(event)))

    @property
    def followed(self) -> bool:
        """Whether GNSS has had a part in where the filter is since that started."""
        belief = self._tracker.rests
        return belief is not None and self._by_gnss_ns is not None and self._by_gnss_ns >= belief.started_ns

    def gone_on(self) -> None:
        """The filter started where the autopilot has the vehicle by what the daemon before this one sent it, not by GNSS."""
        belief = self._tracker.rests
        self._gone_on_ns = None if belief is None else belief.started_ns

    @property
    def goes_on(self) -> bool:
        """Whether the filter rests on nothing else than that yet."""
        belief = self._tracker.rests
        alone = belief is not None and belief.last_fix_ns is None and belief.started_ns == self._gone_on_ns
        return alone and not self.followed

    @property
    def scaled(self) -> bool:
        """Whether the camera's motion is off by a factor: it is not to be used."""
        return self._scale.wrong

    def disown_camera(self) -> None:
        """What the camera showed was wrong; where that alone spoke against GNSS, or gave fixes, the filter has to start anew."""
        self._odometry.clear()
        belief = self._tracker.rests
        if self._monitor.disown_camera() or (belief is not None and belief.last_fix_ns is not None):
            self._tracker.forget()

    def camera_changed(self, since_ns: int, *, in_use: bool) -> None:
        """What the camera showed since a time, or since the last fix before, was wrong, and right until then: the filter starts
        anew where GNSS says the place, and goes on where nothing else does, or where the camera found GNSS false before.
        `in_use`: the camera is used as it is now."""
        self._odometry.clear()
        belief = self._tracker.rests
        fixed_ns = 0 if belief is None or belief.last_fix_ns is None else belief.last_fix_ns
        right_until_ns = max(1, min(since_ns, fixed_ns))
        if self._monitor.disown_camera(right_until_ns=right_until_ns, in_use=in_use) or self._monitor.trusted:
            self._tracker.forget()
        else:
            self._tracker.doubt_motion()

    def retimed(self) -> None:
        """What frames said so far, beside GNSS and against it, was of other times."""
        self._odometry.clear()
        self._map = MapOffset(self._settings.navigator.map_sigma_m)
        self._monitor.disown_camera(in_use=True)

    def reaimed(self) -> None:
        """What frames said so far was off by what is taken off from now on: the filter starts from GNSS anew."""
        self.retimed()
        self._tracker.forget()

    def _keep_near(self, event: Gnss, t_ns: int, mode: Mode) -> list[Command]:
        belief = self._tracker.rests
        if belief is None or not self._monitor.trusted or mode in INJECTING:
            return []
        vision = belief.last_fix_ns is not None and t_ns - belief.last_fix_ns < GNSS_AFTER_NS
        just_now = self._fused_ns is not None and t_ns - self._fused_ns < GNSS_INTERVAL_NS
        if vision or just_now:
            return []
        self._fused_ns = t_ns
        if self._rejected_since_ns != belief.rested_ns:
            self._rejected, self._rejected_since_ns = 0, belief.rested_ns  # a fix has held the filter since
        sigma = max(self._settings.navigator.seed_sigma_m, self._monitor.sigma_m(event))
        if not isinstance(self._tracker.observe_gnss(t_ns, event.place, sigma), Rejected):
            self._rejected, self._by_gnss_ns = 0, t_ns
            return []
        self._rejected += 1
        if self._rejected < RESEED_AFTER_REJECTIONS:
            return []
        self._rejected = 0
        self.began_anew = self._tracker.seed(t_ns, event.place, sigma)
        return [Notice(Severity.NOTICE, "visloc: restarted from trusted GNSS")]

    def judged(self, now_ns: int) -> None:
        """The verdict was passed. Where GNSS is trusted no more and alone has held the filter since the last fix, it may have
        dragged it away."""
        was_trusted, self._was_trusted = self._was_trusted, self._monitor.trusted
        self._tracker.gnss_false = self._was_false(self._tracker.gnss_false)
        belief = self._tracker.rests
        if not was_trusted or self._was_trusted or belief is None or self._fused_ns is None:
            return
        if self._fused_ns > belief.rested_ns:
            self._tracker.dragged(now_ns, dragged_m((now_ns - belief.rested_ns) * 1e-9))

    def _was_false(self, before: float) -> float:
        """The probability that GNSS is false that holds the filter for its level, or was when it last did: where it is only lost
        that stays as it was, where something speaks against it nobody knows since when."""
        verdict = self._monitor.verdict
        if self._monitor.trusted:
            return max(DRAGGED, verdict.probability_false)
        return 1.0 if verdict.verdict is Verdict.SUSPECT else before

    def on_motion(self, seen: Motion) -> None:
        """Hold what the camera saw of an interval against the receiver, once its position after it is there.

        Intervals follow each other; displacements from a keyframe overlap, and would count the same metres again and again.
        """
        self._odometry.append((seen, self._tracker.zoom_share))
        self._compare_odometry()

    def _compare_odometry(self) -> None:
        track = self._tracker.gnss
        newest_ns = track.newest_ns
        while newest_ns is not None and self._odometry and self._odometry[0][0].t_ns <= newest_ns:
            seen, zoom_share = self._odometry.popleft()
            moved = track.displacement(seen.t_from_ns, seen.t_ns)
            if moved is not None:
                own_m2 = (seen.cov_ne_m2[0][0] + seen.cov_ne_m2[1][1]) / 2
                scale2 = max(0.0, seen.sigma_scale**2 - zoom_share**2)
                shared = (scale2 + seen.sigma_heading_rad**2) / 2
                by_lens_m2 = seen.sigma_focal**2 * (seen.per_focal_ne_m[0] ** 2 + seen.per_focal_ne_m[1] ** 2) / 2
                var_m2 = own_m2 + by_lens_m2 + shared * (seen.d_ne_m[0] ** 2 + seen.d_ne_m[1] ** 2)
                lens = Lens(abs(self._tracker.longer_share) + self._tracker.alike.lens_bend, seen.per_focal_ne_m, zoom_share)
                self._monitor.on_displacement(seen.t_from_ns, seen.t_ns, moved, seen.d_ne_m, var_m2, lens)
                self._watch_scale(seen, moved)

    def _watch_scale(self, seen: Motion, moved_ne_m: Vec2) -> None:
        """Until a first fix shows that the camera is set up right."""
        rests, height_m = self._tracker.rests, self._tracker.height_above_home_m
        if rests is None or rests.last_fix_ns is not None or height_m is None:
            self._scale.clear()
            return
        told = self._scale.on_motion(seen, moved_ne_m, height_m)
        if told:
            self._told += told
            self.disown_camera()

    def _with_lens(self, fix: Fix, over: float) -> Cov2:
        """Covariance of a fix, by a factor more than it claims, with what a lens or an aim that is doubted adds to it."""
        (nn, ne), (en, ee), (north, east) = *fix.cov_ne_m2, fix.per_focal_ne_m
        nn, ne, en, ee = over * nn, over * ne, over * en, over * ee
        var, astray_m2 = self._tracker.longer_share**2, self._tracker.astray_m**2
        nn, ee = nn + astray_m2, ee + astray_m2
        return (nn + var * north**2, ne + var * north * east), (en + var * north * east, ee + var * east**2)

    def _over(self, fix: Fix) -> float:
        """By what factor its covariance is more than it claims, as its neighbours' scatter bears it out."""
        belief = self._tracker.rests
        return 1.0 if belief is None else claims.scattered(belief.claims, fix.method)

    def refused(self, fix: Fix) -> None:
        """Show the monitor a fix that the filter refused while GNSS alone has held that since the last one taken: then it is GNSS
        that the fix contradicts. Where fixes are rare every one of them would be refused, and a drag have no witness."""
        belief = self._tracker.rests
        if belief is None or self._fused_ns is None or not self._monitor.trusted:
            return
        if self._fused_ns > belief.rested_ns:
            self._shown(fix, None)

    def shown(self, fix: Fix) -> Vec2 | None:
        """Show the monitor a fix of a vehicle that no filter has placed yet; GNSS minus it, north and east metres."""
        return self._shown(fix, None)

    def _ground(self, fix: Fix, held: NavState | None) -> Ground | None:
        """What a fix looked at, by its own place, and how far it lay from where the filter `held` the vehicle, if by fixes."""
        origin = self._tracker.origin
        if origin is None:
            return None
        self._reference = self._reference or fix.place
        (view_n, view_e), spacing_m = votes.looked_at(fix, fix.place.h_amsl_m - origin.h_amsl_m)
        north, east, _ = wgs84.ned_from_geo(fix.place, self._reference)
        ground = Ground(fix.method, (north + view_n, east + view_e), spacing_m, fix.probability_wrong)
        if held is None or not self._held_by_fixes(fix.t_ns - round(held.age_of_fix_s * 1e9)):
            return ground
        (nn, _), (_, ee) = held.cov_ne_m2
        (fix_nn, _), (_, fix_ee) = fix.cov_ne_m2
        # fixes lie alike by what all have in common; that may have grown by this very fix (a lens that comes into doubt)
        own_m2 = max(0.0, (nn + ee) / 2 - self._tracker.shared_m**2)
        north, east, _ = wgs84.ned_from_geo(fix.place, origin)
        off_ne_m = north - held.p_ned_m[0], east - held.p_ned_m[1]
        return ground._replace(off_ne_m=off_ne_m, off_var_m2=own_m2 + (fix_nn + fix_ee) / 2)

    def _held_by_fixes(self, rested_ns: int) -> bool:
        """Whether a filter that rests on a fix of a time, or on where it was seeded then, owes nothing to GNSS."""
        if self._by_fixes_ns is None or rested_ns > self._by_fixes_ns + ROUNDED_NS:
            return False
        return self._by_gnss_ns is None or self._by_gnss_ns <= rested_ns

    def placed(self) -> None:
        """The filter started where answers over several grounds, which agree, have the vehicle: GNSS had no part in that."""
        belief = self._tracker.rests
        self._by_fixes_ns = None if belief is None else belief.rested_ns

    def _shown(self, fix: Fix, held: NavState | None) -> Vec2 | None:
        """GNSS minus a fix that the monitor was shown, north and east metres; None where there is no GNSS beside it."""
        velocity = self._tracker.velocity
        difference = None if velocity is None else self._tracker.gnss.minus(fix, velocity.v_ned_mps)
        if velocity is not None and difference is not None:
            v_ne_mps, map_sigma_m = velocity.v_ned_mps[:2], self._settings.navigator.map_sigma_m
            over = self._over(fix)
            cov_m2, ground = self._with_lens(fix, over), self._ground(fix, held)
            self._monitor.on_vision(fix.t_ns, difference, cov_m2, map_sigma_m, v_ne_mps, ground, over)
        return difference

    def compare(self, fix: Fix, held: NavState | None = None, *, delay_told: bool = False) -> list[Command]:
        """Show the monitor an accepted fix beside GNSS: the fix itself, for the filter rides on a velocity that may be false. The
        filter `held` the vehicle there before it took the fix.

        While GNSS is trusted, the difference also tells how far the map is off. `delay_told`: frames are known to come late.
        """
        velocity, difference = self._tracker.velocity, self._shown(fix, held)
        self._by_fixes_ns = fix.t_ns
        if velocity is None or difference is None:
            return []
        north, east, _ = velocity.v_ned_mps
        verdict = self._monitor.verdict
        (nn, _), (_, ee) = fix.cov_ne_m2
        other_m = apart_m(abs(self._tracker.height_above_home_m or 0.0))
        beside = Beside(fix.t_ns, difference, (north, east), fix.per_focal_ne_m, nn + ee, other_m)
        if verdict.verdict is Verdict.SUSPECT:
            self._map.suspected(verdict.since_ns, beside)
        elif self._monitor.trusted:
            self._map.compared(beside)
        self._tracker.know_map(self._map.sigma_m)
        if self._tracker.alike.lens_bend or 0 < self._tracker.alike.aim_share <= self._tracker.alike.aim_open:
            return []
        return self._map.notices(delay_told=delay_told, longer_share=self._tracker.longer_share)
