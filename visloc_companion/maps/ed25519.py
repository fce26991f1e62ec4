"""Ed25519 (RFC 8032): keys, signatures, and the files that keys lie in (PEM).

The only importer of cryptography, which is loaded when a key is used: a daemon that trusts no key does without.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

from visloc_companion.errors import ConfigError

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

SIGNATURE_BYTES = 64
MAX_PEM_BYTES = 16_384
_SPKI_HEAD = bytes.fromhex("302a300506032b6570032100")
"""What stands before the 32 bytes of an Ed25519 key in its SubjectPublicKeyInfo (RFC 8410, 4)."""
SHORT = 16
"""Digits of a fingerprint that messages name: 64 bits."""
_BEGIN = b"-----BEGIN "
_MAKE = "visloc map key --out NAME"


@dataclass(frozen=True, slots=True)
class PublicKey:
    """32 bytes (RFC 8032, 5.1.5)."""

    raw: bytes

    @property
    def fingerprint(self) -> str:
        """SHA-256 of its SubjectPublicKeyInfo, as `openssl pkey -pubin -in FILE -outform DER | sha256sum` gives it."""
        return hashlib.sha256(_SPKI_HEAD + self.raw).hexdigest()

    def verifies(self, signature: bytes, content: bytes) -> bool:
        """Whether a signature of 64 bytes was made by the holder of the private key over exactly these bytes."""
        from cryptography.exceptions import InvalidSignature
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

        try:
            Ed25519PublicKey.from_public_bytes(self.raw).verify(signature, content)
        except InvalidSignature:
            return False
        return True

    def pem(self) -> bytes:
        """The content of a .pub file."""
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
        from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

        return Ed25519PublicKey.from_public_bytes(self.raw).public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)


class PrivateKey:
    """What signs."""

    def __init__(self, key: Ed25519PrivateKey) -> None:
        self._key = key
        self.public = PublicKey(key.public_key().public_bytes_raw())

    @classmethod
    def generate(cls) -> PrivateKey:
        """A new one, from the system's source of randomness."""
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

        return cls(Ed25519PrivateKey.generate())

    def sign(self, content: bytes) -> bytes:
        """The 64 bytes of the signature."""
        return self._key.sign(content)

    def pem(self, passphrase: bytes) -> bytes:
        """The content of a .key file (PKCS #8), encrypted unless the passphrase is empty."""
        from cryptography.hazmat.primitives.serialization import BestAvailableEncryption, Encoding, NoEncryption, PrivateFormat

        lock = BestAvailableEncryption(passphrase) if passphrase else NoEncryption()
        return self._key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, lock)


def read_public_pem(pem: bytes, where: str) -> PublicKey:
    """The key in the content of a .pub file. Raises ConfigError where there is none of Ed25519."""
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    from cryptography.hazmat.primitives.serialization import load_pem_public_key

    if b"PRIVATE KEY" in pem:
        remedy = "name the .pub file, and keep the .key off every aircraft: make new ones if it was on one"
        raise ConfigError("holds a private key, where the public one belongs", where=where, remedy=remedy)
    if pem.count(_BEGIN) > 1:  # the first alone would count, and whoever withdrew it would not know
        raise ConfigError("holds more than one key", where=where, remedy="give each a file of its own, and name them all")
    try:
        key = load_pem_public_key(pem)
    except (ValueError, TypeError, UnsupportedAlgorithm) as why:
        raise ConfigError("holds no public key (PEM)", where=where, remedy=f"name the .pub file that `{_MAKE}` made") from why
    if not isinstance(key, Ed25519PublicKey):
        what = f"holds a key of another kind ({type(key).__name__.lstrip('_')}), not of Ed25519"
        raise ConfigError(what, where=where, remedy=f"name the .pub file that `{_MAKE}` made")
    return PublicKey(key.public_bytes_raw())


def read_private_pem(pem: bytes, passphrase: bytes, where: str) -> PrivateKey:
    """The key in the content of a .key file; an empty passphrase is none. Raises ConfigError where there is none of Ed25519, or
    the passphrase is not its own."""
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    is_locked = b"ENCRYPTED" in pem
    if is_locked and not passphrase:
        raise ConfigError("is encrypted", where=where, remedy="give the file with its passphrase: --passphrase-file FILE")
    try:
        key = load_pem_private_key(pem, passphrase if is_locked else None)
    except (ValueError, TypeError, UnsupportedAlgorithm) as why:
        what = "cannot be read with this passphrase" if is_locked else "holds no private key (PEM)"
        raise ConfigError(what, where=where, remedy=f"name the .key file that `{_MAKE}` made, and its passphrase") from why
    if not isinstance(key, Ed25519PrivateKey):
        what = f"holds a key of another kind ({type(key).__name__.lstrip('_')}), not of Ed25519"
        raise ConfigError(what, where=where, remedy=f"make one with `{_MAKE}`")
    return PrivateKey(key)
