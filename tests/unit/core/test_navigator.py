"""The navigator in simulated flights (conftest.World)."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

import numpy as np
import pytest

from tests.unit.core.flown import ORIGIN, S, World, errors, frame, modes, requests, started, texts
from visloc_companion.core.navigator import Navigator
from visloc_companion.core.settings import CoreSettings, InjectionSettings
from visloc_companion.core.source.switching import HAND_BACK_NS
from visloc_companion.geo import wgs84
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    EkfSource,
    EstimatorStatus,
    Event,
    Fix,
    FrameRef,
    GeoPoint,
    Gnss,
    Imu,
    Injection,
    InjectionPolicy,
    LinkChanged,
    Mode,
    Notice,
    OperatorFix,
    OriginChanged,
    PriorPose,
    SourceSwitched,
    Status,
    SwitchSource,
    Verdict,
)

# ------------------------------------------------------------------------------------------------------------- whole flights


def test_healthy_flight_stays_in_shadow_and_injects_nothing(world: type[World]) -> None:
    w = started(world).fly(60)
    assert modes(w) == [Mode.WAITING, Mode.SHADOW]
    assert w.first(Injection) == math.inf
    assert w.first(Status, verdict=Verdict.OK) < 3
    assert max(errors(w, 10)) < 4
    assert len([1 for t, _, _ in w.statuses if 30 <= t < 40]) == 100  # one Status each Tick
    assert [c for _, c in w.commands if isinstance(c, SwitchSource)] == [SwitchSource(EkfSource.GNSS)]  # once, to make sure


@pytest.mark.parametrize(("blind", "expected"), [(False, 1), (True, 0)])
def test_in_flight_an_unconfirmed_source_goes_to_gnss_only_after_fixes_agreed(
    world: type[World], blind: bool, expected: int
) -> None:
    w = started(world, blind=lambda t: blind)
    w.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1, armed=True))
    w.fly(40)
    switches = [t for t, c in w.commands if isinstance(c, SwitchSource)]
    assert len(switches) == expected
    assert all(t > 20 for t in switches)


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_the_first_answer_is_of_use(world: type[World], seed: int) -> None:
    """The worker is asked about no frame that was taken before the filter began: its answer could not be taken."""
    w = started(world, seed=seed).fly(6)
    assert w.requests
    assert not [text for text in texts(w) if "too_old" in text]


def test_slow_drag_is_declared_early_and_the_flight_goes_on_vision(world: type[World]) -> None:
    w = started(world, pull_m=lambda t: (max(0.0, t - 60), 0.0)).fly(130)
    declared = w.first(Status, verdict=Verdict.SUSPECT)
    assert 60 < declared < 75  # pulled less than 15 m at 1 m/s
    assert w.first(Injection) == declared
    assert w.first(SwitchSource, source=EkfSource.VISION) == declared
    assert w.first(SourceSwitched) == math.inf
    assert w.source is EkfSource.VISION
    assert modes(w) == [Mode.WAITING, Mode.SHADOW, Mode.AIDING]
    assert float(np.median(errors(w, declared))) < 2
    assert max(errors(w, 10)) < 6
    assert w.status_at(130)[0].verdict is Verdict.SUSPECT


@pytest.mark.parametrize(("jumped_m", "speed_mps"), [(2000.0, 0.2), (5000.0, 10.0), (8000.0, 0.2)])
def test_a_gnss_that_jumps_by_kilometres_costs_no_fixes(world: type[World], jumped_m: float, speed_mps: float) -> None:
    """Half of what it jumped by, over two minutes, counted as the map's: the vehicle was lost within seconds, fixes waited for
    others over other ground, and one that hovers was led away by a trusted GNSS."""
    w = world(speed_mps=speed_mps, pull_m=lambda t: (jumped_m, 0.0) if t > 31 else (0.0, 0.0))
    w.start()
    w.fly(60)
    assert w.notices("GNSS not trusted, camera says elsewhere")[0] < 45
    assert Mode.LOST not in {status.mode for _, status, _ in w.statuses}
    assert w.status_at(60)[0].mode is Mode.AIDING
    assert w.status_at(60)[1] < 6


def test_a_spoofed_autopilot_does_not_move_the_prior(world: type[World]) -> None:
    """200 m step, no switching allowed: the autopilot's own position goes astray and the search stays at the truth."""
    settings = CoreSettings(injection=InjectionSettings(policy=InjectionPolicy.NEVER))
    w = started(world, settings=settings, pull_m=lambda t: (0.0, 200.0 if t > 40 else 0.0)).fly(90)
    assert np.hypot(*(w.ekf_p - w.p)) > 150
    assert max(error for t, _, error in w.requests if t > 20) < 8
    assert w.status_at(90)[0].verdict is Verdict.SUSPECT
    assert w.first(Injection) == math.inf


