"""The navigator on hand-made events."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.unit.core.flown import ORIGIN, S, World, attitude, errors, frame, quiet, requests, started
from visloc_companion.core.guard import RESTART_AFTER
from visloc_companion.core.navigator import Navigator
from visloc_companion.core.settings import CoreSettings, InjectionSettings
from visloc_companion.errors import Reason
from visloc_companion.geo import se3, wgs84
from visloc_companion.protocols import NavigatorLike
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    Baro,
    EkfSource,
    EstimatorStatus,
    Fix,
    Gnss,
    Injection,
    LinkChanged,
    LocalPose,
    Mode,
    NoFix,
    Notice,
    OperatorFix,
    OriginChanged,
    PriorPose,
    RequestMessage,
    Status,
    SwitchSource,
    Tick,
    TiltSeen,
    TimesyncSample,
    Verdict,
    Vote,
    WorkerState,
)

# ----------------------------------------------------------------------------------------------------------- single behaviours


def test_is_a_navigator() -> None:
    navigator: NavigatorLike = Navigator(CoreSettings())
    (status,) = navigator.on(Tick(0), 0)
    assert isinstance(status, Status)
    assert (status.mode, status.verdict, status.place) == (Mode.WAITING, Verdict.DENIED, None)
    assert navigator.on(Baro(0, 0, 1013.0, 15.0), 0) == []
    assert navigator.on(TimesyncSample(2, 0, 1), 2) == []


def test_a_new_link_brings_requests_and_the_origin_is_asked_for_until_it_comes() -> None:
    navigator = Navigator(CoreSettings())
    wanted = navigator.on(LinkChanged(0, up=True, autopilot=AutopilotKind.PX4), 0)
    assert RequestMessage(230, 2.0) in wanted
    origin = RequestMessage(49, 0.0)
    asked = [t for t in range(0, 200) if origin in navigator.on(Tick(t), t * S // 10)]
    assert asked == [50, 100, 150]
    navigator.on(OriginChanged(0, ORIGIN), 20 * S)
    assert not [t for t in range(200, 300) if origin in navigator.on(Tick(t), t * S // 10)]


def test_a_lost_link_waits(world: type[World]) -> None:
    w = started(world).fly(10)
    w.send(LinkChanged(0, up=False))
    w.fly(11)
    assert w.status_at(11)[0].mode is Mode.WAITING
    w.start()
    w.fly(12)
    assert w.status_at(12)[0].mode is Mode.SHADOW


@pytest.mark.parametrize("may_switch", [True, False])
def test_no_source_is_asked_for_while_the_link_is_lost(world: type[World], *, may_switch: bool) -> None:
    """GNSS is trusted again meanwhile; nobody would hear it, and the operator is asked once."""
    settings = CoreSettings(injection=InjectionSettings(switch_source=may_switch))
    w = started(world, settings=settings, jammed=lambda t: 20 < t < 30).fly(40)
    w.send(LinkChanged(0, up=False))
    w.fly(70)
    w.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1))
    back_s = w.t
    w.fly(72)
    orders = [t for t, c in w.commands if c == SwitchSource(EkfSource.GNSS) and t > 40]
    asked = orders + [t for t in w.notices("set EKF position source to GNSS") if t > 40]
    assert w.notices("GNSS trusted")[-1] < back_s <= asked[0] < back_s + 0.2
    assert len(asked) == 1


def test_time_that_goes_back_is_refused_and_at_last_starts_anew(world: type[World]) -> None:
    w = started(world).fly(30)
    navigator = w.navigator
    (notice,) = navigator.on(Tick(S), S)
    assert isinstance(notice, Notice)
    assert "implausible_time" in notice.text
    status = navigator.on(Tick(0), 30 * S)[-1]
    assert isinstance(status, Status)
    assert status.mode is Mode.SHADOW
    got = [navigator.on(Tick(S), S + k) for k in range(RESTART_AFTER)]
    (anew,) = got[-1]
    assert isinstance(anew, Notice)
    assert "starting anew" in anew.text
    (status,) = navigator.on(Tick(S), 2 * S)
    assert isinstance(status, Status)
    assert (status.mode, status.t_ns) == (Mode.WAITING, 2 * S)


def test_an_autopilot_that_restarts(world: type[World]) -> None:
    w = started(world, jammed=lambda t: t > 20).fly(30)
    assert w.source is EkfSource.VISION
    got = w.send(Attitude(round(w.t * S), 5 * S, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    assert [c.text for c in got if isinstance(c, Notice)] == ["visloc: autopilot clock stepped -1020.0 s"]
    w.source = EkfSource.GNSS
    w.fly(31)
    assert w.source is EkfSource.VISION  # told again


def test_an_autopilot_without_an_origin_is_not_aided_and_not_sent_to_vision(world: type[World]) -> None:
    """The old origin may not be its own any more, and the link sends nothing before it has told one."""
    w = started(world, jammed=lambda t: t > 20).fly(30)
    armed = LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1, armed=True)
    w.send(LinkChanged(0, up=False))
    w.send(Attitude(round(w.t * S), 5 * S, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    w.source = EkfSource.GNSS
    w.send(armed)
    w.fly(45)
    assert w.status_at(44)[0].mode is Mode.WAITING
    assert not [c for t, c in w.commands if isinstance(c, Injection | SwitchSource) and t > 30]
    assert len([c for t, c in w.commands if c == RequestMessage(49, 0.0) and t > 30]) == 3
    w.send(OriginChanged(0, ORIGIN))
    w.fly(46)
    assert (w.status_at(46)[0].mode, w.source) == (Mode.AIDING, EkfSource.VISION)
    assert max(errors(w, 30)) < 6.0, "the filter went on meanwhile"


def test_a_gnss_that_is_trusted_holds_the_filter_while_the_origin_is_waited_for(world: type[World]) -> None:
    """Nothing is injected in WAITING either: the filter drifted by what the autopilot's velocity is off."""
    w = started(world, blind=lambda t: t > 20, false_velocity_mps=lambda t: (2.0 * (t > 30), 0.0)).fly(30)
    w.send(LinkChanged(0, up=False))
    w.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1))
    w.fly(70)
    assert (w.status_at(69)[0].mode, w.status_at(69)[0].verdict) == (Mode.WAITING, Verdict.OK)
    assert max(errors(w, 40)) < 12.0


