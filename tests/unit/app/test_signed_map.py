"""Where keys are trusted nothing of the daemon uses a pack that none of them has signed, nor files that are not as signed."""

import json
import os
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from visloc_companion.app.clock import MonotonicClock
from visloc_companion.app.ground_check import open_pack
from visloc_companion.app.journal import JournalHeader, JournalWriter, read_header
from visloc_companion.app.link import map_extent
from visloc_companion.app.parts import Constructors, Reports, StartFailed, assemble, journal_header
from visloc_companion.app.preflight import preflight
from visloc_companion.app.replay import flown_config
from visloc_companion.app.worker import file_stamps
from visloc_companion.app.worker_process import open_localiser
from visloc_companion.config import Config, parse_config
from visloc_companion.errors import ConfigError, HashMismatch, SignatureInvalid, VislocError
from visloc_companion.maps.manifest import MANIFEST, read_manifest, write_manifest
from visloc_companion.maps.signature import SIGNATURE
from visloc_companion.prepare.sign import KeyPair, make_keys, open_signer, sign_pack
from visloc_companion.testing.fake_link import FakeLink

REPORTS = Reports(lambda notice: None, lambda text: None, lambda text: None)
CAMERA = {"url": "tcp:127.0.0.1:5600"} | dict.fromkeys(("fx_px", "fy_px"), 500.0) | {"cx_px": 320.0, "cy_px": 240.0}


@pytest.fixture
def pair(tmp_path: Path) -> KeyPair:
    return make_keys(tmp_path / "fleet")


@pytest.fixture
def pack(tmp_path: Path, tiny_world: Any, pair: KeyPair) -> Path:
    shutil.copytree(tiny_world.pack, tmp_path / "pack")
    sign_pack(tmp_path / "pack", open_signer(pair.private))
    return tmp_path / "pack"


def trusting(pack: Path, pair: KeyPair, **more: Any) -> Config:
    return parse_config({"map": {"pack": str(pack), "trusted_keys": [str(pair.public)]}, **more})


def rewritten(pack: Path) -> None:
    """The attack: another capture date, and the hash that belongs to it."""
    write_manifest(pack, read_manifest(pack).model_copy(update={"capture_date": "2026-06-30"}))


