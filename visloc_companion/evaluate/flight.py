"""A recorded flight through the navigator, in the recording's own time: telemetry alone, or with frames localised in line."""

from __future__ import annotations

import heapq
import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import count

from visloc_companion.adapters.camera.calibration import wrong_size
from visloc_companion.adapters.logs.frames import FrameSource
from visloc_companion.app.ground_check import PERIOD_S, Ground, Standing, look
from visloc_companion.app.journal import Entry
from visloc_companion.app.terrain import TerrainAnswer
from visloc_companion.app.worker_process import about_terrain, no_fix
from visloc_companion.core.settings import CoreSettings
from visloc_companion.errors import Reason
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.types import CameraModel, Event, Fix, FrameRef, LinkChanged, LocaliseRequest, NoFix, TerrainRequest, Tick

NS_PER_S = 1_000_000_000
ANSWER_DELAY_S = 0.15
"""A replayed answer reaches the navigator so long after the request, whatever this machine needed: replays repeat exactly."""
_MAX_TICKING_GAP_NS = 60 * NS_PER_S
"""In a longer gap of the log the output clock stops: nobody wants a million ticks of silence."""
Pace = Callable[[int], None]
_Timed = tuple[int, Event]


@dataclass(frozen=True, slots=True)
class RecordedEyes:
    """What a replay sees with. `file_to_boot_ns` added to a frame's own time gives the recording's clock; `unusable` counts by
    what is wrong with them the frames that were asked for and are no use."""

    frames: FrameSource
    file_to_boot_ns: int
    model: CameraModel
    localiser: Localiser
    reference: ReferenceMap
    unusable: Counter[str] = field(default_factory=Counter)

    def frame_events(self) -> Iterator[_Timed]:
        """One FrameRef a frame, at its own time."""
        for number, t_us in enumerate(self.frames.t_us):
            t_ns = t_us * 1000 + self.file_to_boot_ns
            size = (self.model.width_px, self.model.height_px, 3)
            yield t_ns, FrameRef(t_ns, t_ns, number, 0, *size, t_boot_ns=t_ns)

    def answer(self, request: LocaliseRequest) -> Fix | NoFix:
        """Localise the frame that is asked for; a frame that cannot be used is a NoFix."""
        pixels = self.frames.pixels(request.frame.frame_id)
        fault = "cannot be decoded" if pixels is None else wrong_size(pixels, self.model)
        if pixels is None or fault is not None:
            self.unusable[fault or ""] += 1
            return no_fix(request, self.localiser.method, Reason.BAD_FRAME, fault or "")
        return self.localiser.localise(request, pixels, self.reference)


def replay_recording(
    events: Sequence[_Timed],
    settings: CoreSettings,
    *,
    eyes: RecordedEyes | None = None,
    terrain: TerrainAnswer | None = None,
    ground: Ground | None = None,
    on_progress: Callable[[float], None] | None = None,
    pace: Pace | None = None,
) -> Iterator[Entry]:
    """The entries (events and commands, as a journal holds them) of a recording that is flown through a new navigator.

    `terrain` answers about the ground below the track, `ground` about where GNSS puts the vehicle while it is disarmed.
    `events` are in time order on the recording's clock, which is the navigator's. `pace(t_ns)` is called before each event, to
    replay in real time. `on_progress` is told the seconds that are done.
    """
    from visloc_companion.core.navigator import Navigator  # loads filterpy: only who flies waits

    navigator = Navigator(settings)
    due: list[tuple[int, int, Event]] = []
    order = count()
    start_ns = events[0][0] if events else 0
    stream = _with_ticks(_merged(_with_ground(events, settings, ground), eyes), settings.navigator.output_rate_hz)
    told_s = -math.inf
    for t_ns, event in _with_answers(stream, due):
        if pace is not None:
            pace(t_ns)
        yield Entry(t_ns, event, None)
        for command in navigator.on(event, t_ns):
            yield Entry(t_ns, None, command)
            if isinstance(command, LocaliseRequest) and eyes is not None:
                at_ns = t_ns + round(ANSWER_DELAY_S * NS_PER_S)
                heapq.heappush(due, (at_ns, next(order), replace(eyes.answer(command), t_rx_ns=at_ns)))
            elif isinstance(command, TerrainRequest):
                at_ns = t_ns + round(ANSWER_DELAY_S * NS_PER_S)
                heapq.heappush(due, (at_ns, next(order), replace(about_terrain(terrain, command), t_rx_ns=at_ns)))
        done_s = (t_ns - start_ns) / NS_PER_S
        if on_progress is not None and done_s - told_s >= 1:
            told_s = done_s
            on_progress(done_s)


def _with_ground(events: Sequence[_Timed], settings: CoreSettings, ground: Ground | None) -> Sequence[_Timed]:
    """What the map says on the ground, as the daemon would have been told. A log that never arms may be one of a flight without
    its arming, whose heights are no mistake: there nothing is asked."""
    if ground is None or not any(isinstance(event, LinkChanged) and event.armed for _, event in events):
        return events
    standing, due_ns, told = Standing(settings.gnss.min_fix_type), events[0][0], list[_Timed]()
    for t_ns, event in events:
        standing.heard(event)
        told.append((t_ns, event))
        if t_ns >= due_ns and standing.place is not None:
            told.append((t_ns, look(ground, standing.place, t_ns)))
            due_ns = t_ns + round(PERIOD_S * NS_PER_S)
    return told


def _merged(events: Sequence[_Timed], eyes: RecordedEyes | None) -> Iterator[_Timed]:
    """Telemetry and frames in time order; frames of before and after the telemetry are left out."""
    if eyes is None or not events:
        return iter(events)
    first_ns, last_ns = events[0][0], events[-1][0]
    inside = (item for item in eyes.frame_events() if first_ns <= item[0] <= last_ns)
    return heapq.merge(events, inside, key=lambda item: item[0])


def _with_ticks(stream: Iterator[_Timed], rate_hz: float) -> Iterator[_Timed]:
    period_ns = round(NS_PER_S / rate_hz)
    tick_ns: int | None = None
    for t_ns, event in stream:
        tick_ns = t_ns if tick_ns is None else tick_ns
        stop_ns = min(t_ns, tick_ns + _MAX_TICKING_GAP_NS)
        while tick_ns < stop_ns:
            yield tick_ns, Tick(tick_ns)
            tick_ns += period_ns
        tick_ns = max(tick_ns, t_ns - period_ns)
        yield t_ns, event


def _with_answers(stream: Iterator[_Timed], due: list[tuple[int, int, Event]]) -> Iterator[_Timed]:
    """The stream with answers (a heap that grows meanwhile) put in where they fall due."""
    for t_ns, event in stream:
        while due and due[0][0] <= t_ns:
            at_ns, _, answer = heapq.heappop(due)
            yield at_ns, answer
        yield t_ns, event
