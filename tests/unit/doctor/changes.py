"""Changes to good facts that break a rule."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from visloc_companion.doctor.facts import Facts
from visloc_companion.types import AutopilotKind

AP, PX4 = AutopilotKind.ARDUPILOT, AutopilotKind.PX4
Change = Callable[[Facts], Facts]
SLOW_LINE = "serial:/dev/ttyS0:57600"


@dataclass(frozen=True, slots=True)
class Break:
    """`names` must stand in the remedy."""

    rule: str
    kind: AutopilotKind
    change: Change
    level: str
    names: str


def parameters(**values: float) -> Change:
    return lambda facts: replace(facts, parameters={**facts.parameters, **values})


def without(name: str, **values: float) -> Change:
    return lambda facts: replace(facts, parameters={n: v for n, v in facts.parameters.items() if n != name} | values)


def without_all(prefix: str) -> Change:
    return lambda facts: replace(facts, parameters={n: v for n, v in facts.parameters.items() if not n.startswith(prefix)})


def link(**values: Any) -> Change:
    return lambda facts: replace(facts, link=replace(facts.link, **values))


def of_another_kind(facts: Facts) -> Facts:
    """The autopilot's HEARTBEAT names neither of both."""
    return replace(facts, autopilot=AutopilotKind.UNKNOWN)


def camera(**values: Any) -> Change:
    return lambda facts: replace(facts, camera=replace(facts.camera, **values))


def found(**values: Any) -> Change:
    return lambda facts: replace(facts, map=replace(facts.map, **values))


def model(**values: Any) -> Change:
    return lambda facts: replace(facts, model=replace(facts.model, **values))


def system(**values: Any) -> Change:
    return lambda facts: replace(facts, system=replace(facts.system, **values))


def config(section: str, **values: Any) -> Change:
    def change(facts: Facts) -> Facts:
        part = getattr(facts.config, section).model_copy(update=values)
        return replace(facts, config=facts.config.model_copy(update={section: part}))

    return change


def unstated(section: str, name: str) -> Change:
    def change(facts: Facts) -> Facts:
        part = getattr(facts.config, section)
        bare = type(part)(**part.model_dump(exclude={name}, exclude_unset=True))
        return replace(facts, config=facts.config.model_copy(update={section: bare}))

    return change


def both(first: Change, second: Change) -> Change:
    return lambda facts: second(first(facts))


def version(text: str, change: Change = lambda facts: facts) -> Change:
    return lambda facts: replace(change(facts), version=text)


def slow(name: str) -> Change:
    return lambda facts: replace(
        facts, link=replace(facts.link, rates_hz={**facts.link.rates_hz, name: 3.0 if name != "EKF_STATUS_REPORT" else 0.5})
    )


def ap(rule: str, level: str, names: str, change: Change | None = None, **values: float) -> Break:
    return Break(rule, AP, change or parameters(**values), level, names)


def px4(rule: str, level: str, names: str, change: Change | None = None, **values: float) -> Break:
    return Break(rule, PX4, change or parameters(**values), level, names)
