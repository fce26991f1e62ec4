"""Which enlargement a frame that was not recognised is looked at with next. Tries come in rounds, which become rarer."""

from __future__ import annotations

import math

STEP, STEPS = 1.12, 7
"""A round goes from 1 / 2.2 to 2.2: localisers recognise a scale that is off by half of a step."""
GUESS_LEAST, GUESS_ALIKE, GUESS_TIMES = 0.1, 0.05, 3
"""Natural logarithms: of a guess that is worth a try, and of one that was tried already, so many times in a round."""
PAUSE_NS, LONGEST_PAUSE_NS = 20_000_000_000, 160_000_000_000


class ZoomTries:
    """Remembers what was tried since frames were recognised last."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Frames are recognised."""
        self._tried: list[float] = []
        self._pause_ns, self._rest_until_ns = PAUSE_NS, 0

    def exhausted(self, now_ns: int) -> None:
        """The round is over."""
        self._tried = []
        self._rest_until_ns = now_ns + self._pause_ns
        self._pause_ns = min(2 * self._pause_ns, LONGEST_PAUSE_NS)

    def next(self, now_ns: int, guess: float | None, known: float) -> float | None:
        """What to try, as a factor of the enlargement that is believed; `guess`: what odometry says, `known`: the lens as it is
        calibrated. None while nothing is to be tried."""
        if now_ns < self._rest_until_ns:
            return None
        log_guess = 0.0 if guess is None else math.log(guess)
        n_alike = sum(abs(tried - log_guess) < GUESS_ALIKE for tried in self._tried)
        if guess is not None and GUESS_LEAST < abs(log_guess) < (STEPS + 1) * math.log(STEP) and n_alike < GUESS_TIMES:
            self._tried.append(log_guess)
            return guess
        log_known = math.log(known)
        if abs(log_known) > GUESS_ALIKE and log_known not in self._tried:
            self._tried.append(log_known)
            return known
        left = [log for log in _steps() if log not in self._tried]
        if not left:
            self.exhausted(now_ns)
            return None
        nearest = min(left, key=lambda log: abs(log - log_guess))
        self._tried.append(nearest)
        return math.exp(nearest)


def _steps() -> list[float]:
    return [sign * k * math.log(STEP) for k in range(1, STEPS + 1) for sign in (1, -1)]
