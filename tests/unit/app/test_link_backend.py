"""Who owns the connection: this program or MAVSDK."""

import time
from pathlib import Path

import pytest

from visloc_companion.adapters.mavlink import mavsdk_channel
from visloc_companion.adapters.mavlink.mavsdk_channel import MavsdkOpener, load_library
from visloc_companion.adapters.mavlink.pymavlink_link import PymavlinkLink
from visloc_companion.adapters.mavlink.signing_stamp import MARGIN
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.app.constructors import make_link
from visloc_companion.config import parse_config
from visloc_companion.errors import ConfigError


def make(**link: object) -> PymavlinkLink:
    made = make_link(parse_config({"link": link}), MonotonicClock(), lambda *_: None, lambda _: None)
    assert isinstance(made, PymavlinkLink)
    return made


def test_mavsdk_opens_the_connection(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mavsdk_channel, "load_library", object)
    assert isinstance(make(backend="mavsdk")._open_channel, MavsdkOpener)
    assert not isinstance(make()._open_channel, MavsdkOpener)


def test_mavsdk_and_a_key_exclude_each_other(tmp_path: Path) -> None:
    key = tmp_path / "key"
    key.touch(mode=0o600)
    key.write_text("secret")
    with pytest.raises(ConfigError, match=r"link.backend: MAVSDK cannot sign.*remedy"):
        make(backend="mavsdk", signing_key_file=str(key))


def test_without_the_package_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "mavsdk", None)
    with pytest.raises(ConfigError, match=r"link.backend = mavsdk.*visloc-companion\[mavsdk\]"):
        load_library()


def test_signing_goes_on_where_the_last_start_ended(tmp_path: Path) -> None:
    """A clock that is behind does not make old recordings new."""
    key, stamp = tmp_path / "key", tmp_path / "stamp"
    key.touch(mode=0o600)
    key.write_text("secret")
    far_ahead = 2**46
    stamp.write_text(f"{far_ahead}\n")
    link = make(signing_key_file=str(key), signing_stamp_file=str(stamp))
    link.session.poll(MonotonicClock().now_ns())
    by_s = time.monotonic() + 30.0
    while int(stamp.read_text()) == far_ahead and time.monotonic() < by_s:
        time.sleep(0.01)  # a thread writes
    assert far_ahead + MARGIN <= int(stamp.read_text()) < far_ahead + 2 * MARGIN
