"""The key file: what counts as a key, and who else may have seen it."""

import errno
import hashlib
import os

import pytest

from visloc_companion.adapters.mavlink.signing_key import key_of, read_key, write_key
from visloc_companion.errors import ConfigError


@pytest.fixture
def key_file(tmp_path):
    path = tmp_path / "key"
    path.touch(mode=0o600)
    return path


def test_a_passphrase_is_hashed_as_ground_stations_do(key_file):
    key_file.write_text("correct horse\n")
    assert read_key(key_file) == hashlib.sha256(b"correct horse").digest()
    key_file.write_text(" correct horse \r\n")
    assert read_key(key_file) == hashlib.sha256(b" correct horse ").digest()


def test_64_hexadecimal_digits_are_the_key(key_file):
    key_file.write_text("0123456789abcdefABCDEF" + "00" * 21 + "\n")
    assert read_key(key_file).hex() == "0123456789abcdefabcdef" + "00" * 21
    key_file.write_text("01" * 31)
    assert read_key(key_file) == hashlib.sha256(b"01" * 31).digest()


@pytest.mark.parametrize("content", [b"", b"\n", b"  \n", b"two\nlines\n", b"\xff\xfe", b"00" * 32, b"x" * 5000])
def test_what_is_no_key(content):
    with pytest.raises(ConfigError, match=r"remedy: .*link-key"):
        key_of(content, "here")


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o606, 0o644, 0o610])
def test_a_key_that_others_may_use_is_refused(key_file, mode):
    key_file.write_text("secret")
    key_file.chmod(mode)
    with pytest.raises(ConfigError, match=f"link.signing_key_file.*mode {mode:04o}.*remedy: chmod 600"):
        read_key(key_file)


def test_a_key_of_somebody_else_is_refused(key_file, monkeypatch):
    key_file.write_text("secret")
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    with pytest.raises(ConfigError, match=r"belongs to user .*remedy: chown"):
        read_key(key_file)


def test_a_key_that_may_not_be_read_is_not_to_be_made_anew(key_file, monkeypatch):
    def refuse(*_):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    key_file.write_text("secret")
    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(
        ConfigError, match=r"cannot be read: Permission denied.*remedy: run this as the user whose key it is"
    ) as told:
        read_key(key_file)
    assert "link-key" not in str(told.value)


def test_what_cannot_be_read(tmp_path):
    with pytest.raises(ConfigError, match=r"cannot be read: No such file.*remedy: make one with `visloc link-key`"):
        read_key(tmp_path / "absent")
    with pytest.raises(ConfigError):
        read_key(tmp_path)
    os.mkfifo(tmp_path / "pipe", 0o600)
    with pytest.raises(ConfigError, match="no regular file"):
        read_key(tmp_path / "pipe")


def test_a_made_key_is_private_and_its_own(tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    passphrase = write_key(first)
    write_key(second)
    assert first.stat().st_mode & 0o777 == 0o600
    assert read_key(first) == hashlib.sha256(passphrase.encode()).digest() != read_key(second)
    with pytest.raises(ConfigError, match="cannot be made: File exists"):
        write_key(first)
