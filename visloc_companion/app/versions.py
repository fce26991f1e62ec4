"""What decides the last bit of every result: Python, the packages that compute, the C library, and the kind of processor."""

from __future__ import annotations

import contextlib
import importlib.metadata
import platform
from pathlib import Path

_PACKAGES = ("visloc-companion", "numpy", "opencv-python-headless", "pymavlink", "filterpy", "rasterio", "pyproj", "mcap")
_NOT_KNOWN = "not known"
_OF_THE_PROCESSOR = ("model name", "CPU implementer", "CPU part")


def versions() -> dict[str, str]:
    """Versions of Python and of what decides the results, and the computer's architecture and processor."""
    found = {"python": platform.python_version()}
    for name in _PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found | {"libc": " ".join(platform.libc_ver()), "machine": platform.machine(), "processor": processor()}


def processor(root: Path = Path("/")) -> str:
    """The first processor as proc(5), /proc/cpuinfo, tells it: x86 by a name, Arm by implementer and part."""
    try:
        lines = (root / "proc/cpuinfo").read_text(errors="replace").splitlines()
    except OSError:
        return _NOT_KNOWN
    told: dict[str, str] = {}
    for key, _, value in (line.partition(":") for line in lines):
        told.setdefault(key.strip(), value.strip())
    return " ".join(told[key] for key in _OF_THE_PROCESSOR if told.get(key)) or _NOT_KNOWN
