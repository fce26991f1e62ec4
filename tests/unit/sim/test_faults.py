import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from visloc_companion.errors import ConfigError
from visloc_companion.sim import faults
from visloc_companion.sim.faults import FaultSchedule


def test_an_empty_schedule_leaves_everything_alone():
    effect = FaultSchedule().gnss(10.0)
    assert (effect.jammed, effect.spoofed, effect.offset_ned_m) == (False, False, (0.0, 0.0, 0.0))
    assert FaultSchedule().gnss_start_s is None


def test_jam_has_a_beginning_and_an_end():
    schedule = faults.jam(10.0, 20.0)
    assert [schedule.gnss(t).jammed for t in (9.99, 10.0, 19.99, 20.0)] == [False, True, True, False]
    assert schedule.gnss_start_s == 10.0


def test_no_gnss_is_jammed_from_the_first_moment():
    assert faults.no_gnss().gnss(0.0).jammed


def test_slow_drag_moves_position_and_velocity_together_then_holds_then_releases():
    schedule = faults.slow_drag(10.0, 2.0, math.pi / 2, end_s=20.0, release_s=30.0)
    effect = schedule.gnss(15.0)
    assert effect.offset_ned_m == pytest.approx((0.0, 10.0, 0.0))
    assert effect.offset_v_ned_mps == pytest.approx((0.0, 2.0, 0.0))
    assert effect.spoofed
    held = schedule.gnss(25.0)
    assert held.offset_ned_m == pytest.approx((0.0, 20.0, 0.0))
    assert held.offset_v_ned_mps == (0.0, 0.0, 0.0)
    assert not schedule.gnss(30.0).spoofed


def test_position_only_drag_leaves_the_velocity_true():
    effect = faults.slow_drag(0.0, 1.0, 0.0, consistent_velocity=False).gnss(5.0)
    assert effect.offset_ned_m[0] == pytest.approx(5.0)
    assert effect.offset_v_ned_mps == (0.0, 0.0, 0.0)


def test_gnss_that_returns_bad_is_jammed_first_and_wrong_then():
    schedule = faults.gnss_returns_bad(10.0, 20.0, (50.0, 0.0, 0.0), end_s=40.0)
    assert schedule.gnss(15.0).jammed
    assert schedule.gnss(25.0).offset_ned_m == (50.0, 0.0, 0.0)
    assert not schedule.gnss(45.0).spoofed


def test_jamming_wins_over_spoofing_and_offsets_add_up():
    schedule = faults.step_spoof(0.0, (10.0, 0.0, 0.0)) + faults.slow_drag(0.0, 1.0, 0.0) + faults.jam(20.0)
    assert schedule.gnss(5.0).offset_ned_m[0] == pytest.approx(15.0)
    assert schedule.gnss(25.0).jammed
    assert not schedule.gnss(25.0).spoofed


def test_camera_faults_do_not_touch_gnss():
    schedule = faults.camera_freeze(5.0, 6.0) + faults.camera_silence(7.0, 8.0)
    assert [schedule.camera_frozen(t) for t in (4.9, 5.5, 6.0)] == [False, True, False]
    assert [schedule.camera_silent(t) for t in (6.9, 7.5, 8.0)] == [False, True, False]
    assert not schedule.gnss(5.5).jammed
    assert schedule.gnss_start_s is None


def test_meaconing_is_jammed_first_and_then_at_the_other_place():
    schedule = faults.meaconed(10.0, 20.0, (300.0, 0.0, 0.0), end_s=40.0)
    assert schedule.gnss(15.0).jammed
    assert schedule.gnss(25.0).meacon_ned_m == (300.0, 0.0, 0.0)
    assert schedule.gnss(25.0).spoofed
    assert not schedule.gnss(45.0).spoofed
    assert schedule.gnss_start_s == 10.0


