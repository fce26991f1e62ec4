"""Adapters of one's own, as the type checker sees them: read by mypy (`make lint`), run by nobody.

What fits a protocol is taken where the protocol is asked for. What does not must be an error: an ignore that is not needed is
one, too.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from typing import assert_type

from visloc_companion.errors import Reason
from visloc_companion.protocols import AutopilotLink, Camera, Clock, FrameSlots, Localiser, NavigatorLike, ReferenceMap
from visloc_companion.testing.fake_camera import FakeCamera
from visloc_companion.testing.fake_link import FakeLink
from visloc_companion.testing.fake_localiser import FakeLocaliser
from visloc_companion.testing.fake_map import AnalyticMap
from visloc_companion.types import CameraModel, Command, Event, Fix, FrameRef, Image, LocaliseRequest, NoFix


class OwnLocaliser:
    """Finds nothing."""

    @property
    def method(self) -> str:
        return "own"

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        frame = request.frame
        return NoFix(frame.t_rx_ns, frame.t_ns, request.request_id, frame.frame_id, self.method, Reason.NO_MATCH, 0.0)


class NeverDeclines(OwnLocaliser):
    """Stricter than it must be: that fits."""

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> NoFix:
        answer = super().localise(request, pixels, ref)
        assert isinstance(answer, NoFix)
        return answer


class SaysNone(OwnLocaliser):
    """A refusal is a value with a reason, not None."""

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | None:  # type: ignore[override]
        return None


class NamelessLocaliser:
    """Without `method`."""

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        raise NotImplementedError


class OwnCamera:
    """Shows nothing."""

    def __init__(self, camera_model: CameraModel) -> None:
        self._model = camera_model

    def model(self) -> CameraModel:
        return self._model

    async def frames(self, slots: FrameSlots) -> AsyncIterator[FrameRef]:
        if self.model().width_px < 0:
            yield FrameRef(0, 0, 0, 0, 1, 1, 1)

    def left_out(self) -> Mapping[str, int]:
        return {}

    async def close(self) -> None:
        """Nothing is open."""


class CountsNothing:
    """A camera that does not say what it left out."""

    def model(self) -> CameraModel:
        raise NotImplementedError

    async def frames(self, slots: FrameSlots) -> AsyncIterator[FrameRef]:
        if self.model().width_px < 0:
            yield FrameRef(0, 0, 0, 0, 1, 1, 1)

    async def close(self) -> None:
        """Nothing is open."""


class Seconds:
    """A clock in seconds is none."""

    def now_ns(self) -> float:
        return 0.0

    async def sleep_until(self, t_ns: int) -> None:
        """At once."""


def what_fits(
    model: CameraModel, link: FakeLink, camera: FakeCamera, localiser: FakeLocaliser, ground: AnalyticMap
) -> tuple[list[Localiser], list[Camera], AutopilotLink, ReferenceMap]:
    """Own adapters and the fakes of `visloc_companion.testing` are what the protocols ask for."""
    return [OwnLocaliser(), NeverDeclines(), localiser], [OwnCamera(model), camera], link, ground


def no_localiser() -> Localiser:
    """An error: it has no name."""
    return NamelessLocaliser()  # type: ignore[return-value]


def no_camera() -> Camera:
    """An error: frames would be lost without a word."""
    return CountsNothing()  # type: ignore[return-value]


def no_clock() -> Clock:
    """An error: half a nanosecond is no time."""
    return Seconds()  # type: ignore[return-value]


def what_is_got(
    navigator: NavigatorLike,
    localiser: Localiser,
    camera: Camera,
    link: AutopilotLink,
    ref: ReferenceMap,
    asked: LocaliseRequest,
    seen: Image,
) -> None:
    """The types of what the protocols give."""
    answer = localiser.localise(asked, seen, ref)
    assert_type(answer, Fix | NoFix)
    assert_type(navigator.on(answer, 0), list[Command])
    assert_type(camera.model(), CameraModel)
    assert_type(link.events(), AsyncIterator[Event])
    assert_type(ref.to_geo(0.0, 0.0), tuple[float, float])
