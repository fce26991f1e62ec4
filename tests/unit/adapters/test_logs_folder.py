from __future__ import annotations

import re
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink2

from tests.unit.adapters.turned_video import write_upside_down
from tests.unit.adapters.varying_video import write_varying_video
from visloc_companion.adapters.logs.folder import FoundOffset, open_folder
from visloc_companion.errors import ConfigError, LogError

UNIX_US = 1_600_000_000_000_000
LENS = "width_px = 64\nheight_px = 48\nfx_px = 50.0\nfy_px = 50.0\ncx_px = 31.5\ncy_px = 23.5\n"


def telemetry(folder: Path) -> None:
    mav = mavlink2.MAVLink(None, srcSystem=1, srcComponent=1)
    pieces = []
    for k in range(20):
        for message in (mav.heartbeat_encode(2, 3, 0, 0, 4), mav.attitude_encode(60_000 + 100 * k, 0, 0, 0, 0, 0, 0)):
            pieces.append(struct.pack(">Q", UNIX_US + 100_000 * k) + bytes(message.pack(mav)))
    (folder / "telemetry.tlog").write_bytes(b"".join(pieces))


def pictures(folder: Path) -> None:
    for k in range(3):
        cv2.imwrite(str(folder / f"f{k}.png"), np.full((48, 64, 3), (10, 20, 30 + k), np.uint8))
    (folder / "frames.csv").write_text("t_us,file\n60200000,f2.png\n60000000,f0.png\n60100000,f1.png\n")


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    telemetry(tmp_path)
    pictures(tmp_path)
    (tmp_path / "camera.toml").write_text(LENS + 'time_base = "autopilot_boot"\n')
    (tmp_path / "truth.csv").write_text(
        "t_us, lat_deg, lon_deg, h_amsl_m\n60100000,47.4,8.55,500\n\n  \n60000000,47.3,8.55,501\n  \n"
    )
    return tmp_path


def test_a_whole_folder(flight: Path) -> None:
    opened = open_folder(flight)
    assert opened.camera is not None
    assert (opened.camera.width_px, opened.camera.fx_px) == (64, 50.0)
    assert opened.frames is not None
    assert opened.frames.t_us == (60_000_000, 60_100_000, 60_200_000)
    pixels = opened.frames.pixels(2)
    assert pixels is not None
    assert pixels[0, 0].tolist() == [32, 20, 10], "RGB"
    assert [(row.t_ns, row.place.lat_deg) for row in opened.truth] == [(60_000_000_000, 47.3), (60_100_000_000, 47.4)]
    assert opened.boot_from_file_ns == 0


def test_a_mask_is_sought_in_the_folder(flight: Path) -> None:
    cv2.imwrite(str(flight / "gear.png"), np.eye(48, 64, dtype=np.uint8) * 255)
    with (flight / "camera.toml").open("a", encoding="utf-8") as file:
        file.write('mask = "gear.png"\n')
    camera = open_folder(flight).camera
    assert camera is not None
    assert (camera.mask, len(camera.mask_sha256)) == (str(flight / "gear.png"), 64)


@pytest.mark.parametrize("cycles", [1, 2])
def test_a_receiver_that_counts_its_weeks_anew_is_told_with_the_offset(flight: Path, cycles: int) -> None:
    """The remedy is carried out: frames and truth then lie where the autopilot's clock has them."""
    weeks_us = cycles * 1024 * 604_800_000_000
    for name in ("frames.csv", "truth.csv"):
        text = (flight / name).read_text()
        for t_us in (60_000_000, 60_100_000, 60_200_000):
            text = text.replace(str(t_us), str(UNIX_US - 60_000_000 + t_us + weeks_us))
        (flight / name).write_text(text)
    (flight / "camera.toml").write_text(LENS + 'time_base = "unix"\n')
    with pytest.raises(LogError, match=f"{1024 * cycles} weeks off, as of a receiver whose count of weeks") as caught:
        open_folder(flight)
    stated = re.search(r'write (time_base = "offset") and (offset_s = [-0-9.]+) into camera.toml', str(caught.value))
    assert stated is not None
    (flight / "camera.toml").write_text(LENS + "\n".join(stated.groups()) + "\n")
    opened = open_folder(flight)
    assert opened.frames is not None
    assert [t_us * 1000 + opened.boot_from_file_ns for t_us in opened.frames.t_us] == [
        60_000_000_000,
        60_100_000_000,
        60_200_000_000,
    ]
    assert [row.t_ns for row in opened.truth] == [60_000_000_000, 60_100_000_000]


