"""Where the vehicle is, as whoever starts the daemon says: told to the navigator as soon as it can take it."""

from __future__ import annotations

from dataclasses import dataclass

from visloc_companion.core.validate import MAX_OPERATOR_SIGMA_M, is_place
from visloc_companion.errors import ConfigError
from visloc_companion.types import Event, GeoPoint, LocalPose, OperatorFix, OriginChanged, PriorPose


@dataclass(frozen=True, slots=True)
class At:
    """A place, degrees WGS 84, and its 1-sigma radius in metres."""

    lat_deg: float
    lon_deg: float
    sigma_m: float

    @classmethod
    def parsed(cls, text: str, sigma_m: float, where: str = "--at") -> At:
        """From "LAT,LON", which `where` gave. Raises ConfigError for what is no place on the globe, or no radius."""
        option = where + " " if where.startswith("--") else ""
        remedy = f"write {option}LAT,LON in degrees, such as {option}47.0123,8.4567, and --sigma in metres"
        try:
            lat_deg, lon_deg = (float(part) for part in text.split(","))
        except ValueError as why:
            raise ConfigError(f"{text!r} is no latitude and longitude", where=where, remedy=remedy) from why
        if not is_place(GeoPoint(lat_deg, lon_deg, 0.0)):
            raise ConfigError(f"{text!r} is no place to fly", where=where, remedy=remedy)
        if not 0 < sigma_m <= MAX_OPERATOR_SIGMA_M:
            raise ConfigError(f"{sigma_m} is not above 0 and at most {MAX_OPERATOR_SIGMA_M:.0f}", where="--sigma", remedy=remedy)
        return cls(lat_deg, lon_deg, sigma_m)


class FirstPosition:
    """Watches the link's events for the moment when the autopilot has told its origin and its height."""

    def __init__(self, at: At | None) -> None:
        self._at, self._origin = at, False

    def heard(self, event: Event) -> OperatorFix | None:
        """The operator's position, once."""
        self._origin |= isinstance(event, OriginChanged)
        if self._at is None or not self._origin or not isinstance(event, PriorPose | LocalPose):
            return None
        at, self._at = self._at, None
        return OperatorFix(event.t_rx_ns, GeoPoint(at.lat_deg, at.lon_deg, 0.0), at.sigma_m)

    def outdated(self) -> bool:
        """The vehicle has flown on since: whether there was something that is not told any more."""
        at, self._at = self._at, None
        return at is not None
