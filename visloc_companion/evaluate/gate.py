"""Gates: conditions on figures that decide a command's exit code, as in `--gate "hmi=0,p95_m<=12"`."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from visloc_companion.errors import ConfigError, did_you_mean

_OPERATORS: dict[str, Callable[[float, float], bool]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
    "=": operator.eq,
    "<": operator.lt,
    ">": operator.gt,
}
_SHORT = {
    "mean_m": "error_horizontal_m.mean",
    "median_m": "error_horizontal_m.median",
    "p95_m": "error_horizontal_m.p95",
    "max_m": "error_horizontal_m.max",
    "false_alarms": "gnss.false_alarms",
    "detected_at_s": "gnss.detected_at_s",
    "n_injected": "injected.n",
    "rate_hz": "injected.rate_hz",
    "gap_max_ms": "injected.gap_max_ms",
    "p50_ms": "latency_ms.p50",
    "p95_ms": "latency_ms.p95",
    "p99_ms": "latency_ms.p99",
}
_PLAIN = ("duration_s", "n_frames", "n_fixes", "n_no_fix", "availability", "hmi", "misleading", "nees")
_CONDITION = re.compile(r"^\s*([A-Za-z0-9_.]+)\s*(<=|>=|==|!=|=|<|>)\s*([-+0-9.eE]+)\s*$")
_WHERE = "--gate"


@dataclass(frozen=True, slots=True)
class Check:
    """A figure against its limit, for results and reports. `value` None (undefined) never passes."""

    name: str
    value: float | str | None
    limit: str
    passed: bool


@dataclass(frozen=True, slots=True)
class Condition:
    """One condition of a gate, on a figure of the summary (dotted path)."""

    name: str
    path: str
    symbol: str
    limit: float

    def check(self, summary: dict[str, Any]) -> Check:
        """Whether the summary satisfies it. A figure that is undefined fails."""
        value: Any = summary
        for part in self.path.split("."):
            value = value.get(part) if isinstance(value, dict) else None
        number = value if isinstance(value, int | float) else None
        passed = number is not None and _OPERATORS[self.symbol](number, self.limit)
        return Check(self.name, number, f"{self.symbol} {self.limit:g}", passed)


def parse_gate(text: str) -> list[Condition]:
    """The conditions of a gate, separated by commas; none in a blank text.

    Names are those of the summary (`hmi`, `availability`, ...), short ones (`p95_m`, `gap_max_ms`, ...) or dotted paths
    (`error_horizontal_m.p95`). Raises ConfigError naming the condition that is wrong.
    """
    return [_condition(part) for part in text.split(",")] if text.strip() else []


def _condition(text: str) -> Condition:
    if not text.strip():
        raise ConfigError("has a comma without a condition beside it", where=_WHERE, remedy="write one, or leave the comma out")
    found = _CONDITION.match(text)
    if found is None:
        raise ConfigError(f"{text.strip()!r} is no condition", where=_WHERE, remedy='write NAME<=NUMBER, as in "hmi=0,p95_m<=12"')
    name, symbol, number = found.groups()
    try:
        limit = float(number)
    except ValueError as why:
        raise ConfigError(f"{number!r} in {text.strip()!r} is no number", where=_WHERE, remedy="write a plain number") from why
    if not math.isfinite(limit):  # every figure would keep it
        raise ConfigError(f"{number!r} in {text.strip()!r} is beyond any number", where=_WHERE, remedy="write a smaller number")
    return Condition(name, _path(name), symbol, limit)


def _path(name: str) -> str:
    known = {**_SHORT, **{plain: plain for plain in _PLAIN}, **{path: path for path in _SHORT.values()}}
    if name in known:
        return known[name]
    remedy = f"{did_you_mean(name, known)} valid are {', '.join([*_PLAIN, *_SHORT])}".lstrip()
    raise ConfigError(f"{name!r} is no figure", where=_WHERE, remedy=remedy)


def check_gate(text: str, summary: dict[str, Any]) -> list[Check]:
    """All conditions of a gate checked against a summary. Raises ConfigError for a gate that cannot be read."""
    return [condition.check(summary) for condition in parse_gate(text)]
