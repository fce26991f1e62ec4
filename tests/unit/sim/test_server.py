"""The simulated autopilot and its camera as a process of their own."""

from __future__ import annotations

import asyncio
import json
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from visloc_companion.adapters.camera.tcp import FrameDecoder, StreamedFrame
from visloc_companion.errors import ConfigError, MapError
from visloc_companion.geo.wgs84 import distance_m
from visloc_companion.maps.crs import map_crs
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.server import ServerPlan, SimulationServer, _Datagrams, main
from visloc_companion.testing.loopback import free_port
from visloc_companion.types import AutopilotKind, GeoPoint

EAST_M, NORTH_M, SIZE_PX = 500_000.0, 5_205_000.0, 300
BOOT_AGE_S = 3.0


@pytest.fixture
def plan(tmp_path: Path) -> ServerPlan:
    """The flight with the frozen camera over 300 x 300 m of noise, forty times as fast as the clock."""
    pixels = np.random.default_rng(1).integers(0, 255, (SIZE_PX, SIZE_PX, 3)).astype(np.uint8)
    T_map_pix = np.array([[1.0, 0.0, EAST_M], [0.0, -1.0, NORTH_M]])
    ortho, dsm = Scene(pixels, np.full((SIZE_PX, SIZE_PX), 480.0, np.float32), T_map_pix, "EPSG:32632").save(tmp_path)
    lat_deg, lon_deg = map_crs("EPSG:32632").to_geo(EAST_M + SIZE_PX / 2, NORTH_M - SIZE_PX / 2)
    return ServerPlan(
        scenario="camera_freeze",
        kind=AutopilotKind.PX4,
        vehicle="copter",
        seed=1,
        speed=40.0,
        mavlink_port=free_port(socket.SOCK_DGRAM),
        camera_port=free_port(socket.SOCK_STREAM),
        frame_rate_hz=1.0,
        ortho=str(ortho),
        dsm=str(dsm),
        home=GeoPoint(lat_deg, lon_deg, 480.0),
        reach_m=200.0,
        gsd_m=0.5,
        turn_rad=0.3,
        result=str(tmp_path / "truth.json"),
    )


def test_a_plan_is_read_as_it_was_written(plan: ServerPlan, tmp_path: Path) -> None:
    plan.save(tmp_path / "plan.json")
    assert ServerPlan.load(tmp_path / "plan.json") == plan
    without_dsm = replace(plan, dsm=None)
    without_dsm.save(tmp_path / "plan.json")
    assert ServerPlan.load(tmp_path / "plan.json") == without_dsm


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"sped": 2.0}, "missing or unknown fields: sped"),
        ({"seed": ...}, "missing or unknown fields: seed"),
        ({"kind": "betaflight"}, "'betaflight' is not a valid AutopilotKind"),
        ({"home": {"lat": 1.0}}, "lat"),
        ({"scenario": "picnic"}, "scenario: unknown name 'picnic'"),
    ],
)
def test_a_wrong_plan_is_named(plan: ServerPlan, tmp_path: Path, change: dict[str, Any], complaint: str) -> None:
    path = tmp_path / "plan.json"
    plan.save(path)
    data = json.loads(path.read_text(encoding="utf-8")) | change
    path.write_text(json.dumps({name: value for name, value in data.items() if value is not ...}), encoding="utf-8")
    with pytest.raises(ConfigError, match=complaint) as caught:
        ServerPlan.load(path)
    assert str(path) in str(caught.value)
    assert "remedy" in str(caught.value)


@pytest.mark.parametrize("text", ["", "[]", "[1, 2]", "{", "null"])
def test_what_is_no_plan_at_all_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "plan.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match="is no plan of a flight"):
        ServerPlan.load(path)


def test_the_process_says_in_one_line_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in ([], [str(tmp_path / "none.json")]):
        with pytest.raises(SystemExit) as end:
            main(arguments)
        assert end.value.code == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        assert said.startswith("error: ")


def test_a_scene_that_is_none_is_refused(plan: ServerPlan) -> None:
    with pytest.raises(MapError):
        SimulationServer(replace(plan, ortho=plan.result))


