from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from visloc_companion.errors import ConfigError
from visloc_companion.localise.registration.registry import (
    DEFAULT_MAX_PROBABILITY_WRONG,
    DEFAULT_METHOD,
    METHODS,
    make_registration,
)


def test_the_default_is_the_first_name():
    assert next(iter(METHODS)) == DEFAULT_METHOD
    assert set(METHODS) == {"height-search", "gicp", "features"}


def test_refuses_unknown_names_and_probabilities():
    with pytest.raises(ConfigError, match="use one of height-search, gicp, features"):
        make_registration("icp")
    with pytest.raises(ConfigError, match="max_probability_wrong"):
        make_registration("gicp", 1.5)


def test_names_the_extra_where_open3d_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(ConfigError, match=r"visloc-companion\[open3d\]"):
        make_registration("features")


def test_names_the_system_library_where_open3d_is_there_and_cannot_be_loaded(monkeypatch, tmp_path):
    """Installing Open3D again would not bring it."""
    (tmp_path / "open3d.py").write_text("raise ImportError('libusb-1.0.so.0: cannot open shared object file')")
    monkeypatch.delitem(sys.modules, "open3d", raising=False)
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(ConfigError, match=r"libusb-1\.0\.so\.0: cannot.*remedy: install that library .*libusb-1\.0-0") as caught:
        make_registration("features")
    assert "pip" not in str(caught.value)


def test_gicp_refines_from_a_prior_that_is_near(scene):
    near = scene.source_m @ scene.T_true[:3, :3].T + scene.T_true[:3, 3] + [1.5, -1.0, 0.5]
    found = make_registration("gicp", 1.0)(near, scene.reference_m, scene.prior)
    T = found.T_reference_source
    off = near @ T[:3, :3].T + T[:3, 3] - (near - [1.5, -1.0, 0.5])
    assert np.abs(off.mean(0)).max() < 0.3


def test_gicp_finds_the_same_in_coordinates_of_a_projected_crs(scene, capfd):
    """Its voxels end at some 500 km: what lies beyond was left out, with a line of warning for each point."""
    origin = np.array([500_000.0, 5_000_000.0, 0.0])
    near = scene.source_m @ scene.T_true[:3, :3].T + scene.T_true[:3, 3] + [1.5, -1.0, 0.5]
    register = make_registration("gicp", 1.0)
    here, far = register(near, scene.reference_m, scene.prior), register(near + origin, scene.reference_m + origin, scene.prior)
    T, T_far = here.T_reference_source, far.T_reference_source
    moved_far = (near + origin) @ T_far[:3, :3].T + T_far[:3, 3] - origin
    assert np.abs(near @ T[:3, :3].T + T[:3, 3] - moved_far).max() < 2e-3
    assert "out of range" not in "".join(capfd.readouterr())


def test_the_limit_of_what_is_accepted_is_the_one_that_the_page_states():
    page = (Path(__file__).resolve().parents[4] / "docs" / "structure.md").read_text(encoding="utf-8")
    assert f"({DEFAULT_MAX_PROBABILITY_WRONG}, stated in the file)" in page
