"""A self-contained HTML report of a calibration: what it is good for, where corners were seen, by how much views err."""

from __future__ import annotations

from html import escape

import numpy as np

from visloc_companion.evaluate.reports.report_parts import html_page, tiles
from visloc_companion.evaluate.reports.report_svg import circle, figure, legend, line, rect
from visloc_companion.prepare.lens.calibrate import Calibration
from visloc_companion.prepare.lens.document import left_out_words, share_words
from visloc_companion.prepare.lens.limits import FOCAL_SHARE, Shortcoming, rms_limit_px, shortcomings, unseen_words
from visloc_companion.prepare.lens.view import all_residuals_px

_WIDTH, _PAD = 640.0, 12.0
_ARROW = 0.05
"""Of the picture's width: how long the longest of nearly all residuals is drawn; none is drawn more than twice as long."""


def lens_report(of: Calibration, section: str) -> str:
    """The page. `section` is the TOML that was written."""
    short = shortcomings(of)
    model = of.lens.model
    title = f"Calibration of a camera of {model.width_px} x {model.height_px} px"
    parts = [
        f"<h1>{escape(title)}</h1>",
        f"<p class=soft>{escape(of.board.name)}, model {escape(of.candidate.kind)}</p>",
        _verdict(short),
        _tiles(of),
        f'<div class="two"><div>{_coverage(of)}</div><div>{_residuals(of)}</div></div>',
        _models(of),
        _views(of),
        f"<h2>For the configuration</h2><div class=scroll><pre>{escape(section)}</pre></div>",
    ]
    footnote = (
        "Held out: fitted without these views, which then show by how much the lens errs. Sigmas: jackknife over the views."
    )
    return html_page(title, parts, footnote)


def _verdict(short: list[Shortcoming]) -> str:
    if not short:
        return '<div class="verdict"><span class="badge">GOOD</span><span>every limit is met</span></div>'
    told = "".join(f"<p><b>{escape(_begun(each.what))}.</b> {escape(_begun(each.remedy))}.</p>" for each in short)
    return f'<div class="verdict fail"><span class="badge">NOT GOOD</span><div>{told}</div></div>'


def _begun(words: str) -> str:
    return words[0].upper() + words[1:]


def _tiles(of: Calibration) -> str:
    model = of.lens.model
    numbers = [(f"{value:.2f} ± {sigma:.2f}", f"{name}, px") for name, value, sigma in of.numbers]
    return tiles(
        [
            (f"{of.candidate.rms_px:.2f} px", f"off, rms of views held out; at most {rms_limit_px(model.width_px):.2f}"),
            (
                share_words(of.focal_share),
                f"1-sigma of the focal length, and so of heights; at most {100 * FOCAL_SHARE:g}\u00a0%",
            ),
            (str(len(of.views)), f"views used, {len(of.looked.left_out) + len(of.outlying)} left out"),
            (f"{100 * of.coverage.share:.0f} %", "of the picture's parts show corners of the board"),
            *numbers,
            (
                f"{1e3 * of.sheet.bent_m:.1f} mm, {100 * of.sheet.stretched:+.1f} %" if of.sheet.sure else "flat",
                f"sheet: bent, longer across; focal length {share_words(of.sheet.focal_share)} off for it"
                if of.sheet.sure
                else "the sheet, and alike across and down, as far as the views tell",
            ),
        ]
    )


def _frame(of: Calibration) -> tuple[float, float, float, list[str]]:
    """Pixels of the drawing to one of the picture, its size, and the picture's outline."""
    model = of.lens.model
    scale = _WIDTH / model.width_px
    height = model.height_px * scale
    return scale, _WIDTH + 2 * _PAD, height + 2 * _PAD, [rect(_PAD, _PAD, _WIDTH, height, "frame")]


