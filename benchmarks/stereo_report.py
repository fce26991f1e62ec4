"""Table and pictures of benchmarks/stereo.py."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.worlds.stereo_world import COVERS, Flight
from visloc_companion.localise.structure.base import LocalCloud
from visloc_companion.types import FloatArray

Row = dict[str, Any]
SEASONS = {"map": "leaves", "flight": "bare"}
SHARES = {"within", "complete", "right"}
COLUMNS = {
    **{"raw": "raw m", "raw_range": "raw, ranged m", "shape": "shape m", "p90": "shape p90 m", "within": "within 1 m"},
    **{"bowl": "bowl m", "complete": "complete", "right": "and right", "sigma": "sigma", "offset": "offset", "seconds": "s"},
}
COVER_COLUMNS = {
    **{"shape": "shape m", "bias": "bias m", "p90": "p90 m", "within": "within 1 m", "complete": "complete"},
    **{"right": "and right", "rough": "rough m"},
}


def picture(path: Path, flight: Flight, cloud: LocalCloud, shape: FloatArray) -> None:
    """The middle frame, the cloud's heights, and its errors (blue -1 m, white 0, red +1 m; black: no point)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    reach, cell = 75.0, 0.5
    size = round(2 * reach / cell)
    at = np.round((cloud.points_m[:, :2] * [1, -1] + reach) / cell).astype(int)
    ok = ((at >= 0) & (at < size)).all(1) & np.isfinite(shape)
    height, error = np.zeros((size, size, 3), np.uint8), np.zeros((size, size, 3), np.uint8)
    up = cloud.points_m[ok, 2]
    low, high = np.percentile(up, (1, 99))
    grey = np.clip((up - low) / max(high - low, 1) * 255, 0, 255).astype(np.uint8)
    height[at[ok, 1], at[ok, 0]] = cv2.applyColorMap(grey[:, None], cv2.COLORMAP_VIRIDIS)[:, 0]
    e = np.clip(shape[ok], -1, 1)
    error[at[ok, 1], at[ok, 0]] = np.column_stack(
        [255 * (1 - np.maximum(e, 0)), 255 * (1 - np.abs(e)), 255 * (1 + np.minimum(e, 0))]
    ).astype(np.uint8)
    frame = cv2.resize(flight.frames[len(flight.frames) // 2].pixels[:, :, ::-1], (size * 4 // 3, size))
    cv2.imwrite(str(path), np.hstack([frame, height, error]))


def table(rows: list[Row]) -> list[str]:
    """Markdown: all flights, by season and by overlap; then by cover and season (cells weigh); then what was refused."""
    good = [r for r in rows if "refused" not in r]
    flown = [r for r in good if r["date"] != "box"]
    groups = {"boxes": [r for r in good if r["date"] == "box"], "all flights": flown}
    groups |= {name: [r for r in flown if r["date"] == date] for date, name in SEASONS.items()}
    for low in (0.5, 0.6, 0.7):
        groups[f"overlap {low:.0%} to {low + 0.1:.0%}"] = [r for r in flown if low <= r["overlap"] < low + 0.1]
    lines = [f"| frames | n | {' | '.join(COLUMNS.values())} |", f"|{'---|' * (len(COLUMNS) + 2)}"]
    lines += [f"| {name} | {len(members)} | {' | '.join(_cells(members))} |" for name, members in groups.items() if members]
    lines += [
        "",
        f"| cover | season | 1 m cells | {' | '.join(COVER_COLUMNS.values())} |",
        f"|{'---|' * (len(COVER_COLUMNS) + 3)}",
    ]
    for cover in COVERS:
        for date, name in SEASONS.items():
            found = [r["covers"][cover] for r in flown if r["date"] == date and cover in r["covers"]]
            if found:
                weight = [f["cells"] for f in found]
                mean = (_figure(k, float(np.average([f[k] for f in found], weights=weight))) for k in COVER_COLUMNS)
                lines.append(f"| {cover} | {name} | {sum(weight)} | {' | '.join(mean)} |")
    refused = Counter(r["refused"] for r in rows if "refused" in r)
    return [*lines, "", f"refused: {sum(refused.values())} of {len(rows)} {dict(refused)}"]


def _cells(members: list[Row]) -> list[str]:
    """Medians over the flights."""
    return [_figure(k, float(np.median([abs(r[k]) for r in members if r[k] is not None]))) for k in COLUMNS]


def _figure(key: str, value: float) -> str:
    return f"{value:.1%}" if key in SHARES else f"{value:+.2f}" if key == "bias" else f"{value:.2f}"
