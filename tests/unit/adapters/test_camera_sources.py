"""Cameras of files, videos and TCP streams: times, sizes, damage, ends and reconnection."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.unit.adapters.turned_video import write_upside_down
from tests.unit.adapters.varying_video import write_varying_video
from visloc_companion.adapters.camera.factory import make_camera
from visloc_companion.adapters.camera.files import FilesCamera
from visloc_companion.adapters.camera.tcp import Encoding, StreamedFrame, TcpCamera, encode_frame
from visloc_companion.adapters.camera.video import VideoCamera
from visloc_companion.config import CameraConfig
from visloc_companion.errors import CameraError, ConfigError
from visloc_companion.protocols import Camera
from visloc_companion.types import CameraModel, FrameRef, Image

MODEL = CameraModel(64, 48, 60.0, 60.0, 31.5, 23.5)


class Slots:
    """Keeps every picture."""

    def __init__(self) -> None:
        self.pictures: list[Image] = []

    def write(self, pixels: Image) -> int:
        self.pictures.append(pixels.copy())
        return len(self.pictures) - 1

    def read(self, frame: FrameRef) -> Image:
        return self.pictures[frame.slot]


class JumpingClock:
    """Time that passes only by sleeping, at once."""

    def __init__(self) -> None:
        self.t_ns = 5_000_000_000

    def now_ns(self) -> int:
        return self.t_ns

    async def sleep_until(self, t_ns: int) -> None:
        await asyncio.sleep(0)
        self.t_ns = max(self.t_ns, t_ns)


class WallClock:
    def now_ns(self) -> int:
        return time.monotonic_ns()

    async def sleep_until(self, t_ns: int) -> None:
        await asyncio.sleep(max(0.0, (t_ns - self.now_ns()) / 1e9))


def picture(tone: int, width: int = 64, height: int = 48) -> Image:
    pixels = np.full((height, width, 3), 40, np.uint8)
    pixels[:, :, 0] = tone
    return pixels


def write_png(path: Path, pixels: Image) -> None:
    path.write_bytes(cv2.imencode(".png", pixels[:, :, ::-1])[1].tobytes())


def folder_of(tmp_path: Path, names: list[str], rows: str) -> Path:
    for number, name in enumerate(names):
        write_png(tmp_path / name, picture(100 + number))
    (tmp_path / "frames.csv").write_text("t_us, file\n" + rows, encoding="utf-8")
    return tmp_path


async def all_of(camera: Camera, slots: Slots) -> list[FrameRef]:
    return [frame async for frame in camera.frames(slots)]


async def test_files_come_in_time_order_at_their_pace_with_their_pixels(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, ["a.png", "b.png", "c.png"], "2000000, c.png\n1000000, a.png\n1250000, b.png\n")
    slots = Slots()
    frames = await all_of(FilesCamera(folder, MODEL, JumpingClock()), slots)
    assert [frame.t_ns for frame in frames] == [5_000_000_000, 5_250_000_000, 6_000_000_000]
    assert [int(slots.read(frame)[0, 0, 0]) for frame in frames] == [100, 101, 102]
    assert all(frame.t_boot_ns is None and (frame.width_px, frame.height_px, frame.channels) == (64, 48, 3) for frame in frames)
    assert len({frame.frame_id for frame in frames}) == 3


async def test_files_of_the_autopilots_clock_say_so(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, ["a.png"], "1000001, a.png\n")
    (folder / "camera.toml").write_text('time_base = "autopilot_boot"\n', encoding="utf-8")
    (frame,) = await all_of(FilesCamera(folder, MODEL, JumpingClock()), Slots())
    assert frame.t_boot_ns == 1_000_001_000


async def test_damaged_and_missing_images_are_left_out(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, ["a.png", "b.png"], "0, a.png\n1, broken.png\n2, missing.png\n3, b.png\n4, empty.png\n")
    (folder / "broken.png").write_bytes((folder / "a.png").read_bytes()[:60])
    (folder / "empty.png").touch()
    camera = FilesCamera(folder, MODEL, JumpingClock())
    assert len(await all_of(camera, Slots())) == 2
    assert camera.unreadable == 3


async def test_a_folder_without_one_readable_image_is_an_error(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, [], "0, a.png\n")
    with pytest.raises(CameraError, match=r"none of the 1 images.*remedy"):
        await all_of(FilesCamera(folder, MODEL, JumpingClock()), Slots())


async def test_an_image_of_another_size_names_file_sizes_and_remedy(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, ["a.png"], "0, a.png\n")
    write_png(folder / "a.png", picture(1, 80, 60))
    with pytest.raises(CameraError, match=r"a\.png: image is 80x60, the calibration is for 64x48; remedy: .*calibrate"):
        await all_of(FilesCamera(folder, MODEL, JumpingClock()), Slots())


async def test_an_image_of_another_size_among_others_is_left_out(tmp_path: Path) -> None:
    """A camera that broke is opened again; a recording would begin anew each time."""
    folder = folder_of(tmp_path, ["a.png", "b.png", "c.png"], "0, a.png\n1, b.png\n2, c.png\n")
    write_png(folder / "b.png", picture(1, 80, 60))
    camera, slots = FilesCamera(folder, MODEL, JumpingClock()), Slots()
    frames = await all_of(camera, slots)
    assert [int(slots.read(frame)[0, 0, 0]) for frame in frames] == [100, 102]
    assert (camera.misfits, camera.unreadable) == (1, 0)


@pytest.mark.parametrize(
    ("table", "text"),
    [
        ("t_us, file\n", "has no rows"),
        ("t_us, file\nsoon, a.png\n", "row 1, column t_us"),
        ("time, file\n1, a.png\n", "column t_us"),
        ("t_us, file\n5,\n", "row 1, column file"),
    ],
)
def test_a_wrong_table_names_the_row_and_column(tmp_path: Path, table: str, text: str) -> None:
    (tmp_path / "frames.csv").write_text(table, encoding="utf-8")
    with pytest.raises(CameraError, match=text):
        FilesCamera(tmp_path, MODEL, JumpingClock())


def test_a_missing_folder_or_table_is_named(tmp_path: Path) -> None:
    with pytest.raises(CameraError, match="not a folder"):
        FilesCamera(tmp_path / "nowhere", MODEL, JumpingClock())
    with pytest.raises(CameraError, match=r"frames\.csv: cannot be read"):
        FilesCamera(tmp_path, MODEL, JumpingClock())


async def test_a_closed_folder_ends(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, ["a.png", "b.png"], "0, a.png\n1000, b.png\n")
    camera = FilesCamera(folder, MODEL, JumpingClock())
    seen = []
    async with contextlib.aclosing(camera.frames(Slots())) as frames:  # type: ignore[type-var]
        async for frame in frames:
            seen.append(frame)
            await camera.close()
    assert len(seen) == 1


def write_video(path: Path, n: int, width: int = 64, height: int = 48) -> None:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (width, height))
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no MJPG video")
    for k in range(n):
        writer.write(np.ascontiguousarray(picture(60 + 30 * k, width, height)[:, :, ::-1]))
    writer.release()


async def test_a_video_is_timed_by_its_rate_or_by_the_table_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "flight.avi"
    write_video(path, 4)
    slots = Slots()
    frames = await all_of(VideoCamera(path, MODEL, JumpingClock()), slots)
    assert [frame.t_ns - frames[0].t_ns for frame in frames] == [0, 100_000_000, 200_000_000, 300_000_000]
    assert [int(p[20, 20, 0]) for p in slots.pictures] == pytest.approx([60, 90, 120, 150], abs=6)
    path.with_suffix(".csv").write_text("t_us\n7000000\n7500000\n8000000.0\n8.5e6\n", encoding="utf-8")
    timed = await all_of(VideoCamera(path, MODEL, JumpingClock()), Slots())
    assert [frame.t_ns - timed[0].t_ns for frame in timed] == [0, 500_000_000, 1_000_000_000, 1_500_000_000]


async def test_a_video_of_varying_rate_is_timed_by_its_stamps(tmp_path: Path) -> None:
    shown_ms = [0, 100, 250, 700, 800, 1500]
    write_varying_video(tmp_path / "flight.mkv", shown_ms)
    frames = await all_of(VideoCamera(tmp_path / "flight.mkv", MODEL, JumpingClock()), Slots())
    assert [(frame.t_ns - frames[0].t_ns) // 1_000_000 for frame in frames] == shown_ms


async def test_a_video_is_shown_as_it_is_stored(tmp_path: Path) -> None:
    write_upside_down(tmp_path / "flight.mp4", 2)
    slots = Slots()
    await all_of(VideoCamera(tmp_path / "flight.mp4", MODEL, JumpingClock()), slots)
    assert [int(picture[5, 30, 0]) > 150 > int(picture[40, 30, 0]) for picture in slots.pictures] == [True, True]


def test_videos_that_cannot_be_used_are_named(tmp_path: Path) -> None:
    with pytest.raises(CameraError, match=r"no\.mp4: cannot be opened"):
        VideoCamera(tmp_path / "no.mp4", MODEL, JumpingClock())
    write_video(tmp_path / "large.avi", 1, 80, 64)
    with pytest.raises(CameraError, match=r"large\.avi: image is 80x64, the calibration is for 64x48"):
        VideoCamera(tmp_path / "large.avi", MODEL, JumpingClock())


@contextlib.asynccontextmanager
async def sending(*streams: bytes) -> AsyncIterator[str]:
    """A server that gives each connection the next stream and then hangs up; the last one is kept open."""
    left, done = list(streams), asyncio.Event()

    async def serve(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        data = left.pop(0) if left else b""
        with contextlib.suppress(ConnectionError):
            writer.write(data)
            await writer.drain()
            if not left:
                await done.wait()
        writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    try:
        yield f"127.0.0.1:{server.sockets[0].getsockname()[1]}"
    finally:
        done.set()
        server.close()
        await server.wait_closed()
        await asyncio.sleep(0.01)


async def first_frames(camera: TcpCamera, slots: Slots, n: int) -> list[FrameRef]:
    seen: list[FrameRef] = []
    async with asyncio.timeout(10.0), contextlib.aclosing(camera.frames(slots)) as frames:  # type: ignore[type-var]
        async for frame in frames:
            seen.append(frame)
            if len(seen) == n:
                break
    await camera.close()
    return seen


@pytest.mark.parametrize("encoding", list(Encoding))
async def test_a_streamed_frame_arrives_with_the_autopilots_time(encoding: Encoding) -> None:
    data = encode_frame(StreamedFrame(picture(150), 12_345_678, autopilot_clock=True), encoding)
    slots = Slots()
    async with sending(data) as address:
        (frame,) = await first_frames(TcpCamera(address, MODEL, WallClock(), latency_s=0.02), slots, 1)
    assert frame.t_boot_ns == 12_345_678_000
    assert frame.t_rx_ns - frame.t_ns == 20_000_000
    assert slots.pictures[0].mean((0, 1)) == pytest.approx([150, 40, 40], abs=3)


async def test_a_frame_of_the_senders_own_clock_is_stamped_on_arrival() -> None:
    async with sending(encode_frame(StreamedFrame(picture(1)[:, :, 0], 99))) as address:
        (frame,) = await first_frames(TcpCamera(address, MODEL, WallClock()), Slots(), 1)
    assert (frame.t_boot_ns, frame.channels) == (None, 1)


async def test_a_lost_connection_is_made_again_and_damage_is_skipped() -> None:
    good = [encode_frame(StreamedFrame(picture(k), k, autopilot_clock=True)) for k in range(3)]
    damaged = bytearray(good[1])
    damaged[500] ^= 255
    async with sending(good[0] + good[1][:300], bytes(damaged) + good[2]) as address:
        camera = TcpCamera(address, MODEL, WallClock(), reconnect_s=0.01)
        frames = await first_frames(camera, Slots(), 2)
    assert [frame.t_boot_ns for frame in frames] == [0, 2_000]
    assert (camera.connections, camera.resyncs) == (2, 1)


async def test_of_frames_that_wait_only_the_newest_is_taken() -> None:
    stream = b"".join(encode_frame(StreamedFrame(picture(k), k, autopilot_clock=True)) for k in range(20))
    async with sending(stream) as address:
        camera = TcpCamera(address, MODEL, WallClock())
        seen: list[int] = []
        async with asyncio.timeout(10.0), contextlib.aclosing(camera.frames(Slots())) as frames:  # type: ignore[type-var]
            async for frame in frames:
                seen.append((frame.t_boot_ns or 0) // 1000)
                if seen[-1] == 19:
                    break
        await camera.close()
    assert seen == sorted(seen)
    assert len(seen) + camera.skipped == 20


async def test_a_stream_of_another_size_names_address_sizes_and_remedy() -> None:
    async with sending(encode_frame(StreamedFrame(picture(1, 32, 24), 0))) as address:
        with pytest.raises(CameraError, match=rf"tcp:{address}: image is 32x24, the calibration is for 64x48; remedy"):
            await first_frames(TcpCamera(address, MODEL, WallClock()), Slots(), 1)


async def test_nobody_there_yields_nothing_and_close_ends_it() -> None:
    async with sending(b"") as address:
        pass
    camera = TcpCamera(address, MODEL, WallClock(), reconnect_s=0.01)
    task = asyncio.create_task(all_of(camera, Slots()))
    await asyncio.sleep(0.1)
    assert not task.done()
    await camera.close()
    assert await asyncio.wait_for(task, 5.0) == []


async def test_nobody_there_for_long_is_an_error_that_says_what_to_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("visloc_companion.adapters.camera.tcp.PATIENCE_S", 0.05)
    async with sending(b"") as address:
        pass
    with pytest.raises(CameraError, match=rf"tcp:{address}: no camera process answers there: .*Connect call failed.*start"):
        await asyncio.wait_for(all_of(TcpCamera(address, MODEL, WallClock(), reconnect_s=0.01), Slots()), 5.0)


def test_urls_name_cameras(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, ["a.png"], "0, a.png\n")
    sized = {"width_px": 64, "height_px": 48, "cx_px": 31.5, "cy_px": 23.5}
    assert isinstance(make_camera(CameraConfig(url=f"files:{folder}", **sized), JumpingClock()), FilesCamera)
    camera = make_camera(CameraConfig(url="tcp:[::1]:5600", **sized, fx_px=61.0), JumpingClock())
    assert isinstance(camera, TcpCamera)
    assert (camera.model().width_px, camera.model().fx_px) == (64, 61.0)
    for wrong in ("", "files:", "webcam:0", "files"):
        with pytest.raises(ConfigError, match=r"camera\.url.*remedy: use one of files:FOLDER"):
            make_camera(CameraConfig(url=wrong), JumpingClock())
    for wrong in ("tcp:localhost", "tcp:host:0", "tcp:host:x", "tcp:host:70000"):
        with pytest.raises(CameraError, match="HOST:PORT"):
            make_camera(CameraConfig(url=wrong), JumpingClock())
