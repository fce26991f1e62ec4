"""The verbs: what the parts of the system ask of each other. Each has a fake in `visloc_companion.testing`."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from typing import Protocol, runtime_checkable

from visloc_companion.types import (
    Accepted,
    CameraModel,
    Command,
    Event,
    FeaturePatch,
    Fix,
    FloatArray,
    FrameRef,
    GeoPoint,
    Image,
    Injection,
    LocaliseRequest,
    NavState,
    NoFix,
    Notice,
    ReferencePatch,
    Rejected,
    Report,
    RequestMessage,
    SwitchSource,
    TooOld,
)


@runtime_checkable
class Clock(Protocol):
    """Time, for the shell only. The core gets `now_ns` as an argument."""

    def now_ns(self) -> int:
        """Monotonic time, ns."""

    async def sleep_until(self, t_ns: int) -> None:
        """Return when `now_ns() >= t_ns`."""


@runtime_checkable
class AutopilotLink(Protocol):
    """The MAVLink connection to one autopilot (contract suite: `visloc_companion.testing.contract_link`)."""

    @property
    def rounds(self) -> int:
        """How often the connection was seen to so far: grows while it is served, whatever the autopilot says."""

    @property
    def withheld(self) -> str:
        """Why positions are not sent that are to be, in a few words; empty where they are."""

    @property
    def n_sent(self) -> int:
        """How many positions went out so far: an output with a slow period of its own sends few of those that it is given."""

    @property
    def left_out(self) -> int:
        """How many messages, of all kinds, were left out so far because the line was too slow for them; 0 where it never is."""

    def events(self) -> AsyncIterator[Event]:
        """Decoded events, stamped with arrival time, until the link is closed. Reconnects by itself (LinkChanged)."""

    async def send(self, injection: Injection) -> None:
        """Send an external position, encoded for the detected autopilot."""

    async def request(self, message: RequestMessage) -> bool:
        """Ask for a message rate; True when the message then really arrived at about that rate."""

    async def switch(self, source: SwitchSource) -> bool:
        """Switch the autopilot's position source; True when it confirmed. Also emits SourceSwitched."""

    async def notify(self, notice: Notice) -> None:
        """Send a STATUSTEXT."""

    async def report(self, report: Report) -> None:
        """Tell ground stations how the companion does; the autopilot takes no notice."""

    async def close(self) -> None:
        """Stop sending at once and release the socket or port."""


class FrameSlots(Protocol):
    """Shared-memory slots for pixels (app/slots.py). A camera writes, the worker reads."""

    def write(self, pixels: Image) -> int:
        """Copy the pixels into a slot that nobody reads and return its number; the oldest unread frame gives way."""

    def read(self, frame: FrameRef) -> Image:
        """The pixels of a frame (a view, valid until released)."""


@runtime_checkable
class Camera(Protocol):
    """A source of frames."""

    def model(self) -> CameraModel:
        """The calibrated model; raises CameraError where there is none."""

    def frames(self, slots: FrameSlots) -> AsyncIterator[FrameRef]:
        """Frames as they come, stamped mid-exposure on the shell's clock; raises CameraError where it broke for good."""

    def left_out(self) -> Mapping[str, int]:
        """How many frames were left out since it was opened, by why, in words; not those that a newer one overtook."""

    async def close(self) -> None:
        """Release the device."""


class LocalProjection(Protocol):
    """The map's CRS linearised at one place (grid convergence and scale included)."""

    @property
    def J_map_ne(self) -> FloatArray:
        """(2, 2): (north, east) metres on the ground -> (easting, northing) in the map's CRS units."""

    @property
    def origin_map_m(self) -> tuple[float, float]:
        """Easting and northing of the place in the map's CRS units."""


@runtime_checkable
class ReferenceMap(Protocol):
    """A georeferenced map, read-only and synchronous (maps/pack.py: a pack; maps/raster.py: GeoTIFF files)."""

    @property
    def gsd_m(self) -> float:
        """Ground sample distance of the finest level, metres on the ground."""

    def patch(
        self, center_map_m: tuple[float, float], size_px: tuple[int, int], gsd_m: float, heading_rad: float
    ) -> ReferencePatch:
        """Window of (width, height) pixels about a centre in the map's CRS.

        `heading_rad` is the direction of the patch's up axis, clockwise from grid north; `gsd_m` is metres on the ground.
        The centre of the window is at pix ((width - 1) / 2, (height - 1) / 2). Raises OutsideMap where no pixel is on the map.
        """

    def projection_at(self, place: GeoPoint) -> LocalProjection:
        """The CRS linearised at a place."""

    def to_map(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        """Easting and northing in the map's CRS."""

    def to_geo(self, easting_m: float, northing_m: float) -> tuple[float, float]:
        """Latitude and longitude, degrees WGS 84."""

    def height_amsl_m(self, easting_m: float, northing_m: float) -> float:
        """Surface height at a place (NaN outside)."""

    def covers(self, lat_deg: float, lon_deg: float, margin_m: float = 0.0) -> bool:
        """Whether a place lies on the map, grown by a margin."""


@runtime_checkable
class FeatureMap(Protocol):
    """What a reference map with stored features can do beside (maps/pack.py). `name` and `recipe` are those of the features
    that the localiser uses: what was stored under another name or with another recipe does not exist for it."""

    def stored_gsd_m(self, center_map_m: tuple[float, float], gsd_m: float, name: str, recipe: str) -> float | None:
        """The stored GSD nearest to a wanted one at a place, metres on the ground; None where none is within 2^0.25 of it."""

    def stored_patch(
        self, center_map_m: tuple[float, float], size_px: tuple[int, int], gsd_m: float, name: str, recipe: str
    ) -> FeaturePatch | None:
        """Window of (width, height) pixels, heading 0, at the nearest stored GSD, its centre at most half a pixel away from the
        wanted one in each axis; None where `stored_gsd_m` is None. Raises OutsideMap where no pixel is on the map."""


@runtime_checkable
class EdgedMap(Protocol):
    """What a reference map that says where it ends can do beside (maps/grid.py): nothing is looked for beyond."""

    @property
    def corners_map_m(self) -> FloatArray:
        """(4, 2) easting and northing of the raster's corners."""


@runtime_checkable
class ShapeMap(Protocol):
    """What a reference map with a surface model or a cloud can do beside (maps/grid.py)."""

    def cloud_around(self, center_map_m: tuple[float, float], radius_m: float, max_points: int) -> FloatArray:
        """(N, 3) points of the upper surface within `radius_m` of a place in the map's CRS: metres true east and true north of
        it, and above mean sea level; at most `max_points`, thinned evenly. Raises OutsideMap where there is none, MapError for
        a map whose ground is a plane."""


@runtime_checkable
class Localiser(Protocol):
    """Finds the camera's pose from one frame. Synchronous, pure, seeded by the request."""

    @property
    def method(self) -> str:
        """Name for results."""

    def localise(self, request: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        """The pose of the camera, or why there is none. Never raises for what an image or a place may contain."""


class Estimator(Protocol):
    """Delayed-state filter of position and velocity."""

    def observe(self, fix: Fix) -> Accepted | Rejected | TooOld:
        """Take a fix at its image time."""

    def at(self, t_ns: int) -> NavState:
        """The state propagated to a time."""


class NavigatorLike(Protocol):
    """The pure navigation core."""

    def on(self, event: Event, now_ns: int) -> list[Command]:
        """Take one event; return what is to be done. No I/O, no clock, no waiting."""
