"""The made-up flight of the unit tests, for reports that a browser renders."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

SOURCE = Path(__file__).parents[1] / "unit" / "evaluate" / "synthetic_flight.py"


@pytest.fixture(scope="session")
def synthetic() -> ModuleType:
    name = "visloc_tests_synthetic_flight"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, SOURCE)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return sys.modules[name]
