"""The verdict in words for the operator: one message a change, at most 50 characters (STATUSTEXT), two with what follows."""

from __future__ import annotations

from dataclasses import replace

from visloc_companion.types import Command, GnssVerdict, Mode, Notice, Severity, Verdict

WORDS = {
    "no_data": "none received yet",
    "silence": "receiver silent",
    "no_fix": "no fix",
    "few_satellites": "too few satellites",
    "accuracy": "poor accuracy",
    "autopilot_glitch": "autopilot sees glitch",
    "autopilot_rejects": "autopilot rejects it",
    "vision_disagrees": "camera says elsewhere",
    "odometry_disagrees": "moves unlike the camera",
    "height_disagrees": "height unlike barometer",
    "receiver_spoofing": "receiver says spoofed",
    "receiver_jamming": "receiver says jammed",
    "receiver_authentication": "signals not authentic",
    "receivers_differ": "two receivers differ",
    "clock_jump": "its time jumped",
    "off_map": "outside the map",
    "off_surface": "height unlike the map's",
    "out_of_reach": "back at wrong place",
    "probation": "being checked",
}
STATE = {Verdict.OK: "trusted", Verdict.SUSPECT: "not trusted", Verdict.DENIED: "lost"}
FIRST = "waiting"
OR_CAMERA = "visloc: or camera, map set up wrong: no fix yet"
"""Beside a GNSS that moves unlike a camera in whose pictures nothing was recognised yet: who is wrong is open."""
MAX_TEXT, MAX_MESSAGES = 50, 2
MODES = frozenset(f"visloc: {mode.value.upper()}" for mode in Mode)


def text(verdict: GnssVerdict, ever_trusted: bool = True) -> str:
    """ "visloc: GNSS not trusted, poor accuracy". Before it was ever trusted it is "waiting", not "lost"."""
    state = STATE[verdict.verdict] if ever_trusted or verdict.verdict is Verdict.OK else FIRST
    why = f", {WORDS.get(verdict.reasons[0], verdict.reasons[0])}" if verdict.reasons else ""
    return f"visloc: GNSS {state}{why}"[:MAX_TEXT]


def notice(verdict: GnssVerdict, ever_trusted: bool = True) -> Notice:
    """What goes to the operator and into the journal on a change."""
    severity = Severity.NOTICE if verdict.verdict is Verdict.OK else Severity.WARNING
    data = (*((name, value) for name, value, _ in verdict.evidence), ("probability_false", verdict.probability_false))
    return Notice(severity, text(verdict, ever_trusted), to_operator=True, data=(*data, ("reasons", " ".join(verdict.reasons))))


def has_room(commands: list[Command]) -> bool:
    """Whether the operator may be told one more thing in a tick of these commands."""
    return sum(isinstance(c, Notice) and c.to_operator for c in commands) < MAX_MESSAGES


def two_at_most(commands: list[Command]) -> list[Command]:
    """The commands of a tick, in which the operator is told no more than two things: the mode, which follows from the others, is
    logged only where a verdict and a request to switch the source come with it."""
    if sum(isinstance(c, Notice) and c.to_operator for c in commands) <= MAX_MESSAGES:
        return commands
    return [replace(c, to_operator=False) if isinstance(c, Notice) and c.text in MODES else c for c in commands]
