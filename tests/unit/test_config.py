"""Configuration: defaults, unknown keys, bad values, files that cannot be read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from visloc_companion.config import Config, load_config, parse_config
from visloc_companion.core.filter.relocalise import MEMORY
from visloc_companion.errors import ConfigError


def test_empty_file_gives_defaults(tmp_path: Path) -> None:
    path = tmp_path / "visloc.toml"
    path.write_text("")
    assert load_config(path) == Config()


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ('[journal]\nfolder = "~/journals"', "journal.folder"),
        ('[map]\ntrusted_keys = ["/etc/a.pub", "~pi/b.pub"]', "map.trusted_keys"),
        ('[camera]\nurl = "files:~/frames"', "camera.url"),
    ],
)
def test_a_path_that_only_a_shell_understands_is_refused(tmp_path: Path, text: str, key: str) -> None:
    """Journals lay in a folder called ~ below wherever the daemon was started."""
    path = tmp_path / "visloc.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=rf"{path}: {key}: only a shell knows what ~ is.*write the whole path"):
        load_config(path)


@pytest.mark.parametrize(
    ("told", "says"),
    [
        ({"link": "udpin:0.0.0.0:14550"}, r"link: it is a section: its keys stand below a line \[NAME\] \(got 'udpin"),
        ({"map": {"trusted_keys": "/etc/a.pub"}}, r"map.trusted_keys: it is a list: write it in brackets, \[ \] \(got '/etc"),
        ({"link": {"operator_systems": 255}}, r"link.operator_systems: it is a list: write it in brackets"),
    ],
)
def test_what_has_another_shape_is_told_in_the_words_of_the_file(told: dict[str, Any], says: str) -> None:
    """It was "a text is no value for it: write numbers without quotes", and "a valid tuple"."""
    with pytest.raises(ConfigError, match=says):
        parse_config(told)


def test_unknown_key_names_the_nearest_valid_one() -> None:
    with pytest.raises(ConfigError, match=r"navigator.output_rate: unknown key, did you mean 'output_rate_hz'"):
        parse_config({"navigator": {"output_rate": 10}})


def test_unknown_section_lists_what_is_valid() -> None:
    with pytest.raises(ConfigError, match=r"xyzzy: unknown key, valid are link, camera"):
        parse_config({"xyzzy": {}})


def test_all_problems_are_told_at_once() -> None:
    with pytest.raises(ConfigError) as caught:
        parse_config({"navigator": {"output_rate_hz": 50}, "link": {"urll": "x"}, "gnss": {"max_h_acc_m": float("nan")}})
    text = str(caught.value)
    assert "navigator.output_rate_hz" in text
    assert "did you mean 'url'" in text
    assert "gnss.max_h_acc_m" in text


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("camera", "mount_sigma_deg", 0),
        ("navigator", "acceleration_correlation_s", 1e-6),
    ],
)
def test_what_the_filter_cannot_compute_with_is_refused_before_the_flight(section: str, key: str, value: float) -> None:
    with pytest.raises(ConfigError, match=rf"{section}\.{key}: Input should be greater"):
        parse_config({section: {key: value}})


@pytest.mark.parametrize(
    "text", ["mount_roll_deg = nan", "mount_yaw_deg = -inf", "distortion = [0.0, nan, 0.0, 0.0, 0.0]", "cx_px = inf"]
)
def test_what_is_no_number_is_refused_by_name(tmp_path: Path, text: str) -> None:
    path = tmp_path / "visloc.toml"
    path.write_text(f"[camera]\n{text}\n")
    with pytest.raises(ConfigError, match=rf"camera\.{text.split(maxsplit=1)[0]}.*finite number"):
        load_config(path)


@pytest.mark.parametrize(
    ("camera", "told"),
    [
        ({"distortion": [0.1, 0.2, 0.0, 0.0]}, "4 coefficients, but distortion_model 'brown_conrady' has 5: k1 k2 p1 p2 k3"),
        ({"distortion_model": "fisheye"}, "5 coefficients, but distortion_model 'fisheye' has 4: k1 k2 k3 k4"),
        ({"distortion_model": "rational", "distortion": [0.1] * 5}, "5 coefficients, .*has 8: k1 k2 p1 p2 k3 k4 k5 k6"),
        (
            {"distortion_model": "equidistant"},
            "camera.distortion_model: Input should be 'brown_conrady', 'rational' or 'fisheye'",
        ),
    ],
)
def test_coefficients_that_do_not_fit_the_lens_are_told(camera: dict[str, object], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        parse_config({"camera": camera})


def test_a_delay_in_milliseconds_is_refused(tmp_path: Path) -> None:
    """No fix that is 6 s old is of use: with 50 for 50 ms none was ever taken, and `run --check` had nothing against it."""
    path = tmp_path / "visloc.toml"
    path.write_text("[camera]\nlatency_s = 50\n")
    with pytest.raises(ConfigError, match=r"visloc\.toml: camera\.latency_s: .*less than or equal to 5 \(got 50\)"):
        load_config(path)
    assert parse_config({"camera": {"latency_s": 2.5}}).camera.latency_s == 2.5


def test_unreadable_and_broken_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"absent.toml: cannot be read"):
        load_config(tmp_path / "absent.toml")
    bad = tmp_path / "bad.toml"
    bad.write_text("[link\nurl = 1")
    with pytest.raises(ConfigError, match=r"bad.toml: is not valid TOML: .*line 1"):
        load_config(bad)
    bad.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match=r"bad.toml: cannot be read"):
        load_config(bad)


def test_a_file_of_another_system_is_read(tmp_path: Path) -> None:
    """Windows' editors put a byte order mark before the text, and end lines their way."""
    path = tmp_path / "visloc.toml"
    path.write_bytes(b'\xef\xbb\xbf[link]\r\nurl = "tcp:h\xc3\xb6he.local:5760"\r\n')
    assert load_config(path).link.url == "tcp:höhe.local:5760"


