"""From the configuration to the link: what is signed, and what stands against it."""

from pathlib import Path

import pytest

from visloc_companion.adapters.mavlink.pymavlink_link import PymavlinkLink
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.app.constructors import make_link
from visloc_companion.app.preflight import preflight
from visloc_companion.config import Config, parse_config
from visloc_companion.errors import ConfigError


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
