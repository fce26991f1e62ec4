"""From the configuration to the link: what is signed, and what stands against it."""

import errno
import os
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from visloc_companion.adapters.mavlink.outputs.fence import Fence
from visloc_companion.adapters.mavlink.outputs.kinds import Output
from visloc_companion.adapters.mavlink.pymavlink_link import PymavlinkLink
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.app.constructors import make_link
from visloc_companion.app.preflight import preflight
from visloc_companion.config import Config, parse_config
from visloc_companion.errors import ConfigError, HashMismatch


def link_of(config: Config) -> PymavlinkLink:
    link = make_link(config, MonotonicClock(), lambda *_: None, lambda _: None)
    assert isinstance(link, PymavlinkLink)
    return link


def test_without_a_key_nothing_is_signed() -> None:
    assert link_of(Config()).session.settings.signing is None


def test_with_a_key_everything_is_signed(tmp_path: Path) -> None:
    path = tmp_path / "key"
    path.touch(mode=0o600)
    path.write_text("11" * 32)
    config = parse_config({"link": {"signing_key_file": str(path), "signing_link_id": 3, "accept_unsigned": True}})
    signing = link_of(config).session.settings.signing
    assert signing is not None
    assert (signing.key, signing.link_id, signing.accept_unsigned) == (b"\x11" * 32, 3, True)


def test_a_key_that_others_may_read_stands_against_the_start(tmp_path: Path) -> None:
    path = tmp_path / "key"
    path.write_text("secret")
    path.chmod(0o644)
    config = parse_config({"link": {"signing_key_file": str(path)}})
    with pytest.raises(ConfigError):
        link_of(config)
    problems, _ = preflight(config)
    assert [type(problem) for problem in problems] == [ConfigError]


def test_a_disk_that_keeps_no_time_of_signing_is_a_problem_before_the_flight_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    key = tmp_path / "key"
    key.touch(mode=0o600)
    key.write_text("11" * 32)

    def fails(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    config = parse_config({"link": {"signing_key_file": str(key), "signing_stamp_file": str(tmp_path / "stamp")}})
    monkeypatch.setattr(Path, "touch", fails)
    assert link_of(config).session.settings.signing is not None
    problems, _ = preflight(config)
    assert ["cannot be kept" in problem.what for problem in problems] == [True]


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("link", "system_id", 4),
        ("link", "component_id", 198),
        ("link", "operator_systems", (254, 255)),
        ("link", "reconnect_s", 5.0),
        ("injection", "gnss_source_set", 3),
        ("injection", "vision_source_set", 3),
        ("injection", "px4_gps_ctrl", 3),
        ("injection", "position_sensor_id", 7),
        ("injection", "external_estimate_period_s", 4.0),
        ("injection", "max_step_m", 8.0),
    ],
)
def test_no_key_of_the_link_is_lost_on_the_way(section: str, key: str, value: object) -> None:
    settings = link_of(parse_config({section: {key: value}})).session.settings
    assert getattr(settings, key) == value
    assert getattr(link_of(Config()).session.settings, key) != value


@pytest.mark.parametrize(
    ("told", "where"),
    [
        ({"link": {"component_id": 1}}, "link.component_id"),
        ({"link": {"signing_stamp_file": "/tmp/stamp"}}, "link.signing_key_file"),
        ({"link": {"signing_link_id": 2, "signing_stamp_file": "/tmp/stamp"}}, "link.signing_key_file"),
        ({"link": {"gnss_rate_hz": 0.4}}, "link.gnss_rate_hz"),
        ({"gnss": {"silence_s": 0.3}}, "link.gnss_rate_hz"),
        ({"injection": {"switch_source": True, "gnss_source_set": 2}}, "injection.vision_source_set"),
        ({"injection": {"switch_source": True, "px4_gps_ctrl": 0}}, "injection.px4_gps_ctrl"),
        ({"injection": {"switch_source": True, "px4_gps_ctrl": 6}}, "injection.px4_gps_ctrl"),
    ],
)
def test_what_contradicts_itself_stands_against_the_start(told: dict[str, Any], where: str) -> None:
    problems, _ = preflight(parse_config(told))
    assert [(type(problem), problem.where) for problem in problems] == [(ConfigError, where)]
    assert problems[0].remedy
    with pytest.raises(ConfigError):
        link_of(parse_config(told))


