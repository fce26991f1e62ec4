"""What the tests of the navigator read off a simulated flight."""

from __future__ import annotations

import math
from typing import Any

from visloc_companion.core.settings import CoreSettings, InjectionSettings
from visloc_companion.errors import Reason
from visloc_companion.geo import wgs84
from visloc_companion.types import (
    Attitude,
    Fix,
    FrameRef,
    GeoPoint,
    LocaliseRequest,
    Mode,
    NoFix,
    Notice,
    OpenPlace,
)

S = 1_000_000_000
ORIGIN = GeoPoint(59.3, 18.1, 40.0)
World = Any


def started(world: type[World], **faults: Any) -> World:
    made = world(**faults)
    made.start()
    return made


def blinkered(world: type[World], settings: CoreSettings | None = None, **faults: Any) -> World:
    """A worker that finds the vehicle only within the region that it is asked about, and merely lists it where that is large."""

    class Blinkered(world):  # type: ignore[misc]
        def _localise(self, request: LocaliseRequest) -> None:
            super()._localise(request)
            when, fix = self.answers[-1]
            if isinstance(fix, NoFix):
                return
            north, east, _ = wgs84.ned_from_geo(fix.place, request.prior.place)
            sigma_m = math.sqrt(request.prior.cov_ne_m2[0][0])
            within = math.hypot(north, east) <= 3 * sigma_m
            listed = (OpenPlace(fix.place, fix.cov_ne_m2, math.log(0.5)),) if within else ()
            told = fix.request_id, fix.frame_id, "test"
            none = NoFix(0, fix.t_ns, *told, Reason.AMBIGUOUS, 5.0, open_places=listed, footprint_m=100.0)
            self.answers[-1] = (when, fix if within and sigma_m < 150 else none)

    usual = {"settings": settings or CoreSettings(injection=InjectionSettings(switch_source=True)), "jammed": lambda t: True}
    w = Blinkered(**(usual | faults))
    w.start()
    return w


def near_sighted(world: type[World]) -> type[World]:
    class NearSighted(world):  # type: ignore[misc]
        """Within what it is asked about, as a localiser looks."""

        def _localise(self, request: LocaliseRequest) -> None:
            super()._localise(request)
            when, found = self.answers[-1]
            reach_m = 3 * math.sqrt(request.prior.cov_ne_m2[0][0])
            if isinstance(found, Fix) and wgs84.distance_m(found.place, request.prior.place) > reach_m:
                told = found.t_ns, found.request_id, found.frame_id, found.method
                self.answers[-1] = when, NoFix(0, *told, Reason.NO_MATCH, 5.0)

    return NearSighted


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
