"""What is replayed over a pack: by the keys of the configuration that is given, where one is."""

import shutil
from pathlib import Path
from typing import Any

import pytest

from visloc_companion.app.journal import JournalHeader
from visloc_companion.cli.replay_sources import open_source
from visloc_companion.cli.rerun_source import RerunSource
from visloc_companion.config import Config, MapConfig, parse_config
from visloc_companion.errors import ConfigError, LogError, SignatureInvalid
from visloc_companion.prepare.sign import KeyPair, make_keys, open_signer, sign_pack


@pytest.fixture
def pair(tmp_path: Path) -> KeyPair:
    return make_keys(tmp_path / "fleet")


def test_a_log_is_flown_over_a_signed_pack_where_the_configuration_asks_for_one(
    tmp_path: Path, tiny_world: Any, pair: KeyPair
) -> None:
    pack, own, log = tmp_path / "pack", tmp_path / "own.toml", tmp_path / "flight.tlog"
    shutil.copytree(tiny_world.pack, pack)
    own.write_text(f'[map]\ntrusted_keys = ["{pair.public}"]\n')
    log.write_bytes(b"no log")
    with pytest.raises(LogError):  # the pack was taken, as nobody asks for a signature
        open_source(log, pack, None, False, None)
    with pytest.raises(SignatureInvalid, match="is not there"):
        open_source(log, pack, own, False, None)
    sign_pack(pack, open_signer(pair.private))
    with pytest.raises(LogError):
        open_source(log, pack, own, False, None)
    pair.public.unlink()
    with pytest.raises(ConfigError, match=r"own\.toml: map\.trusted_keys = .*fleet\.pub: cannot be read"):
        open_source(log, pack, own, False, None)


def test_the_keys_of_an_aircraft_are_not_looked_for_where_its_journal_is_replayed(pair: KeyPair) -> None:
    flown = JournalHeader(Config(map=MapConfig(pack="pack", trusted_keys=("/etc/visloc/fleet.pub",))).model_dump(mode="json"))
    source = RerunSource(Path("flight.mcap"), None, Path("flight.mcap"), None, salvage=False)
    assert source._effective(flown).map == MapConfig(pack="pack")
    lens = {"width_px": 640, "height_px": 480, "fx_px": 554.0, "fy_px": 554.0, "cx_px": 319.5, "cy_px": 239.5}
    own = parse_config({"camera": lens, "map": {"pack": "pack", "trusted_keys": [str(pair.public)]}})
    given = RerunSource(Path("flight.mcap"), own, Path("own.toml"), Path("other"), salvage=False)
    assert given._effective(flown).map == MapConfig(pack="other", trusted_keys=(str(pair.public),))
