"""Whether the packages of the extra `train` are there; asked before any of them is imported."""

from __future__ import annotations

from importlib.util import find_spec

from visloc_companion.errors import ConfigError

PACKAGES = ("torch", "onnx", "onnxscript")


def missing_packages() -> list[str]:
    """Packages of the extra `train` that are not installed."""
    return [name for name in PACKAGES if find_spec(name) is None]


def require_training() -> None:
    """Raise ConfigError, with the command that helps, where a package of the extra is missing."""
    missing = missing_packages()
    if missing:
        raise ConfigError(
            f"needs {', '.join(missing)}",
            where="visloc train",
            remedy="pip install 'visloc-companion[train]' (docs/training.md says how without a GPU)",
        )
