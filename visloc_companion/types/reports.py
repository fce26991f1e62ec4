"""What a ground station is shown of the companion. Nothing here reaches the navigator or changes what the autopilot does."""

from __future__ import annotations

from dataclasses import dataclass

NAME_LENGTH = 10
"""Characters of a name in NAMED_VALUE_FLOAT and NAMED_VALUE_INT."""


@dataclass(frozen=True, slots=True)
class ComputerLoad:
    """How busy the companion computer is; shares are 0 to 1, None stands where the system does not tell.

    `cores` is the share of each core since the last look, oldest core number first. Memory that programs could have is not used.
    """

    uptime_s: float | None
    cores: tuple[float, ...]
    temperature_c: float | None
    ram_used_bytes: int | None
    ram_total_bytes: int | None
    storage_used_bytes: int | None
    storage_total_bytes: int | None


@dataclass(frozen=True, slots=True)
class Report:
    """At `t_ns`: numbers by name (at most 10 ASCII characters; a float that is not finite means "none"), and the load.

    `critical` is shown by the companion's own heartbeat until the next report.
    """

    t_ns: int
    values: tuple[tuple[str, float | int], ...] = ()
    load: ComputerLoad | None = None
    critical: bool = False