@pytest.mark.parametrize("false_mps", [5.0, 25.0])
def test_a_false_velocity_does_not_carry_the_filter_away(world: type[World], false_mps: float) -> None:
    """The spoofed receiver's velocity is false, too: fixes contradict it, and the filter follows the fixes."""
    never = CoreSettings(injection=InjectionSettings(policy=InjectionPolicy.NEVER))
    w = started(world, settings=never, false_velocity_mps=lambda t: (0.0, false_mps) if t > 40 else (0.0, 0.0)).fly(80)
    assert max(errors(w, 40)) < 5 * false_mps
    assert max(errors(w, 55)) < 10
    assert float(np.median(errors(w, 55))) < 3


def test_while_injecting_a_false_velocity_makes_it_lag_but_not_lose_the_fixes(world: type[World]) -> None:
    always = CoreSettings(injection=InjectionSettings(policy=InjectionPolicy.ALWAYS))
    flights = [
        started(world, seed=seed, settings=always, false_velocity_mps=lambda t: (0.0, 5.0) if t > 40 else (0.0, 0.0)).fly(80)
        for seed in range(4)
    ]
    assert float(np.mean([np.median(errors(w, 50)) for w in flights])) < 7
    assert max(max(errors(w, 40)) for w in flights) < 23


def test_jam_and_return(world: type[World]) -> None:
    w = started(world, jammed=lambda t: 60 < t < 80).fly(130)
    denied, back = w.first(Status, verdict=Verdict.DENIED, mode=Mode.AIDING), w.first(SwitchSource, 90.0, source=EkfSource.GNSS)
    assert 61 <= denied <= 62
    assert 99 <= back <= 102
    assert modes(w) == [Mode.WAITING, Mode.SHADOW, Mode.AIDING, Mode.SHADOW]
    assert w.source is EkfSource.GNSS
    assert max(errors(w, 60)) < 6
    gaps = np.diff([t for t, c in w.commands if isinstance(c, Injection)])
    assert float(gaps.max()) < 0.15


def test_gnss_that_returns_at_a_wrong_place_is_not_trusted(world: type[World]) -> None:
    w = started(world, jammed=lambda t: 60 < t < 80, pull_m=lambda t: (25.0, 25.0) if t > 60 else (0.0, 0.0)).fly(180)
    assert w.status_at(180)[0].verdict is Verdict.SUSPECT
    assert w.status_at(180)[0].mode is Mode.AIDING
    assert max(errors(w, 60)) < 6


def test_dead_reckoning_in_the_closed_loop_grows_honestly_until_lost(world: type[World]) -> None:
    """No vision after the jam: our output is the autopilot's own velocity integrated, which it then follows."""
    for seed in range(2):
        w = started(world, seed=seed, jammed=lambda t: t > 60, blind=lambda t: t > 70).fly(160)
        assert modes(w) == [Mode.WAITING, Mode.SHADOW, Mode.AIDING, Mode.DEAD_RECKONING, Mode.LOST]
        lost = w.first(Status, mode=Mode.LOST)
        assert 90 < lost < 160
        assert max(t for t, c in w.commands if isinstance(c, Injection)) < lost
        sigmas = [(s.cov_ne_m2[0][0], e) for t, s, e in w.statuses if 72 < t < lost]
        assert all(b[0] > a[0] for a, b in itertools.pairwise(sigmas))
        assert all(e < 3 * math.sqrt(var) for var, e in sigmas)
        assert any("LOST" in text for text in texts(w))


def test_a_learned_velocity_error_is_not_fed_back(world: type[World]) -> None:
    """The drag teaches the filter a velocity error; when vision ends after the switch, that must not accelerate the loop."""
    w = started(world, pull_m=lambda t: (max(0.0, t - 60), 0.0), blind=lambda t: t > 80, accel_bias_mps2=(0.0, 0.0)).fly(110)
    assert w.source is EkfSource.VISION
    true_v = w.velocity(w.t)
    assert math.hypot(w.ekf_v[0] - true_v[0], w.ekf_v[1] - true_v[1]) < 1.5
    status, error = w.status_at(110)
    assert error < 3 * math.sqrt(status.cov_ne_m2[0][0])


