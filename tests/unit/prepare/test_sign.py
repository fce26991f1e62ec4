"""Keys and signatures are made with care: private from the start, never over another, and only of what was checked."""

import os
from pathlib import Path

import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from visloc_companion.errors import ConfigError, HashMismatch, MapError, SignatureInvalid
from visloc_companion.maps.ed25519 import PrivateKey
from visloc_companion.maps.manifest import MANIFEST, read_manifest
from visloc_companion.maps.pack import PackMap
from visloc_companion.maps.signature import SIGNATURE, public_keys, read_signature
from visloc_companion.prepare.add_features import add_features
from visloc_companion.prepare.build import build_pack
from visloc_companion.prepare.sign import KeyPair, Signer, make_keys, open_signer, sign_pack


@pytest.fixture
def ortho(tmp_path: Path, write_raster) -> Path:
    image = np.random.default_rng(1).integers(1, 255, (90, 80)).astype(np.uint8)
    write_raster(tmp_path / "a.tif", image, "EPSG:32633", (47.0, 15.3), 1.0)
    return tmp_path / "a.tif"


@pytest.fixture
def pack(tmp_path: Path, ortho: Path) -> Path:
    build_pack([ortho], None, tmp_path / "pack")
    return tmp_path / "pack"


@pytest.fixture
def pair(tmp_path: Path) -> KeyPair:
    return make_keys(tmp_path / "fleet")


def secret(path: Path, content: bytes) -> Path:
    path.touch(mode=0o600)
    path.write_bytes(content)
    return path


def test_a_pair_of_keys_signs_and_verifies(pack: Path, pair: KeyPair) -> None:
    sign_pack(pack, open_signer(pair.private))
    keys = public_keys([pair.public])
    assert [key.fingerprint for key in keys] == [pair.fingerprint]
    assert PackMap.open(pack, trusted=keys)