def test_what_is_not_used_does_not() -> None:
    assert preflight(parse_config({"injection": {"gnss_source_set": 2, "px4_gps_ctrl": 0}}))[0] == []
    assert preflight(parse_config({"injection": {"switch_source": True}}))[0] == []


def test_a_map_is_looked_at_without_a_camera_too(tmp_path: Path, tiny_world: Any) -> None:
    """GNSS is held against it on the ground; a pack that lacked a file, or had another's pixels, passed the check."""
    pack = tmp_path / "pack"
    shutil.copytree(tiny_world.pack, pack)
    settings = {"map": {"pack": str(pack)}}
    assert preflight(parse_config(settings))[0] == []
    whole = (pack / "ortho.tif").read_bytes()
    (pack / "ortho.tif").write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    (problem,) = preflight(parse_config(settings))[0]
    assert isinstance(problem, HashMismatch) and "ortho.tif" in str(problem)
    assert preflight(parse_config({"map": settings["map"] | {"verify_hashes": False}}))[0] == []
    (pack / "ortho.tif").unlink()
    assert "ortho.tif: the pack lacks this file" in str(preflight(parse_config(settings))[0][0])


def test_a_problem_is_told_once(tiny_world: Any) -> None:
    """A focal length in millimetres stood there twice, as the camera's and the localiser's."""
    camera = {"url": "tcp:127.0.0.1:5600", "fx_px": 3.6, "fy_px": 3.6}
    told = {"map": {"pack": str(tiny_world.pack)}, "camera": camera, "localiser": {"method": "gradient"}}
    (problem,) = preflight(parse_config(told))[0]
    assert "camera.fx_px: 3.6 px are a view of 179°" in str(problem)


def test_positions_stay_near_the_map_and_its_middle_may_become_the_origin(monkeypatch: pytest.MonkeyPatch) -> None:
    bounds = SimpleNamespace(south_deg=-1.0, west_deg=179.9, north_deg=1.0, east_deg=-179.7)
    manifest = SimpleNamespace(bounds=bounds, heights=SimpleNamespace(plane_amsl_m=12.0, grid=None))
    monkeypatch.setattr("visloc_companion.maps.signature.read_signed", lambda folder, trusted: manifest)
    told = {"map": {"pack": "pack"}, "injection": {"max_outside_map_m": 300.0, "output": "odometry", "position_sensor_id": 7}}
    settings = link_of(parse_config(told)).session.settings
    assert settings.fence == Fence(-1.0, 179.9, 1.0, -179.7, 300.0)
    assert (settings.output, settings.position_sensor_id, settings.origin_to_set) == (Output.ODOMETRY, 7, None)
    allowed = link_of(parse_config({**told, "injection": {"set_origin": True}})).session.settings
    assert allowed.output is None
    assert allowed.origin_to_set is not None
    assert (allowed.origin_to_set.lat_deg, allowed.origin_to_set.h_amsl_m) == (0.0, 12.0)
    assert allowed.origin_to_set.lon_deg == pytest.approx(-179.9)


def test_an_origin_that_is_to_be_set_lies_on_the_ground_of_the_map(tiny_world: Any) -> None:
    """It lay at --ground-height-m, 0 by default, over packs with a surface model as well: ArduPilot counts its height above the
    sea from there, so that 300 m of it were missing."""
    told = {"map": {"pack": str(tiny_world.pack)}}
    assert link_of(parse_config(told)).session.settings.origin_to_set is None
    origin = link_of(parse_config({**told, "injection": {"set_origin": True}})).session.settings.origin_to_set
    assert origin is not None
    assert origin.h_amsl_m == pytest.approx(300.0, abs=1.0)


def test_without_a_map_there_is_no_fence_and_no_origin_to_set() -> None:
    assert link_of(Config()).session.settings.fence is None
    with pytest.raises(ConfigError, match="set_origin"):
        link_of(parse_config({"injection": {"set_origin": True}}))
