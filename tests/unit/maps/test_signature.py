"""Signed packs: what a trusted key has signed is used, and nothing else."""

import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from visloc_companion.errors import ConfigError, HashMismatch, MapError, SignatureInvalid
from visloc_companion.maps.ed25519 import PrivateKey, PublicKey
from visloc_companion.maps.manifest import DIGEST, MANIFEST, read_manifest
from visloc_companion.maps.pack import PackMap
from visloc_companion.maps.signature import SIGNATURE, public_keys, read_signature
from visloc_companion.prepare.build import build_pack
from visloc_companion.prepare.sign import Signer, sign_pack


@pytest.fixture(scope="module")
def signer() -> Signer:
    return Signer(PrivateKey.generate())


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory, signer: Signer) -> Path:
    """Two signed packs that differ in a word of the manifest: `pack` and `other`."""
    from rasterio import Affine
    from rasterio import open as opened

    folder = tmp_path_factory.mktemp("signed")
    image = np.random.default_rng(1).integers(1, 255, (120, 100)).astype(np.uint8)
    for name, values in (("a.tif", image), ("dsm.tif", image.astype(np.float32))):
        shape = {"width": 100, "height": 120, "count": 1, "dtype": values.dtype}
        with opened(folder / name, "w", "GTiff", crs="EPSG:32633", transform=Affine(1, 0, 5e5, 0, -1, 52e5), **shape) as out:
            out.write(values, 1)
    for name in ("pack", "other"):
        build_pack([folder / "a.tif"], folder / "dsm.tif", folder / name, source=name, sign=signer.sign)
    return folder


@pytest.fixture
def pack(built: Path, tmp_path: Path) -> Path:
    shutil.copytree(built / "pack", tmp_path / "pack")
    return tmp_path / "pack"


def opened_with(pack: Path, *keys: PublicKey) -> PackMap:
    return PackMap.open(pack, trusted=keys)


def seal(pack: Path, raw: bytes) -> None:
    """Write a manifest with the digest that belongs to it, as somebody does who means it."""
    (pack / MANIFEST).write_bytes(raw)
    (pack / DIGEST).write_text(f"{hashlib.sha256(raw).hexdigest()}  {MANIFEST}\n")


def flip(path: Path, at: int, bit: int = 0) -> None:
    raw = bytearray(path.read_bytes())
    raw[at] ^= 1 << bit
    path.write_bytes(raw)


def test_what_a_trusted_key_signed_is_opened(pack: Path, signer: Signer) -> None:
    other = PrivateKey.generate().public
    assert opened_with(pack, signer.public).manifest.source == "pack"
    assert opened_with(pack, other, signer.public).manifest == opened_with(pack).manifest


def test_a_pack_is_signed_in_three_lines_that_the_same_key_writes_again(pack: Path, signer: Signer) -> None:
    before = (pack / SIGNATURE).read_bytes()
    (pack / SIGNATURE).unlink()
    sign_pack(pack, signer)
    assert (pack / SIGNATURE).read_bytes() == before and len(before) < 200
    found = read_signature(pack)
    assert found is not None and found.fingerprint == signer.public.fingerprint
    assert signer.public.verifies(found.value, (pack / MANIFEST).read_bytes())
    assert sorted(path.name for path in pack.iterdir()) == sorted([MANIFEST, DIGEST, SIGNATURE, *read_manifest(pack).files])


def test_without_trusted_keys_a_pack_is_opened_as_before(pack: Path) -> None:
    for content in (b"garbage", None):
        (pack / SIGNATURE).unlink() if content is None else (pack / SIGNATURE).write_bytes(content)
        assert opened_with(pack).manifest.source == "pack"


def test_a_pack_that_nobody_signed_is_refused(pack: Path, signer: Signer) -> None:
    (pack / SIGNATURE).unlink()
    with pytest.raises(SignatureInvalid, match=r"manifest\.sig: is not there: the pack is not signed.*visloc map sign PACK"):
        opened_with(pack, signer.public)


