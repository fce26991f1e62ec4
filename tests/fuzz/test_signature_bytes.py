"""Whatever stands in `manifest.sig`, or in the file of a key, the end is a pack that is signed, or an error that says so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.fuzz.damage import KINDS, damaged
from visloc_companion.errors import ConfigError, SignatureInvalid
from visloc_companion.maps.ed25519 import PrivateKey, read_private_pem
from visloc_companion.maps.pack import PackMap
from visloc_companion.maps.signature import SIGNATURE, public_keys
from visloc_companion.prepare.build import build_pack
from visloc_companion.prepare.sign import Signer

FUZZ = settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
SIGNER = Signer(PrivateKey.generate())


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fuzz")
    image = np.random.default_rng(1).integers(1, 255, (70, 60)).astype(np.uint8)
    place = rasterio.Affine(1.0, 0.0, 500_000.0, 0.0, -1.0, 5_200_000.0)
    shape = {"width": 60, "height": 70, "count": 1, "dtype": "uint8"}
    with rasterio.open(folder / "a.tif", "w", driver="GTiff", crs="EPSG:32633", transform=place, **shape) as out:
        out.write(image, 1)
    build_pack([folder / "a.tif"], None, folder / "pack", sign=SIGNER.sign)
    return folder / "pack"


def changed_bytes(raw: bytes, data: st.DataObject) -> bytes:
    kind = data.draw(st.sampled_from([*KINDS, "other", "lines"]))
    if kind == "other":
        return data.draw(st.binary(max_size=300))
    if kind == "lines":
        return b"".join(data.draw(st.permutations(raw.splitlines(keepends=True))))
    return damaged(raw, data, kind, most_added=2000, most_swapped=80)


@FUZZ
@given(data=st.data())
def test_no_other_bytes_are_the_signature(pack: Path, data: st.DataObject) -> None:
    raw = (pack / SIGNATURE).read_bytes()
    changed = changed_bytes(raw, data)
    (pack / SIGNATURE).write_bytes(changed)
    try:
        if changed == raw:
            PackMap.open(pack, trusted=[SIGNER.public])
            return
        with pytest.raises(SignatureInvalid) as why:
            PackMap.open(pack, trusted=[SIGNER.public])
        assert why.value.where == str(pack / SIGNATURE)
        assert why.value.remedy
    finally:
        (pack / SIGNATURE).write_bytes(raw)


@FUZZ
@given(data=st.data())
def test_the_file_of_a_key_holds_one_or_an_error_says_so(tmp_path: Path, data: st.DataObject) -> None:
    file = tmp_path / "fleet.pub"
    file.write_bytes(changed_bytes(SIGNER.public.pem(), data))
    try:
        (key,) = public_keys([file])
    except ConfigError as why:
        assert str(file) in why.where and why.remedy
    else:
        assert len(key.raw) == 32


@FUZZ
@given(data=st.data(), passphrase=st.binary(max_size=1023))
def test_the_file_of_a_private_key_holds_one_or_an_error_says_so(data: st.DataObject, passphrase: bytes) -> None:
    whole = PrivateKey.generate()
    pem = whole.pem(passphrase)
    assert read_private_pem(pem, passphrase, "here").public == whole.public
    try:
        read_private_pem(changed_bytes(pem, data), passphrase, "here")
    except ConfigError as why:
        assert why.where == "here" and why.remedy
