"""Flight folders as they are found: names of other systems, frames there twice, frames of several starts."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink2

from tests.unit.adapters.test_camera_sources import MODEL as CAMERA
from tests.unit.adapters.test_camera_sources import JumpingClock, all_of, folder_of
from tests.unit.adapters.test_camera_sources import Slots as KeptSlots
from tests.unit.adapters.test_logs_dataflash import MODERN, boot, message
from tests.unit.adapters.test_logs_folder import LENS, UNIX_US, make_video, pictures, telemetry
from visloc_companion.adapters.camera.files import FilesCamera
from visloc_companion.adapters.camera.table import stamped_by_autopilot
from visloc_companion.adapters.logs.folder import open_folder
from visloc_companion.errors import CameraError, ConfigError, LogError


@pytest.fixture
def found(tmp_path: Path) -> Path:
    telemetry(tmp_path)
    pictures(tmp_path)
    (tmp_path / "truth.csv").write_text("t_us,lat_deg,lon_deg,h_amsl_m\n60000000,47.3,8.55,501\n")
    (tmp_path / "camera.toml").write_text(LENS)
    return tmp_path


@pytest.mark.parametrize(
    ("name", "other"), [("frames.csv", "Frames.CSV"), ("truth.csv", "Truth.csv"), ("camera.toml", "CAMERA.TOML")]
)
def test_a_file_in_other_letters_is_not_passed_over(found: Path, name: str, other: str) -> None:
    """Windows takes either; a truth or frames that nobody read would be missed by nobody."""
    (found / name).rename(found / other)
    with pytest.raises(LogError, match=rf"{other}: is not read under this name; remedy: name it {name}"):
        open_folder(found)


def test_frames_that_nothing_lists_are_told_of(found: Path) -> None:
    """As cameras name them: the replay said that the flight has no frames, and not why."""
    (found / "truth.csv").unlink()
    make_video(found)
    (found / "video.avi").rename(found / "DJI_0001.AVI")
    images = sorted(path.relative_to(found) for path in found.rglob("*.png"))
    assert open_folder(found).notes == (
        "DJI_0001.AVI was not read: name it video.avi, in the flight's folder.",
        f"{len(images)} images, the first being {images[0]}, were not read: list them in frames.csv with the time of each "
        "(columns t_us,file).",
    )


def test_a_mask_alone_is_no_frame_that_was_forgotten(tmp_path: Path) -> None:
    telemetry(tmp_path)
    (tmp_path / "mask.png").touch()
    assert open_folder(tmp_path).notes == ()


async def test_nor_by_the_daemons_camera(tmp_path: Path) -> None:
    """Without its time base each frame would bear the time of its arrival."""
    folder = folder_of(tmp_path, ["a.png"], "0, a.png\n")
    (folder / "Camera.toml").write_text('time_base = "autopilot_boot"\n')
    with pytest.raises(CameraError, match=r"Camera\.toml: is not read under this name; remedy: name it camera\.toml"):
        FilesCamera(folder, CAMERA, JumpingClock())
    (folder / "Camera.toml").rename(folder / "camera.toml")
    assert [frame.t_boot_ns for frame in await all_of(FilesCamera(folder, CAMERA, JumpingClock()), KeptSlots())] == [0]


def test_log_and_video_may_be_in_other_letters(found: Path) -> None:
    make_video(found)
    (found / "video.avi").rename(found / "VIDEO.AVI")
    (found / "telemetry.tlog").rename(found / "Telemetry.TLOG")
    (found / "camera.toml").write_text(LENS + "video_start_us = 60000000\n")
    frames = open_folder(found).frames
    assert frames is not None
    assert len(frames.t_us) == 6
    assert frames.pixels(3) is not None


@pytest.mark.parametrize("name", ["Flug über See/Bild 1.png", "写真/%05d&{x}.png", "a,b.png"])
def test_names_may_hold_what_file_systems_allow(found: Path, name: str) -> None:
    (found / name).parent.mkdir(exist_ok=True)
    (found / "f0.png").rename(found / name)
    quoted = f'"{name}"' if "," in name else name
    (found / "frames.csv").write_text(f"t_us,file\n60000000,{quoted}\n", encoding="utf-8-sig")
    opened = open_folder(found)
    assert opened.frames is not None
    assert opened.frames.pixels(0) is not None


def test_a_frame_that_is_listed_twice_counts_once(found: Path) -> None:
    """Lists that were put together from overlapping parts; seen twice, the camera would seem to be frozen."""
    (found / "frames.csv").write_text("t_us,file\n60100000,f1.png\n60000000,f0.png\n60100000.0,f1.png\n")
    frames = open_folder(found).frames
    assert frames is not None
    assert frames.t_us == (60_000_000, 60_100_000)


@pytest.mark.parametrize("kind", [LogError, CameraError])
def test_two_files_of_one_time_are_refused(found: Path, kind: type[Exception]) -> None:
    """Of two cameras, or of times in whole seconds: which of them was taken then nobody knows."""
    (found / "frames.csv").write_text("t_us,file\n60000000,f0.png\n61000000,f1.png\n61000000,f2.png\n")
    words = r"frames\.csv, row 3, column t_us: has the time of row 2 and another file; remedy: write finer times, and"
    with pytest.raises(kind, match=words):
        open_folder(found) if kind is LogError else FilesCamera(found, CAMERA, JumpingClock())


@pytest.mark.parametrize(
    ("toml", "told"), [("", True), ('time_base = "unix"\n', False), ('time_base = "offset"\noffset_s = 0.0\n', False)]
)
def test_frames_of_several_starts_of_the_autopilot_are_told(found: Path, toml: str, told: bool) -> None:
    """The clock of each begins at zero: frames of the second would be placed into the first flight."""
    mav = mavlink2.MAVLink(None, srcSystem=1, srcComponent=1)
    with (found / "telemetry.tlog").open("ab") as file:
        for k in range(20):
            for message in (mav.heartbeat_encode(2, 3, 0, 0, 4), mav.attitude_encode(1_000 + 100 * k, 0, 0, 0, 0, 0, 0)):
                file.write(struct.pack(">Q", UNIX_US + 20_000_000 + 100_000 * k) + bytes(message.pack(mav)))
    (found / "camera.toml").write_text(LENS + toml)
    if "unix" in toml:
        for name in ("frames.csv", "truth.csv"):
            text = (found / name).read_text()
            (found / name).write_text(text.replace("\n60", f"\n{(UNIX_US + 0) // 1_000_000}"))
    opened = open_folder(found)
    assert opened.recording.losses.reboots == 1
    said = [note for note in opened.notes if "started more than once in this log, and t_us counts from the first start" in note]
    assert len(said) == told


def test_frames_of_a_boot_that_was_not_read_are_told_of_it(found: Path) -> None:
    """Two boots in one log, a day apart by GPS time; the frames are of the shorter one. Expected: it is named, and then read."""
    day_ms = 86_400_000

    def of_day(day: int, n: int) -> bytes:
        place = (474_000_000, 85_500_000, 54_000, 10.0, 90.0, -0.1, 0.0)
        stamps = [1_000_000 + 200_000 * k for k in range(n)]
        gps = [message(MODERN, "GPS", us, 0, 3, day * day_ms + us // 1000, 2200, 15, 80, *place) for us in stamps]
        return boot(n, 1.0) + b"".join(gps)

    for old in found.glob("telemetry.*"):
        old.unlink()
    (found / "telemetry.bin").write_bytes(of_day(1, 20) + of_day(2, 90))
    first_us = round((315_964_800 + 2200 * 604_800 + 86_400 - 18) * 1e6)
    (found / "truth.csv").unlink()
    (found / "camera.toml").write_text(LENS + 'time_base = "unix"\n')
    (found / "frames.csv").write_text(f"t_us,file\n{first_us + 1_500_000},{next(found.glob('*.png')).name}\n")
    with pytest.raises(LogError, match=r"none of the frames lies in .*read was 2, --boot reads another; remedy: name their boot"):
        open_folder(found)
    frames = open_folder(found, boot=1).frames
    assert frames is not None
    assert len(frames.t_us) == 1


@pytest.mark.parametrize("tail", ["6500", "65000000,47.3,8.5", "65000000,47.3,8.5" + "\0" * 4000, "\0" * 4000])
def test_a_table_that_the_power_was_cut_from_is_read_up_to_there(found: Path, tail: str) -> None:
    """A recorder on board is switched off with the battery: a row is half written, and the disk may have promised zeros."""
    truth, table = (found / name for name in ("truth.csv", "frames.csv"))
    whole = open_folder(found)
    assert not whole.notes and whole.frames is not None
    rows = "60000000,47.3,8.55,501\n61000000,47.3,8.55,502\n"
    truth.write_text("t_us,lat_deg,lon_deg,h_amsl_m\n" + rows + tail)
    listed = table.read_text().rstrip("\n") + "\n"
    table.write_text(listed + (tail if tail.startswith("\0") else "65000000"))
    cut = open_folder(found)
    assert cut.frames is not None and cut.frames.t_us == whole.frames.t_us
    assert cut.notes == tuple(
        f"{name} ends in the middle of a row or in zeros, as a loss of power leaves it: the rows before were read."
        for name in ("frames.csv", "truth.csv")
    )
    truth.write_text("t_us,lat_deg,lon_deg,h_amsl_m\n" + rows.rstrip("\n"))
    table.write_text(listed.rstrip("\n"))
    assert not open_folder(found).notes, "a last row without its end is whole"


@pytest.mark.parametrize("after", [False, True])
def test_a_calibration_is_a_camera_file(found: Path, after: bool) -> None:
    """What `visloc calibrate --out camera.toml` writes, with a time base above it or below, was an unknown key."""
    base, section = 'time_base = "autopilot_boot"\n', f"# visloc calibrate\n[camera]\n{LENS}"
    (found / "camera.toml").write_text(section + base if after else base + section)
    opened = open_folder(found)
    assert opened.camera is not None
    assert (opened.camera.width_px, opened.camera.fx_px) == (64, 50.0)
    assert opened.boot_from_file_ns == 0
    assert stamped_by_autopilot(found)


def test_a_key_above_a_section_and_in_it_is_refused(found: Path) -> None:
    (found / "camera.toml").write_text(f"fx_px = 51.0\n[camera]\n{LENS}")
    with pytest.raises(ConfigError, match="camera: unknown key"):
        open_folder(found)


def test_a_video_that_is_cut_off_is_not_told_by_its_rows(found: Path) -> None:
    """AVI has its index at the end: it has no frames then, and rows were to be taken off."""
    make_video(found)
    rows = "".join(f"{60_000_000 + 100_000 * k}\n" for k in range(6))
    (found / "frames.csv").write_text("t_us\n" + rows)
    data = (found / "video.avi").read_bytes()
    (found / "video.avi").write_bytes(data[: len(data) * 2 // 3])
    with pytest.raises(LogError, match=r"video\.avi: cannot be decoded as a video"):
        open_folder(found)


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        (
            "frames.csv",
            "t_us,file\n60000000,f0.png\n60100000,5,f1.png\n",
            r"row 2: has more fields .*\('f1\.png'\)",
        ),
        (
            "truth.csv",
            "t_us,lat_deg,lon_deg,h_amsl_m\n60000000,47,3,8,55,501\n",
            r"row 1: has more fields .*with a point",
        ),
    ],
)
def test_a_row_of_more_fields_than_columns_is_refused(found: Path, name: str, text: str, told: str) -> None:
    """Decimal commas move every value behind them: a file `5` was missing, and a longitude was 3."""
    (found / name).write_text(text)
    with pytest.raises(LogError, match=rf"{name}, {told}"):
        open_folder(found)


def test_blank_fields_behind_the_last_column_mean_nothing(found: Path) -> None:
    (found / "frames.csv").write_text("t_us,file\n60000000,f0.png,\n60100000,f1.png, ,\n")
    frames = open_folder(found).frames
    assert frames is not None
    assert len(frames.t_us) == 2


def test_an_empty_description_of_the_camera_is_not_called_missing(found: Path) -> None:
    (found / "camera.toml").write_text("")
    with pytest.raises(LogError, match=r"camera\.toml: states nothing; remedy: describe the camera there"):
        open_folder(found)
    (found / "camera.toml").unlink()
    with pytest.raises(LogError, match=r"camera\.toml: is missing beside the frames"):
        open_folder(found)