def test_another_key_is_named_and_refused(pack: Path, signer: Signer) -> None:
    other = PrivateKey.generate().public
    with pytest.raises(SignatureInvalid) as why:
        opened_with(pack, other)
    assert why.value.where == str(pack / SIGNATURE)
    assert signer.public.fingerprint[:16] in why.value.what and other.fingerprint[:16] in why.value.what


def test_a_signature_that_only_names_the_trusted_key_is_refused(pack: Path, signer: Signer) -> None:
    sign_pack(pack, Signer(PrivateKey.generate()))
    forged = read_signature(pack)
    assert forged is not None
    text = (pack / SIGNATURE).read_text().replace(forged.fingerprint, signer.public.fingerprint)
    (pack / SIGNATURE).write_text(text)
    with pytest.raises(SignatureInvalid, match=r"does not fit manifest\.json"):
        opened_with(pack, signer.public)


def test_the_attack_that_hashes_do_not_see_is_found(pack: Path, signer: Signer) -> None:
    """Whoever can write the folder moves the map by 300 m and writes all hashes anew: every check without a key is content."""
    data = json.loads((pack / MANIFEST).read_bytes())
    for grid in (data["ortho"], data["heights"]["grid"]):
        grid["transform"][2] += 300.0
    import rasterio

    for name in ("ortho.tif", "dsm.tif"):
        with rasterio.open(pack / name, "r+", IGNORE_COG_LAYOUT_BREAK="YES") as raster:
            raster.transform = rasterio.Affine.translation(300.0, 0.0) @ raster.transform
        raw = (pack / name).read_bytes()
        data["files"][name] = {"bytes": len(raw), "sha256": hashlib.sha256(raw).hexdigest()}
    seal(pack, json.dumps(data).encode())
    assert PackMap.open(pack, verify_hashes=True).center_map_m[0] == pytest.approx(500_350.0, abs=1.0)
    with pytest.raises(SignatureInvalid, match=r"does not fit manifest\.json.*remedy: copy the pack again"):
        opened_with(pack, signer.public)


def test_a_signature_of_another_pack_is_none_of_this_one(pack: Path, built: Path, signer: Signer) -> None:
    shutil.copy(built / "other" / SIGNATURE, pack / SIGNATURE)
    with pytest.raises(SignatureInvalid, match=r"does not fit manifest\.json"):
        opened_with(pack, signer.public)


