from __future__ import annotations

import itertools
from dataclasses import replace

import pytest

from visloc_companion.core.gnss import GnssMonitor
from visloc_companion.core.settings import GnssSettings
from visloc_companion.types import (
    AutopilotKind,
    Baro,
    EkfSource,
    EstimatorStatus,
    GeoPoint,
    Gnss,
    GnssIntegrity,
    GnssTime,
    GnssVerdict,
    MapAtGnss,
    Vec2,
    Verdict,
)

S = 1_000_000_000
HERE = GeoPoint(59.0, 18.0, 50.0)
GOOD = Gnss(0, 0, 3, 14, HERE, 1.0, 1.5, None)
COV = ((1.0, 0.0), (0.0, 1.0))
HEALTHY = EstimatorStatus(0, 0.2, 0.2, 0.2, horizontal_position_ok=True, gnss_glitch=False, gnss_in_use=None)


class Feed:
    """A monitor fed at 5 Hz."""

    def __init__(self, settings: GnssSettings | None = None) -> None:
        self.monitor = GnssMonitor(settings or GnssSettings())
        self.k = 0

    def run(
        self,
        seconds: float,
        gnss: Gnss | None = GOOD,
        status: EstimatorStatus | None = None,
        vision: Vec2 | None = None,
        source: EkfSource = EkfSource.GNSS,
        out_of_reach: bool = False,
    ) -> GnssVerdict:
        for _ in range(round(seconds * 5)):
            self.k += 1
            now = self.k * S // 5
            if gnss is not None:
                self.monitor.on_gnss(replace(gnss, t_rx_ns=now))
                self.monitor.on_reach(out_of_reach)
            if status is not None:
                self.monitor.on_evidence(replace(status, t_rx_ns=now))
            if vision is not None:
                self.monitor.on_vision(now, vision, COV, 0.5, (10.0, 0.0))
            self.monitor.update(now, source)
        return self.monitor.verdict


def trusted(**settings: float) -> Feed:
    feed = Feed(GnssSettings(**settings))  # type: ignore[arg-type]
    assert feed.run(5).verdict is Verdict.OK
    return feed


def test_denied_until_healthy_for_a_while() -> None:
    feed = Feed()
    got = feed.run(1, gnss=None)
    assert (got.verdict, got.reasons) == (Verdict.DENIED, ("no_data",))
    assert not feed.monitor.trusted
    got = feed.run(1)
    assert (got.verdict, got.reasons) == (Verdict.DENIED, ("probation",))
    got = feed.run(1)
    assert (got.verdict, got.reasons) == (Verdict.OK, ())
    assert feed.monitor.trusted
    since = got.since_ns
    assert feed.run(10).since_ns == since


@pytest.mark.parametrize(
    ("bad", "verdict", "reason"),
    [
        (replace(GOOD, fix_type=1), Verdict.DENIED, "no_fix"),
        (replace(GOOD, n_satellites=3), Verdict.DENIED, "few_satellites"),
        (replace(GOOD, h_acc_m=25.0), Verdict.SUSPECT, "accuracy"),
    ],
)
def test_bad_flags_count_when_they_last(bad: Gnss, verdict: Verdict, reason: str) -> None:
    feed = trusted()
    assert feed.run(1.4, bad).verdict is Verdict.OK
    assert feed.run(1).verdict is Verdict.OK
    got = feed.run(2, bad)
    assert (got.verdict, got.reasons) == (verdict, (reason,))


def test_unknown_satellites_and_accuracy_are_no_evidence() -> None:
    assert Feed().run(5, replace(GOOD, n_satellites=None, h_acc_m=None)).verdict is Verdict.OK


def test_silence() -> None:
    feed = trusted()
    assert feed.run(1.9, gnss=None).verdict is Verdict.OK
    got = feed.run(0.5, gnss=None)
    assert (got.verdict, got.reasons) == (Verdict.DENIED, ("silence",))


