"""What a rule is, and what it finds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum

from visloc_companion.doctor.facts import Facts
from visloc_companion.types import AutopilotKind


class Level(StrEnum):
    """How grave a finding is."""

    GREEN = "green"
    AMBER = "amber"
    RED = "red"
    SKIPPED = "skipped"


@dataclass(frozen=True, slots=True)
class Finding:
    """What a check found: the level and what was read. `parameters` are the autopilot's to set; `remedy` replaces the rule's, or
    says what is to be done besides setting them."""

    level: Level
    read: str
    remedy: str = ""
    parameters: Mapping[str, float] = field(default_factory=dict)


def green(read: str) -> Finding:
    """As it should be."""
    return Finding(Level.GREEN, read)


def amber(read: str, remedy: str = "", parameters: Mapping[str, float] | None = None) -> Finding:
    """Works, but should be seen to."""
    return Finding(Level.AMBER, read, remedy, parameters or {})


def red(read: str, remedy: str = "", parameters: Mapping[str, float] | None = None) -> Finding:
    """Must not be flown with."""
    return Finding(Level.RED, read, remedy, parameters or {})


def skipped(read: str, remedy: str) -> Finding:
    """Could not be judged; the remedy says what to give."""
    return Finding(Level.SKIPPED, read, remedy)


@dataclass(frozen=True, slots=True)
class Rule:
    """One question. `reads` names what it looks at, `remedy` what to do where the answer is not green.

    `only` is the autopilot that it concerns (None: both). `poses`: it bears on positions that are sent as a vision system's.
    """

    id: str
    reads: str
    why: str
    remedy: str
    check: Callable[[Facts], Finding]
    only: AutopilotKind | None = None
    poses: bool = False

    @property
    def theme(self) -> str:
        """The first word of the id."""
        return self.id.partition("-")[0]


@dataclass(frozen=True, slots=True)
class Judged:
    """A rule's answer for one set of facts. `besides`: the part of the remedy beyond setting `parameters`."""

    rule: Rule
    level: Level
    read: str
    remedy: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    besides: str = ""


REBOOT = "then reboot the autopilot"
FASTER_URL = "from then on link.url = serial:DEVICE:921600"
_ORDER = (Level.RED, Level.AMBER, Level.GREEN, Level.SKIPPED)


def judge(rules: tuple[Rule, ...], facts: Facts) -> list[Judged]:
    """Every rule's answer, worst first, skipped ones last."""
    judged = [_answer(rule, facts) for rule in rules]
    return sorted(judged, key=lambda answer: _ORDER.index(answer.level))


def _answer(rule: Rule, facts: Facts) -> Judged:
    if rule.only is not None and rule.only is not facts.autopilot:
        other = f"the autopilot is {facts.autopilot}"
        if facts.autopilot is AutopilotKind.UNKNOWN:
            other = "no autopilot was read" if facts.link is None else "the autopilot is neither ArduPilot nor PX4"
        return Judged(rule, Level.SKIPPED, other, f"concerns {rule.only} only")
    if rule.poses and not facts.sends_poses:
        return Judged(rule, Level.SKIPPED, str(facts.choice), "concerns positions of a vision system only")
    finding = rule.check(facts)
    if finding.parameters:
        remedy = _to_set(rule, finding.parameters, finding.remedy)
        return Judged(rule, finding.level, finding.read, remedy, finding.parameters, finding.remedy)
    return Judged(rule, finding.level, finding.read, "" if finding.level is Level.GREEN else finding.remedy or rule.remedy)


def agree(judged: list[Judged], agreed: Mapping[str, float]) -> list[Judged]:
    """The same answers; what several rules would set in different ways is told in each with the value that suits all of them."""
    return [_agreeing(answer, agreed) if answer.parameters else answer for answer in judged]


def _agreeing(answer: Judged, agreed: Mapping[str, float]) -> Judged:
    parameters = {name: agreed.get(name, value) for name, value in answer.parameters.items()}
    return replace(answer, parameters=parameters, remedy=_to_set(answer.rule, parameters, answer.besides))


def _to_set(rule: Rule, parameters: Mapping[str, float], besides: str) -> str:
    values = ", ".join(f"{name} = {number(value)}" for name, value in parameters.items())
    return f"set {values}" + (f", {REBOOT}" if REBOOT in rule.remedy else "") + (f"; {besides}" if besides else "")


def number(value: float) -> str:
    """A parameter's value as people write it: 5000000, 0.5."""
    return f"{value:.0f}" if value == round(value) else f"{value:.7g}"
