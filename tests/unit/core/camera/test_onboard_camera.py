"""What is learned of the camera reaches frames, requests and fixes."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.camera.camera_time import UNKNOWN_S
from visloc_companion.core.camera.gimbal import Gimbal
from visloc_companion.core.camera.onboard_camera import OnboardCamera
from visloc_companion.core.camera.sun_memory import FEWEST
from visloc_companion.core.camera.tilt_memory import NOTHING_TOLD, Told
from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.propagation import Drive
from visloc_companion.core.settings import GimbalSettings, NavigatorSettings
from visloc_companion.core.terrain.terrain_aiding import METHOD as TERRAIN
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.core.tracking import Tracker
from visloc_companion.errors import Reason
from visloc_companion.geo import se3, wgs84
from visloc_companion.types import (
    Fix,
    FrameRef,
    GeoPoint,
    GimbalAttitude,
    GimbalFrame,
    LocaliseRequest,
    NoFix,
    Notice,
    Odometry,
    PosePrior,
    Quat,
    Sun,
    Tick,
    TiltSeen,
    Turn,
    Vec3,
)

LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
HERE = GeoPoint(48.0, 11.0, 500.0)
COV = ((0.5, 0.0), (0.0, 0.5))
MS = 1_000_000
SIGMA_RAD = math.radians(1.0)


@pytest.fixture
def tracker() -> Tracker:
    """Seeded, 100 m above home, on its way north at 10 m/s."""
    made = Tracker(NavigatorSettings())
    made.set_origin(HERE)
    drive(made, 0, (10.0, 0.0, 0.0))
    assert made.seed(0, HERE, 2.0)
    made.height_above_home_m = 100.0
    return made


MOTION = Odometry(0, 0, 1, (1.0, 0.0, 0.0), COV)
TURN_COV = ((1e-6, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 1e-6))


def drive(tracker: Tracker, t_ns: int, v_ned_mps: Vec3) -> None:
    tracker.drive(Velocity(t_ns, v_ned_mps, 600.0, 0.3, Drive.AUTOPILOT), t_ns, alone=False)


def frame(k: int, boot_ns: int | None) -> FrameRef:
    return FrameRef(k * 200 * MS, k * 200 * MS, k, 0, 640, 480, 3, boot_ns)


def fix_at(t_ns: int, method: str = "image") -> Fix:
    return Fix(0, t_ns, 1, 1, method, HERE, LEVEL, COV, 1.0, 0.005, 1e-4, 1.0)


def test_fixes_of_frames_by_arrival_are_wider_along_the_track(tracker: Tracker) -> None:
    camera = OnboardCamera(LEVEL, SIGMA_RAD, (0.0, 0.0, 0.0), ClockOffset(), AttitudeBuffer(), tracker)
    fix = fix_at(200 * MS)
    for k in range(3):
        camera.on_frame(frame(k, k * 200 * MS))
    state = tracker.at(fix.t_ns)
    assert camera.stated(fix, state) == fix
    for k in range(3, 6):
        assert camera.on_frame(frame(k, None)) == frame(k, None)
    (nn, _), (_, ee) = camera.stated(fix, state).cov_ne_m2
    assert nn == pytest.approx(0.5 + (10 * UNKNOWN_S) ** 2, rel=0.1)
    assert ee == pytest.approx(0.5)
    ground = replace(fix, method=TERRAIN)
    assert camera.stated(ground, state) == ground
    assert camera.stated(fix, None) == fix


def test_a_tilted_mount_is_learned_beside_a_good_gnss_only(tracker: Tracker) -> None:
    truth = se3.quat_from_euler(math.radians(2.0), 0.0, 0.0)
    for trusted in (False, True):
        camera = OnboardCamera(LEVEL, SIGMA_RAD, (0.0, 0.0, 0.0), ClockOffset(), AttitudeBuffer(), tracker)
        said = []
        start = 1 + 300 * trusted
        for k in range(start, start + 240):
            t_ns, heading = k * 1000 * MS, 0.4 * (k // 6)
            drive(tracker, t_ns, (0.0, 0.0, 0.0))
            tracker.gnss.add(t_ns, HERE)
            camera.on_frame(replace(frame(k, t_ns), t_ns=t_ns))
            q = se3.quat_from_euler(0.0, 0.0, heading)
            prior = PosePrior(HERE, se3.quat_multiply(q, camera.q_carrier_cambody), COV, 3.0, 0.05, 0.02)
            asked = [LocaliseRequest(k, frame(k, None), prior, 1), Tick(0)]
            assert camera.asked(asked) is asked  # type: ignore[arg-type, comparison-overlap]
            axis = se3.R_from_quat(se3.quat_multiply(q, truth))[:, 2] - se3.R_from_quat(prior.q_ned_frd)[:, 2]
            place = wgs84.geo_from_ned((100 * float(axis[0]), 100 * float(axis[1]), 0.0), HERE)
            fix = replace(fix_at(t_ns), request_id=k, place=place, q_ned_frd=prior.q_ned_frd)
            said += camera.on_fix(fix, taken=True, gnss_trusted=trusted)
        off = math.degrees(se3.angle_between(camera.q_carrier_cambody, truth))
        assert off < 0.5 if trusted else off == pytest.approx(2.0, abs=1e-6)
        assert ("camera's mounting learned" in [n.text for n in said if isinstance(n, Notice)]) == trusted


def test_answers_without_a_turn_say_nothing(tracker: Tracker) -> None:
    camera = OnboardCamera(LEVEL, SIGMA_RAD, (0.0, 0.0, 0.0), ClockOffset(), AttitudeBuffer(), tracker)
    assert camera.on_answer(NoFix(0, 0, 1, 1, "image", Reason.NO_MATCH, 1.0)) == []
    assert camera.on_fix(fix_at(0), taken=True, gnss_trusted=True) == []


def test_what_fixes_tell_of_the_tilt_goes_into_the_next_prior_where_the_filter_took_them(tracker: Tracker) -> None:
    turn, cov = (math.radians(0.8), 0.0), ((1e-6, 0.0), (0.0, 1e-6))
    for taken in (False, True):
        camera = OnboardCamera(LEVEL, SIGMA_RAD, (0.0, 0.0, 0.0), ClockOffset(), AttitudeBuffer(), tracker)
        prior = PosePrior(HERE, LEVEL, COV, 3.0, 0.05, SIGMA_RAD)
        camera.asked([LocaliseRequest(1, frame(1, None), prior, 1)])
        fix = replace(fix_at(200 * MS), tilt=TiltSeen(turn, cov))
        assert camera.on_fix(fix, taken=taken, gnss_trusted=False) == []
        known = camera.tilt(400 * MS, LEVEL)
        assert (known is not None) == taken
        if known is not None:
            assert 0.3 * turn[0] < known.turn_ne_rad[0] < turn[0]
            assert known.sigma_rad < SIGMA_RAD


def test_where_fixes_show_the_sun_goes_into_the_next_prior_where_the_filter_took_them(tracker: Tracker) -> None:
    for taken in (False, True):
        camera = OnboardCamera(LEVEL, SIGMA_RAD, (0.0, 0.0, 0.0), ClockOffset(), AttitudeBuffer(), tracker)
        for k in range(FEWEST):
            assert camera.sun(k * 200 * MS) is None
            camera.on_fix(replace(fix_at(k * 200 * MS), sun=Sun(210.0, 35.0)), taken=taken, gnss_trusted=False)
        assert camera.sun(FEWEST * 200 * MS) == (Sun(210.0, 35.0) if taken else None)


def turned_against(tracker: Tracker, *, fix_every: int) -> tuple[OnboardCamera, list[str]]:
    """A camera whose pictures turn against the vehicle, with a fix now and then (0: none), and what it told."""
    clock, attitude = ClockOffset(), AttitudeBuffer()
    camera, said = OnboardCamera(LEVEL, SIGMA_RAD, (0.3, 0.0, 0.0), clock, attitude, tracker), []
    for k in range(1, 60):
        clock.on_arrival(k * 200 * MS, k * 200 * MS)
        attitude.add(k * 200 * MS, se3.quat_from_euler(0.0, 0.0, 0.05 * k), (0.0, 0.0, 0.25))
        turn = Turn((k - 1) * 200 * MS, k * 200 * MS, se3.quat_from_euler(0.0, 0.0, -0.05), TURN_COV)
        found = fix_every > 0 and k % fix_every == 0
        nothing = NoFix(k * 200 * MS, k * 200 * MS, k, k, "image", Reason.NO_MATCH, 1.0, motion=MOTION, turn=turn)
        said += camera.on_answer(camera.of_vehicle(replace(fix_at(k * 200 * MS), motion=MOTION, turn=turn) if found else nothing))
    return camera, [n.text for n in said if isinstance(n, Notice)]


def test_a_picture_that_turns_against_the_vehicle_is_used_no_more(tracker: Tracker) -> None:
    camera, said = turned_against(tracker, fix_every=0)
    assert said == ["visloc: picture is mirrored, NOT USED"]
    after = camera.of_vehicle(replace(fix_at(0), motion=MOTION))
    assert isinstance(after, NoFix)
    assert (after.reason, after.motion, after.turn) == (Reason.BAD_FRAME, None, None)
    lost = NoFix(0, 0, 1, 1, "image", Reason.WORKER_DIED, 1.0, motion=MOTION)
    assert camera.of_vehicle(lost) == replace(lost, motion=None)
    assert camera.of_vehicle(replace(lost, zoomed=fix_at(0))) == replace(lost, motion=None)
    ground = fix_at(0, TERRAIN)
    assert camera.of_vehicle(ground) is ground


def test_a_camera_whose_pictures_are_recognised_is_not_taken_for_mirrored(tracker: Tracker) -> None:
    camera, said = turned_against(tracker, fix_every=15)
    assert said == []
    assert isinstance(camera.of_vehicle(fix_at(0)), Fix)


def test_while_nobody_says_where_the_gimbal_points_the_camera_counts_as_looking_down(tracker: Tracker) -> None:
    """The clock stepped between question and answer: the lever arm is that of a gimbal that points straight down."""
    clock, attitude, lever_m = ClockOffset(), AttitudeBuffer(), 2.0
    gimbal = Gimbal(GimbalSettings(), clock, attitude)
    camera = OnboardCamera(LEVEL, SIGMA_RAD, (lever_m, 0.0, 0.0), clock, attitude, tracker, gimbal)
    for known in (False, True):
        if known:
            clock.on_arrival(200 * MS, 200 * MS)
        moved = camera.of_vehicle(fix_at(200 * MS))
        assert isinstance(moved, Fix)
        assert wgs84.ned_from_geo(moved.place, HERE) == pytest.approx((-lever_m, 0.0, 0.0), abs=1e-6)
    request = LocaliseRequest(1, frame(1, None), PosePrior(HERE, LEVEL, COV, 3.0, 0.05, 0.02), 1)
    asked = camera.asked_of_vehicle(request).prior.place
    assert wgs84.ned_from_geo(asked, HERE) == pytest.approx((-lever_m, 0.0, 0.0), abs=1e-6)


def test_a_gimbal_that_turns_against_the_vehicle_is_no_mirror(tracker: Tracker) -> None:
    """Its pictures turn as it says that it turned, and the other way round than the vehicle did."""
    clock, attitude = ClockOffset(), AttitudeBuffer()
    gimbal = Gimbal(GimbalSettings(), clock, attitude)
    camera, said = OnboardCamera(LEVEL, SIGMA_RAD, (0.0, 0.0, 0.0), clock, attitude, tracker, gimbal), []
    for k in range(1, 60):
        t_ns = k * 200 * MS
        clock.on_arrival(t_ns, t_ns)
        attitude.add(t_ns, se3.quat_from_euler(0.0, 0.0, 0.05 * k), (0.0, 0.0, 0.25))
        q_ned_gimbal = se3.quat_multiply(se3.quat_from_euler(0.0, 0.0, -0.05 * k), se3.quat_from_euler(0.0, -math.pi / 2, 0.0))
        camera.on_gimbal(GimbalAttitude(t_ns, t_ns, 1, q_ned_gimbal, GimbalFrame.NORTH), t_ns)
        turn = Turn((k - 1) * 200 * MS, t_ns, se3.quat_from_euler(0.0, 0.0, -0.05), TURN_COV)
        said += camera.on_answer(NoFix(t_ns, t_ns, k, k, "image", Reason.NO_MATCH, 1.0, turn=turn))
    assert [n.text for n in said if isinstance(n, Notice)] == []


@pytest.mark.parametrize(("used", "doubt"), [(0.04j, 0.01), (0j, 0.04)])
def test_where_the_camera_looked_stays_in_doubt_once_a_delay_is_told(
    tracker: Tracker, monkeypatch: pytest.MonkeyPatch, used: complex, doubt: float
) -> None:
    """What was taken off fixes no longer is: without GNSS nothing tells how much of it was the delay's."""
    camera = OnboardCamera(LEVEL, SIGMA_RAD, (0.0, 0.0, 0.0), ClockOffset(), AttitudeBuffer(), tracker)
    camera._aim.used, camera._aim.doubt = used, doubt

    def told(turn: Turn | None, q_frd_cambody: Quat) -> list[Notice]:
        camera._time.told_s = -0.3
        return []

    monkeypatch.setattr(camera._time, "on_turn", told)
    tracker.height_above_home_m = 100.0
    camera.on_answer(fix_at(1000 * MS))
    assert not camera.aimed
    assert tracker.alike.aim_open == tracker.alike.aim_share == pytest.approx(0.04)
    assert tracker.shared_m == pytest.approx(2.0, abs=0.1)


