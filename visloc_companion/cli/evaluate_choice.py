"""What every `visloc evaluate` is asked first: which methods there are, which of them is meant, and on which cases."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import typer

from visloc_companion.errors import ConfigError


def chosen_cases(cases: Path | None, method: str, methods: Collection[str], list_methods: bool, example: str) -> Path | None:
    """The folder that was named; None where only the methods were wanted, which are printed.

    Raises ConfigError for an unknown method, or with an example where no folder was named.
    """
    if list_methods:
        typer.echo("\n".join(methods))
        return None
    if method not in methods:
        raise ConfigError(f"unknown method {method!r}", where="--method", remedy=f"use one of {', '.join(methods)}")
    if cases is None:
        raise ConfigError("no folder named", where="CASES", remedy=example)
    return cases
