"""`visloc replay` says why not one frame of a folder was localised."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import typer
from pymavlink.dialects.v20 import ardupilotmega as mavlink2
from typer.testing import CliRunner

from visloc_companion.cli.replay import replay
from visloc_companion.evaluate.unasked import unasked_noted
from visloc_companion.types import GeoPoint, PriorPose

UNIX_US = 1_600_000_000_000_000
CAMERA = "width_px = 64\nheight_px = 48\nfx_px = 55.0\nfy_px = 55.0\ncx_px = 31.5\ncy_px = 23.5\n"
MIDDLE = GeoPoint(46.99672, 9.00263, 380.0)
"""80 m above the middle of the tiny world."""
app = typer.Typer()
app.command()(replay)


def flight(folder: Path, place: GeoPoint, above_home_m: float, *, attitudes: bool = True) -> None:
    """Ten seconds at a place, with five frames of noise."""
    mav, sent = mavlink2.MAVLink(None, srcSystem=1, srcComponent=1), []
    lat, lon, h_mm = round(place.lat_deg * 1e7), round(place.lon_deg * 1e7), round(place.h_amsl_m * 1e3)
    for k in range(100):
        boot = 60_000 + 100 * k
        messages = [
            mav.heartbeat_encode(2, 3, 0x81, 0, 4),
            mav.gps_raw_int_encode(boot * 1000, 3, lat, lon, h_mm, 90, 90, 0, 0, 14),
            mav.global_position_int_encode(boot, lat, lon, h_mm, round(above_home_m * 1e3), 0, 0, 0, 0),
        ]
        messages += [mav.attitude_encode(boot, 0, 0, 0, 0, 0, 0)] if attitudes else []
        sent += [struct.pack(">Q", UNIX_US + 100_000 * k) + bytes(message.pack(mav)) for message in messages]
    (folder / "telemetry.tlog").write_bytes(b"".join(sent))
    (folder / "camera.toml").write_text(CAMERA)
    rows = [f"{65_000_000 + 500_000 * k},{k}.png" for k in range(5)]
    (folder / "frames.csv").write_text("t_us,file\n" + "\n".join(rows) + "\n")
    noise = np.random.default_rng(1)
    for k in range(5):
        cv2.imwrite(str(folder / f"{k}.png"), noise.integers(0, 255, (48, 64, 3), dtype=np.uint8))


def replayed(folder: Path, pack: Path) -> str:
    result = CliRunner().invoke(app, [str(folder), "--map", str(pack)])
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.parametrize(("above_home_m", "told"), [(0.0, True), (-14.0, True), (80.0, False)])
def test_a_log_that_never_leaves_the_ground_says_why_no_frame_was_localised(
    tmp_path: Path, tiny_world: Any, above_home_m: float, told: bool
) -> None:
    """A home that was set in the air gives 0 m all the time."""
    flight(tmp_path, MIDDLE, above_home_m)
    text, span = replayed(tmp_path, tiny_world.pack), f"{above_home_m:.1f} and {above_home_m:.1f} m above its home"
    assert (f"none of the 5 frames was localised: the log has the vehicle between {span}" in text) == told


def test_a_log_without_attitudes_says_why_no_frame_was_localised(tmp_path: Path, tiny_world: Any) -> None:
    flight(tmp_path, MIDDLE, 80.0, attitudes=False)
    text = replayed(tmp_path, tiny_world.pack)
    assert "none of the 5 frames was localised: at their times there was never position, velocity, attitude and height" in text


def test_nothing_is_said_where_frames_were_asked_for_or_none_were_there() -> None:
    events = [(1, PriorPose(1, 1, GeoPoint(47.0, 8.0, 400.0), (0.0, 0.0, 0.0), 0.0))]
    assert len(unasked_noted(5, 0, events, 15.0)) == 1
    assert unasked_noted(5, 1, events, 15.0) == []
    assert unasked_noted(0, 0, events, 15.0) == []
