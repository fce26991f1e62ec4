"""`visloc map key`, `sign`, and the options about signatures of the other commands; exit codes of the whole program."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio
from typer.testing import CliRunner

from visloc_companion.cli.map import map_app
from visloc_companion.errors import ConfigError, SignatureInvalid


def visloc(*args: object) -> str:
    """Standard output and error of `visloc map ...`; errors of the package are raised, as main() gets them."""
    result = CliRunner().invoke(map_app, [str(arg) for arg in args])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output


@pytest.fixture
def ortho(tmp_path: Path) -> Path:
    shape = {"width": 200, "height": 200, "count": 1, "dtype": "uint8"}
    place = rasterio.Affine(1.0, 0.0, 500_000.0, 0.0, -1.0, 5_200_000.0)
    with rasterio.open(tmp_path / "a.tif", "w", driver="GTiff", crs="EPSG:32633", transform=place, **shape) as out:
        out.write(np.random.default_rng(1).integers(1, 255, (200, 200)).astype(np.uint8), 1)
    return tmp_path / "a.tif"


@pytest.fixture
def fingerprint(tmp_path: Path) -> str:
    """Of a pair of keys that lies in fleet.key and fleet.pub."""
    told = visloc("key", "--out", tmp_path / "fleet")
    assert (tmp_path / "fleet.key").read_text() not in told
    return told.split()[-1]


@pytest.fixture
def pack(tmp_path: Path, ortho: Path, fingerprint: str) -> Path:
    told = visloc("build", "--ortho", ortho, "--out", tmp_path / "pack", "--model", "none", "--sign-key", tmp_path / "fleet.key")
    assert f"signed by the key {fingerprint}" in told
    return tmp_path / "pack"


def test_what_info_and_check_say_of_a_signature(tmp_path: Path, pack: Path, fingerprint: str) -> None:
    public, result = tmp_path / "fleet.pub", tmp_path / "result.json"
    for command in ("info", "check"):
        said = " ".join(visloc(command, pack, "--json", result).split())
        assert f"by the key {fingerprint}, not verified (give --trusted-key FILE)" in said
        assert json.loads(result.read_text())["signature"] == {"key": fingerprint, "verified_with": None}
        visloc("key", "--out", tmp_path / command)
        said = " ".join(
            visloc(command, pack, "--trusted-key", tmp_path / f"{command}.pub", "--trusted-key", public, "--json", result).split()
        )
        assert f"by the key {fingerprint}, verified with {public}" in said
        assert json.loads(result.read_text())["signature"] == {"key": fingerprint, "verified_with": str(public)}
        with pytest.raises(SignatureInvalid, match="is by the key"):
            visloc(command, pack, "--trusted-key", tmp_path / f"{command}.pub")
    (pack / "manifest.sig").unlink()
    assert "signature not signed" in " ".join(visloc("info", pack).split())
    assert "sign" not in visloc("check", pack)
    for command in ("info", "check"):
        with pytest.raises(SignatureInvalid, match="is not there"):
            visloc(command, pack, "--trusted-key", public)


def test_features_say_that_the_signature_is_gone(tmp_path: Path, pack: Path, fingerprint: str) -> None:
    features = ("features", pack, "--model", "none", "--replace")
    assert f"the manifest has changed, so its signature is gone: visloc map sign {pack} --key FILE" in visloc(*features)
    assert "signature" not in visloc(*features)
    assert f"{pack} is signed by {fingerprint}" in visloc("sign", pack, "--key", tmp_path / "fleet.key")
    assert f"signed by the key {fingerprint}" in visloc(*features, "--sign-key", tmp_path / "fleet.key")
    assert "verified with" in visloc("check", pack, "--trusted-key", tmp_path / "fleet.pub")


def test_a_key_that_cannot_sign_is_told_before_the_work(tmp_path: Path, ortho: Path, fingerprint: str) -> None:
    (tmp_path / "fleet.key").chmod(0o644)
    build = ("build", "--ortho", ortho, "--out", tmp_path / "pack", "--model", "none")
    with pytest.raises(ConfigError, match=r"fleet\.key: may be used by others"):
        visloc(*build, "--sign-key", tmp_path / "fleet.key")
    with pytest.raises(ConfigError, match=r"--passphrase-file: is of no use by itself.*--sign-key"):
        visloc(*build, "--passphrase-file", tmp_path / "phrase")
    assert not (tmp_path / "pack").exists()


def test_exit_codes(tmp_path: Path, pack: Path) -> None:
    """2 for keys, which are usage, 3 for a pack, which is data."""

    def code(*arguments: object) -> int:
        command = [sys.executable, "-m", "visloc_companion.cli.main", "map", *map(str, arguments)]
        return subprocess.run(command, capture_output=True, timeout=100, env=os.environ, check=False).returncode

    public, private = tmp_path / "fleet.pub", tmp_path / "fleet.key"
    assert code("check", pack, "--trusted-key", public) == 0
    assert code("check", pack, "--trusted-key", private) == 2
    assert code("key", "--out", tmp_path / "fleet") == 2
    assert code("sign", pack) == 2
    (pack / "manifest.sig").write_bytes(b"x")
    assert code("check", pack, "--trusted-key", public) == 3
    assert code("sign", tmp_path, "--key", private) == 3


@pytest.mark.parametrize("asked", ["fleet.key", "fleet.pub", "fleet.2026", "fleet.2026.key"])
def test_a_pair_of_keys_is_called_as_was_asked(tmp_path: Path, asked: str) -> None:
    stem = asked.removesuffix(".key").removesuffix(".pub")
    visloc("key", "--out", tmp_path / asked)
    assert sorted(file.name for file in tmp_path.iterdir()) == [f"{stem}.key", f"{stem}.pub"]
    before = (tmp_path / f"{stem}.key").read_bytes()
    for again in (stem, f"{stem}.key", f"{stem}.pub"):
        with pytest.raises(ConfigError, match="exists already"):
            visloc("key", "--out", tmp_path / again)
    assert (tmp_path / f"{stem}.key").read_bytes() == before