def test_once_a_delay_is_told_what_was_seen_before_it_counts_no_more(tracker: Tracker) -> None:
    clock, attitude, late_ns = ClockOffset(), AttitudeBuffer(), 1000 * MS
    camera = OnboardCamera(LEVEL, SIGMA_RAD, (0.0, 0.0, 0.0), clock, attitude, tracker)

    def rocking(t_ns: int) -> Quat:
        t_s = t_ns * 1e-9
        return se3.quat_from_euler(0.05 * math.sin(2.3 * t_s), 0.05 * math.sin(1.6 * t_s + 1), 0.3 * math.sin(0.4 * t_s))

    given: list[int] = []
    told_at = None
    for k in range(1, 100):
        for t_ns in range((k - 1) * 200 * MS, k * 200 * MS, 20 * MS):
            clock.on_arrival(t_ns, t_ns)
            attitude.add(t_ns, rocking(t_ns), (0.0, 0.0, 0.0))
        given.append(camera.on_frame(frame(k, None)).t_ns)
        if k < 3:
            continue
        a, b = (rocking(at * 200 * MS - late_ns) for at in (k - 1, k))
        seen = Turn(given[-2], given[-1], se3.quat_multiply(se3.quat_inverse(a), b), TURN_COV)
        answer = replace(fix_at(given[-1]), turn=seen, motion=replace(MOTION, t_from_ns=given[-2], t_to_ns=given[-1]))
        of_vehicle = camera.of_vehicle(answer)
        if told_at is None:
            assert isinstance(of_vehicle, Fix)
        told = [c.text for c in camera.on_answer(of_vehicle) if isinstance(c, Notice) and c.to_operator]
        if told:
            assert told == ["visloc: frames late, corrected: latency_s = 1.00"]
            told_at = len(given)
            assert camera.retimed_s == pytest.approx(-1.0, abs=0.01)
            before = camera.of_vehicle(fix_at(given[-1]))
            assert isinstance(before, NoFix)
            assert before.detail == "the frame was taken at another time than was believed"
        elif told_at == len(given) - 1:
            assert isinstance(of_vehicle, Fix)
            assert of_vehicle.motion is of_vehicle.turn is None
        elif told_at is not None:
            assert isinstance(of_vehicle, Fix)
            assert of_vehicle.motion is not None
    assert told_at is not None


