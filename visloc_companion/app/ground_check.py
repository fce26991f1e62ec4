"""Before arming: what does the map say of the place where GNSS puts the vehicle?

The answer is an event for the navigator (core/satellites/gnss_map.py judges it). The map is opened in a thread, without its
hashes (the start verifies them where it must), asked every few seconds while the vehicle is disarmed, and let go when it arms.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from visloc_companion.config import Config
from visloc_companion.core.validate import is_place
from visloc_companion.errors import VislocError
from visloc_companion.protocols import Clock, ReferenceMap
from visloc_companion.types import Event, GeoPoint, Gnss, LinkChanged, MapAtGnss

if TYPE_CHECKING:
    from visloc_companion.maps.pack import PackMap

PERIOD_S = 2.0


@dataclass(frozen=True, slots=True)
class Ground:
    """A map, and whether it has a surface model (without, its heights are a plane that says nothing)."""

    reference: ReferenceMap
    has_surface: bool


def open_pack(config: Config, *, verify_hashes: bool = False) -> Ground:
    """The configured pack, signed by one of the keys that are trusted. Raises MapError, ConfigError for a bad key file."""
    from visloc_companion.maps.pack import PackMap
    from visloc_companion.maps.signature import public_keys

    trusted = public_keys(config.map.trusted_keys)
    return ground_of(PackMap.open(Path(config.map.pack), verify_hashes=verify_hashes, trusted=trusted))


def ground_of(pack: PackMap) -> Ground:
    """A pack, to be asked."""
    return Ground(pack, pack.manifest.heights.grid is not None)


def look(ground: Ground, place: GeoPoint, t_rx_ns: int) -> MapAtGnss:
    """Ask a map about a place."""
    reference, surface = ground.reference, math.nan
    inside = reference.covers(place.lat_deg, place.lon_deg)
    if inside and ground.has_surface:
        surface = reference.height_amsl_m(*reference.to_map(place.lat_deg, place.lon_deg))
    return MapAtGnss(t_rx_ns, place, inside, surface if math.isfinite(surface) else None)


class Standing:
    """Of the link's events: where GNSS puts the vehicle while it is disarmed."""

    def __init__(self, min_fix_type: int) -> None:
        self._min_fix_type = min_fix_type
        self._place: GeoPoint | None = None
        self.grounded = False

    def heard(self, event: Event) -> None:
        """Take an event of the link."""
        if isinstance(event, LinkChanged):
            self.grounded = event.up and not event.armed
        elif isinstance(event, Gnss) and event.receiver == 0:
            usable = event.fix_type >= self._min_fix_type and is_place(event.place)
            self._place = event.place if usable else None

    @property
    def place(self) -> GeoPoint | None:
        """The place to ask about; None without a usable fix, and while armed or without a link."""
        return self._place if self.grounded else None


class GroundCheck:
    """Watches the link's events and tells the navigator what the map says."""

    def __init__(
        self, config: Config, clock: Clock, tell: Callable[[Event], None], open_map: Callable[[Config], Ground] = open_pack
    ) -> None:
        self._config, self._clock, self._tell, self._open = config, clock, tell, open_map
        self._standing = Standing(config.gnss.min_fix_type)
        self._map: Ground | None = None

    def heard(self, event: Event) -> None:
        """Take an event of the link."""
        self._standing.heard(event)

    async def serve(self) -> None:
        """Until cancelled, or until the map cannot be opened (the worker says why)."""
        while True:
            await asyncio.sleep(PERIOD_S)
            place = self._standing.place
            if not self._standing.grounded:
                self._map = None
            if place is None:
                continue
            try:
                answer = await asyncio.to_thread(self._ask, place)
            except (VislocError, OSError):
                return
            if self._standing.grounded:
                self._tell(answer)

    def _ask(self, place: GeoPoint) -> MapAtGnss:
        if self._map is None:
            self._map = self._open(self._config)
        return look(self._map, place, self._clock.now_ns())
