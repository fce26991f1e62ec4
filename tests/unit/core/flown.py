"""What the tests of the navigator read off a simulated flight."""

from __future__ import annotations

import math
from typing import Any

from visloc_companion.types import (
    Attitude,
    FrameRef,
    GeoPoint,
    LocaliseRequest,
    Mode,
    Notice,
)

S = 1_000_000_000
ORIGIN = GeoPoint(59.3, 18.1, 40.0)
World = Any


def started(world: type[World], **faults: Any) -> World:
    made = world(**faults)
    made.start()
    return made


def texts(w: World) -> list[str]:
    return [c.text for _, c in w.commands if isinstance(c, Notice)]


def modes(w: World) -> list[Mode]:
    seen: list[Mode] = []
    for _, status, _ in w.statuses:
        if not seen or seen[-1] is not status.mode:
            seen.append(status.mode)
    return seen


def errors(w: World, since_s: float, until_s: float = math.inf) -> list[float]:
    return [e for t, _, e in w.statuses if since_s <= t <= until_s]


def quiet(world: type[World]) -> World:
    """Ten seconds of flight without a camera."""
    return started(world, camera=lambda t: False).fly(10)


def frame(t_s: float, **more: Any) -> FrameRef:
    return FrameRef(round(t_s * S), round(t_s * S), 1, 0, 640, 480, 1, **more)


def attitude(w: World, t_s: float) -> None:
    w.navigator.on(Attitude(round(t_s * S), round((t_s + 995) * S), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), round(t_s * S))


def requests(commands: list[Any]) -> list[LocaliseRequest]:
    return [c for c in commands if isinstance(c, LocaliseRequest)]