def test_a_slow_localiser_does_not_make_the_mode_flap(world: type[World]) -> None:
    w = started(world, jammed=lambda t: t > 30, latency_s=1.6).fly(60)
    assert modes(w) == [Mode.WAITING, Mode.SHADOW, Mode.AIDING]


def test_vision_that_returns_after_dead_reckoning_is_taken(world: type[World]) -> None:
    w = started(world, jammed=lambda t: t > 60, blind=lambda t: 65 < t < 95).fly(125)
    assert modes(w) == [Mode.WAITING, Mode.SHADOW, Mode.AIDING, Mode.DEAD_RECKONING, Mode.AIDING]
    before, after = w.status_at(95)[0].reset_counter, w.status_at(97)[0].reset_counter
    assert after == before + 1  # a step of more than max_step_m is a discontinuity
    assert max(errors(w, 105)) < 5


@pytest.mark.parametrize(("max_step_m", "claimed_m"), [(0.5, 5.76), (5.0, 6.77)])
def test_corrections_that_are_sent_as_resets_by_the_configuration_make_accelerations_less_doubtful(
    world: type[World], max_step_m: float, claimed_m: float
) -> None:
    """Five seconds after the last fix; what is sent as a reset does not tilt the autopilot (docs/decisions/0021)."""

    class Feeling(world):  # type: ignore[misc]
        def _telemetry(self, t: float, gnss: np.ndarray, jammed: bool) -> None:
            super()._telemetry(t, gnss, jammed)
            now, boot = round(t * S), round((t + 995) * S)
            north, east = ((b - a) / 0.05 for a, b in zip(self.velocity(t - 0.05), self.velocity(t), strict=True))
            self.send(Imu(now, boot, (north + self.accel_bias_mps2[0], east + self.accel_bias_mps2[1], -9.80665)))

    settings = CoreSettings(injection=InjectionSettings(switch_source=True, max_step_m=max_step_m))
    w = started(Feeling, settings=settings, jammed=lambda t: t > 30, blind=lambda t: t > 40).fly(45)
    assert math.sqrt(w.status_at(44.9)[0].cov_ne_m2[0][0]) == pytest.approx(claimed_m, rel=0.02)


def test_gnss_that_is_lost_after_the_landing_does_not_put_the_autopilot_on_vision(world: type[World]) -> None:
    """The vehicle is carried indoors, or its autopilot is started again: nothing would be sent on that source."""
    w = started(
        world,
        jammed=lambda t: t > 70,
        height_m=lambda t: 100.0 if t < 40 else 0.0,
        camera=lambda t: t < 40,
    ).fly(90)
    assert modes(w) == [Mode.WAITING, Mode.SHADOW], "no loss: a vehicle on the ground needs no positions"
    assert w.first(SwitchSource, source=EkfSource.VISION) == math.inf


def test_camera_that_stops(world: type[World]) -> None:
    w = started(world, jammed=lambda t: t > 40, camera=lambda t: not 60 < t < 75).fly(90)
    assert modes(w) == [Mode.WAITING, Mode.SHADOW, Mode.AIDING, Mode.DEAD_RECKONING, Mode.AIDING]
    (when,) = w.notices("no new camera frames")
    assert 62 <= when <= 62.3
    assert len(w.notices("frames are back")) == 1


def test_a_frame_stamped_before_the_autopilot_was_restarted_does_not_stop_those_after_it(world: type[World]) -> None:
    """Its stamp lies an hour ahead: as the newest one it waited for its attitude, and all others seemed older."""
    w = started(world).fly(30)
    ahead = FrameRef(30 * S, 30 * S, w.k, 0, 640, 480, 1, t_boot_ns=3600 * S)
    w.send(ahead)
    w.fly(40)
    asked = [t for t, _, _ in w.requests if t > 31]
    assert len(asked) >= 15


def test_a_camera_that_never_delivers_is_told(world: type[World]) -> None:
    w = started(world, settings=dataclasses.replace(CoreSettings(), has_camera=True), camera=lambda t: False).fly(30)
    (when,) = w.notices("no camera frames yet")
    assert 10 <= when <= 10.5


def test_a_camera_that_repeats_one_picture_does_not_stop_the_filter(world: type[World]) -> None:
    """Its fixes agree with each other perfectly, and with a vehicle that stands; the autopilot's velocity says that it flies."""
    w = started(world, jammed=lambda t: t > 40, frozen=lambda t: 60 < t < 72).fly(100)
    assert max(errors(w, 60, 75)) < 25
    assert max(errors(w, 80)) < 6
    assert Mode.DEAD_RECKONING in modes(w)