def test_intermittent_jamming_comes_and_goes_until_its_end():
    schedule = faults.intermittent(10.0, on_s=4.0, off_s=6.0, end_s=32.0)
    assert [schedule.gnss(t).jammed for t in (9.0, 11.0, 15.0, 21.0, 25.0, 31.0, 33.0)] == [
        False,
        True,
        False,
        True,
        False,
        True,
        False,
    ]


def test_frames_are_late_by_their_own_number_and_overtake_each_other():
    schedule = faults.these(faults.FramesLate(10.0, 0.2, 0.8, 20.0))
    delays = [schedule.frame_delay_s(15.0, k, 1) for k in range(200)]
    assert min(delays) >= 0.2
    assert max(delays) <= 1.0
    assert max(a - b for a, b in pairwise(delays)) > 0.5, "an older frame arrives after a newer one"
    assert [schedule.frame_delay_s(15.0, k, 1) for k in range(200)] == delays
    assert schedule.frame_delay_s(9.0, 3, 1) == schedule.frame_delay_s(20.0, 3, 1) == 0.0


def test_the_lateness_of_two_flights_and_of_two_faults_has_nothing_in_common():
    """The frames of every flight, whatever its seed, were late by the same times, and two buffers in a row by twice one time."""
    one, two = faults.these(faults.FramesLate(0.0, 0.0, 1.0)), faults.these(*2 * [faults.FramesLate(0.0, 0.0, 0.5)])
    a, b, c = (np.array([w.frame_delay_s(1.0, k, seed) for k in range(400)]) for w, seed in [(one, 1), (one, 2), (two, 1)])
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.15
    assert c.std() == pytest.approx(a.std() / math.sqrt(2), rel=0.1)


def test_what_drags_a_meacon_is_added_to_its_place(companion):
    schedule = faults.meaconed(0.0, 2.0, (300.0, 0.0, -20.0)) + faults.slow_drag(2.0, 1.0, math.pi / 2)
    flight = companion(faults=schedule, sending=False, mission=[(0, 0, -40)]).fly(12.1)
    sample = flight.pilot.flight.gnss
    assert sample.p_ned_m == pytest.approx((300.0, 10.0, -20.0), abs=3.0)
    assert sample.v_ned_mps == pytest.approx((0.0, 1.0, 0.0), abs=0.4)


@pytest.mark.parametrize(
    ("fault", "reading"),
    [
        (faults.CompassError(10.0, 0.4, 4.0, 20.0), lambda s, t: s.compass_error_rad(t) / 0.4),
        (faults.BaroDrift(10.0, -20.0, 4.0, 20.0), lambda s, t: s.baro_error_m(t) / -20.0),
    ],
    ids=["compass", "baro"],
)
def test_what_drifts_goes_as_it_came(fault, reading):
    schedule = faults.these(fault)
    shares = [reading(schedule, t) for t in (9.9, 11.0, 14.0, 19.0, 22.0, 25.0)]
    assert shares == pytest.approx([0.0, 0.25, 1.0, 1.0, 0.5, 0.0])


def test_clocks_step_each_on_its_own():
    schedule = faults.these(faults.AutopilotClockStep(5.0, 2.5), faults.CompanionClockStep(7.0, -1.5))
    assert [schedule.autopilot_clock_ns(t) for t in (4.9, 5.0)] == [0, 2_500_000_000]
    assert [schedule.companion_clock_ns(t) for t in (6.9, 7.0)] == [0, -1_500_000_000]


@pytest.mark.parametrize(
    ("steps", "at"),
    [
        ([(2.0, -5.0)], r"at 2 s by -5 s: leads to 3 s before"),
        ([(4.0, 2.0), (6.0, -9.0)], r"at 6 s by -9 s: leads to 1 s before"),
        ([(-1.0, -0.5)], r"at -1 s by -0\.5 s: leads to 0\.5 s before"),
    ],
)
def test_an_autopilot_has_no_time_before_its_boot(steps, at):
    """A message's time_usec is unsigned: such a flight ended in struct.error."""
    with pytest.raises(ConfigError, match=at):
        faults.these(*(faults.AutopilotClockStep(*step) for step in steps))
    assert faults.these(faults.AutopilotClockStep(5.0, 2.0), faults.AutopilotClockStep(6.0, -8.0)).autopilot_clock_ns(6.0) < 0


