"""Tells ground stations how the companion does: numbers of the navigator by name, and the computer's load."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path

from visloc_companion.app.computer import Computer
from visloc_companion.app.health import sensor_health
from visloc_companion.app.ticker import time_grid
from visloc_companion.config import Config
from visloc_companion.core.covariance import largest_sigma_m
from visloc_companion.protocols import Clock
from visloc_companion.types import ComputerLoad, Mode, Report, Status, Verdict

LOAD_RATE_HZ = 1.0
MODES = {Mode.WAITING: 0, Mode.SHADOW: 1, Mode.AIDING: 2, Mode.DEAD_RECKONING: 3, Mode.LOST: 4}
VERDICTS = {Verdict.OK: 0, Verdict.SUSPECT: 1, Verdict.DENIED: 2}
"""The numbers of VL_MODE and VL_VERDICT (docs/mavlink.md)."""


@dataclass(frozen=True, slots=True)
class Condition:
    """The newest status, whether some part of the daemon is at fault, and whether the flight is being recorded."""

    status: Status | None
    faulty: bool
    recording: bool

    @property
    def critical(self) -> bool:
        """Whether the operator should look: a part at fault, or a position that may be further off than allowed."""
        return self.faulty or (self.status is not None and self.status.alert)


class GroundReports:
    """Sends reports by the clock. `look` gives the condition, `send` takes each report."""

    def __init__(
        self, config: Config, clock: Clock, look: Callable[[], Condition], send: Callable[[Report], Awaitable[None]]
    ) -> None:
        self._rate_hz, self._tells_load = config.link.telemetry_rate_hz, config.link.computer_status
        self._clock, self._look, self._send = clock, look, send
        self._computer = Computer(Path(config.journal.folder or "/"))
        self.load: ComputerLoad | None = None
        """The newest look at the computer, whether the ground station is told of it or not."""

    async def serve(self) -> None:
        """Serve until cancelled."""
        async with asyncio.TaskGroup() as group:
            group.create_task(self._serve_load())
            if self._rate_hz > 0:
                group.create_task(self._serve_values())

    async def _serve_load(self) -> None:
        """The heartbeat's state goes with it, so that it is told even where the load is not."""
        async for now_ns, _ in time_grid(self._clock, LOAD_RATE_HZ):
            self.load = await asyncio.to_thread(self._computer.look)
            told = self.load if self._tells_load else None
            await self._send(Report(now_ns, load=told, critical=self._look().critical))

    async def _serve_values(self) -> None:
        async for now_ns, _ in time_grid(self._clock, self._rate_hz):
            condition = self._look()
            if condition.status is not None:
                health = sensor_health(condition.status, recording=condition.recording)
                values = (*named(condition.status), ("VL_HEALTH", int(health)))
                await self._send(Report(now_ns, values, critical=condition.critical))


def named(status: Status) -> tuple[tuple[str, float | int], ...]:
    """The numbers that a pilot may want on the screen; NaN where there is none. Metres and seconds."""
    return (
        ("VL_MODE", MODES[status.mode]),
        ("VL_VERDICT", VERDICTS[status.verdict]),
        ("VL_PL", _or_nan(status.protection_level_m)),
        ("VL_VPL", _or_nan(status.vertical_protection_level_m)),
        ("VL_SIGMA", math.nan if status.place is None else largest_sigma_m(status.cov_ne_m2)),
        ("VL_FIXAGE", _or_nan(status.age_of_fix_s)),
    )


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value
