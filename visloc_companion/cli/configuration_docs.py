"""Writes docs/configuration.md from the configuration's models: `python -m visloc_companion.cli.configuration_docs FILE`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from visloc_companion.config import Config

HEAD = """# Configuration

`visloc run --config FILE` reads TOML; `visloc run --config FILE --check` prints what is in effect.

* Every key has a default (but a camera's lens must be stated); an unknown key is an error that names the nearest valid one.
* Units are in the key names; numbers, `true` and `false` stand without quotes. No number is beyond 1e9, and none that must be
  above 0 below 1e-9.
* A relative path counts from where `visloc` is started (as a service: `/var/lib/visloc`), that of `camera.mask` from the file
  that names it; `~` is refused.

This page is made from the models by `python -m visloc_companion.cli.configuration_docs docs/configuration.md`.
"""


def render() -> str:
    """The whole page as Markdown."""
    parts = [HEAD, _top_level(), *(_section(name, info) for name, info in Config.model_fields.items() if _is_section(info))]
    return "\n".join(parts)


def _is_section(info: FieldInfo) -> bool:
    return isinstance(info.annotation, type) and issubclass(info.annotation, BaseModel)


def _top_level() -> str:
    rows = [_row(name, info) for name, info in Config.model_fields.items() if not _is_section(info)]
    return "\n".join(["## Top level", "", *_table(rows), ""])


def _section(name: str, info: FieldInfo) -> str:
    model = info.annotation
    if not (isinstance(model, type) and issubclass(model, BaseModel)):
        raise TypeError(f"{name} is not a section")
    rows = [_row(key, field) for key, field in model.model_fields.items()]
    return "\n".join([f"## `[{name}]`", "", (model.__doc__ or "").strip(), "", *_table(rows), ""])


def _table(rows: list[str]) -> list[str]:
    return ["| key | default | allowed | meaning |", "|---|---|---|---|", *rows]


def _row(name: str, info: FieldInfo) -> str:
    meaning = " ".join((info.description or "").split()).replace("|", "\\|")
    return f"| `{name}` | `{_toml(info.default)}` | {_allowed(info)} | {meaning} |"


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    return json.dumps(value) if isinstance(value, tuple) else str(value)


def _allowed(info: FieldInfo) -> str:
    choices = get_args(info.annotation)
    if get_origin(info.annotation) is tuple:
        choices = get_args(choices[0])
    if choices and all(isinstance(choice, str) for choice in choices):
        return " ".join(f"`{choice}`" for choice in choices)
    limits = [(symbol, getattr(part, key)) for part in info.metadata for key, symbol in _SYMBOLS if hasattr(part, key)]
    return ", ".join(f"{symbol} {value:g}" for symbol, value in limits if value is not None)


_SYMBOLS = (("gt", ">"), ("ge", "≥"), ("lt", "<"), ("le", "≤"))


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(render(), encoding="utf-8")