def test_the_autopilot_is_never_ahead_of_the_clock(plan: ServerPlan) -> None:
    server = SimulationServer(plan)
    start_ns = now_ns = 123_456_789
    for wait_ns in [3_700_000] * 200 + [250_000_000, 1, 9_999_999]:
        server.advance_to(now_ns)
        elapsed_s = (now_ns - start_ns) / 1e9
        assert elapsed_s - 0.01 - 1e-6 < server.pilot.t_s <= elapsed_s + 1e-6
        now_ns += wait_ns


def test_a_process_that_was_held_up_flies_no_longer_than_the_scenario(plan: ServerPlan) -> None:
    server = SimulationServer(plan)
    for now_s in (0.0, 129.0, 137.0, 140.0):
        server.advance_to(round(now_s * 1e9))
    assert server.pilot.t_s == pytest.approx(130.0, abs=0.021)


def watch(port: int, frames: list[StreamedFrame]) -> None:
    """Connect as soon as somebody listens, and take frames until the other end hangs up."""
    decoder = FrameDecoder(1 << 20)
    for _ in range(400):
        try:
            stream = socket.create_connection(("127.0.0.1", port), timeout=0.1)
            break
        except OSError:
            threading.Event().wait(0.05)
    with stream:
        stream.settimeout(30.0)
        try:
            while data := stream.recv(1 << 18):
                frames += [decoded for frame in decoder.feed(data) if (decoded := frame.decoded()) is not None]
        except ConnectionResetError:
            return


def test_it_flies_serves_and_ends_without_a_word(plan: ServerPlan, tmp_path: Path) -> None:
    """A viewer that still watches at the end is hung up on: exit code 0, nothing on stderr, and the truth is written."""
    plan.save(tmp_path / "plan.json")
    frames: list[StreamedFrame] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", plan.mavlink_port))
        station.settimeout(30.0)
        viewer = threading.Thread(target=watch, args=(plan.camera_port, frames))
        viewer.start()
        command = [sys.executable, "-m", "visloc_companion.sim.server", str(tmp_path / "plan.json")]
        process = subprocess.Popen(command, stderr=subprocess.PIPE)
        first = station.recv(2000)
        _, said = process.communicate(timeout=60)
    viewer.join()
    assert (process.returncode, said) == (0, b"")
    assert "HEARTBEAT" in {message.get_type() for message in mavlink.MAVLink(None).parse_buffer(first)}
    result = json.loads(Path(plan.result).read_text(encoding="utf-8"))
    assert result["pulled_m"] == 0.0
    assert "land" in result["failsafe"], "nobody helped the vehicle through the jamming"
    times_ns = [row[0] for row in result["truth"]]
    assert times_ns == sorted(times_ns)
    assert times_ns[-1] - times_ns[0] == pytest.approx(130e9, abs=2e9)
    assert max(distance_m(GeoPoint(*row[1:]), plan.home) for row in result["truth"]) < 400.0
    assert len(frames) >= 2  # of 130; how many a viewer gets in 3 s is the machine's load
    assert all(frame.autopilot_clock and frame.pixels.shape == (480, 640, 3) for frame in frames)
    times_s = [frame.t_us / 1e6 - BOOT_AGE_S for frame in frames]
    assert times_s == sorted(times_s)
    for one, two, t_s in zip(frames, frames[1:], times_s[1:], strict=False):
        assert np.array_equal(one.pixels, two.pixels) == (60.0 <= t_s < 72.0), f"at {t_s:.1f} s"


@pytest.mark.parametrize(("scenario", "fault"), [("worker_crash", "WorkerCrash"), ("companion_clock_step", "CompanionClockStep")])
def test_faults_of_the_companion_itself_are_refused(plan: ServerPlan, scenario: str, fault: str) -> None:
    """They were passed over without a word: the daemon flew without a fault."""
    with pytest.raises(ConfigError, match=rf"{scenario!r} holds {fault}, .*remedy: .*visloc sim --scenario {scenario}"):
        SimulationServer(replace(plan, scenario=scenario))


