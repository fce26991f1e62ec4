"""`visloc map key`, `visloc map sign`, and what the other commands about packs share with them: options, and words."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from visloc_companion.errors import ConfigError

if TYPE_CHECKING:
    from visloc_companion.maps.manifest import Manifest
    from visloc_companion.prepare.sign import Signer

KeyFile = Annotated[Path, typer.Option("--key", metavar="FILE", help="Private key (visloc map key); nobody else may read it.")]
SignKey = Annotated[
    Path | None, typer.Option("--sign-key", metavar="FILE", help="Sign the pack with this private key (visloc map key).")
]
PassphraseFile = Annotated[
    Path | None,
    typer.Option("--passphrase-file", metavar="FILE", help="Its first line is the private key's passphrase; owner only."),
]
TrustedKeys = Annotated[
    list[Path] | None,
    typer.Option(
        "--trusted-key", metavar="FILE", help="Public key (.pub) that must have signed the pack; of several, one of them must."
    ),
]


def make_key(
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="NAME", help="NAME.key and NAME.pub are made, which NAME.key names, too; neither is replaced."
        ),
    ],
    passphrase_file: PassphraseFile = None,
) -> None:
    """Make a pair of keys for signing packs: NAME.key signs and stays where packs are built, NAME.pub goes on the aircraft."""
    from visloc_companion.prepare.sign import make_keys

    pair = make_keys(out, passphrase_file)
    typer.echo(f"{pair.private} signs packs (visloc map sign PACK --key {pair.private}): keep it where they are built")
    typer.echo(f"{pair.public} verifies them: name it in map.trusted_keys of each aircraft's configuration")
    typer.echo(f"fingerprint {pair.fingerprint}")


def sign(
    pack: Annotated[Path, typer.Argument(metavar="PACK", help="Folder of the pack.")],
    key_file: KeyFile,
    passphrase_file: PassphraseFile = None,
) -> None:
    """Check every file of a pack against its manifest, then sign the manifest (manifest.sig). A signature before is replaced."""
    from visloc_companion.maps.manifest import read_manifest
    from visloc_companion.prepare.sign import open_signer, sign_pack

    signer = open_signer(key_file, passphrase_file)
    with hashes_bar(read_manifest(pack)) as checked:
        sign_pack(pack, signer, checked)
    typer.echo(f"{pack} is signed by {signer.public.fingerprint}")


def chosen_signer(sign_key: Path | None, passphrase_file: Path | None) -> Signer | None:
    """Who `--sign-key` names; read before the work, so that a wrong one costs none. Raises ConfigError."""
    if sign_key is None:
        if passphrase_file is not None:
            raise ConfigError("--passphrase-file: is of no use by itself", remedy="name the private key, too: --sign-key FILE")
        return None
    from visloc_companion.prepare.sign import open_signer

    return open_signer(sign_key, passphrase_file)


@contextmanager
def hashes_bar(manifest: Manifest) -> Iterator[Callable[[str, int], None]]:
    """A bar over the bytes of a pack's files; call with the name and size of each that was hashed."""
    from visloc_companion.cli.progress import bar

    done = 0
    with bar("hashes", sum(entry.bytes for entry in manifest.files.values())) as advance:

        def checked(name: str, size: int) -> None:
            nonlocal done
            del name
            done += size
            advance(done)

        yield checked


def signature_info(pack: Path, trusted: Sequence[Path]) -> dict[str, Any]:
    """For results: the fingerprint of the key that a pack says it is signed by, and which of the files of trusted keys holds that
    key (the pack was opened with these); None where there is none. Raises SignatureInvalid, ConfigError."""
    from visloc_companion.maps.signature import public_keys, read_signature

    signature = read_signature(pack)
    files = dict(zip((key.fingerprint for key in public_keys(trusted, "--trusted-key")), map(str, trusted), strict=True))
    by = None if signature is None else signature.fingerprint
    return {"key": by, "verified_with": None if by is None else files.get(by)}


def described_signature(info: dict[str, Any]) -> str:
    """The same in words."""
    if info["key"] is None:
        return "not signed"
    how = f"verified with {info['verified_with']}" if info["verified_with"] else "not verified (give --trusted-key FILE)"
    return f"by the key {info['key']}, {how}"