def test_unix_times_are_placed_by_the_log(flight: Path) -> None:
    (flight / "camera.toml").write_text(LENS + 'time_base = "unix"\n')
    (flight / "frames.csv").write_text(f"t_us,file\n{UNIX_US},f0.png\n")
    (flight / "truth.csv").write_text(f"t_us,lat_deg,lon_deg,h_amsl_m\n{UNIX_US + 500_000},47.4,8.55,500\n")
    opened = open_folder(flight)
    assert opened.truth[0].t_ns == 60_500_000_000
    assert "the ground station's clock was taken for it" in opened.notes[0]


def test_an_offset_is_added(flight: Path) -> None:
    toml = LENS + 'time_base = "offset"\noffset_s = 0.25\n'
    (flight / "camera.toml").write_text(toml, encoding="utf-8-sig")
    opened = open_folder(flight)
    assert opened.truth[0].t_ns == 60_250_000_000
    assert opened.boot_from_file_ns == 250_000_000


def test_what_lies_outside_of_the_telemetry_is_counted_and_left_out(flight: Path) -> None:
    seconds = [0, 59, 60, 61, 62, 3600]
    (flight / "truth.csv").write_text("t_us,lat_deg,lon_deg,h_amsl_m\n" + "".join(f"{s * 10**6},47,8,500\n" for s in seconds))
    (flight / "frames.csv").write_text("t_us,file\n59000000,f0.png\n60100000,f1.png\n")
    opened = open_folder(flight)
    assert [row.t_ns // 10**9 for row in opened.truth] == [59, 60, 61, 62], (
        "with the neighbours that the ends are interpolated with"
    )
    assert opened.notes == (
        "Of 2 frames, 1 lie outside of the telemetry and were left out.",
        "Of 6 rows of truth.csv, 4 lie outside of the telemetry and were left out.",
    )


@pytest.mark.parametrize(("name", "row"), [("truth.csv", "60.1,47,8,500"), ("frames.csv", f"{UNIX_US},f0.png")])
def test_times_of_another_base_are_refused(flight: Path, name: str, row: str) -> None:
    text = (flight / name).read_text().splitlines()[0]
    (flight / name).write_text(f"{text}\n{row}\n")
    with pytest.raises(LogError, match=r"lies in the telemetry, which goes from 60\.000 to 61\.900 s.*time_base"):
        open_folder(flight)


@pytest.mark.parametrize(
    ("toml", "words"),
    [
        ('time_base = "gps"', "time_base: 'gps' is unknown"),
        ('time_base = "offset"', "offset_s: needed"),
        ('time_base = "offset"\noffset_s = nan', "offset_s: needed"),
        ('time_base = "offset"\noffset_s = 1e300', "offset_s: needed"),
        ("offset_s = 3.0", "offset_s: means nothing with time_base 'autopilot_boot'"),
        ("width_pxx = 64", "did you mean 'width_px'"),
        ("width_px = ", "cannot be read"),
        ("video_start_us = 1.5", "video_start_us"),
    ],
)
def test_a_wrong_camera_file_is_named(flight: Path, toml: str, words: str) -> None:
    (flight / "camera.toml").write_text(toml)
    with pytest.raises(ConfigError, match=r"camera\.toml") as caught:
        open_folder(flight)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("frames.csv", "t_us,file\nsoon,f0.png\n", "row 1, column t_us"),
        ("frames.csv", "t_us,file\n1,\n", "column file"),
        ("frames.csv", "t_us,file\n", "has no rows"),
        ("frames.csv", "time,name\n1,a.png\n", "column t_us"),
        ("frames.csv", "t_us,t_us,file\n60000000,60100000,f0.png\n", "has column t_us more than once"),
        ("frames.csv", "t_us,file\n60000000,frames\\f0.png\n", "none of the files that it lists is there, the first being "),
        ("truth.csv", "t_us,lat_deg,lat_deg,lon_deg,h_amsl_m\n1,47,46,8,9\n", "has column lat_deg more than once"),
        ("truth.csv", "t_us,lat_deg,lon_deg,h_amsl_m\n1,47,8,\n", "row 1, column h_amsl_m"),
        ("truth.csv", "t_us,lat_deg,lon_deg,h_amsl_m\n1,47,8,4_6\n", "row 1, column h_amsl_m"),
        ("frames.csv", "t_us,file\n60_000_000,f0.png\n", "row 1, column t_us"),
        ("truth.csv", "t_us,lat_deg,lon_deg\n1,47,8\n", "column h_amsl_m"),
        ("truth.csv", "t_us,lat_deg,lon_deg,h_amsl_m\n", "has no rows"),
        ("truth.csv", "", "has no column t_us, lat_deg, lon_deg, h_amsl_m"),
        ("truth.csv", "t_us;lat_deg;lon_deg;h_amsl_m\n1;47;8;9\n", "its first line is 't_us;lat_deg;lon_deg;h_amsl_m'"),
        ("truth.csv", "t_us,lat_deg,lon_deg,h_amsl_m\n1,474000000,85500000,9\n", "column lat_deg: 4.74e+08 is beyond ±90"),
        (
            "truth.csv",
            "t_us,lat_deg,lon_deg,h_amsl_m\n1,-122,47,9\n",
            "-122 is beyond ±90; remedy: write latitudes in degrees; longitudes",
        ),
        ("truth.csv", "t_us,lat_deg,lon_deg,h_amsl_m\n1,47,8,9\n1,0,0,0\n", "row 2, column lat_deg: 0, 0 is what receivers"),
        (
            "truth.csv",
            "t_us,lat_deg,lon_deg,h_amsl_m\n60000000,47,8,9\n61000000,47,8,9\n60000000.0,47,8.001,9\n",
            "row 3, column t_us: has the time of row 1 and another place",
        ),
        (
            "frames.csv",
            "t_us,file\n60.0,f0.png\n60.5,f1.png\n",
            "write microseconds (60.5 looks like seconds), and the frames of one",
        ),
        (
            "truth.csv",
            "t_us,lat_deg,lon_deg,h_amsl_m\n60.0,47,8,9\n60.1,47,8.001,9\n",
            "another place; remedy: write microseconds (60.1 looks like seconds), or leave",
        ),
    ],
)
def test_a_wrong_table_is_named(flight: Path, name: str, text: str, words: str) -> None:
    (flight / name).write_text(text)
    with pytest.raises(LogError, match=name.replace(".", r"\.")) as caught:
        open_folder(flight)
    assert words in str(caught.value)


