"""Whatever is flipped, cut off or overwritten in a cloud: points, or a CloudError that names the file; never a crash."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from visloc_companion.errors import MapError
from visloc_companion.maps.cloud import read_cloud

laspy = pytest.importorskip("laspy")
FUZZ = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
HEAD_BYTES = 2500
"""Where headers lie: half of the changes are there."""


@pytest.fixture(scope="module")
def clouds(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("clouds")
    points = np.random.default_rng(1).uniform(-30, 30, (3000, 3)) * [1, 1, 0.1]
    paths = {}
    for point_format in (1, 6):
        header = laspy.LasHeader(point_format=point_format, version="1.4")
        header.scales = np.array([0.001] * 3)
        las = laspy.LasData(header)
        las.x, las.y, las.z = points.T
        for suffix in ("las", "laz"):
            paths[f"{suffix} {point_format}"] = folder / f"{point_format}.{suffix}"
            las.write(folder / f"{point_format}.{suffix}")
    paths["npz"] = folder / "c.npz"
    np.savez_compressed(paths["npz"], points=points)
    return paths


@pytest.mark.parametrize("kind", ["las 1", "laz 1", "las 6", "laz 6", "npz"])
@FUZZ
@given(data=st.data())
def test_damaged_clouds_end_in_points_or_a_named_error(clouds: dict[str, Path], kind: str, data: st.DataObject) -> None:
    path = clouds[kind]
    raw = path.read_bytes()
    at = data.draw(st.integers(0, min(len(raw), HEAD_BYTES) - 1) | st.integers(0, len(raw) - 1))
    part = data.draw(st.binary(max_size=20))
    path.write_bytes(raw[:at] + part + raw[at + len(part) :] if part else raw[:at])
    try:
        assert np.isfinite(read_cloud(path).points_m).all()
    except MapError as why:
        assert str(path) in why.where and why.remedy
    finally:
        path.write_bytes(raw)
