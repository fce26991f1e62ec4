"""Whether the packages of the extra `web` are there; asked before any of them is imported."""

from __future__ import annotations

from importlib.util import find_spec

from visloc_companion.errors import ConfigError

PACKAGES = ("starlette", "uvicorn", "prometheus_client")


def require_web() -> None:
    """Raise ConfigError, with the command that helps, where a package of the extra is missing."""
    missing = [name for name in PACKAGES if find_spec(name) is None]
    if missing:
        raise ConfigError(f"needs {', '.join(missing)}", where="visloc web", remedy="pip install 'visloc-companion[web]'")
