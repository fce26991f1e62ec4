"""At the start the log says whether the map's features come from the pack."""

import shutil
from pathlib import Path
from typing import Any

from visloc_companion.app.worker_process import open_localiser
from visloc_companion.config import parse_config
from visloc_companion.localise.features.onnx import open_features
from visloc_companion.localise.registry import ON_FEATURES
from visloc_companion.prepare.add_features import add_features


def test_a_pack_without_the_networks_features_flies_with_a_warning(small_world: Any, network: Path, tmp_path: Path) -> None:
    pack = Path(shutil.copytree(small_world.pack, tmp_path / "pack"))
    camera = {"url": "x:y", "width_px": 240, "height_px": 200, "fx_px": 160.0, "fy_px": 160.0, "cx_px": 119.5, "cy_px": 99.5}
    chosen = {"method": next(iter(ON_FEATURES)), "model": str(network), "threads": 1}
    config = parse_config({"camera": camera, "map": {"pack": str(pack)}, "localiser": chosen})
    name = open_features(network, threads=1).name
    assert f"holds no features '{name}': they are computed in flight" in open_localiser(config).about
    add_features(pack, [open_features(network, threads=1)])
    assert "computed in flight" not in open_localiser(config).about