def test_a_private_key_is_private_from_the_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever opens a file before its rights are taken away reads it after that, too."""
    opened, modes = os.open, {}

    def noted(path: Path, flags: int, mode: int = 0o777, **how: object) -> int:
        descriptor = opened(path, flags, mode, **how)
        modes[Path(path).name] = os.fstat(descriptor).st_mode & 0o777, bool(flags & os.O_EXCL)
        return descriptor

    before = os.umask(0)
    try:
        with monkeypatch.context() as patch:
            patch.setattr(os, "open", noted)
            pair = make_keys(tmp_path / "fleet")
    finally:
        os.umask(before)
    assert modes == {"fleet.key": (0o600, True), "fleet.pub": (0o644, True)}
    assert pair.private.stat().st_mode & 0o777 == 0o600


def test_no_key_is_ever_replaced(tmp_path: Path, pair: KeyPair) -> None:
    content = pair.private.read_bytes(), pair.public.read_bytes()
    with pytest.raises(ConfigError, match="exists"):
        make_keys(tmp_path / "fleet")
    pair.public.unlink()
    with pytest.raises(ConfigError, match=r"fleet\.key: cannot be made: File exists"):
        make_keys(tmp_path / "fleet")
    assert not pair.public.exists() and pair.private.read_bytes() == content[0]
    pair.private.unlink()
    pair.public.write_bytes(content[1])
    with pytest.raises(ConfigError, match=r"fleet\.pub: exists already.*remedy"):
        make_keys(tmp_path / "fleet")
    assert not pair.private.exists() and pair.public.read_bytes() == content[1]


def test_half_a_pair_is_not_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = os.open

    def full(path: Path, flags: int, mode: int = 0o777, **how: object) -> int:
        if Path(path).suffix != ".pub":
            return opened(path, flags, mode, **how)
        os.close(opened(path, flags, mode, **how))
        return opened("/dev/full", os.O_WRONLY)

    with monkeypatch.context() as patch:
        patch.setattr(os, "open", full)
        with pytest.raises(ConfigError, match=r"fleet\.pub: cannot be written: No space left"):
            make_keys(tmp_path / "fleet")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o644, 0o602])
def test_a_key_that_others_may_use_signs_nothing(pair: KeyPair, mode: int) -> None:
    pair.private.chmod(mode)
    with pytest.raises(ConfigError, match=rf"fleet\.key: may be used by others \(mode {mode:04o}\).*chmod 600"):
        open_signer(pair.private)


def test_a_passphrase_locks_the_key(tmp_path: Path, pack: Path) -> None:
    phrase = secret(tmp_path / "phrase", b"correct horse\nnot this line\n")
    pair = make_keys(tmp_path / "locked", phrase)
    assert b"ENCRYPTED PRIVATE KEY" in pair.private.read_bytes()
    with pytest.raises(ConfigError, match=r"locked\.key: is encrypted; remedy: .*--passphrase-file"):
        open_signer(pair.private)
    with pytest.raises(ConfigError, match=r"locked\.key: cannot be read with this passphrase"):
        open_signer(pair.private, secret(tmp_path / "wrong", b"wrong horse"))
    sign_pack(pack, open_signer(pair.private, secret(tmp_path / "same", b"correct horse")))
    assert PackMap.open(pack, trusted=public_keys([pair.public]))
    phrase.chmod(0o644)
    with pytest.raises(ConfigError, match=r"phrase: may be used by others"):
        open_signer(pair.private, phrase)


@pytest.mark.parametrize("content", [b"", b"\nsecond line", b"x" * 1024])
def test_what_is_no_passphrase(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(ConfigError, match="does not begin with a passphrase of 1 to 1023 bytes"):
        make_keys(tmp_path / "fleet", secret(tmp_path / "phrase", content))
    assert make_keys(tmp_path / "longest", secret(tmp_path / "long", b"x" * 1023))


def test_key_files_that_hold_no_key_sign_nothing(tmp_path: Path, pair: KeyPair) -> None:
    of_rsa = rsa.generate_private_key(65537, 2048).private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    good = pair.private.read_bytes()
    wrong = {
        "rsa": (of_rsa, "another kind .RSA"),
        "garbage": (b"\xff\0" * 999, "holds no private key"),
        "empty": (b"", "holds no"),
    }
    wrong |= {"cut": (good[:70], "holds no private key"), "public": (pair.public.read_bytes(), "holds no private key")}
    for name, (content, what) in wrong.items():
        with pytest.raises(ConfigError, match=rf"{name}: .*{what}.*remedy: "):
            open_signer(secret(tmp_path / name, content))
    with pytest.raises(ConfigError, match=r"absent: cannot be read.*visloc map key"):
        open_signer(tmp_path / "absent")


def test_what_is_not_as_its_manifest_says_is_not_signed(pack: Path) -> None:
    raw = (pack / "ortho.tif").read_bytes()
    (pack / "ortho.tif").write_bytes(raw[:-1] + bytes([raw[-1] ^ 1]))
    with pytest.raises(HashMismatch):
        sign_pack(pack, Signer(PrivateKey.generate()))
    (pack / "ortho.tif").write_bytes(raw)
    (pack / MANIFEST).write_bytes((pack / MANIFEST).read_bytes() + b" ")
    with pytest.raises(HashMismatch):
        sign_pack(pack, Signer(PrivateKey.generate()))
    assert not (pack / SIGNATURE).exists()


def test_a_signature_is_written_whole_or_not_at_all(pack: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = Signer(PrivateKey.generate())
    sign_pack(pack, first)

    def fails(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", fails)
        with pytest.raises(MapError, match=r"manifest\.sig: cannot be written: No space left.*remedy"):
            sign_pack(pack, Signer(PrivateKey.generate()))
    assert PackMap.open(pack, trusted=[first.public])
    assert not list(pack.glob(".*"))


def test_a_signed_pack_is_replaced_as_any_other(ortho: Path, tmp_path: Path, pack: Path) -> None:
    """What a pack holds besides its files is taken for somebody's, and keeps it from being replaced."""
    one, two = Signer(PrivateKey.generate()), Signer(PrivateKey.generate())
    sign_pack(pack, one)
    build_pack([ortho], None, pack, source="later", sign=two.sign)
    assert PackMap.open(pack, trusted=[two.public]).manifest.source == "later"
    build_pack([ortho], None, pack)
    assert not (pack / SIGNATURE).exists()


def test_features_that_are_added_leave_no_signature_of_the_manifest_before(pack: Path) -> None:
    signer = Signer(PrivateKey.generate())
    sign_pack(pack, signer)
    add_features(pack, (), replace=True)
    assert read_signature(pack) is None
    with pytest.raises(SignatureInvalid, match="is not there"):
        PackMap.open(pack, trusted=[signer.public])
    add_features(pack, (), replace=True, signer=signer)
    assert PackMap.open(pack, trusted=[signer.public])


def test_who_signs_again_does_not_vouch_for_what_was_changed_since(pack: Path) -> None:
    signer, other = Signer(PrivateKey.generate()), Signer(PrivateKey.generate())
    sign_pack(pack, signer)
    with pytest.raises(SignatureInvalid, match="is by the key"):
        add_features(pack, (), replace=True, signer=other)
    signature, changed = (pack / SIGNATURE).read_bytes(), read_manifest(pack)
    from visloc_companion.maps.manifest import write_manifest

    write_manifest(pack, changed.model_copy(update={"capture_date": "2026-01-01"}))
    with pytest.raises(SignatureInvalid, match=r"does not fit manifest\.json"):
        add_features(pack, (), replace=True, signer=signer)
    assert (pack / SIGNATURE).read_bytes() == signature
