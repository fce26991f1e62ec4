"""Whether a pack's manifest is the one that the holder of a trusted key has signed.

`manifest.sig` beside the manifest is three lines of ASCII: the kind and its version, the fingerprint of the key, and the Ed25519
signature of the very bytes of `manifest.json` in base64. The manifest names the SHA-256 of every file, so that who checks both
knows that the whole pack is as it was signed (verify.py). `manifest.sha256` tells damage; anybody can write it anew.
"""

from __future__ import annotations

import base64
import os
import re
import stat
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from visloc_companion.errors import ConfigError, SignatureInvalid
from visloc_companion.maps.ed25519 import MAX_PEM_BYTES, SHORT, PublicKey, read_public_pem
from visloc_companion.maps.manifest import MANIFEST, Manifest, manifest_bytes, parsed_manifest

SIGNATURE, SIGNATURE_DRAFT = "manifest.sig", ".manifest.sig.part"
"""The second is what a signing that was killed leaves (whole_file.write_whole)."""
_FORM = re.compile(rb"visloc-map-signature 1\nkey ([0-9a-f]{64})\nsignature ([A-Za-z0-9+/]{86}==)\n")
_MAX_BYTES = 1024
_COPY = "copy the pack again from where it was signed; or find out what was changed and by whom before you sign it again"
_SIGN = "sign it where it was built: visloc map sign PACK --key FILE"


@dataclass(frozen=True, slots=True)
class Signature:
    """What `manifest.sig` says: the fingerprint of a key (64 hexadecimal digits), and 64 bytes."""

    fingerprint: str
    value: bytes

    def content(self) -> bytes:
        """The content of the file."""
        encoded = base64.b64encode(self.value).decode()
        return f"visloc-map-signature 1\nkey {self.fingerprint}\nsignature {encoded}\n".encode()


def public_keys(paths: Sequence[str | Path], stated: str = "map.trusted_keys") -> tuple[PublicKey, ...]:
    """The public keys in files; `stated` is what names them, for messages.

    Raises ConfigError for a file that cannot be read, holds no Ed25519 key, or may be written by everybody.
    """
    return tuple(_public_key(Path(path), f"{stated} = {path}") for path in paths)


def read_signature(folder: Path) -> Signature | None:
    """The signature of a pack as it stands there, not verified; None where there is none. Raises SignatureInvalid for a file that
    is no such signature, or cannot be read."""
    where = folder / SIGNATURE
    try:
        is_file = stat.S_ISREG(where.stat().st_mode)
        raw = _head(where, _MAX_BYTES) if is_file else b""
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as why:
        remedy = "let this user read it (sudo chmod -R a+rX FOLDER)"
        raise SignatureInvalid(f"cannot be read: {why.strerror}", where=str(where), remedy=remedy) from why
    found = _FORM.fullmatch(raw)
    signature = None if found is None else Signature(found[1].decode(), base64.b64decode(found[2]))
    if signature is None or signature.content() != raw:
        raise SignatureInvalid("is no signature of a map pack, or a damaged one", where=str(where), remedy=_COPY)
    return signature


def require_signed(raw: bytes, folder: Path, trusted: Sequence[PublicKey]) -> str:
    """The fingerprint of the trusted key that signed these bytes of a manifest. Raises SignatureInvalid where none did."""
    where, signature = str(folder / SIGNATURE), read_signature(folder)
    keys = {key.fingerprint: key for key in trusted}
    named = ", ".join(f"{each[:SHORT]}..." for each in keys)
    if signature is None:
        what = f"is not there: the pack is not signed, and only what is signed by {named} is trusted"
        raise SignatureInvalid(what, where=where, remedy=_SIGN)
    key = keys.get(signature.fingerprint)
    if key is None:
        what = f"is by the key {signature.fingerprint[:SHORT]}..., and trusted is {named}"
        remedy = f"{_SIGN} with the trusted one; or trust this key, if you know whose it is (map.trusted_keys)"
        raise SignatureInvalid(what, where=where, remedy=remedy)
    if not key.verifies(signature.value, raw):
        what = f"does not fit {MANIFEST}: one of them is not what was signed by {signature.fingerprint[:SHORT]}..."
        raise SignatureInvalid(what, where=where, remedy=_COPY)
    return key.fingerprint


def read_signed(folder: Path, trusted: Sequence[PublicKey]) -> Manifest:
    """The manifest of a pack, of which nothing is looked at before its signature by one of the trusted keys, where there are any.

    The bytes are read once, so that those that were verified are those that count. Raises SignatureInvalid, and MapError as
    `read_manifest` does.
    """
    raw = manifest_bytes(folder)
    if trusted:
        require_signed(raw, folder, trusted)
    return parsed_manifest(raw, folder)


def _public_key(path: Path, where: str) -> PublicKey:
    remedy = "name the .pub file that `visloc map key --out NAME` made"
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise ConfigError("is no regular file", where=where, remedy=remedy)
        pem = _head(path, MAX_PEM_BYTES)
    except OSError as why:
        raise ConfigError(f"cannot be read: {why.strerror}", where=where, remedy=remedy) from why
    if status.st_mode & stat.S_IWOTH:
        what = f"may be written by everybody (mode {stat.S_IMODE(status.st_mode):04o}), who could put another key there"
        raise ConfigError(what, where=where, remedy=f"see that it is the right one, then chmod o-w {path}")
    return read_public_pem(pem, where)


def _head(path: Path, most: int) -> bytes:
    """A file's first bytes, and one more where it is longer. Raises OSError."""
    with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
        return file.read(most + 1)
