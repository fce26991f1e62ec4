"""The frames' clock is found from how pictures and vehicle turn, or it is said that it cannot be."""

from __future__ import annotations

import math
import struct
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink2

from tests.unit.landing_gear import legs, with_gear
from visloc_companion.adapters.logs.recording import Losses, Recording
from visloc_companion.cli.replay_sources import open_source
from visloc_companion.errors import LogError
from visloc_companion.evaluate import camera_offset
from visloc_companion.evaluate.camera_offset import best_offset, seen_turns
from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler, quat_inverse, quat_multiply
from visloc_companion.types import Attitude, AutopilotKind, CameraModel, Image, Quat, Turn

LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
MOUNT = quat_from_euler(0.02, math.radians(12.0), math.radians(90.0))
RATE_HZ, FRAMES_HZ = 20.0, 4.0


def attitudes(duration_s: float, turning: float, seed: int = 3) -> list[Attitude]:
    """A vehicle that rocks, banks and changes its heading now and then; from 50 s of boot time on."""
    rng = np.random.default_rng(seed)
    n = round(duration_s * RATE_HZ)
    smooth = np.hanning(round(3 * RATE_HZ))
    smooth /= smooth.sum()
    shaken = [np.convolve(rng.standard_normal(n + len(smooth)), smooth, "same")[:n] for _ in range(3)]
    roll, pitch = turning * 0.3 * shaken[0], turning * 0.2 * shaken[1]
    yaw = np.cumsum(turning * 0.35 * shaken[2]) / RATE_HZ
    t_ns = [round((50.0 + k / RATE_HZ) * 1e9) for k in range(n)]
    return [
        Attitude(t, t, quat_from_euler(float(r), float(p), float(y)), (0.0, 0.0, 0.0))
        for t, r, p, y in zip(t_ns, roll, pitch, yaw, strict=True)
    ]


def turns_of(told: list[Attitude], first_s: float, seconds: float, late_s: float, noise_rad: float, mount: Quat) -> list[Turn]:
    """What a camera sees from `first_s` on, on a clock that reads `late_s` less than the boot clock; some turns are nonsense."""
    rng = np.random.default_rng(1)
    step = round(RATE_HZ / FRAMES_HZ)
    start = round((first_s - 50.0) * RATE_HZ)
    picked = told[start : start + round(seconds * RATE_HZ) : step]
    found = []
    for k, (a, b) in enumerate(pairwise(picked)):
        rel = quat_multiply(quat_inverse(quat_multiply(a.q_ned_frd, mount)), quat_multiply(b.q_ned_frd, mount))
        off = quat_from_euler(*(float(v) for v in rng.standard_normal(3) * (0.3 if k % 17 == 5 else noise_rad)))
        variance = noise_rad**2
        cov = ((variance, 0.0, 0.0), (0.0, variance, 0.0), (0.0, 0.0, variance))
        shift = round(late_s * 1e9)
        found.append(Turn(a.t_boot_ns - shift, b.t_boot_ns - shift, quat_multiply(rel, off), cov))
    return found


def recording(told: list[Attitude]) -> Recording:
    return Recording(Path("flight/telemetry.tlog"), AutopilotKind.ARDUPILOT, [(a.t_rx_ns, a) for a in told], Losses())


@pytest.mark.parametrize("late_s", [-1234.567, 0.0, 20.115])
def test_the_offset_is_found_in_a_long_log_to_milliseconds(late_s: float) -> None:
    told = attitudes(600.0, 1.0)
    found = best_offset(recording(told), turns_of(told, 200.0, 90.0, late_s, 0.004, MOUNT), told, MOUNT)
    assert found.offset_ns * 1e-9 == pytest.approx(late_s, abs=0.02)
    assert found.sigma_s < 0.02


def test_frames_that_begin_before_the_log_are_placed() -> None:
    told = attitudes(120.0, 1.0)
    turns = turns_of(told, 50.0, 80.0, 7.0, 0.004, LEVEL)
    late = told[round(25 * RATE_HZ) :]
    assert best_offset(recording(late), turns, late, LEVEL).offset_ns * 1e-9 == pytest.approx(7.0, abs=0.02)


