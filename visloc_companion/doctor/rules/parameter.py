"""Rules about one parameter of the autopilot."""

from __future__ import annotations

from collections.abc import Callable

from visloc_companion.doctor.facts import Facts
from visloc_companion.doctor.finding import REBOOT, Finding, Level, Rule, green, number, red, skipped
from visloc_companion.types import AutopilotKind

Judge = Callable[[str, float, Facts], Finding]
"""From a parameter's name and value, and all facts, to a finding."""
ABSENT = "nothing to do where this vehicle does not need it; see that its version does not call it by another name"


def parameter(
    rule_id: str,
    only: AutopilotKind,
    names: str | Callable[[Facts], str],
    why: str,
    remedy: str,
    judge: Judge,
    reads: str = "",
    *,
    poses: bool = False,
) -> Rule:
    """A rule about the first of `names` (separated by spaces: what a parameter was called in turn) that the autopilot has."""

    def check(facts: Facts) -> Finding:
        candidates = (names if isinstance(names, str) else names(facts)).split()
        if not facts.parameters:
            return unread(facts, "the autopilot")
        for name in candidates:
            if name in facts.parameters:
                return judge(name, facts.parameters[name], facts)
        if not facts.parameters_complete:
            return skipped(f"{candidates[0]} was not read", "see link-parameters")
        return skipped(f"the autopilot has no parameter {' or '.join(candidates)}", ABSENT)

    return Rule(rule_id, reads or (names if isinstance(names, str) else "") or rule_id, why, remedy, check, only, poses)


def unread(facts: Facts, of: str) -> Finding:
    """Parameters that are not there, of what `of` names: not asked for, lost on the way, or unknown to the autopilot."""
    if not facts.parameters and facts.link is None:
        remedy = "give --link URL"
    else:
        remedy = ABSENT if facts.parameters_complete else "see link-parameters"
    return skipped(f"no parameters of {of}", remedy)


def within(good: Callable[[float], bool], set_to: float, level: Level = Level.RED) -> Judge:
    """Green where `good`, else of a level, with the value to set."""

    def judge(name: str, value: float, facts: Facts) -> Finding:
        del facts
        read = f"{name} = {number(value)}"
        return green(read) if good(value) else Finding(level, read, parameters={name: set_to})

    return judge


def bit_clear(bit: int, level: Level = Level.RED) -> Judge:
    """Green where a bit is 0; else the same value without it is to be set."""

    def judge(name: str, value: float, facts: Facts) -> Finding:
        del facts
        read = f"{name} = {value:g} (bit {bit} is {int(value) >> bit & 1})"
        cleared = int(value) & ~(1 << bit)
        return Finding(level, read, parameters={name: float(cleared)}) if int(value) >> bit & 1 else green(read)

    return judge


def least_quality(name: str, value: float, facts: Facts) -> Finding:
    """0 is green; a demand for quality is met by ODOMETRY only."""
    read = f"{name} = {value:g}"
    if value <= 0:
        return green(read)
    output = facts.assumed.injection.output
    if facts.config is not None and output == "odometry":
        return green(f"{read}, and ODOMETRY carries a quality")
    level = Level.AMBER if facts.config is not None and output == "auto" else Level.RED
    return Finding(level, read + (": the daemon sends ODOMETRY for it" if level is Level.AMBER else ""), parameters={name: 0.0})


def one_to_set(read: str, values: dict[str, float], of: int, besides: str = "") -> Finding:
    """Red; set by itself only where the vehicle has one MAVLink port. Which of several is ours nobody says: one that was set
    and not rebooted still shows its old self on the link, and the next in turn may be the pilot's radio."""
    if of == 1:
        return red(read, besides, values)
    asked = " or ".join(f"{name} = {number(value)}" for name, value in values.items())
    return red(read, f"{asked}, whichever is the companion's port, {REBOOT}" + (f"; {besides}" if besides else ""))


def own_system(name: str, value: float, facts: Facts) -> Finding:
    """The autopilot's system id is the one that the configuration names."""
    wanted = facts.assumed.link.system_id
    read = f"{name} = {value:g}, link.system_id = {wanted or '0 (any)'}"
    return green(read) if wanted in (0, int(value)) else red(read, f"link.system_id = {value:g} in the configuration")