def test_without_vision_the_filter_follows_trusted_gnss_and_nothing_is_injected_when_that_ends(world: type[World]) -> None:
    w = started(world, blind=lambda t: True, jammed=lambda t: t > 90).fly(110)
    assert max(errors(w, 5, 90)) < 8
    assert w.first(Injection) == math.inf  # never anchored by a fix
    assert w.status_at(110)[0].mode is Mode.SHADOW
    assert w.status_at(110)[0].age_of_fix_s is None


def test_a_flight_without_gnss_starts_from_the_operator(world: type[World]) -> None:
    w = started(world, jammed=lambda t: True)
    w.fly(10)
    assert modes(w) == [Mode.WAITING]
    w.send(OperatorFix(0, wgs84.geo_from_ned((float(w.p[0]) + 8, float(w.p[1]) - 5, -100.0), ORIGIN), 10.0))
    w.fly(40)
    assert modes(w) == [Mode.WAITING, Mode.SHADOW, Mode.AIDING]
    assert max(errors(w, 15)) < 6


def test_a_drag_while_vision_is_blind_is_found_when_it_sees_again(world: type[World]) -> None:
    """GNSS holds the filter through the drag; the search must still reach the truth, which the localiser then finds."""
    w = started(world, pull_m=lambda t: (0.8 * max(0.0, t - 40), 0.0), blind=lambda t: 35 < t < 75).fly(100)
    assert w.status_at(74)[1] > 20
    wide = [r for t, r, _ in w.requests if 70 < t < 75]
    assert all(math.sqrt(r.prior.cov_ne_m2[0][0]) * 3 > 28 for r in wide)
    assert w.status_at(100)[0].verdict is Verdict.SUSPECT
    assert max(errors(w, 85)) < 6


def test_an_operator_can_start_it_before_there_is_any_velocity(world: type[World]) -> None:
    navigator = Navigator(CoreSettings())
    navigator.on(OriginChanged(0, ORIGIN), 0)
    navigator.on(OperatorFix(0, GeoPoint(59.3, 18.1, 140.0), 10.0), 0)
    navigator.on(Attitude(S, S, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), S)
    (request,) = requests(navigator.on(frame(1.0), S))
    assert request.prior.place.h_amsl_m == pytest.approx(140.0)
    assert request.prior.sigma_h_m == pytest.approx(20.0, abs=0.1)


def test_policies(world: type[World]) -> None:
    never = CoreSettings(injection=InjectionSettings(policy=InjectionPolicy.NEVER))
    always = CoreSettings(injection=InjectionSettings(policy=InjectionPolicy.ALWAYS))
    w = started(world, settings=never, jammed=lambda t: t > 20).fly(30)
    assert w.first(Injection) == math.inf
    assert w.status_at(30)[0].mode is Mode.SHADOW
    w = started(world, settings=always).fly(30)
    assert w.first(Injection) < 4
    assert not [c for _, c in w.commands if isinstance(c, SwitchSource)]


def test_where_switching_is_not_allowed_the_operator_is_asked_once(world: type[World]) -> None:
    w = started(world, settings=CoreSettings(), jammed=lambda t: 20 < t < 40).fly(135)
    asked = [(t, c) for t, c in w.commands if isinstance(c, Notice) and "set EKF position source" in c.text]
    assert [c.text[-6:] for _, c in asked] == ["VISION", "o GNSS"]
    assert all(c.to_operator for _, c in asked)
    back_s, sent_s = asked[1][0], [t for t, c in w.commands if isinstance(c, Injection)]
    assert sent_s[-1] - back_s == pytest.approx(HAND_BACK_NS * 1e-9, abs=0.2)
    assert max(after - before for before, after in itertools.pairwise(sent_s)) < 0.15


def test_notices_to_the_operator_are_short_and_one_for_each_mode(world: type[World]) -> None:
    w = started(world, jammed=lambda t: t > 20, blind=lambda t: t > 30).fly(120)
    notices = [c for _, c in w.commands if isinstance(c, Notice) and c.to_operator]
    assert all(len(c.text) <= 50 for c in notices)
    for mode in ("SHADOW", "AIDING", "DEAD_RECKONING", "LOST"):
        assert [c.text for c in notices].count(f"visloc: {mode}") == 1