def test_after_a_start_from_gnss_that_contradicted_the_filter_a_fix_is_waited_for(world: type[World]) -> None:
    """It jumped by 300 m while nothing was recognised, and was jammed before anything told: positions 302 m off were sent."""
    jumps = started(world, blind=lambda t: 30 < t < 80, pull_m=lambda t: (300.0 * (t > 55), 0.0), jammed=lambda t: t > 62).fly(90)
    assert len(jumps.notices("restarted from trusted GNSS")) == 1
    assert 80 < jumps.first(Injection) < 85
    assert jumps.status_at(89)[0].mode is Mode.AIDING
    steady = started(world, blind=lambda t: 30 < t < 80, jammed=lambda t: t > 62).fly(75)
    assert steady.status_at(74)[0].mode is Mode.DEAD_RECKONING


def test_attitude_that_is_not_later_is_refused(world: type[World]) -> None:
    w = started(world).fly(5)
    now = round(w.t * S)
    event = Attitude(now, now + 995 * S, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert [c.text for c in w.send(event) if isinstance(c, Notice)] == ["Attitude not used: implausible_time"]


def test_attitude_that_ends_waits(world: type[World]) -> None:
    w = started(world, jammed=lambda t: t > 8).fly(12)
    assert w.status_at(12)[0].mode is Mode.AIDING
    for k in range(1, 31):
        w.navigator.on(Tick(0), round((w.t + k * 0.1) * S))
    status = w.navigator.on(Tick(0), round((w.t + 3.1) * S))[-1]
    assert isinstance(status, Status)
    assert (status.mode, status.injected) == (Mode.WAITING, False)


def test_injection_needs_an_attitude(world: type[World]) -> None:
    """After a clock step the attitudes are gone; until the next one there is nothing to send."""
    w = started(world, jammed=lambda t: t > 8).fly(12)
    now = round(w.t * S)
    w.navigator.on(LocalPose(now, 3 * S, (0.0, 0.0, -100.0), (0.0, 0.0, 0.0)), now)
    commands = w.navigator.on(Tick(0), now)
    assert not [c for c in commands if isinstance(c, Injection)]
    assert isinstance(commands[-1], Status)


def test_local_position_drives_the_filter_too(world: type[World]) -> None:
    w = started(world).fly(10)
    state = w.statuses[-1][1]
    for k in range(1, 11):
        now = round((w.t + k * 0.1) * S)
        w.navigator.on(LocalPose(now, now + 995 * S, (0.0, 0.0, -130.0), (0.0, 30.0, 0.0)), now)
    status = w.navigator.on(Tick(0), now)[-1]
    assert isinstance(status, Status)
    assert status.place is not None
    assert state.place is not None
    assert status.v_ned_mps[1] == pytest.approx(30.0, abs=1.0)
    assert status.place.h_amsl_m == pytest.approx(170.0)
    _, east, _ = wgs84.ned_from_geo(status.place, state.place)
    assert east == pytest.approx(30.0, abs=3.0)


def test_local_position_before_the_origin_is_not_placed() -> None:
    navigator = Navigator(CoreSettings())
    assert navigator.on(LocalPose(0, 0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), 0) == []


def test_a_distrusted_velocity_grows_the_covariance_faster(world: type[World]) -> None:
    sigmas = []
    for ok in (True, False):
        w = started(world, jammed=lambda t: t > 8, blind=lambda t: t > 12).fly(12)
        for _ in range(100):
            w.step()
            w.send(EstimatorStatus(0, 0.1, 0.1, 0.1, horizontal_position_ok=ok, gnss_glitch=False, gnss_in_use=None))
        sigmas.append(math.sqrt(w.statuses[-1][1].cov_ne_m2[0][0]))
    assert sigmas[1] > 2 * sigmas[0]


def test_an_origin_that_moves_in_flight_moves_no_vehicle(world: type[World]) -> None:
    w = started(world, jammed=lambda t: t > 20).fly(30)
    before = w.status_at(30)[0].reset_counter
    moved = wgs84.geo_from_ned((700.0, -300.0, 10.0), ORIGIN)
    assert [c.text for c in w.send(OriginChanged(0, moved)) if isinstance(c, Notice)] == ["visloc: EKF origin moved"]
    assert w.send(OriginChanged(0, moved)) == []
    w.fly(50)
    assert max(errors(w, 25)) < 6
    assert w.status_at(31)[0].reset_counter == before + 1
    place = w.last_injection.place
    assert w.last_injection.p_ned_m == pytest.approx(wgs84.autopilot_ned_from_geo(AutopilotKind.ARDUPILOT, place, moved))


def test_an_origin_that_changes_its_height_moves_nothing(world: type[World]) -> None:
    """As ArduPilot's does every few seconds where EK3_OGN_HGT_MASK lets GNSS correct it."""
    w = started(world, jammed=lambda t: t > 20).fly(30)
    before = w.status_at(30)[0].reset_counter
    for k in range(1, 5):
        raised = replace(ORIGIN, h_amsl_m=ORIGIN.h_amsl_m + 0.04 * k)
        assert w.send(OriginChanged(0, raised)) == []
        w.fly(30 + 5 * k)
    assert w.status_at(49)[0].reset_counter == before
    assert w.last_injection.p_ned_m == pytest.approx(
        wgs84.autopilot_ned_from_geo(AutopilotKind.ARDUPILOT, w.last_injection.place, raised)
    )


def test_consistent_fixes_elsewhere_relocalise_and_count_a_reset(world: type[World]) -> None:
    w = started(world, jammed=lambda t: t > 20, fix_sigma_m=1.0).fly(30)
    before = w.status_at(30)[0].reset_counter
    w.map_error_m = (80.0, 0.0)
    w.fly(40)
    assert w.status_at(40)[0].reset_counter == before + 1
    assert len(w.notices("relocalised")) == 1
    assert len(w.notices("Fix not used: gated")) == 1
    assert w.status_at(40)[1] == pytest.approx(80, abs=4)


def test_operator_fix_needs_sense(world: type[World]) -> None:
    w = world()
    w.navigator.on(LinkChanged(0, up=True), 0)
    (refused,) = w.navigator.on(OperatorFix(0, ORIGIN, 10.0), 0)
    assert isinstance(refused, Notice)
    assert refused.text == "visloc: position refused, no EKF origin yet"
    w = started(world).fly(10)
    (refused,) = w.send(OperatorFix(0, wgs84.geo_from_ned((900.0, 0.0, 0.0), ORIGIN), 10.0))
    assert "far from trusted GNSS" in refused.text


def test_frames_are_asked_newest_first_from_the_filters_state(world: type[World]) -> None:
    settings = CoreSettings(q_frd_cambody=se3.quat_from_euler(0.0, 0.3, 0.0), seed=9)
    w = started(world, settings=settings, latency_s=0.9, fix_period_s=0.2).fly(30)
    times = [(t, request.frame.t_ns * 1e-9) for t, request, _ in w.requests if t > 10]
    assert 10 < len(times) < 25  # one in each latency, not one for each frame
    assert all(t - image <= 0.25 for t, image in times)
    request = w.requests[-1][1]
    assert request.prior.q_ned_frd == pytest.approx(se3.quat_from_euler(0.0, 0.3, 0.0))
    assert request.prior.sigma_tilt_rad == settings.mount_sigma_rad
    assert [r.request_id for _, r, _ in w.requests] == list(range(1, len(w.requests) + 1))


def test_requests_carry_what_fixes_told_of_the_tilt_beside_the_autopilots_attitude(world: type[World]) -> None:
    seen = TiltSeen((math.radians(0.8), 0.0), ((1e-5, 0.0), (0.0, 1e-5)))
    w = started(world, tilt=seen).fly(60)
    first, last = w.requests[0][1].prior, w.requests[-1][1].prior
    assert first.tilt is None
    assert last.tilt is not None
    assert last.tilt.turn_ne_rad == pytest.approx(seen.turn_ne_rad, abs=math.radians(0.1))
    assert last.tilt.sigma_rad < last.sigma_tilt_rad
    assert last.q_ned_frd == pytest.approx(first.q_ned_frd)


def test_a_frame_with_the_autopilots_time_is_converted(world: type[World]) -> None:
    w = quiet(world)
    (request,) = requests(w.send(frame(w.t, t_boot_ns=round((w.t - 0.3 + 995) * S))))
    assert request.frame.t_ns == pytest.approx((w.t - 0.3) * S, abs=1000)


def test_no_request_without_attitude_seed_or_height(world: type[World]) -> None:
    w = quiet(world)
    assert requests(w.send(frame(w.t - 9.9))) == []  # older than the memory
    assert requests(w.send(frame(w.t, t_boot_ns=2000 * S))) == []
    fresh = Navigator(CoreSettings())
    assert requests(fresh.on(frame(0.0), 0)) == []
    w = quiet(world)
    now = round((w.t + 0.01) * S)
    w.send(PriorPose(now, now + 995 * S, ORIGIN, (0.0, 0.0, 0.0), 5.0))
    assert requests(w.send(frame(w.t))) == []


def test_answers_and_the_end_of_the_worker_free_the_queue(world: type[World]) -> None:
    w = quiet(world)
    (first,) = requests(w.navigator.on(frame(w.t), round(w.t * S)))
    later = round((w.t + 0.3) * S)
    attitude(w, w.t + 0.3)
    assert w.navigator.on(frame(w.t + 0.3), later) == []
    (second,) = requests(w.navigator.on(NoFix(0, 0, first.request_id, 1, "t", Reason.NO_MATCH, 1.0), later))
    third_ns = round((w.t + 0.6) * S)
    attitude(w, w.t + 0.6)
    assert w.navigator.on(frame(w.t + 0.6), third_ns) == []
    assert w.navigator.on(WorkerState(0, up=False, restarts=1), third_ns) == []
    (third,) = requests(w.navigator.on(WorkerState(0, up=True, restarts=1), third_ns))
    assert third.request_id == second.request_id + 1
    bad = Fix(
        0, third_ns, third.request_id, 1, "t", ORIGIN, (1.0, 0.0, 0.0, 0.0), ((math.nan, 0.0), (0.0, 1.0)), 1.0, 0.1, 0.0, 1.0
    )
    last_ns = round((w.t + 0.9) * S)
    attitude(w, w.t + 0.9)
    assert w.navigator.on(frame(w.t + 0.9), last_ns) == []
    assert len(requests(w.navigator.on(bad, last_ns))) == 1  # a broken answer is an answer, too


def test_a_structure_vote_that_the_worker_does_not_survive_is_given_up(world: type[World]) -> None:
    """Every structure vote runs into the deadline, every image is not recognised: the image is asked for all the same."""
    w = started(world, settings=CoreSettings(structure=True), camera=lambda t: False).fly(10)
    votes, t_s = [], w.t
    for _ in range(40):
        t_s += 0.3
        attitude(w, t_s)
        for request in requests(w.navigator.on(frame(t_s), round(t_s * S))):
            votes.append(request.vote)
            reason = Reason.WORKER_TIMEOUT if request.vote is Vote.STRUCTURE else Reason.NO_MATCH
            w.navigator.on(NoFix(0, 0, request.request_id, 1, "t", reason, 1.0), round(t_s * S))
    assert len(votes) > 30
    assert votes.count(Vote.STRUCTURE) == 2


def test_fixes_that_cannot_be_placed_say_why(world: type[World]) -> None:
    fix = Fix(0, S, 1, 1, "t", ORIGIN, (1.0, 0.0, 0.0, 0.0), ((1.0, 0.0), (0.0, 1.0)), 1.0, 0.1, 0.0, 1.0)
    fresh = Navigator(CoreSettings())
    assert [c.text for c in fresh.on(fix, S) if isinstance(c, Notice)] == ["Fix not used: not_seeded"]
    w = started(world).fly(20)
    assert "Fix not used: too_old" in [c.text for c in w.send(fix) if isinstance(c, Notice)]


def test_time_stamps_that_do_not_fit_are_replaced_by_arrival(world: type[World]) -> None:
    w = started(world).fly(10)
    now = round(w.t * S)
    w.send(Gnss(now, 1, 3, 14, wgs84.geo_from_ned((float(w.p[0]), float(w.p[1]), 0.0), ORIGIN), 1.0, None, None))
    w.fly(20)
    assert w.status_at(20)[0].verdict is Verdict.OK
    assert max(errors(w, 10)) < 4


def test_an_old_position_does_not_seed() -> None:
    navigator = Navigator(CoreSettings())
    navigator.on(OriginChanged(0, ORIGIN), 0)
    navigator.on(PriorPose(0, 0, ORIGIN, (0.0, 0.0, 0.0), 50.0), 0)
    for k in range(50):
        now = k * S // 10
        navigator.on(Gnss(now, now, 3, 12, ORIGIN, 1.0, None, None), now)
        status = navigator.on(Tick(now), now)[-1]
    assert isinstance(status, Status)
    assert (status.verdict, status.place) == (Verdict.OK, None)
    navigator.on(PriorPose(5 * S, 5 * S, ORIGIN, (0.0, 0.0, 0.0), 50.0), 5 * S)
    status = navigator.on(Tick(0), 5 * S)[-1]
    assert isinstance(status, Status)
    assert status.place is not None


def test_a_vanished_origin_cannot_happen_but_seeding_needs_one() -> None:
    navigator = Navigator(CoreSettings())
    for k in range(50):
        now = k * S // 10
        navigator.on(Gnss(now, now, 3, 12, ORIGIN, 1.0, None, None), now)
        navigator.on(PriorPose(now, now, ORIGIN, (0.0, 0.0, 0.0), 50.0), now)
        commands = navigator.on(Tick(now), now)
    assert isinstance(commands[-1], Status)
    assert commands[-1].place is None


def test_what_is_no_event_is_told_and_not_passed_over() -> None:
    with pytest.raises(AssertionError, match="'weather'"):
        Navigator(CoreSettings()).on("weather", S)  # type: ignore[arg-type]