def written_to(file: Path) -> None:
    """One bit of a file, its size and the time of its last change as before."""
    before, raw = file.stat(), file.read_bytes()
    with file.open("r+b") as out:
        out.seek(len(raw) // 2)
        out.write(bytes([raw[len(raw) // 2] ^ 1]))
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))


async def started(config: Config, make: Constructors | None = None) -> list[VislocError]:
    """What stands against the start; the real worker opens the pack where there is one."""
    link = Constructors(lambda config, clock, *_: (map_extent(config), FakeLink(clock))[1], lambda *_: None)  # type: ignore[arg-type, return-value]
    try:
        parts = await assemble(config, MonotonicClock(), make or link, REPORTS)
    except StartFailed as failed:
        return list(failed.exceptions)  # type: ignore[arg-type]
    await parts.close()
    return []


async def test_the_daemon_starts_over_a_signed_pack(pack: Path, pair: KeyPair) -> None:
    assert await started(trusting(pack, pair)) == []
    assert preflight(trusting(pack, pair))[0] == []
    assert map_extent(trusting(pack, pair)) == map_extent(parse_config({"map": {"pack": str(pack)}}))


@pytest.mark.parametrize("more", [{}, {"localiser": {"terrain": True, "method": "gradient"}}], ids=["ground alone", "worker"])
async def test_the_daemon_does_not_start_over_another_one(pack: Path, pair: KeyPair, more: dict[str, Any]) -> None:
    rewritten(pack)
    assert await started(parse_config({"map": {"pack": str(pack)}, **more})) == []
    (problem,) = await started(trusting(pack, pair, **more))
    assert isinstance(problem, SignatureInvalid) and str(pack / SIGNATURE) in str(problem)
    (problem,) = preflight(trusting(pack, pair, **more))[0]
    assert isinstance(problem, SignatureInvalid)


async def test_files_are_hashed_at_the_start_where_only_the_ground_is_held_against_them(pack: Path, pair: KeyPair) -> None:
    """Without camera and terrain nobody did: a signed manifest beside exchanged heights was believed."""
    written_to(pack / "dsm.tif")
    (problem,) = await started(trusting(pack, pair))
    assert isinstance(problem, HashMismatch) and "dsm.tif" in str(problem)


async def test_a_key_that_is_not_there_stands_against_the_start_once(pack: Path, pair: KeyPair) -> None:
    pair.public.unlink()
    for problems in (await started(trusting(pack, pair)), preflight(trusting(pack, pair))[0]):
        assert [type(problem) for problem in problems] == [ConfigError]
        assert f"map.trusted_keys = {pair.public}: cannot be read" in str(problems[0])


def test_whoever_opens_the_pack_anew_looks_at_the_signature(pack: Path, pair: KeyPair) -> None:
    """A worker that is started again is told not to hash what is unchanged, and the check on the ground never does."""
    config = trusting(pack, pair, localiser={"method": "gradient"}, camera=CAMERA)
    unhashed = config.model_copy(update={"map": config.map.model_copy(update={"verify_hashes": False})})
    assert open_localiser(unhashed).reference is not None and open_pack(unhashed).has_surface
    rewritten(pack)
    assert map_extent(config) == (None, None)
    for opens in (open_localiser, open_pack):
        with pytest.raises(SignatureInvalid):
            opens(unhashed)


def test_hashes_cannot_be_left_out_where_keys_are_trusted(pair: KeyPair) -> None:
    with pytest.raises(ConfigError, match=r"map: .*verify_hashes must be true"):
        parse_config({"map": {"pack": "pack", "trusted_keys": [str(pair.public)], "verify_hashes": False}})
    assert parse_config({"map": {"pack": "pack", "verify_hashes": False}}).map.trusted_keys == ()


def test_a_file_whose_time_was_set_back_has_another_stamp(pack: Path) -> None:
    """Inode, size and time of the last change to it were as before: a worker that was started again did not hash it."""
    before = file_stamps(str(pack))
    written_to(pack / "dsm.tif")
    assert file_stamps(str(pack)) != before


def test_the_journal_says_who_signed_the_map(pack: Path, pair: KeyPair, tmp_path: Path) -> None:
    header = journal_header(trusting(pack, pair), 5)
    assert header.map_signed_by == pair.fingerprint
    assert preflight(trusting(pack, pair))[1]["map_signed_by"] == pair.fingerprint
    unasked = journal_header(parse_config({"map": {"pack": str(pack)}}), 5)
    assert (unasked.map_signed_by, unasked.map_manifest_sha256) == ("", header.map_manifest_sha256)
    writer = JournalWriter.create(tmp_path / "journals", header, max_bytes=10**7)
    writer.close()
    assert writer.path is not None and read_header(writer.path) == header
    rewritten(pack)
    assert journal_header(trusting(pack, pair), 5).map_signed_by == ""


def test_a_journal_of_before_has_nobody_who_signed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import visloc_companion.app.journal as journal

    def as_before(topic: str, thing: Any) -> bytes:
        told = asdict(thing)
        del told["map_signed_by"], told["configuration"]["map"]["trusted_keys"]
        return json.dumps(told).encode()

    monkeypatch.setattr(journal, "payload", as_before)
    header = JournalHeader(Config().model_dump(mode="json"), {"visloc-companion": "0.1.0"}, "ab" * 32)
    writer = JournalWriter.create(tmp_path, header, max_bytes=10**7)
    writer.close()
    assert writer.path is not None
    found = read_header(writer.path)
    assert (found.map_manifest_sha256, found.map_signed_by) == ("ab" * 32, "")
    assert flown_config(found, writer.path) == Config()


def test_a_manifest_that_is_gone_is_for_others_to_tell(pack: Path, pair: KeyPair) -> None:
    (pack / MANIFEST).unlink()
    assert journal_header(trusting(pack, pair), 5).map_signed_by == ""
    assert map_extent(trusting(pack, pair)) == (None, None)
