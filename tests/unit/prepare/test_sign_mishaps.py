"""Keys and packs in places where things go wrong: disks without rights, names that are none, a signing that was cut off."""

import os
from pathlib import Path

import numpy as np
import pytest

from visloc_companion.errors import ConfigError
from visloc_companion.maps.pack import PackMap
from visloc_companion.maps.signature import public_keys
from visloc_companion.prepare.add_features import add_features
from visloc_companion.prepare.build import build_pack
from visloc_companion.prepare.sign import make_keys, open_signer, sign_pack


def test_a_disk_that_keeps_no_rights_gets_no_private_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """FAT is mounted with one mode for all: whoever made a key there was told later that others may use it, and to chmod."""
    opened = os.open

    def of_fat(path: Path, flags: int, mode: int = 0o777, **how: object) -> int:
        descriptor = opened(path, flags, mode, **how)
        os.fchmod(descriptor, 0o755)
        return descriptor

    with monkeypatch.context() as patch:
        patch.setattr(os, "open", of_fat)
        with pytest.raises(ConfigError, match=r"fleet\.key: others may use it there \(mode 0755\).*FAT.*another disk"):
            make_keys(tmp_path / "fleet")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["", ".", "..", "/", "keys/.."])
def test_a_folder_is_no_name_of_a_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "keys").mkdir()
    with pytest.raises(ConfigError, match=r"--out .*: names no file; remedy: .*visloc map key --out NAME"):
        make_keys(Path(name))
    assert [path.name for path in tmp_path.rglob("*")] == ["keys"]


def test_a_public_key_that_is_to_sign_is_told_from_a_private_one_with_wrong_rights(tmp_path: Path) -> None:
    pair = make_keys(tmp_path / "fleet")
    with pytest.raises(ConfigError, match=r"fleet\.pub: holds no private key, but the public one; remedy: name the \.key file"):
        open_signer(pair.public)


def test_two_keys_in_a_file_are_not_taken_for_one(tmp_path: Path) -> None:
    """The first alone would count: an old one before the new one stayed trusted, and the new one was not."""
    old, new = make_keys(tmp_path / "old"), make_keys(tmp_path / "new")
    (tmp_path / "both.pub").write_bytes(old.public.read_bytes() + new.public.read_bytes())
    with pytest.raises(ConfigError, match=r"both\.pub: holds more than one key; remedy: give each a file of its own"):
        public_keys([tmp_path / "both.pub"])
    (tmp_path / "noted.pub").write_bytes(b"# of 2026\r\n" + new.public.read_bytes().replace(b"\n", b"\r\n"))
    assert [key.fingerprint for key in public_keys([tmp_path / "noted.pub"] * 2)] == [new.fingerprint] * 2


def test_a_signing_that_was_cut_off_is_in_nobodys_way(tmp_path: Path, write_raster, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a killed `visloc map sign` leaves is no file of the user's that a new pack would lose."""

    def killed(path: Path, target: Path) -> Path:
        raise KeyboardInterrupt

    image = np.random.default_rng(1).integers(1, 255, (90, 80)).astype(np.uint8)
    write_raster(tmp_path / "a.tif", image, "EPSG:32633", (47.0, 15.3), 1.0)
    pack, pair = tmp_path / "pack", make_keys(tmp_path / "fleet")
    build_pack([tmp_path / "a.tif"], None, pack)
    for again in (lambda: add_features(pack, [], replace=True), lambda: build_pack([tmp_path / "a.tif"], None, pack)):
        with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
            patch.setattr(Path, "replace", killed)
            sign_pack(pack, open_signer(pair.private))
        assert [path.name for path in pack.glob(".*")] == [".manifest.sig.part"]
        again()
        assert list(pack.glob(".*")) == []
    sign_pack(pack, open_signer(pair.private))
    assert PackMap.open(pack, trusted=public_keys([pair.public]))
