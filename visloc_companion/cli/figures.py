"""Figures of an evaluation as lines of text."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import typer


def figure_lines(summary: dict[str, Any]) -> Iterator[str]:
    """One line for each figure of a summary."""
    for name, value in summary.items():
        yield f"{name:24} {figure_text(value)}"


def figure_text(value: Any) -> str:
    """A number, text, or a dictionary of them."""
    if isinstance(value, dict):
        return "  ".join(f"{name} {figure_text(part)}" for name, part in value.items())
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def end_if_broken_off(why: BaseException | None, document: dict[str, Any]) -> None:
    """Say that the figures are of some cases only, and end as what told the work to end would have."""
    if why is not None:
        typer.echo(f"BROKEN OFF: {len(document['cases'])} of {document['asked']} cases", err=True)
        raise why
