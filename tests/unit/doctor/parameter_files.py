"""Parameter files as ground stations read them."""

from __future__ import annotations

from pathlib import Path


def read_parameters(path: Path) -> dict[str, float]:
    """The parameters of a file: NAME,VALUE (ArduPilot), or vehicle, component, name, value, type with tabs (QGroundControl)."""
    lines = (line.partition("#")[0].strip() for line in path.read_text(encoding="utf-8").splitlines())
    rows = (line.split("\t")[2:4] if "\t" in line else line.replace(",", " ").split() for line in lines if line)
    return {name: float(value) for name, value in rows}
