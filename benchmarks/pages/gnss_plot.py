"""The curve of false alarms against how far a drag of 1 m/s had pulled, as an SVG beside an autopilot without a monitor."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

WIDTH, HEIGHT, LEFT, BOTTOM, TOP, RIGHT = 640, 360, 60, 50, 20, 20
MAX_M, LOW, HIGH = 32.0, 0.005, 5.0
ALONE_M, TARGET_M = 28.0, 15.0
COLOURS = ("#1b6ca8", "#c8553d")


def pulled_svg(curves: Mapping[str, Sequence[Mapping[str, float]]]) -> str:
    """Median (full) and 95th percentile (dashed) of each curve; horizontal: false alarms an hour, logarithmic."""
    parts = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" font-size="12">']
    parts.append(f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>')
    for metres in range(0, 31, 5):
        parts.append(_line((LOW, metres), (HIGH, metres), "#dddddd"))
        parts.append(_text(LEFT - 8, _y(metres) + 4, f"{metres} m", "end"))
    for rate, label in ((0.01, "1 in 100 h"), (0.1, "1 in 10 h"), (1.0, "1 in 1 h")):
        parts.append(_line((rate, 0), (rate, MAX_M), "#dddddd"))
        parts.append(_text(_x(rate), HEIGHT - BOTTOM + 18, label, "middle"))
    parts.append(_line((LOW, ALONE_M), (HIGH, ALONE_M), "#555555", "2 3"))
    parts.append(_text(LEFT + 6, _y(ALONE_M) - 6, "autopilot alone: 28 m after 30 s, undetected"))
    parts.append(_line((LOW, TARGET_M), (HIGH, TARGET_M), "#555555", "2 3"))
    parts.append(_text(LEFT + 6, _y(TARGET_M) - 6, "target"))
    for k, (name, rows) in enumerate(curves.items()):
        colour = COLOURS[k % len(COLOURS)]
        for field, dash in (("median_m", ""), ("p95_m", "6 4")):
            points = " ".join(f"{_x(r['alarms_per_h']):.1f},{_y(r[field]):.1f}" for r in rows)
            parts.append(
                f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="2" stroke-dasharray="{dash}"/>'
            )
        parts.append(_text(WIDTH - RIGHT - 6, TOP + 14 + 16 * k, f"{name}: median, 95 % dashed", "end", colour))
    parts.append(_text((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 10, "false alarms (left end: none seen)", "middle"))
    return "\n".join([*parts, "</svg>", ""])


def _x(rate: float) -> float:
    share = math.log(max(rate, LOW) / LOW) / math.log(HIGH / LOW)
    return LEFT + min(share, 1.0) * (WIDTH - LEFT - RIGHT)


def _y(metres: float) -> float:
    return HEIGHT - BOTTOM - min(metres, MAX_M) / MAX_M * (HEIGHT - BOTTOM - TOP)


def _line(a: tuple[float, float], b: tuple[float, float], colour: str, dash: str = "") -> str:
    ends = f'x1="{_x(a[0]):.1f}" y1="{_y(a[1]):.1f}" x2="{_x(b[0]):.1f}" y2="{_y(b[1]):.1f}"'
    return f'<line {ends} stroke="{colour}" stroke-dasharray="{dash}"/>'


def _text(x: float, y: float, text: str, anchor: str = "start", colour: str = "#222222") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}">{text}</text>'