def test_configuration_is_frozen() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        Config().link.url = "x"


def test_the_default_method_is_the_same_everywhere() -> None:
    from visloc_companion.cli import evaluate, sim
    from visloc_companion.evaluate.campaign import FlightSpec

    spec = FlightSpec("jam", Path(), Path(), None)
    assert {Config().localiser.method, evaluate.DEFAULT_METHOD, sim.DEFAULT_METHOD, spec.method} == {"deep"}


def test_every_method_may_be_configured() -> None:
    from visloc_companion.localise.registry import METHODS

    for method in METHODS:
        assert parse_config({"localiser": {"method": method}}).localiser.method == method


def test_providers_are_an_ordered_choice() -> None:
    assert parse_config({"localiser": {"providers": ["cuda", "cpu"]}}).localiser.providers == ("cuda", "cpu")
    with pytest.raises(ConfigError, match=r"localiser.providers.0: .* \(got 'vulkan'\)"):
        parse_config({"localiser": {"providers": ["vulkan"]}})
    with pytest.raises(ConfigError, match=r"localiser.providers: .* at least 1 item"):
        parse_config({"localiser": {"providers": []}})


def test_true_is_no_number() -> None:
    with pytest.raises(ConfigError, match=r"link\.system_id: true is no value for it"):
        parse_config({"link": {"system_id": True}})
    with pytest.raises(ConfigError, match=r"navigator\.output_rate_hz: true is no value"):
        parse_config({"navigator": {"output_rate_hz": True}})
    with pytest.raises(ConfigError, match=r"camera\.distortion: true is no value"):
        parse_config({"camera": {"distortion": [True, 0.0, 0.0, 0.0, 0.0]}})
    assert parse_config({"localiser": {"odometry": False}}).localiser.odometry is False


