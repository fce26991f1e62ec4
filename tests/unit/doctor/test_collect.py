"""What is read of camera, map, network and computer, and the drift of a clock."""

from __future__ import annotations

import asyncio
import math
import re
import shutil
import subprocess
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.unit.doctor.conftest import good_facts
from visloc_companion.adapters.camera.calibration import camera_model
from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.config import CameraConfig, Config, parse_config
from visloc_companion.doctor.collect.camera import read_camera
from visloc_companion.doctor.collect.maps import read_map
from visloc_companion.doctor.collect.model import read_model
from visloc_companion.doctor.collect.rates import drift
from visloc_companion.doctor.collect.system import read_system
from visloc_companion.doctor.collect.vehicle import barometer_h_amsl_m
from visloc_companion.doctor.finding import judge
from visloc_companion.doctor.rules.registry import RULES
from visloc_companion.errors import CameraError
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.build import build_pack
from visloc_companion.prepare.sign import make_keys, open_signer, sign_pack
from visloc_companion.types import AutopilotKind, CameraModel, FrameRef, GeoPoint, TimesyncSample


def samples(ppm: float, n: int = 60, jitter_ms: float = 0.0) -> list[TimesyncSample]:
    rng = np.random.default_rng(1)
    found = []
    for k in range(n):
        sent, rtt = k * 100_000_000, 2_000_000 + int(abs(rng.normal(0.0, jitter_ms)) * 1e6)
        found.append(TimesyncSample(sent + rtt, sent, 7_000_000_000 + round((sent + rtt // 2) * (1 + ppm * 1e-6))))
    return found


@pytest.mark.parametrize("ppm", [-900.0, 0.0, 40.0, 900.0])
def test_the_drift_of_the_autopilots_clock_is_found_within_its_sigma(ppm: float) -> None:
    slope, sigma = drift(samples(ppm, jitter_ms=1.0))
    assert slope == pytest.approx(ppm, abs=3 * sigma + 1.0)
    assert sigma < 100.0


def test_too_few_exchanges_or_too_short_a_time_give_no_drift() -> None:
    assert drift(samples(0.0, n=5)) == (None, 0.0)
    assert drift([replace(s, t_sent_ns=0, t_rx_ns=1000) for s in samples(0.0)])[0] is None


class Frames:
    """A camera of so many frames, each a flat grey or noise."""

    def __init__(self, grey: int | None, n: int = 8) -> None:
        self.grey, self.n, self.closed = grey, n, False

    def model(self) -> CameraModel:
        return CameraModel(640, 480, 500.0, 500.0, 319.5, 239.5)

    async def frames(self, slots: Any) -> AsyncIterator[FrameRef]:
        for k in range(self.n):
            await asyncio.sleep(0.01)
            noise = np.random.default_rng(k).integers(20, 200, (48, 64, 3)).astype(np.uint8)
            slots.write(noise if self.grey is None else np.full((48, 64, 3), self.grey, np.uint8))
            yield FrameRef(k, 0, 0, 0, 64, 48, 3)

    def left_out(self) -> dict[str, int]:
        return {}

    async def close(self) -> None:
        self.closed = True


CAMERA = parse_config({"camera": {"url": "device:0"}})


async def camera_facts(camera: Frames, config: Config = CAMERA) -> Any:
    facts = await read_camera(config, MonotonicClock(), 0.3, lambda *_: camera)
    assert camera.closed or not config.camera.url
    return facts


async def test_frames_are_counted_and_looked_at() -> None:
    facts = await camera_facts(Frames(None))
    assert (facts.problem, facts.n_frames, facts.repeated) == ("", 8, 0.0)
    assert facts.rate_hz > 0
    assert facts.dark == facts.bright == 0.0


async def test_black_and_repeated_frames_are_seen() -> None:
    facts = await camera_facts(Frames(0))
    assert (facts.dark, facts.bright, facts.repeated) == (1.0, 0.0, 1.0)


class Round(Frames):
    """A fisheye whose image is a circle as high as the picture, black around it."""

    def __init__(self, section: CameraConfig, grey: int = 200) -> None:
        super().__init__(grey, 3)
        v, u = np.mgrid[0:240, 0:320]
        self.lens, self.circle = camera_model(section), np.hypot(u - 159.5, v - 119.5) < 120.0

    def model(self) -> CameraModel:
        return self.lens

    async def frames(self, slots: Any) -> AsyncIterator[FrameRef]:
        for k in range(self.n):
            slots.write(np.where(self.circle, self.grey - k, 0).astype(np.uint8))
            yield FrameRef(k, 0, 0, 0, 320, 240, 1)


@pytest.mark.parametrize(("half_deg", "grey", "unlit"), [(90.0, 200, 0.0), (45.0, 200, 0.44), (45.0, 20, 0.0)])
async def test_black_around_the_image_counts_where_it_is_looked_at(half_deg: float, grey: int, unlit: float) -> None:
    """A circle of 180° holds all that is looked at, one of 90° half of it; a lens that is capped says nothing of its rim."""
    focal = {"fx_px": 120 / math.radians(half_deg), "fy_px": 120 / math.radians(half_deg)}
    size = {"width_px": 320, "height_px": 240, "cx_px": 159.5, "cy_px": 119.5}
    lens = {"distortion_model": "fisheye", "distortion": (0.0, 0.0, 0.0, 0.0)}
    config = parse_config({"camera": {"url": "device:0", **size, **focal, **lens}})
    facts = await camera_facts(Round(config.camera, grey), config)
    assert (facts.problem, facts.n_frames) == ("", 3)
    assert facts.unlit == pytest.approx(unlit, abs=0.02)
    assert facts.dark == pytest.approx(0.0 if half_deg == 90.0 else 0.44, abs=0.02)


async def test_a_rim_that_is_masked_is_no_rim(tmp_path: Path) -> None:
    v, u = np.mgrid[0:240, 0:320]
    cv2.imwrite(str(tmp_path / "mask.png"), np.where(np.hypot(u - 159.5, v - 119.5) < 118, 255, 0).astype(np.uint8))
    size = {"width_px": 320, "height_px": 240, "cx_px": 159.5, "cy_px": 119.5, "fx_px": 152.8, "fy_px": 152.8}
    lens = {"distortion_model": "fisheye", "distortion": (0.0, 0.0, 0.0, 0.0), "mask": str(tmp_path / "mask.png")}
    config = parse_config({"camera": {"url": "device:0", **size, **lens}})
    facts = await camera_facts(Round(config.camera), config)
    assert (facts.problem, facts.unlit, facts.dark) == ("", 0.0, 0.0)
    good = good_facts(AutopilotKind.PX4)
    answers = {a.rule.id: a for a in judge(RULES, replace(good, camera=facts, config=config))}
    assert str(answers["camera-rim"].level) == str(answers["camera-mask"].level) == "green"
    assert re.fullmatch(r"4[4-7] % of what is looked at are masked", answers["camera-mask"].read)


async def test_a_camera_that_gives_nothing_or_cannot_be_used_is_a_problem() -> None:
    assert (await camera_facts(Frames(None, n=0))).problem == "gave no frames"
    other = parse_config({"camera": {"url": "device:0", "width_px": 1280}})
    facts = await read_camera(other, MonotonicClock(), 0.3, lambda *_: Frames(None))
    assert "its calibration is" in facts.problem

    def missing(*_: object) -> Frames:
        raise CameraError("cannot be opened", where="device:9", remedy="check the name")

    assert "check the name" in (await read_camera(CAMERA, MonotonicClock(), 0.3, missing)).problem
    assert await camera_facts(Frames(None), Config()) is None


def test_a_camera_that_another_program_uses_is_a_finding_with_its_process(tmp_path: Path) -> None:
    device = tmp_path / "video0"
    device.write_bytes(b"no video")
    config = parse_config({"camera": {"url": f"device:{device}"}})
    with device.open("rb") as file, subprocess.Popen(["sleep", "60"], stdin=file) as other:
        facts = asyncio.run(read_camera(config, MonotonicClock(), 0.3))
        other.kill()
    assert facts is not None and f"is used by another program: process {other.pid} (sleep)" in facts.problem


def test_the_barometers_height_is_what_px4_states() -> None:
    def altitude(monotonic_m: float) -> Any:
        return mav.MAVLink_altitude_message(1, monotonic_m, *[math.nan] * 5)

    assert barometer_h_amsl_m(altitude(405.5)) == 405.5
    assert (barometer_h_amsl_m(altitude(math.nan)), barometer_h_amsl_m(None)) == (None, None)


def test_a_pack_is_held_against_home_and_mission(tiny_world: Any) -> None:
    pack = PackMap.open(tiny_world.pack)
    middle = GeoPoint(*pack.to_geo(500_200.0, 5_204_800.0), 305.0)
    outside = GeoPoint(*pack.to_geo(500_500.0, 5_204_800.0), 0.0)
    link = good_facts(AutopilotKind.PX4).link
    config = parse_config({"map": {"pack": str(tiny_world.pack)}})
    facts = read_map(config, replace(link, home=middle, mission=(middle, outside)), ("network", "recipe"))
    assert facts.problem == ""
    assert facts.home_margin_m == pytest.approx(200.0, abs=1.0)
    assert facts.mission_margin_m == pytest.approx(-100.0, abs=1.0)
    assert facts.height_above_surface_m == pytest.approx(5.0, abs=1.0)
    assert "holds no features" in facts.features_missing
    assert (facts.capture_date, facts.has_surface) == ("2026-01-01", True)
    alone = read_map(config, None, None)
    assert (alone.home_margin_m, alone.mission_margin_m, alone.features_missing) == (None, None, "")


def test_home_and_mission_over_an_empty_corner_are_told(tmp_path: Path, write_raster: Any) -> None:
    """Within the pack's rectangle, where an orthomosaic shows nothing: both rules were green."""
    image = np.random.default_rng(1).integers(1, 255, (600, 600)).astype(np.uint8)
    image[:300, 300:] = 0
    write_raster(tmp_path / "a.tif", image, "EPSG:32633", (47.0, 15.3), 1.0, nodata=0)
    build_pack([tmp_path / "a.tif"], None, tmp_path / "pack")
    pack = PackMap.open(tmp_path / "pack")
    box = pack.manifest.bounds

    def at(east_m: float, south_m: float) -> GeoPoint:
        return GeoPoint(*pack.to_geo(box.west_map_m + east_m, box.north_map_m - south_m), 0.0)

    link = good_facts(AutopilotKind.PX4).link
    config = parse_config({"map": {"pack": str(tmp_path / "pack")}})
    west, south_east, corner = at(150.0, 150.0), at(450.0, 450.0), at(450.0, 150.0)
    told = read_map(config, replace(link, home=corner, mission=(west, corner, south_east)), None)
    assert told.home_margin_m > 100.0 and told.mission_margin_m > 100.0, "inside the rectangle"
    assert told.home_empty
    assert told.mission_empty == pytest.approx(0.5, abs=0.1)
    fine = read_map(config, replace(link, home=west, mission=(west, at(150.0, 450.0), south_east)), None)
    assert (fine.home_empty, fine.mission_empty) == (False, 0.0)


def test_how_well_a_pack_is_tied_to_wgs_84_is_told(tmp_path: Path, tiny_world: Any, write_raster: Any) -> None:
    image = np.random.default_rng(1).integers(1, 255, (100, 100)).astype(np.uint8)
    write_raster(tmp_path / "a.tif", image, "EPSG:26717", (36.0, -80.0), 1.0)
    build_pack([tmp_path / "a.tif"], None, tmp_path / "pack")
    told = [read_map(parse_config({"map": {"pack": str(pack)}}), None, None) for pack in (tmp_path / "pack", tiny_world.pack)]
    assert [facts.crs_accuracy_m for facts in told if facts is not None] == [10.0, 0.0]


def test_a_pack_that_is_none_is_a_problem(tmp_path: Path) -> None:
    assert "manifest.json" in read_map(parse_config({"map": {"pack": str(tmp_path)}}), None, None).problem
    assert read_map(Config(), None, None) is None


def test_a_signature_is_asked_for_where_keys_are_trusted(tmp_path: Path, tiny_world: Any) -> None:
    pack, pair = tmp_path / "pack", make_keys(tmp_path / "fleet")
    shutil.copytree(tiny_world.pack, pack)
    trusting = parse_config({"map": {"pack": str(pack), "trusted_keys": [str(pair.public)]}})
    unsigned = read_map(trusting, None, None)
    assert unsigned.problem == unsigned.signed_by == "" and "manifest.sig: is not there" in unsigned.signature_problem
    sign_pack(pack, open_signer(pair.private))
    signed, unasked = read_map(trusting, None, None), read_map(parse_config({"map": {"pack": str(pack)}}), None, None)
    assert (signed.signed_by, signed.signature_problem) == (pair.fingerprint, "")
    assert unasked == replace(signed, signed_by="")
    pair.public.unlink()
    assert "fleet.pub: cannot be read" in read_map(trusting, None, None).signature_problem


def test_a_network_answers_its_golden_input_or_is_a_problem(network: Path, tmp_path: Path) -> None:
    facts, wanted = read_model(parse_config({"localiser": {"model": str(network)}}))
    assert (facts.needed, facts.problem, facts.provider) == (True, "", "cpu")
    assert wanted is not None
    assert "tiny" in wanted[0]
    facts, wanted = read_model(parse_config({"localiser": {"model": str(tmp_path)}}))
    assert "no such file" in facts.problem
    assert wanted is None
    assert read_model(parse_config({"localiser": {"method": "gradient"}}))[0].needed is False


def system_tree(root: Path, **files: str) -> Path:
    for name, text in files.items():
        path = root / name.replace("__", "/")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="ascii")
    return root


def test_the_computer_is_read_from_linux(tmp_path: Path) -> None:
    root = system_tree(
        tmp_path,
        proc__meminfo="MemTotal: 4096000 kB\nMemAvailable: 2048000 kB\nSwapTotal: 1024000 kB\nSwapFree: 512000 kB\n",
        proc__cmdline="root=/dev/mmcblk0p2 console=ttyAMA0,115200 quiet",
        sys__class__thermal__thermal_zone0__temp="61500\n",
        sys__class__thermal__thermal_zone1__temp="40000\n",
        sys__class__thermal__thermal_zone2__temp="2147483\n",
        sys__devices__system__cpu__cpu0__cpufreq__scaling_governor="powersave\n",
    )
    config = parse_config({"link": {"url": "serial:/dev/ttyAMA0:921600"}, "journal": {"folder": str(tmp_path / "journals")}})
    facts = read_system(config, root)
    assert (facts.memory_free_mb, facts.swap_used_mb, facts.temperature_c) == (2000.0, 500.0, 61.5)
    assert (facts.governor, facts.console_on_serial, facts.bits) == ("powersave", True, 64)
    assert facts.journal_problem == ""
    assert facts.disk_free_mb is not None
    assert facts.cores >= 1


def test_what_the_system_does_not_tell_is_unknown(tmp_path: Path) -> None:
    config = parse_config({"link": {"url": "serial:/dev/no-such-port:57600"}, "journal": {"folder": "/proc/none"}})
    facts = read_system(config, tmp_path)
    assert facts.memory_free_mb is facts.swap_used_mb is facts.temperature_c is facts.governor is facts.console_on_serial is None
    assert facts.serial_problem == "/dev/no-such-port does not exist"
    assert "/proc/none" in facts.journal_problem
