"""Parameter files: ArduPilot's `NAME,VALUE` and QGroundControl's table, written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.doctor.facts import Facts
from visloc_companion.doctor.finding import Level, Rule, judge, number
from visloc_companion.types import AutopilotKind

_ROUNDS = 8
_HEAD = "# visloc doctor: only what must change. Reboot the autopilot afterwards.\n"


def changes(rules: tuple[Rule, ...], facts: Facts) -> dict[str, float]:
    """What must be set for rules about parameters to become green.

    Two rules may name one parameter (bits of a mask): what one asks for is judged again by all until nothing is left.
    """
    wanted = dict(facts.parameters)
    for _ in range(_ROUNDS):
        judged = judge(rules, replace(facts, parameters=wanted))
        asked = [item for answer in judged if answer.level in (Level.RED, Level.AMBER) for item in answer.parameters.items()]
        step = dict(reversed(asked))
        if not step:
            break
        wanted |= step
    return {name: value for name, value in wanted.items() if facts.parameters.get(name) != value}


def diff(old: Mapping[str, float], new: Mapping[str, float]) -> list[str]:
    """One line a change: `NAME  old -> new`."""
    width = max((len(name) for name in new), default=0)
    return [f"{name:<{width}}  {number(old[name]) if name in old else '-'} -> {number(value)}" for name, value in new.items()]


def render(kind: AutopilotKind, new: Mapping[str, float], system_id: int, types: Mapping[str, int]) -> str:
    """A file that the autopilot's ground stations load: Mission Planner's (ArduPilot) or QGroundControl's (PX4)."""
    if kind is AutopilotKind.PX4:
        rows = [f"{system_id}\t1\t{name}\t{number(value)}\t{types.get(name, _type(value))}\n" for name, value in new.items()]
        return _HEAD + "# Vehicle-Id Component-Id Name Value Type\n" + "".join(rows)
    return _HEAD + "".join(f"{name},{number(value)}\n" for name, value in new.items())


def _type(value: float) -> int:
    return int(mav.MAV_PARAM_TYPE_INT32 if value == round(value) else mav.MAV_PARAM_TYPE_REAL32)