def test_silence_of_the_whole_link_is_not_that_of_gnss() -> None:
    feed = trusted()
    for _ in range(5):
        feed.monitor.on_telemetry(feed.k * S // 5)
        feed.run(0.2)
    assert feed.run(30, gnss=None).verdict is Verdict.OK  # nothing at all comes
    talking = [Verdict.OK]
    for _ in range(20):
        feed.monitor.on_telemetry(feed.k * S // 5)
        talking.append(feed.run(0.2, gnss=None).verdict)
    assert talking.index(Verdict.DENIED) == 11  # two seconds after the link is back


@pytest.mark.parametrize(
    ("status", "reason"),
    [(replace(HEALTHY, gnss_glitch=True), "autopilot_glitch"), (replace(HEALTHY, position_ratio=1.4), "autopilot_rejects")],
)
def test_the_autopilots_flags_count_while_it_flies_on_gnss(status: EstimatorStatus, reason: str) -> None:
    got = trusted().run(2, status=status)
    assert (got.verdict, got.reasons) == (Verdict.SUSPECT, (reason,))
    assert trusted().run(5, status=status, source=EkfSource.VISION).verdict is Verdict.OK
    assert trusted().run(5, status=replace(HEALTHY, position_ratio=None)).verdict is Verdict.OK
    stale = trusted()
    stale.run(0.4, status=status)
    assert stale.run(10).verdict is Verdict.SUSPECT  # 3 s of a standing report, then probation
    assert stale.run(20).verdict is Verdict.OK


def test_lost_gnss_returns_after_probation_even_without_vision() -> None:
    feed = trusted()
    feed.run(5, replace(GOOD, fix_type=0))
    got = feed.run(19)
    assert (got.verdict, got.reasons) == (Verdict.SUSPECT, ("probation",))
    assert feed.run(2).verdict is Verdict.OK


def test_an_interrupted_probation_starts_again() -> None:
    feed = trusted()
    feed.run(5, replace(GOOD, fix_type=0))
    feed.run(15)
    feed.run(0.4, replace(GOOD, fix_type=0))
    assert feed.run(19).verdict is Verdict.SUSPECT
    assert feed.run(2).verdict is Verdict.OK


def test_a_disagreement_with_vision_is_a_spoof_and_needs_vision_to_mend() -> None:
    feed = trusted()
    feed.run(20, vision=(0.5, 0.0))
    got = feed.run(5, vision=(40.0, 0.0))
    assert (got.verdict, got.reasons) == (Verdict.SUSPECT, ("vision_disagrees",))
    assert {name: value for name, value, _ in got.evidence}["drift_sum"] > 12.0
    assert feed.run(60, vision=(40.0, 0.0)).verdict is Verdict.SUSPECT
    assert feed.run(60).verdict is Verdict.SUSPECT  # flags healthy, but nothing agrees
    assert feed.run(15, vision=(0.5, 0.0)).verdict is Verdict.SUSPECT
    assert feed.run(10, vision=(0.5, 0.0)).verdict is Verdict.OK


def test_an_agreement_that_breaks_off_is_no_probation() -> None:
    feed = trusted()
    feed.run(20, vision=(0.5, 0.0))
    feed.run(5, vision=(40.0, 0.0))
    feed.run(6, vision=(0.5, 0.0))
    got = feed.run(60)
    assert (got.verdict, got.reasons) == (Verdict.SUSPECT, ("vision_disagrees",))


def test_gnss_that_comes_back_at_a_wrong_place_is_never_trusted() -> None:
    feed = trusted()
    feed.run(20, vision=(0.5, 0.0))
    feed.run(10, replace(GOOD, fix_type=1))
    got = feed.run(120, vision=(0.0, 30.0))
    assert (got.verdict, got.reasons) == (Verdict.SUSPECT, ("vision_disagrees",))


def test_a_single_disagreement_in_the_probation_starts_it_again() -> None:
    feed = trusted()
    feed.run(20, vision=(0.0, 0.0))
    feed.run(5, replace(GOOD, fix_type=1))
    feed.run(18, vision=(0.0, 0.0))
    feed.run(1, vision=(12.0, 0.0))
    assert feed.run(18, vision=(0.0, 0.0)).verdict is Verdict.SUSPECT
    assert feed.run(3, vision=(0.0, 0.0)).verdict is Verdict.OK


def test_without_vision_it_must_be_where_dead_reckoning_allows() -> None:
    feed = trusted()
    feed.run(5, replace(GOOD, fix_type=1))
    got = feed.run(60, out_of_reach=True)
    assert (got.verdict, got.reasons) == (Verdict.SUSPECT, ("out_of_reach",))
    assert feed.run(21).verdict is Verdict.OK


def test_a_poor_stated_accuracy_widens_the_test_only_so_far() -> None:
    monitor = GnssMonitor(GnssSettings())
    assert monitor.sigma_m(replace(GOOD, h_acc_m=None)) == 1.5
    assert monitor.sigma_m(replace(GOOD, h_acc_m=0.3)) == 1.5
    assert monitor.sigma_m(replace(GOOD, h_acc_m=2.0)) == 2.0
    assert monitor.sigma_m(replace(GOOD, h_acc_m=9.0)) == 3.0


def test_vision_before_any_receiver_is_harmless() -> None:
    monitor = GnssMonitor(GnssSettings())
    monitor.on_vision(S, (0.0, 0.0), COV, 0.5, (0.0, 0.0))
    assert monitor.update(S, EkfSource.GNSS).verdict is Verdict.DENIED


def test_signs_of_the_receivers_and_of_time_cost_trust() -> None:
    elsewhere = GeoPoint(59.001, 18.0, 50.0)
    for k, (spoil, reason) in enumerate(
        (
            (lambda m, now: m.on_gnss(replace(GOOD, t_rx_ns=now, receiver=1, place=elsewhere)), "receivers_differ"),
            (lambda m, now: m.on_evidence(GnssIntegrity(now, 0, None, True, None)), "receiver_spoofing"),
            (lambda m, now: m.on_evidence(GnssIntegrity(now, 0, True, None, None)), "receiver_jamming"),
            (lambda m, now: m.on_evidence(MapAtGnss(now, HERE, False, None)), "off_map"),
            (lambda m, now: m.on_evidence(GnssTime(now, now, now + (now > 5.5 * S) * 3 * S)), "clock_jump"),
        )
    ):
        feed = trusted()
        for _ in range(15):
            spoil(feed.monitor, (feed.k + 1) * S // 5)
            feed.run(0.2)
        verdict = feed.monitor.verdict
        assert (k, verdict.verdict, verdict.reasons) == (k, Verdict.SUSPECT, (reason,))


def test_armed_vehicles_are_not_asked_about_the_map() -> None:
    feed = trusted()
    feed.monitor.on_vehicle(True, AutopilotKind.ARDUPILOT)
    feed.monitor.on_evidence(MapAtGnss(feed.k * S // 5, HERE, False, None))
    assert feed.run(4).verdict is Verdict.OK


def test_a_vehicle_that_is_disarmed_in_the_air_is_not_asked_about_the_map_before_it_is_down() -> None:
    """Its height over the surface made GNSS the false one, and the autopilot was sent to vision."""

    def asked() -> Verdict:
        for _ in range(4):
            feed.monitor.on_evidence(MapAtGnss(feed.k * S // 5, HERE, True, HERE.h_amsl_m - 100.0))
            verdict = feed.run(1).verdict
        return verdict

    feed = trusted()
    feed.monitor.on_vehicle(True, AutopilotKind.ARDUPILOT)
    feed.monitor.on_height(low=False)
    feed.monitor.on_vehicle(False, AutopilotKind.ARDUPILOT)
    feed.monitor.on_height(low=False)
    assert asked() is Verdict.OK
    feed.monitor.on_height(low=True)
    assert asked() is Verdict.SUSPECT


@pytest.mark.parametrize(("autopilot", "verdict"), [(AutopilotKind.ARDUPILOT, Verdict.OK), (AutopilotKind.PX4, Verdict.SUSPECT)])
def test_while_armed_only_a_clock_that_follows_gnss_speaks_against_it(autopilot: AutopilotKind, verdict: Verdict) -> None:
    feed = trusted()
    feed.monitor.on_vehicle(True, autopilot)
    for _ in range(15):
        now = (feed.k + 1) * S // 5
        feed.monitor.on_evidence(GnssTime(now, now, now + (now > 5.5 * S) * 3 * S))
        feed.run(0.2)
    assert feed.monitor.verdict.verdict is verdict


def test_heights_of_few_satellites_are_no_measure_for_what_comes_after() -> None:
    feed = trusted()
    for k in range(60):
        now = (feed.k + 1) * S // 5
        feed.monitor.on_evidence(Baro(now, 0, 1000.0, 20.0))
        poor = replace(GOOD, t_rx_ns=now, n_satellites=4, place=replace(HERE, h_amsl_m=HERE.h_amsl_m + 3.0 * (k // 5)))
        feed.monitor.on_gnss(poor)
        feed.monitor.update(now, EkfSource.GNSS)
        feed.k += 1
    for _ in range(40):
        feed.monitor.on_evidence(Baro((feed.k + 1) * S // 5, 0, 1000.0, 20.0))
        verdict = feed.run(1)
        assert "height_disagrees" not in verdict.reasons
    assert verdict.verdict is Verdict.OK


def test_odometry_speaks_where_there_is_no_map_and_only_vision_mends_it() -> None:
    feed = trusted()
    monitor = feed.monitor

    def fly(seconds: int, drag: float) -> GnssVerdict:
        for _ in range(seconds):
            now = feed.k * S // 5
            monitor.on_displacement(now, now + S, (10.0 + drag, 0.0), (10.0, 0.0), 0.04)
            feed.run(1)
        return monitor.verdict

    assert fly(60, 0.0).verdict is Verdict.OK
    got = fly(15, 1.5)
    assert (got.verdict, got.reasons) == (Verdict.SUSPECT, ("odometry_disagrees",))
    assert got.probability_false >= 0.5
    assert fly(90, 0.0).reasons == ("odometry_disagrees",)  # a drag that is held moves as odometry does
    assert feed.run(40, vision=(0.5, 0.0)).verdict is Verdict.OK


def test_a_false_height_is_found_and_mends_itself() -> None:
    feed = trusted()

    def fly(seconds: float, h_amsl_m: float) -> GnssVerdict:
        for _ in range(round(seconds * 5)):
            feed.monitor.on_evidence(Baro((feed.k + 1) * S // 5, 0, 1000.0, 15.0))
            feed.run(0.2, replace(GOOD, place=GeoPoint(59.0, 18.0, h_amsl_m)))
        return feed.monitor.verdict

    assert fly(120, 50.0).verdict is Verdict.OK
    got = fly(12, 130.0)
    assert (got.verdict, got.reasons) == (Verdict.SUSPECT, ("height_disagrees",))
    assert fly(60, 50.0).verdict is Verdict.OK


def test_the_probability_follows_trust() -> None:
    feed = trusted()
    assert feed.monitor.verdict.probability_false == 0.0  # nothing was compared
    assert feed.run(60, vision=(0.5, 0.0)).probability_false < 0.01
    assert feed.run(6, vision=(30.0, 0.0)).probability_false >= 0.5
    assert feed.run(40, vision=(0.5, 0.0)).probability_false < 0.05
    feed.run(5, replace(GOOD, fix_type=1))
    assert feed.run(5).probability_false == pytest.approx(0.1)  # it may have come back false, and nothing says so yet


def test_a_gnss_that_comes_and_goes_does_not_fill_the_screen() -> None:
    feed = trusted()
    verdicts = [feed.monitor.verdict.verdict]
    for _ in range(10):
        for gnss in (replace(GOOD, fix_type=1), GOOD):
            for _ in range(40):
                verdicts.append(feed.run(0.2, gnss).verdict)
    assert sum(a is not b for a, b in itertools.pairwise(verdicts)) == 1
    assert feed.run(30).verdict is Verdict.OK
    assert feed.monitor.ever_trusted


def suspected_by_vision() -> Feed:
    feed = trusted()
    feed.run(30, vision=(0.5, -0.5))
    assert feed.run(10, vision=(60.0, 0.0)).reasons == ("vision_disagrees",)
    return feed


def test_a_camera_that_is_believed_less_has_to_agree_before_gnss_comes_back() -> None:
    feed = suspected_by_vision()
    assert feed.monitor.disown_camera(in_use=True)
    got = feed.run(90)
    assert (got.verdict, got.reasons) == (Verdict.SUSPECT, ("probation",))
    assert feed.monitor.disown_camera(in_use=True) is False  # it has said nothing since
    assert feed.run(60).verdict is Verdict.SUSPECT
    assert feed.run(60, vision=(0.5, -0.5)).verdict is Verdict.OK


def test_a_camera_that_is_not_used_any_more_need_not() -> None:
    feed = suspected_by_vision()
    assert feed.monitor.disown_camera(in_use=True)
    assert not feed.monitor.disown_camera()  # and now it is set up wrong
    assert feed.run(25).verdict is Verdict.OK


def test_what_a_camera_said_before_it_changed_stands() -> None:
    feed = suspected_by_vision()
    assert not feed.monitor.disown_camera(right_until_ns=feed.k * S // 5)
    assert feed.run(60).reasons == ("vision_disagrees",)
    assert feed.monitor.disown_camera(right_until_ns=30 * S)  # it had changed already then
    assert feed.run(25).verdict is Verdict.OK
