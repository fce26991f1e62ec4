"""Values out of a snapshot that may hold anything: what is not what it should be is None, never an exception."""

from __future__ import annotations

import math
from typing import Any

from visloc_companion.types import Cov2

MAX_TEXT = 200


def number(value: object, low: float = -math.inf, high: float = math.inf) -> float | None:
    """A finite number within bounds; None for all else, {"float": "inf"} among it."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        found = float(value)
    except OverflowError:
        return None
    return found if math.isfinite(found) and low <= found <= high else None


def count(value: object) -> int | None:
    """A whole number from zero."""
    return value if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**63 else None


def flag(value: object) -> bool | None:
    """True, False, or None."""
    return value if isinstance(value, bool) else None


def text(value: object) -> str:
    """A text of at most MAX_TEXT characters; empty for all else."""
    return value[:MAX_TEXT] if isinstance(value, str) else ""


def part(value: object, name: str) -> dict[str, Any]:
    """The object of that name in an object; empty where there is none."""
    found = value.get(name) if isinstance(value, dict) else None
    return found if isinstance(found, dict) else {}


def texts(value: object, limit: int) -> list[str]:
    """The first so many texts of an array."""
    return [text(item) for item in value[:limit] if text(item)] if isinstance(value, list) else []


def place(value: object) -> tuple[float, float] | None:
    """Latitude and longitude, degrees, of an object that holds both."""
    if not isinstance(value, dict):
        return None
    lat_deg, lon_deg = number(value.get("lat_deg"), -90.0, 90.0), number(value.get("lon_deg"), -180.0, 180.0)
    return None if lat_deg is None or lon_deg is None else (lat_deg, lon_deg)


def only_finite(value: Any) -> Any:
    """Nested dicts and lists with None for numbers that JSON cannot hold: sums of what was finite need not be."""
    if isinstance(value, dict):
        return {name: only_finite(inner) for name, inner in value.items()}
    if isinstance(value, list):
        return [only_finite(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def covariance(value: object) -> Cov2 | None:
    """A symmetric 2x2 covariance (m²) that is positive semi-definite; None for all else."""
    rows = value if isinstance(value, list) and len(value) == 2 else [None, None]
    cells = [number(cell) for row in rows for cell in (row if isinstance(row, list) and len(row) == 2 else [None, None])]
    nn, ne, en, ee = cells
    if nn is None or ne is None or en is None or ee is None or nn < 0 or ee < 0:
        return None
    middle, reach = (nn + ee) / 2, math.hypot((nn - ee) / 2, ne)
    is_one = abs(ne - en) <= 1e-6 * max(1.0, middle) and reach <= middle * (1 + 1e-9) and math.isfinite(middle + reach)
    return ((nn, ne), (ne, ee)) if is_one else None