async def test_nothing_passes_while_the_link_is_down(plan: ServerPlan) -> None:
    """The scenario has gaps from 45, 60 and 75 s on; what is sent meanwhile is lost, either way."""
    plan = replace(plan, scenario="link_gaps", speed=25.0)
    server, sent, heard, tried = SimulationServer(plan), [], [], []
    server.pilot.receive = lambda data: heard.append(server.pilot.t_s)  # type: ignore[method-assign]

    class Recorder:
        """Takes what is sent, and answers each packet at once."""

        def sendto(self, data: bytes) -> None:
            sent.append(server.pilot.t_s)

    async def answers() -> None:
        while True:
            tried.append(server.pilot.t_s)
            _Datagrams(server.pilot).datagram_received(b"x", ("", 0))
            await asyncio.sleep(0.001)

    answering = asyncio.create_task(answers())
    await server._fly(Recorder())  # type: ignore[arg-type]
    answering.cancel()
    gaps = ((45.0, 46.0), (60.0, 62.0), (75.0, 79.0))
    assert all(any(first <= t_s < end for t_s in tried) for first, end in gaps)
    for times_s in (sent, heard):
        assert not [t_s for t_s in times_s for first, end in gaps if first <= t_s < end]
        assert [t_s for t_s in times_s if t_s < 45] and [t_s for t_s in times_s if t_s >= 79]


async def test_frames_that_are_late_overtake_each_other(plan: ServerPlan, monkeypatch: pytest.MonkeyPatch) -> None:
    """0.2 to 1 s after their exposure from 40 s on, as the scenario has it; their stamps stay those of the exposure."""
    server = SimulationServer(replace(plan, scenario="frames_late", speed=1.0, frame_rate_hz=20.0))
    server.advance_to(0)
    server.advance_to(50_000_000_000)
    server._viewers = {None: None}  # type: ignore[dict-item]
    exposed_s: dict[int, float] = {}
    arrived: list[tuple[int, float]] = []

    def render(*_: object) -> np.ndarray:
        exposed_s[len(exposed_s) + 1] = time.monotonic()
        return np.full((2, 2, 3), len(exposed_s), np.uint8)

    def deliver(data: bytes) -> None:
        (frame,) = FrameDecoder(1 << 20).feed(data)
        decoded = frame.decoded()
        assert decoded is not None
        arrived.append((int(decoded.pixels[0, 0, 0]), time.monotonic()))

    monkeypatch.setattr(server, "_camera", SimpleNamespace(render=render))
    monkeypatch.setattr(server, "_deliver", deliver)
    flying = asyncio.create_task(server._frames())
    await asyncio.sleep(2.5)
    flying.cancel()
    numbers = [number for number, _ in arrived]
    assert len(numbers) > 5 and numbers != sorted(numbers)
    assert min(t_s - exposed_s[number] for number, t_s in arrived) >= 0.19


async def test_a_picture_that_is_repeated_with_other_noise_is_rendered_anew(
    plan: ServerPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = SimulationServer(replace(plan, scenario="camera_stuck", speed=1.0, frame_rate_hz=20.0))
    server.advance_to(0)
    server.advance_to(30_000_000_000)
    server._viewers = {None: None}  # type: ignore[dict-item]
    seen: list[tuple[object, int]] = []

    def render(place: object, q: object, frame_id: int, shot: object) -> np.ndarray:
        seen.append((place, frame_id))
        server.advance_to(server._stepped_ns + 100_000_000)  # type: ignore[operator]
        return np.zeros((2, 2, 3), np.uint8)

    monkeypatch.setattr(server, "_camera", SimpleNamespace(render=render))
    monkeypatch.setattr(server, "_deliver", lambda data: None)
    flying = asyncio.create_task(server._frames())
    await asyncio.sleep(1.0)
    flying.cancel()
    assert len(seen) > 2
    assert len({place for place, _ in seen}) == 1 and len({frame_id for _, frame_id in seen}) == len(seen)