@pytest.mark.parametrize(
    "text",
    ['width_px = "640"', 'fx_px = "500.0"', 'lever_arm_frd_m = [0.1, "0.2", 0.0]', 'distortion = ["0", "0", "0", "0", "0"]'],
)
def test_a_text_is_no_number_though_it_looks_like_one(tmp_path: Path, text: str) -> None:
    path = tmp_path / "visloc.toml"
    path.write_text(f"[camera]\n{text}\n")
    with pytest.raises(ConfigError, match=rf"visloc\.toml: camera\.{text.split(maxsplit=1)[0]}: a text .* without quotes \(got "):
        load_config(path)


@pytest.mark.parametrize(
    ("section", "key", "value", "told"),
    [
        ("navigator", "velocity_sigma_aiding_mps", 1e-300, "less than 1e-09"),
        ("localiser", "max_rate_hz", 1e-300, "less than 1e-09"),
        ("navigator", "map_sigma_m", 1e300, r"more than 1e\+09"),
        ("injection", "min_sigma_m", 10**200, r"more than 1e\+09"),
        ("camera", "lever_arm_frd_m", [0.0, -1e200, 0.0], r"more than 1e\+09"),
    ],
)
def test_numbers_whose_squares_are_none_are_told_before_the_flight(section: str, key: str, value: object, told: str) -> None:
    with pytest.raises(ConfigError, match=rf"{section}\.{key}: .*nothing can be computed with {told}"):
        parse_config({section: {key: value}})
    assert (
        parse_config({"navigator": {"integrity_risk": 1e-12}, "camera": {"mount_roll_deg": 1e-14}, "seed": 10**12}).seed == 10**12
    )


@pytest.mark.parametrize("word", ["no", "false", "0"])
def test_a_text_is_neither_true_nor_false(word: str) -> None:
    with pytest.raises(ConfigError, match=r"localiser\.structure: a text is no value for it"):
        parse_config({"localiser": {"structure": word}})


@pytest.mark.parametrize(
    ("camera", "told"),
    [
        ({"mount": "gimble"}, r"camera.mount: Input should be 'fixed' or 'gimbal'"),
        ({"gimbal_id": 2}, r'camera: .*gimbal_id without a gimbal: set mount = "gimbal", or leave out'),
        ({"mount": "fixed", "gimbal_frame": "north"}, r"camera: .*gimbal_frame without a gimbal"),
        ({"mount": "gimbal", "gimbal_id": 9}, r"camera.gimbal_id: .*1 to 6 \(the autopilot's own\) or a component \(154, 171"),
        ({"mount": "gimbal", "gimbal_frame": "body"}, r"camera.gimbal_frame: .*'auto', 'airframe', 'heading' or 'north'"),
        ({"mount": "gimbal", "gimbal_yaw_sigma_deg": 90.0}, r"camera.gimbal_yaw_sigma_deg: "),
    ],
)
def test_a_gimbal_that_cannot_be_is_told(camera: dict[str, object], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        parse_config({"camera": camera})


def test_an_effective_configuration_may_state_the_defaults_of_gimbals() -> None:
    """Journals hold every key; a fixed camera's must be read again."""
    whole = parse_config({"camera": {"mount": "fixed"}}).model_dump(mode="json")
    assert parse_config(whole).camera.mount == "fixed"
    assert parse_config({"camera": {"mount": "gimbal", "gimbal_id": 154}}).camera.gimbal_id == 154


def test_as_many_rejections_are_asked_for_as_are_remembered() -> None:
    """A filter that waits for more than that never starts again from fixes that agree."""
    most = MEMORY - 2  # two more where only a false velocity explains them
    assert parse_config({"navigator": {"relocalise_after_rejections": most}}).navigator.relocalise_after_rejections == most
    with pytest.raises(ConfigError, match="relocalise_after_rejections"):
        parse_config({"navigator": {"relocalise_after_rejections": most + 1}})
