"""Sign packs, and make the keys for it. Signing belongs where packs are built: the private key never goes on an aircraft."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from visloc_companion.errors import ConfigError, MapError
from visloc_companion.maps.ed25519 import MAX_PEM_BYTES, PrivateKey, PublicKey, read_private_pem
from visloc_companion.maps.manifest import manifest_bytes, parsed_manifest
from visloc_companion.maps.signature import SIGNATURE, Signature
from visloc_companion.maps.verify import verify_files
from visloc_companion.private_file import create_file, read_private
from visloc_companion.whole_file import write_whole

_MADE_BY = "visloc map key --out NAME"
_PRIVATE, _PUBLIC = ".key", ".pub"
_MAX_PASSPHRASE_BYTES = 1023
"""cryptography takes no longer one."""


@dataclass(frozen=True, slots=True)
class KeyPair:
    """The two files of a key that was made, and its fingerprint."""

    private: Path
    public: Path
    fingerprint: str


class Signer:
    """Who signs packs."""

    def __init__(self, key: PrivateKey) -> None:
        self._key = key

    @property
    def public(self) -> PublicKey:
        """The key that what it signs is verified with."""
        return self._key.public

    def sign(self, raw: bytes, folder: Path) -> None:
        """Write `manifest.sig` of these bytes of a manifest, whole or not at all. Raises MapError where it cannot be written."""
        try:
            content = Signature(self.public.fingerprint, self._key.sign(raw)).content()
            write_whole(folder / SIGNATURE, content, synced=True)
        except OSError as why:
            remedy = "check the disk, and that this user may write to the folder"
            raise MapError(f"cannot be written: {why.strerror}", where=str(folder / SIGNATURE), remedy=remedy) from why


def make_keys(out: Path, passphrase_file: Path | None = None) -> KeyPair:
    """Make `OUT.key`, which nobody but its owner may read from the start, and `OUT.pub`. Neither must exist; an OUT that ends in
    one of the two names both.

    With a file of a passphrase the private key is encrypted with it. Raises ConfigError.
    """
    if out.name in ("", ".."):
        raise ConfigError("names no file", where=f"--out {out}", remedy=f"say what the files are to be called: {_MADE_BY}")
    passphrase = _passphrase(passphrase_file)
    stem = out.stem if out.suffix in (_PRIVATE, _PUBLIC) else out.name
    private, public = (out.with_name(f"{stem}{suffix}") for suffix in (_PRIVATE, _PUBLIC))
    if public.exists():
        remedy = "name a file that does not exist yet: what was signed with the old key could not be verified any more"
        raise ConfigError("exists already", where=str(public), remedy=remedy)
    key = PrivateKey.generate()
    create_file(private, key.pem(passphrase))
    try:
        create_file(public, key.public.pem(), 0o644)
    except ConfigError:
        private.unlink(missing_ok=True)
        raise
    return KeyPair(private, public, key.public.fingerprint)


def open_signer(key_file: Path, passphrase_file: Path | None = None) -> Signer:
    """Who signs with a private key. Raises ConfigError for a file that others may read, or that holds no Ed25519 key."""
    if _is_public(key_file):  # before its rights are: they are right for a public one
        what = "holds no private key, but the public one"
        raise ConfigError(what, where=str(key_file), remedy=f"name the .key file that `{_MADE_BY}` made")
    pem = read_private(key_file, str(key_file), _MADE_BY, MAX_PEM_BYTES)
    return Signer(read_private_pem(pem, _passphrase(passphrase_file), str(key_file)))


def sign_pack(folder: Path, signer: Signer, progress: Callable[[str, int], None] | None = None) -> None:
    """Sign a pack of which every file was found to be what the manifest says. `progress` as of `verify_files`.

    Raises MapError for what is no pack, or a damaged one, and where the signature cannot be written.
    """
    raw = manifest_bytes(folder)
    verify_files(folder, parsed_manifest(raw, folder), progress=progress)
    signer.sign(raw, folder)


def _is_public(file: Path) -> bool:
    with suppress(OSError):
        if file.is_file():
            with file.open("rb") as opened:
                return b"-----BEGIN PUBLIC KEY-----" in opened.read(MAX_PEM_BYTES)
    return False


def _passphrase(file: Path | None) -> bytes:
    """The first line of a file that nobody else may read; nothing where there is no file."""
    if file is None:
        return b""
    content = read_private(file, str(file), "umask 077; cat > FILE", _MAX_PASSPHRASE_BYTES + 2)
    passphrase = content.splitlines()[0] if content else b""
    if not passphrase or len(passphrase) > _MAX_PASSPHRASE_BYTES:
        what = f"does not begin with a passphrase of 1 to {_MAX_PASSPHRASE_BYTES} bytes"
        raise ConfigError(what, where=str(file), remedy="write it on the first line")
    return passphrase
