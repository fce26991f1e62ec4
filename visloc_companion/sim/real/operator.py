"""The operator of a flight in which the daemon may not switch the source: does as its texts ask, in his own time."""

from __future__ import annotations

import asyncio

from visloc_companion.sim.real.pilot import Pilot
from visloc_companion.sim.real.recorder import Recorder
from visloc_companion.sim.real.scenario import Operator
from visloc_companion.sim.real.station import Station
from visloc_companion.types import EkfSource

ASKED = "set EKF position source to "
_LOOK_S = 0.02
_NS_PER_S = 1_000_000_000


def asked_for(text: str) -> EkfSource | None:
    """The source that a text of the daemon asks for."""
    _, asks, name = text.partition(ASKED)
    return EkfSource(name.lower()) if asks else None


class OperatorsHand:
    """Switches by the ground station; the recorder is told what the autopilot confirmed. What is asked last counts."""

    def __init__(self, operator: Operator, pilot: Pilot, station: Station, recorder: Recorder) -> None:
        self._takes_s = {EkfSource.VISION: operator.to_vision_s, EkfSource.GNSS: operator.to_gnss_s}
        self._pilot, self._station, self._recorder = pilot, station, recorder
        self._due: tuple[int, EkfSource] | None = None
        self._read = 0

    async def serve(self) -> None:
        """Until cancelled. Raises LinkError where the autopilot does not switch."""
        while True:
            await self._look()
            await asyncio.sleep(_LOOK_S)

    async def _look(self) -> None:
        for t_ns, text in self._station.passed_on[self._read :]:
            self._read += 1
            source = asked_for(text)
            if source is not None:
                self._recorder.mark(f"asked for {source.value}")
                self._due = t_ns + round(self._takes_s[source] * _NS_PER_S), source
        if self._due is not None and self._recorder.clock.now_ns() >= self._due[0]:
            (_, source), self._due = self._due, None
            await self._pilot.set_source(self._station, source)
            self._recorder.switched(source)
