"""The visloc command, and the environment in which its libraries are to work: set before they are imported."""

import os
from importlib.util import find_spec
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
"""Set before numpy is imported: its matrices are small here, and what several threads of it cost each other beside another busy
process is more than they bring."""
os.environ["PROJ_NETWORK"] = "OFF"
"""PROJ would fetch grids of datums where this says ON, and in flight nobody answers: then no place is in the map's CRS. What a
computer with a network fetches, one without would not have: the same map would lie elsewhere."""


def _has_own_database() -> bool:
    """Whether rasterio came with PROJ's data, as its wheels do."""
    rasterio = find_spec("rasterio")
    return rasterio is not None and (Path(rasterio.origin or "").parent / "proj_data" / "proj.db").is_file()


for _name in ("PROJ_DATA", "PROJ_LIB"):
    if _name in os.environ and _has_own_database():
        del os.environ[_name]  # that of conda, QGIS or ROS, which rasterio would take: of another version every CRS is unknown