def _coverage(of: Calibration) -> str:
    scale, width, height, outline = _frame(of)
    cov = of.coverage
    down, across = cov.counts.shape
    cell_w, cell_h = _WIDTH / across, (height - 2 * _PAD) / down
    parts: list[str] = []
    for row in range(down):
        for column in range(across):
            n, lit = int(cov.counts[row, column]), bool(cov.lit[row, column])
            css = "s-waiting" if not lit else "s-ok" if n else "s-denied"
            sigma_px = float(of.ray_sigmas_px[row, column])
            sure = f"rays ± {sigma_px:.2g} px at its far end" if np.isfinite(sigma_px) else "the lens folds before its far end"
            words = f"{n} corners, {sure}" if lit else "black in every picture"
            parts.append(rect(_PAD + column * cell_w, _PAD + row * cell_h, cell_w - 1, cell_h - 1, css, words))
    dots = np.concatenate([view.pix for view in of.views])
    parts += [circle(_PAD + (u + 0.5) * scale, _PAD + (v + 0.5) * scale, 1.6, "mark") for u, v in dots.tolist()]
    told = f" Few or none: {', '.join(cov.emptiest)}." if cov.emptiest else ""
    if (guessed := of.least_sure) is not None:
        told += f" Least sure of what shows none: {unseen_words(guessed)}."
    key = legend([("band s-ok", "corners were seen"), ("band s-denied", "none"), ("band s-waiting", "the lens shows nothing")])
    label = "Where corners of the board were seen"
    return (
        f"<h2>Where corners were seen</h2><p class=soft>The lens is known there, and guessed elsewhere.{escape(told)}</p>"
        f"{key}{figure(width, height, [*parts, *outline], label, 'half')}"
    )


def _residuals(of: Calibration) -> str:
    scale, width, height, parts = _frame(of)
    pix = np.concatenate([view.pix for view in of.views])
    off = np.concatenate(all_residuals_px(of.lens, of.views))
    usual = max(float(np.percentile(np.hypot(*off.T), 95)), 1e-6)
    times = _ARROW * of.lens.model.width_px / usual
    drawn = off * (times * scale * np.minimum(1.0, 2 * usual / np.maximum(np.hypot(*off.T), 1e-9)))[:, None]
    for (u, v), (du, dv) in zip(pix.tolist(), drawn.tolist(), strict=True):
        x, y = _PAD + (u + 0.5) * scale, _PAD + (v + 0.5) * scale
        parts += [line(x, y, x + du, y + dv, "error"), circle(x, y, 1.4, "mark")]
    words = f"Drawn {times:.0f} times as long as they are; 95 % are shorter than {usual:.2f} px. Where all point the same way, "
    words += "the model does not describe the lens."
    return (
        f"<h2>By how much corners lie beside</h2><p class=soft>{words}</p>"
        f"{figure(width, height, parts, 'Residuals of the corners', 'half')}"
    )


def _models(of: Calibration) -> str:
    rows = "".join(
        f"<tr><td>{escape(each.kind)}</td><td class=n>{f'{each.rms_px:.3f}' if each.lens else '–'}</td>"
        f"<td>{'chosen' if each is of.candidate else escape(each.why_not)}</td></tr>"
        for each in of.judged
    )
    head = "<tr><th>model</th><th class=n>held out, px</th><th></th></tr>"
    return f"<h2>Models</h2><div class=scroll><table>{head}{rows}</table></div>"


def _views(of: Calibration) -> str:
    rows = "".join(
        f"<tr><td class=name>{escape(view.name)}</td><td class=n>{len(view.ids)}</td><td class=n>{error:.2f}</td>"
        f"<td class=n>{out:.2f}</td><td class=n>{tilt:.0f}°</td></tr>"
        for view, error, out, tilt in zip(
            of.views, of.errors_px.tolist(), np.sqrt(of.candidate.held_out_px2).tolist(), of.tilts_deg, strict=True
        )
    )
    names = ("corners", "rms px", "held out px", "tilt")
    head = "".join(f"<th class=n>{name}</th>" for name in names)
    left = "".join(
        f'<tr class=soft><td class=name>{escape(name)}</td><td class=wrap colspan="4">{escape(why)}</td></tr>'
        for name, why in left_out_words(of).items()
    )
    return f"<h2>Views</h2><div class=scroll><table><tr><th>picture</th>{head}</tr>{rows}{left}</table></div>"