def test_link_and_worker_come_back():
    schedule = faults.these(faults.LinkGap(5.0, 7.0), faults.WorkerCrash(10.0, 3.0))
    assert [schedule.link_down(t) for t in (4.9, 5.0, 7.0)] == [False, True, False]
    assert [schedule.worker_down(t) for t in (9.9, 10.0, 12.9, 13.0)] == [False, True, True, False]


def test_optics_are_a_good_cameras_but_for_the_faults():
    schedule = faults.these(
        faults.Haze(5.0, 300.0), faults.Night(5.0, 1e-3), faults.Blur(10.0, 4.0, 0.1, 20.0), faults.RollingShutter(0.03)
    )
    before, during = schedule.optics(4.0), schedule.optics(12.0)
    assert (before.effects, before.readout_s) == (FaultSchedule().optics(4.0).effects, 0.03)
    assert (during.effects.visibility_m, during.effects.light, during.effects.focus_blur_px) == (300.0, 1e-3, 4.0)
    assert (before.exposure_s, during.exposure_s) == (0.002, 0.1)
    assert schedule.optics(20.0).effects.focus_blur_px == before.effects.focus_blur_px


def test_what_is_wrong_with_the_installation_lasts_for_the_flight():
    schedule = faults.these(faults.MountError(pitch_rad=0.05), faults.FocalError(0.03), faults.MapShift(8.0, -1.0))
    assert (schedule.mount_error.roll_rad, schedule.mount_error.pitch_rad) == (0, 0.05)
    assert schedule.focal_scale == pytest.approx(1.03)
    assert schedule.map_shift_ne_m == (8.0, -1.0)
    assert schedule.gnss_start_s is None


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: faults.jam(20.0, 10.0), "Jam: end_s is 10.0"),
        (lambda: faults.jam(math.nan), "Jam: start_s is nan"),
        (lambda: faults.slow_drag(20.0, 1.0, 0.0, release_s=10.0), "SlowDrag: release_s is 10.0"),
        (lambda: faults.step_spoof(20.0, (math.inf, 0.0, 0.0)), "StepSpoof: offset_ned_m"),
        (lambda: faults.camera_freeze(5.0, 5.0), "CameraFreeze: end_s"),
        (lambda: faults.these(faults.LinkGap(6.0, 5.0)), "LinkGap: end_s"),
        (lambda: faults.these(faults.WorkerCrash(6.0, -4.0)), "WorkerCrash: restart_s"),
        (lambda: faults.these(faults.FramesLate(0.0, -0.2, 0.1)), "FramesLate: delay_s"),
        (lambda: faults.these(faults.Haze(0.0, 0.0)), "Haze: visibility_m"),
        (lambda: faults.these(faults.Night(0.0, -0.1)), "Night: light"),
        (lambda: faults.these(faults.Blur(0.0, -1.0, 0.1)), "Blur: focus_px"),
        (lambda: faults.these(faults.BaroDrift(0.0, 5.0, -1.0)), "BaroDrift: ramp_s"),
        (lambda: faults.these(faults.FocalError(-1.0)), "FocalError: share"),
        (lambda: faults.intermittent(10.0, 0.0, 0.0, 20.0), "intermittent: 0 s on, 0 s off"),
        (lambda: faults.intermittent(20.0, 1.0, 1.0, 10.0), "intermittent: 1 s on, 1 s off from 20 to 10 s"),
    ],
)
def test_a_fault_that_cannot_be_is_refused(make: Callable[[], FaultSchedule], named: str) -> None:
    """A flight without any fault passed where its fault ended before it began."""
    with pytest.raises(ConfigError) as error:
        make()
    assert str(error.value).startswith(named)
    assert error.value.remedy