def plain(thing: object) -> bool:
    if dataclasses.is_dataclass(thing):
        return all(plain(getattr(thing, f.name)) for f in dataclasses.fields(thing))
    if isinstance(thing, tuple):
        return all(plain(part) for part in thing)
    if type(thing) is float:
        return math.isfinite(thing)
    return thing is None or type(thing) in (int, bool, str) or hasattr(thing, "value")


def test_the_same_events_give_the_same_bytes_of_plain_finite_numbers(world: type[World]) -> None:
    faults: dict[str, Any] = {"pull_m": lambda t: (max(0.0, t - 20), 0.0), "jammed": lambda t: t > 40, "blind": lambda t: t > 60}
    one, two = started(world, **faults).fly(110), started(world, **faults).fly(110)
    assert repr(one.commands) == repr(two.commands)
    assert all(plain(command) for _, command in one.commands)


def test_bad_numbers_change_nothing(world: type[World]) -> None:
    clean, dirty = started(world), started(world)
    nan, now = math.nan, 0
    for k in range(40):
        clean.fly(k * 0.5)
        dirty.fly(k * 0.5)
        now = round(dirty.t * S)
        bad = GeoPoint(nan, 18.1, 40.0)
        for event in (
            Attitude(now, now, (nan, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
            PriorPose(now, now, bad, (0.0, 0.0, 0.0), 100.0),
            Gnss(now, now, 3, 12, ORIGIN, nan, None, None),
            EstimatorStatus(now, nan, None, None, True, False, None),
            OriginChanged(now, bad),
            OperatorFix(now, ORIGIN, -1.0),
            Fix(now, now, 0, 0, "t", bad, (1.0, 0.0, 0.0, 0.0), ((1.0, 0.0), (0.0, 1.0)), 1.0, 0.1, 0.0, 1.0),
        ):
            dirty.send(event)
    assert [s for _, s, _ in clean.statuses] == [s for _, s, _ in dirty.statuses]
    assert 7 <= len(dirty.notices("not_finite")) <= 2 * 7  # each kind once in ten seconds


def test_a_landing_is_not_flown_for_long_on_a_position_that_no_fix_holds(world: type[World]) -> None:
    """Below 15 m nothing is asked any more; on what we send back to it the autopilot would drift until long after touch-down."""

    class Landing(world):  # type: ignore[misc]
        def send(self, event: Event) -> Any:
            if isinstance(event, PriorPose):  # above the sea it sinks, too: no home was moved
                place = dataclasses.replace(event.place, h_amsl_m=ORIGIN.h_amsl_m + event.h_rel_m)
                event = dataclasses.replace(event, place=place)
            return super().send(event)

    w = started(Landing, jammed=lambda t: t > 20, height_m=lambda t: 100.0 if t < 40 else 10.0)
    w.send(LinkChanged(0, up=True, autopilot=AutopilotKind.ARDUPILOT, system_id=1, armed=True))
    w.fly(60.0)
    last_fix_s = max(t for t, _, _ in w.requests)
    (lost_s,) = w.notices("LOST")
    assert last_fix_s < 40.5
    assert lost_s == pytest.approx(last_fix_s + 10.0, abs=1.0)
    assert max(t for t, c in w.commands if isinstance(c, Injection)) <= lost_s + 0.1


def test_a_valley_below_home_is_no_landing(world: type[World]) -> None:
    w = world(jammed=lambda t: t > 20, height_m=lambda t: max(60.0 - 8 * max(0.0, t - 25), -120.0))
    w.start()
    w.fly(70.0)
    assert [t for t, _, _ in w.requests if t > 69], "frames are asked about"
    assert w.status_at(69)[0].mode is Mode.AIDING
    assert max(errors(w, 55)) < 10


def test_positions_claim_what_their_fixes_are_worth_until_the_vehicle_is_too_low_for_fixes(world: type[World]) -> None:
    """Two fixes of 1.5 m a second, ten positions; the accelerations' error is not known here (0.2 m/s² are assumed)."""
    w = world(jammed=lambda t: t > 20, height_m=lambda t: 100.0 if t < 40 else 10.0)
    w.start()
    w.fly(60.0)
    claimed = {t: c.stream_sigma_m for t, c in w.commands if isinstance(c, Injection)}
    flying = [sigma_m for t, sigma_m in claimed.items() if 30 < t < 39.5]
    low = [sigma_m for t, sigma_m in claimed.items() if t > 41]
    assert flying == pytest.approx([1.5 * math.sqrt(10 * 0.5) * 0.05 / 0.2] * len(flying), rel=0.35)
    assert len(low) > 50
    assert set(low) == {0.0}