def test_a_flipped_bit_of_any_file_is_found(pack: Path, signer: Signer) -> None:
    for path in sorted(pack.iterdir()):
        raw = path.read_bytes()
        flip(path, len(raw) // 2)
        with pytest.raises(MapError) as why:
            opened_with(pack, signer.public)
        wanted = SignatureInvalid if path.name in (MANIFEST, SIGNATURE) else HashMismatch
        assert type(why.value) is wanted, path.name
        path.write_bytes(raw)
    assert opened_with(pack, signer.public)


def test_a_manifest_is_not_even_parsed_before_its_signature_is_right(pack: Path, signer: Signer) -> None:
    seal(pack, b"[" * 100_000)
    with pytest.raises(SignatureInvalid):
        opened_with(pack, signer.public)


@pytest.mark.parametrize("kind", [os.mkfifo, Path.mkdir])
def test_what_is_no_file_is_no_signature(pack: Path, signer: Signer, kind: Callable[[Path], None]) -> None:
    (pack / SIGNATURE).unlink()
    kind(pack / SIGNATURE)
    with pytest.raises(SignatureInvalid, match="is no signature"):
        opened_with(pack, signer.public)


def test_an_encoding_that_says_the_same_otherwise_is_refused(pack: Path, signer: Signer) -> None:
    """The last digit of base64 before the padding has four bits that nothing is read from."""
    text = (pack / SIGNATURE).read_text()
    digits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/"
    assert digits.index(text[-4]) % 16 == 0
    for other in (text[:-4] + digits[digits.index(text[-4]) + 1] + text[-3:], text.replace("\n", "\r\n"), text + "\n", text[:-1]):
        (pack / SIGNATURE).write_text(other, newline="")
        with pytest.raises(SignatureInvalid, match="is no signature of a map pack, or a damaged one"):
            opened_with(pack, signer.public)


def test_key_files_that_hold_no_key_are_named(tmp_path: Path, signer: Signer) -> None:
    good, file = signer.public.pem(), tmp_path / "fleet.pub"
    file.write_bytes(good)
    assert public_keys([file]) == (signer.public,)
    wrong = {
        "absent.pub": "cannot be read: No such file",
        ".": "is no regular file",
        "rsa.pub": "holds a key of another kind .RSA",
        "x25519.pub": "holds a key of another kind .X25519",
        "garbage.pub": "holds no public key",
        "empty.pub": "holds no public key",
        "cut.pub": "holds no public key",
        "private.pub": "holds a private key, where the public one belongs",
    }
    (tmp_path / "garbage.pub").write_bytes(np.random.default_rng(1).bytes(5000))
    (tmp_path / "empty.pub").touch()
    (tmp_path / "cut.pub").write_bytes(good[: len(good) // 2])
    (tmp_path / "private.pub").write_bytes(PrivateKey.generate().pem(b""))
    for name, key in (("rsa.pub", rsa.generate_private_key(65537, 2048)), ("x25519.pub", X25519PrivateKey.generate())):
        (tmp_path / name).write_bytes(key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    for name, what in wrong.items():
        with pytest.raises(ConfigError, match=rf"map\.trusted_keys = {tmp_path}.*: {what}.*remedy: "):
            public_keys([file, tmp_path / name])


def test_a_key_that_everybody_may_exchange_is_none_to_trust(tmp_path: Path, signer: Signer) -> None:
    file = tmp_path / "fleet.pub"
    file.write_bytes(signer.public.pem())
    file.chmod(0o666)
    with pytest.raises(ConfigError, match=r"may be written by everybody \(mode 0666\).*chmod o-w"):
        public_keys([file])


def test_no_flipped_bit_of_a_trusted_key_lets_a_pack_pass(pack: Path, tmp_path: Path, signer: Signer) -> None:
    file, good = tmp_path / "fleet.pub", signer.public.pem()
    for at in range(0, len(good), 3):
        file.write_bytes(good)
        flip(file, at, at % 7)
        try:
            keys = public_keys([file])
        except ConfigError:
            continue
        if keys != (signer.public,):  # a bit of the frame that says nothing
            with pytest.raises(SignatureInvalid):
                opened_with(pack, *keys)


def test_the_library_is_loaded_for_trusted_keys_alone(pack: Path, tmp_path: Path, signer: Signer) -> None:
    (tmp_path / "fleet.pub").write_bytes(signer.public.pem())
    code = (
        "import sys; from pathlib import Path; import visloc_companion.app.live, visloc_companion.cli.main as _\n"
        "from visloc_companion.maps.pack import PackMap; from visloc_companion.maps.signature import public_keys\n"
        "PackMap.open(Path(sys.argv[1]), trusted=public_keys(sys.argv[2:])); print('cryptography' in sys.modules)"
    )
    for keys in ([], [tmp_path / "fleet.pub"]):
        arguments = [sys.executable, "-c", code, str(pack), *map(str, keys)]
        done = subprocess.run(arguments, capture_output=True, text=True, timeout=60, check=True)
        assert done.stdout.strip() == str(bool(keys))


def test_openssl_says_the_same(pack: Path, tmp_path: Path, signer: Signer) -> None:
    """As docs/maps.md says it is done."""
    if shutil.which("openssl") is None:
        pytest.skip("there is no openssl")
    (tmp_path / "fleet.pub").write_bytes(signer.public.pem())
    verify = (
        "sed -n 's/^signature //p' pack/manifest.sig | base64 -d > manifest.sig.raw\n"
        "openssl pkeyutl -verify -rawin -pubin -inkey fleet.pub -in pack/manifest.json -sigfile manifest.sig.raw"
    )
    show = "openssl pkey -pubin -in fleet.pub -outform DER | sha256sum"
    assert subprocess.run(["sh", "-c", verify], cwd=tmp_path, capture_output=True, check=False).returncode == 0
    shown = subprocess.run(["sh", "-c", show], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert shown.stdout.split()[0] == signer.public.fingerprint
    flip(pack / MANIFEST, 9)
    assert subprocess.run(["sh", "-c", verify], cwd=tmp_path, capture_output=True, check=False).returncode != 0