def test_steady_flight_and_another_flight_tell_nothing() -> None:
    steady, other = attitudes(300.0, 0.003), attitudes(300.0, 1.0, seed=8)
    told = attitudes(300.0, 1.0)
    for log, turns in (
        (steady, turns_of(steady, 100.0, 90.0, 3.0, 0.004, LEVEL)),
        (other, turns_of(told, 100.0, 90.0, 3.0, 0.004, LEVEL)),
    ):
        with pytest.raises(LogError, match="not far likelier than others"):
            best_offset(recording(log), turns, log, LEVEL)
    with pytest.raises(LogError, match="more than twice as long"):
        best_offset(recording(told[:400]), turns_of(told, 60.0, 200.0, 3.0, 0.004, LEVEL), told[:400], LEVEL)


def write_flight(folder: Path, told: list[Attitude], late_s: float, seconds: float, *, gear: bool = False) -> None:
    """Telemetry and rendered pictures of a textured plane."""
    mav = mavlink2.MAVLink(None, srcSystem=1, srcComponent=1)
    pieces = []
    for k, a in enumerate(told):
        w, x, y, z = a.q_ned_frd
        quaternion = mav.attitude_quaternion_encode(a.t_boot_ns // 1_000_000, w, x, y, z, 0, 0, 0)
        for message in (mav.heartbeat_encode(2, 3, 0, 0, 4), quaternion) if k % 20 == 0 else (quaternion,):
            pieces.append(struct.pack(">Q", 1_600_000_000_000_000 + a.t_boot_ns // 1000) + bytes(message.pack(mav)))
    (folder / "telemetry.tlog").write_bytes(b"".join(pieces))
    (folder / "camera.toml").write_text(
        'time_base = "offset"\nwidth_px = 320\nheight_px = 240\nfx_px = 260.0\nfy_px = 260.0\ncx_px = 159.5\ncy_px = 119.5\n'
    )
    rng = np.random.default_rng(4)
    ground = sum(cv2.resize(rng.normal(0, 1, (n, n)).astype(np.float32), (1200, 1200)) for n in (40, 160, 500))
    ground = np.clip(120 + 30 * ground, 0, 255).astype(np.uint8)
    K_inv = np.linalg.inv(np.array([[260.0, 0.0, 159.5], [0.0, 260.0, 119.5], [0.0, 0.0, 1.0]]))
    rows = ["t_us,file"]
    for k, a in enumerate(told[: round(seconds * RATE_HZ) : round(RATE_HZ / FRAMES_HZ)]):
        to_ground = np.diag([260.0, 260.0, 1.0]) @ np.array([[0, 1.0, 2.3 + 0.01 * k], [-1.0, 0, 2.3], [0, 0, 1.0]])
        H = to_ground @ R_from_quat(a.q_ned_frd) @ R_FRD_CAM @ K_inv
        seen = cv2.warpPerspective(ground, H, (320, 240), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
        cv2.imwrite(str(folder / f"{k}.jpg"), with_gear(seen) if gear else seen)
        rows.append(f"{a.t_boot_ns // 1000 - round(late_s * 1e6)},{k}.jpg")
    (folder / "frames.csv").write_text("\n".join(rows))


def test_a_replay_finds_it_and_says_so(tmp_path: Path) -> None:
    told = attitudes(90.0, 0.6)
    write_flight(tmp_path, told, 31.4, 30.0)
    source = open_source(tmp_path, None, None, False, None)
    (note, *_) = [note for note in source.notes() if "clock was found" in note]
    assert float(note.split("+ ")[1].split(" s")[0]) == pytest.approx(31.4, abs=0.03)


@pytest.mark.parametrize("named", [False, True])
def test_gear_in_view_hides_no_clock_whether_a_mask_names_it_or_not(tmp_path: Path, named: bool) -> None:
    write_flight(tmp_path, attitudes(90.0, 0.6), 31.4, 30.0, gear=True)
    if named:
        cv2.imwrite(str(tmp_path / "mask.png"), np.where(legs(320, 240), 0, 255).astype(np.uint8))
        with (tmp_path / "camera.toml").open("a", encoding="utf-8") as file:
            file.write('mask = "mask.png"\n')
    (note, *_) = [note for note in open_source(tmp_path, None, None, False, None).notes() if "clock was found" in note]
    assert float(note.split("+ ")[1].split(" s")[0]) == pytest.approx(31.4, abs=0.03)


def test_too_few_frames_are_named_with_the_remedy(tmp_path: Path) -> None:
    write_flight(tmp_path, attitudes(60.0, 0.6), 2.0, 4.0)
    with pytest.raises(LogError, match=r"15 pairs of frames and 1200 attitudes.*state offset_s"):
        open_source(tmp_path, None, None, False, None)


@pytest.mark.parametrize("ahead_s", [3.0, -1.5, 0.0])
def test_a_ground_stations_clock_that_is_not_the_cameras_is_told_by_how_much(tmp_path: Path, ahead_s: float) -> None:
    """Taken for UTC it puts fixes so many seconds of flight off along the course."""
    write_flight(tmp_path, attitudes(90.0, 0.6), -1.6e9 + ahead_s, 30.0)
    toml = tmp_path / "camera.toml"
    toml.write_text(toml.read_text().replace('"offset"', '"unix"'))
    notes = open_source(tmp_path, None, None, False, None).notes()
    assert any("the ground station's clock was taken for it" in note for note in notes)
    warned = [note for note in notes if note.startswith("WARNING: by how the pictures turn, that clock was ")]
    if ahead_s == 0.0:
        assert not warned and any(note.startswith("The pictures turn as the log says to 0.0") for note in notes)
        return
    (note,) = warned
    found_s, way = note.split("that clock was ")[1].split(" s ", 1)
    assert float(found_s) == pytest.approx(abs(ahead_s), abs=0.03) and way.startswith("ahead" if ahead_s > 0 else "behind")
    stated = note.split("offset_s = ")[1].split(" into")[0]
    toml.write_text(toml.read_text().replace('time_base = "unix"', f'time_base = "offset"\noffset_s = {stated}'))
    assert not any("that clock" in note for note in open_source(tmp_path, None, None, False, None).notes())


def test_a_ground_stations_clock_that_pictures_tell_nothing_of_is_said_to_be_unchecked(tmp_path: Path) -> None:
    write_flight(tmp_path, attitudes(60.0, 0.6), -1.6e9 + 3.0, 4.0)
    toml = tmp_path / "camera.toml"
    toml.write_text(toml.read_text().replace('"offset"', '"unix"'))
    notes = open_source(tmp_path, None, None, False, None).notes()
    assert "Whether it does could not be told from how the pictures turn." in notes


class Asked:
    """Frames of one picture that remember which of them were asked for."""

    def __init__(self, n: int, rate_hz: float) -> None:
        self.t_us = tuple(round(k * 1e6 / rate_hz) for k in range(n))
        self.numbers: list[int] = []

    def pixels(self, number: int) -> Image | None:
        self.numbers.append(number)
        return None if number % 20 == 0 else np.full((48, 64, 3), 90, np.uint8)


def test_a_video_is_looked_at_beyond_its_first_minutes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 30 frames a second those that are passed over counted, too: it ended after 200 s, the vehicle still on the ground."""
    model = CameraModel(64, 48, 50.0, 50.0, 31.5, 23.5)
    video = Asked(9000, 30.0)
    seen_turns(video, model, LEVEL)
    assert video.t_us[video.numbers[-1]] > 299e6
    monkeypatch.setattr(camera_offset, "MOST_FRAMES", 50)
    few = Asked(9000, 30.0)
    seen_turns(few, model, LEVEL)
    assert len(few.numbers) == 50