def test_a_row_of_truth_that_is_there_twice_counts_once(flight: Path) -> None:
    rows = ["60000000,47,8,9", "61000000,47.001,8,9"]
    (flight / "truth.csv").write_text("\n".join(["t_us,lat_deg,lon_deg,h_amsl_m", *rows, rows[0]]) + "\n")
    assert [row.place.lat_deg for row in open_folder(flight).truth] == [47.0, 47.001]


def test_a_frame_that_is_missing_or_damaged_is_none(flight: Path) -> None:
    (flight / "f0.png").unlink()
    (flight / "f1.png").write_bytes(b"\x89PNG damaged")
    (flight / "f2.png").write_bytes(b"")
    opened = open_folder(flight)
    assert opened.frames is not None
    assert [opened.frames.pixels(k) for k in range(3)] == [None, None, None]
    assert opened.notes[0] == f"Of 3 files of frames.csv, 1 are not there, the first being {flight / 'f0.png'}."


def test_frames_need_a_camera(flight: Path) -> None:
    (flight / "camera.toml").unlink()
    with pytest.raises(LogError, match="describe the camera"):
        open_folder(flight)


def test_no_lens_is_assumed_for_frames(flight: Path) -> None:
    """Half of the focal length is twice the height."""
    (flight / "camera.toml").write_text("width_px = 64\nheight_px = 48\nfx_px = 50.0\ncx_px = 31.5\n")
    with pytest.raises(ConfigError, match=r"camera\.toml: does not say fy_px, cy_px; remedy: write the calibration's values"):
        open_folder(flight)
    (flight / "frames.csv").unlink()
    assert open_folder(flight).frames is None, "without frames nobody needs one"


def test_telemetry_must_be_there_once(flight: Path) -> None:
    (flight / "telemetry.bin").write_bytes(b"x")
    with pytest.raises(LogError, match=r"telemetry\.bin, telemetry\.tlog"):
        open_folder(flight)
    (flight / "telemetry.bin").unlink()
    (flight / "telemetry.tlog").unlink()
    with pytest.raises(LogError, match="has none"):
        open_folder(flight)


