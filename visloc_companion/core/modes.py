"""The navigator's modes: an explicit table of transitions, and nothing else.

WAITING: link, origin, attitude or a first position is missing. SHADOW: navigating, not injecting. AIDING: injecting what
rests on recent fixes. DEAD_RECKONING: injecting what the autopilot's velocity carries on from the last fix. LOST: too unsure
to inject.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from visloc_companion.types import Mode

INJECTING = (Mode.AIDING, Mode.DEAD_RECKONING)
RECOVERED_SHARE = 0.5
"""LOST is left when sigma has fallen below this share of `lost_sigma_m`, without what all fixes have in common."""


@dataclass(frozen=True, slots=True)
class Situation:
    """What the transitions depend on.

    `ready`: link, origin, attitude and a seeded filter are there. `due`: policy and verdict want injection. `recent_fix`:
    the last accepted fix arrived less than `dead_reckoning_after_s` ago. `sigma_m` is the largest horizontal 1-sigma, `shared_m`
    the part of it that no fix takes away.
    `stranded`: too low for fixes, and the last one is too long ago to go on without (a landing). `landed`: so, and disarmed; it
    is not lost, however unsure its place is by and by.
    """

    ready: bool
    due: bool
    recent_fix: bool
    sigma_m: float
    lost_sigma_m: float
    stranded: bool = False
    landed: bool = False
    shared_m: float = 0.0

    @property
    def lost(self) -> bool:
        """Too unsure to inject."""
        return self.sigma_m > self.lost_sigma_m

    @property
    def recovered(self) -> bool:
        """Sure again, with hysteresis."""
        return recovered(self.sigma_m, self.lost_sigma_m, self.shared_m)


def recovered(sigma_m: float, lost_sigma_m: float, shared_m: float = 0.0) -> bool:
    """Whether a largest horizontal 1-sigma is that of a vehicle that is lost no more: what all fixes have in common (`shared_m`)
    may be most of it, and stays."""
    own_m = math.sqrt(max(0.0, sigma_m**2 - shared_m**2))
    return sigma_m < lost_sigma_m and own_m < RECOVERED_SHARE * lost_sigma_m


Condition = Callable[[Situation], bool]

TRANSITIONS: tuple[tuple[Mode, Mode, Condition], ...] = (
    (Mode.WAITING, Mode.SHADOW, lambda s: s.ready),
    (Mode.SHADOW, Mode.WAITING, lambda s: not s.ready),
    (Mode.SHADOW, Mode.LOST, lambda s: not s.landed and (s.lost or (s.due and s.stranded and not s.recent_fix))),
    (Mode.SHADOW, Mode.AIDING, lambda s: s.due and s.recent_fix),
    (Mode.SHADOW, Mode.DEAD_RECKONING, lambda s: s.due),
    (Mode.AIDING, Mode.WAITING, lambda s: not s.ready),
    (Mode.AIDING, Mode.LOST, lambda s: s.lost),
    (Mode.AIDING, Mode.SHADOW, lambda s: not s.due),
    (Mode.AIDING, Mode.DEAD_RECKONING, lambda s: not s.recent_fix),
    (Mode.DEAD_RECKONING, Mode.WAITING, lambda s: not s.ready),
    (Mode.DEAD_RECKONING, Mode.LOST, lambda s: s.lost or s.stranded),
    (Mode.DEAD_RECKONING, Mode.SHADOW, lambda s: not s.due),
    (Mode.DEAD_RECKONING, Mode.AIDING, lambda s: s.recent_fix),
    (Mode.LOST, Mode.WAITING, lambda s: not s.ready),
    (Mode.LOST, Mode.SHADOW, lambda s: s.landed or (s.recovered and not s.due)),
    (Mode.LOST, Mode.AIDING, lambda s: s.recovered and s.due and s.recent_fix),
    (Mode.LOST, Mode.DEAD_RECKONING, lambda s: s.recovered and s.due and not s.stranded),
)
"""From, to, when. The first row that fits is taken; one transition a Tick."""


def next_mode(mode: Mode, situation: Situation) -> Mode:
    """The mode after one step."""
    for source, target, condition in TRANSITIONS:
        if source is mode and condition(situation):
            return target
    return mode