def test_a_stated_fix_comes_with_what_the_mounting_has_of_it(tracker: Tracker) -> None:
    camera = OnboardCamera(LEVEL, SIGMA_RAD, (0.0, 0.0, 0.0), ClockOffset(), AttitudeBuffer(), tracker)
    slope = TiltSeen((0.0, 0.0), ((math.radians(1.6) ** 2, 0.0), (0.0, math.radians(1.6) ** 2)))
    for k in range(1, 40):
        prior = PosePrior(HERE, LEVEL, COV, 3.0, 0.05, SIGMA_RAD, tilt=camera.tilt(200 * MS, LEVEL))
        camera.asked([LocaliseRequest(k, frame(1, None), prior, 1)])
        camera.on_fix(replace(fix_at(200 * MS), request_id=k, tilt=slope), taken=k < 39, gnss_trusted=False)
        if k == 1:
            known = camera.tilt(200 * MS, LEVEL)
    camera.asked([LocaliseRequest(40, frame(1, None), prior, 1)])
    fix, state = replace(fix_at(200 * MS), request_id=40, tilt=slope), tracker.at(200 * MS)
    assert known is not None
    stated = camera.stated(fix, state)
    assert 0.5 * SIGMA_RAD < camera.mounting_rad < known.sigma_rad
    assert stated.cov_ne_m2[0][0] > fix.cov_ne_m2[0][0]
    assert stated.cov_ne_m2[0][1] == fix.cov_ne_m2[0][1]
    tracker.observe(stated, camera.mounting_rad)
    assert tracker.belief is not None and tracker.belief.mounting_rad == camera.mounting_rad
    for other in (replace(fix, method="structure"), replace(fix, method=TERRAIN), replace(fix, tilt=None)):
        assert camera.stated(other, state) == other
        assert camera.mounting_rad == 0
    assert camera.stated(fix, None) == fix
    assert camera.mounting_rad == 0


def test_a_stated_fix_is_turned_around_the_ground_that_it_looks_at(tracker: Tracker, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = OnboardCamera(LEVEL, SIGMA_RAD, (0.0, 0.0, 0.0), ClockOffset(), AttitudeBuffer(), tracker)
    fix, state, turn = fix_at(200 * MS), tracker.at(200 * MS), (0.01, -0.02)
    monkeypatch.setattr(camera._tilt, "told", lambda *_: Told(0.0, 0.0, turn))
    stated = camera.stated(fix, state)
    (x, y, z), (x_before, y_before, z_before) = (se3.R_from_quat(each.q_ned_frd)[:, 2] for each in (stated, fix))
    north, east, _ = wgs84.ned_from_geo(stated.place, fix.place)
    assert (y_before - y, x - x_before) == pytest.approx(turn, abs=1e-4), "the right turn about north and east"
    looked_at = north + 100.0 * x / z, east + 100.0 * y / z
    assert looked_at == pytest.approx((100.0 * x_before / z_before, 100.0 * y_before / z_before), abs=0.05)
    assert math.hypot(north, east) > 2.0
    monkeypatch.setattr(camera._tilt, "told", lambda *_: NOTHING_TOLD)
    assert camera.stated(fix, state).place == fix.place