def make_video(flight: Path, n: int = 6) -> None:
    (flight / "frames.csv").unlink()
    out = cv2.VideoWriter(str(flight / "video.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (64, 48))
    for k in range(n):
        out.write(np.full((48, 64, 3), 40 * k, np.uint8))
    out.release()


def test_a_video_is_timed_by_its_rate_and_read_forwards_and_back(flight: Path) -> None:
    make_video(flight)
    (flight / "camera.toml").write_text(LENS + "video_start_us = 60000000\n")
    frames = open_folder(flight).frames
    assert frames is not None
    assert frames.t_us == tuple(60_000_000 + 100_000 * k for k in range(6))
    for number in (1, 4, 2):
        pixels = frames.pixels(number)
        assert pixels is not None
        assert abs(int(pixels[20, 20, 0]) - 40 * number) <= 3
    assert frames.pixels(6) is None


@pytest.mark.parametrize("shown_ms", [[0, 100, 250, 700, 800, 1500], [0, 100, 250, 250, 900, 1500]])
def test_a_video_of_varying_rate_is_timed_by_its_stamps(flight: Path, shown_ms: list[int]) -> None:
    """Two frames that are shown at once as well: timed by the rate all would be half a second off."""
    (flight / "frames.csv").unlink()
    write_varying_video(flight / "video.mkv", shown_ms)
    (flight / "camera.toml").write_text(LENS + "video_start_us = 60000000\n")
    opened = open_folder(flight)
    assert opened.frames is not None
    assert opened.frames.t_us == tuple(60_000_000 + 1000 * t_ms for t_ms in shown_ms)
    told = "Of 6 frames of video.mkv, 1 has the time of the one before, the first being frame 3 (from 0): add frames.csv"
    assert [note[: len(told)] for note in opened.notes] == [told] * (shown_ms[2] == shown_ms[3])


def test_stamps_that_go_back_are_refused_but_about_an_even_rate(flight: Path) -> None:
    (flight / "frames.csv").unlink()
    (flight / "camera.toml").write_text(LENS + "video_start_us = 60000000\n")
    write_varying_video(flight / "video.mkv", [0, 100, 250, 200, 900, 1500])
    with pytest.raises(LogError, match=r"video\.mkv: its stamps go back, and it has no even rate; remedy: add frames\.csv"):
        open_folder(flight)
    for second_ms in (90, 100):
        write_varying_video(flight / "video.mkv", [0, 100, second_ms, 300, 400, 500])
        opened = open_folder(flight)
        assert opened.frames is not None
        assert opened.frames.t_us == tuple(60_000_000 + 100_000 * k for k in range(6)), "disorder about an even rate"
        assert not opened.notes


def test_a_video_is_read_as_it_is_stored(flight: Path) -> None:
    (flight / "frames.csv").unlink()
    write_upside_down(flight / "video.mp4", 3)
    (flight / "camera.toml").write_text(LENS + "video_start_us = 60000000\n")
    opened = open_folder(flight)
    pixels = opened.frames.pixels(1) if opened.frames is not None else None
    assert pixels is not None
    assert int(pixels[5, 30, 0]) > 150 > int(pixels[40, 30, 0])
    assert opened.notes == ("video.mp4 asks viewers to turn it by 180 degrees: its frames were taken as they are stored.",)


def test_frames_of_two_kinds_or_of_another_number_are_refused(flight: Path) -> None:
    make_video(flight)
    (flight / "frames.csv").write_text("t_us,file\n60000000,f1.png\n60100000,f2.png\n")
    with pytest.raises(LogError, match=r"frames\.csv: lists f1\.png beside video\.avi; remedy: leave either"):
        open_folder(flight)
    for n in (5, 7):
        (flight / "frames.csv").write_text("t_us\n" + "".join(f"{60_000_000 + 100_000 * k}\n" for k in range(n)))
        with pytest.raises(LogError, match=rf"frames\.csv: has {n} rows, video\.avi 6 frames; remedy: write a row for each"):
            open_folder(flight)
    (flight / "video.mp4").write_bytes(b"another")
    with pytest.raises(LogError, match=r"may hold one video, has video\.avi, video\.mp4"):
        open_folder(flight)


def test_a_video_needs_its_start_or_times(flight: Path) -> None:
    make_video(flight, 2)
    with pytest.raises(LogError, match="video_start_us"):
        open_folder(flight)
    (flight / "frames.csv").write_text("t_us\n60000000\n60100000\n")
    frames = open_folder(flight).frames
    assert frames is not None
    assert frames.t_us == (60_000_000, 60_100_000)
    (flight / "frames.csv").write_text("t_us\n60100000\n60000000\n")
    with pytest.raises(LogError, match="row 2, column t_us: goes back"):
        open_folder(flight)


def test_a_video_that_is_none_is_refused(flight: Path) -> None:
    (flight / "frames.csv").unlink()
    (flight / "video.mp4").write_bytes(b"no video")
    (flight / "camera.toml").write_text(LENS + "video_start_us = 60000000\n")
    with pytest.raises(LogError, match="cannot be decoded as a video"):
        open_folder(flight)


def test_turns_of_a_camera_on_a_gimbal_find_no_offset(flight: Path) -> None:
    """They are not the vehicle's: an offset found from them would be wrong without a word."""
    toml = LENS + 'time_base = "offset"\nmount = "gimbal"\n'
    (flight / "camera.toml").write_text(toml)

    def found(*_: object) -> FoundOffset:
        raise AssertionError("it was sought")

    with pytest.raises(LogError, match=r"camera.toml: offset_s: cannot be found from the turns of a camera on a gimbal"):
        open_folder(flight, found)
    (flight / "camera.toml").write_text(toml + "offset_s = 0.25\n")
    assert open_folder(flight, found).boot_from_file_ns == 250_000_000
