"""Pieces that the pages of image and cloud evaluations share: page, tiles, tables of figures, errors over sigmas, pictures."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from typing import Any

import cv2

from visloc_companion import __version__
from visloc_companion.evaluate.reports.report_style import CSS
from visloc_companion.evaluate.reports.report_svg import circle, figure, text
from visloc_companion.types import Image

STYLE = (
    ".cases{display:grid;grid-template-columns:minmax(0,1fr);gap:18px}"
    ".case{background:var(--panel);border-radius:8px;padding:10px 12px}"
    ".shots{display:grid;grid-template-columns:repeat(auto-fit,minmax(150px,1fr));gap:10px;max-width:960px;margin-top:6px}"
    ".shots figure{margin:0}.shots img{width:100%;display:block;border-radius:4px}figcaption{color:var(--soft);font-size:13px}"
    ".ring{fill:none;stroke:var(--soft)}.dotmark{fill:var(--estimate)}"
)
_RIM = 4.8
"""Errors of more sigmas are drawn at so many, on the rim."""
_JPEG_QUALITY = 88


def html_page(title: str, parts: Sequence[str], footnote: str) -> str:
    """A whole self-contained page."""
    body = "".join(parts) + f"<footer>visloc-companion {escape(__version__)}. {escape(footnote)}</footer>"
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1"><link rel="icon" href="data:,">'
        f"<title>{escape(title)}</title><style>{CSS}{STYLE}</style></head><body><main>{body}</main></body></html>\n"
    )


def tiles(figures: Sequence[tuple[str, str]]) -> str:
    """Large figures with a few words below each."""
    cells = "".join(f'<div class="tile"><b>{escape(value)}</b><span>{escape(words)}</span></div>' for value, words in figures)
    return f'<div class="tiles">{cells}</div>'


def figures_table(summary: dict[str, Any]) -> str:
    """Every figure of a summary."""
    rows = "".join(f"<tr><td>{escape(name)}</td><td>{escape(_text(value))}</td></tr>" for name, value in summary.items())
    return f"<h2>All figures</h2><div class=scroll><table>{rows}</table></div>"


def claims_words(figures: dict[str, Any], wrong_means: str) -> str:
    """The figures of `reliability.reliability` as a sentence."""
    separation = figures["separation"]
    return (
        f"{figures['n']} answers, {figures['n_wrong']} of them wrong ({wrong_means}), by their claims "
        f"{figures['claimed_wrong']:.1f}. Expected calibration error {figures['expected_calibration_error']:.4f}, "
        f"excess of wrong ones {round(figures['excess_sigmas'], 1) + 0.0:+.1f} standard deviations of chance"
        + ("." if separation is None else f", area under the ROC curve {separation:.4f}.")
    )


def sigma_scatter(errors: Sequence[tuple[float, float, bool]]) -> str:
    """(east, north) over sigma and whether it is wrong, for each answer, with the 1, 2 and 3 sigma circles."""
    parts = [f'<circle cx="300" cy="300" r="{60 * k}" class="ring"/>' for k in (1, 2, 3)]
    for east, north, wrong in errors:
        x, y = (max(-_RIM, min(_RIM, value)) for value in (east, north))
        parts.append(circle(300 + 60 * x, 300 - 60 * y, 3.2, "dotgnss" if wrong else "dotfix"))
    parts += [text(303, 296 - 60 * k, f"{k} sigma", "label over", "start") for k in (1, 2, 3)]
    parts += [text(300, 592, "east, over sigma"), text(60, 24, "north")]
    return figure(600, 600, parts, "Errors over sigma", "half")


def worst_cases_section(cases: Sequence[str]) -> str:
    """The heading over the `case_section` of the worst cases; empty without any."""
    return f'<h2>The worst cases</h2><div class="cases">{"".join(cases)}</div>' if cases else ""


def case_section(case_id: str, words: str, note: str, shots: Sequence[tuple[Image | None, str]]) -> str:
    """One case: what is to be said, a note in small print, and its pictures (H, W, 3) RGB with captions, None for none."""
    images = "".join(captioned(_jpeg(image), caption) for image, caption in shots if image is not None)
    return (
        f'<section class="case"><b>{escape(case_id)}</b>: {escape(words)}<br>'
        f'<span class="soft">{escape(note)}</span><div class="shots">{images}</div></section>'
    )


def captioned(jpeg: bytes, caption: str) -> str:
    """A picture with its caption."""
    data, words = base64.b64encode(jpeg).decode("ascii"), escape(caption)
    return f'<figure><img src="data:image/jpeg;base64,{data}" alt="{words}"><figcaption>{words}</figcaption></figure>'


def percent(value: float | None) -> str:
    """A share in per cent."""
    return "–" if value is None else f"{100 * value:.1f} %"


def rounded(value: float | None, unit: str = "", digits: int = 2) -> str:
    """A number with its unit."""
    return "–" if value is None else f"{value:.{digits}f}{unit}"


def _jpeg(picture: Image) -> bytes:
    _, jpeg = cv2.imencode(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return jpeg.tobytes()


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k} {_text(v)}" for k, v in value.items())
    return f"{value:.3g}" if isinstance(value, float) else str(value)
