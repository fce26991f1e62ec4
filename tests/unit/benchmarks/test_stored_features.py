from pathlib import Path

import numpy as np
import pytest

from benchmarks.stored_features import Exact
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.build import build_pack
from visloc_companion.testing.fake_features import FakeNetwork

NETWORK = FakeNetwork()
FUNCTIONS = {each.name: each for each in (GRADIENT, NETWORK)}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_what_is_computed_again_is_the_function_that_was_asked_for(tmp_path: Path, write_raster, name: str) -> None:
    """Apart from the pack's by half a step of the stored values at most, and not the same: the pack's are rounded."""
    image = np.kron(np.random.default_rng(1).integers(1, 255, (100, 100)), np.ones((4, 4))).astype(np.uint8)
    write_raster(tmp_path / "a.tif", image, "EPSG:32633", (47.0, 15.3), 0.5)
    build_pack([tmp_path / "a.tif"], None, tmp_path / "pack", ground_h_amsl_m=300.0, networks=[NETWORK])
    pack = PackMap.open(tmp_path / "pack")
    function, (level, *_) = FUNCTIONS[name], [each for each in pack.manifest.features if each.name == name]
    asked = (pack.to_map(47.0, 15.3), (64, 48), pack.gsd_m, name, function.recipe)
    exact, stored = Exact(pack, FUNCTIONS).stored_patch(*asked), pack.stored_patch(*asked)
    assert exact is not None
    assert stored is not None
    apart = np.abs(exact.features - stored.features)
    assert 0.0 < apart.max() <= 0.5 * level.step + 1e-5
