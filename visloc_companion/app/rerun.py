"""An old flight with a new map, localiser or configuration: recorded frames are localised again and the navigator flies on that.

Unlike app/replay.py this does not repeat the flight: the worker's recorded answers and deaths are left out, the requests that the
navigator makes now are answered now, and each answer arrives as late as the recorded ones did. What the map said before arming of
where GNSS put the vehicle is asked of the map of now, too.
"""

from __future__ import annotations

import heapq
import statistics
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from visloc_companion.app.ground_check import Ground, look
from visloc_companion.app.journal import Entry
from visloc_companion.app.terrain import TerrainAnswer
from visloc_companion.app.worker_process import about_terrain, no_fix
from visloc_companion.core.settings import CoreSettings
from visloc_companion.errors import Reason
from visloc_companion.types import Fix, Image, LocaliseRequest, MapAtGnss, NoFix, TerrainRequest, WorkerState

Answer = Callable[[LocaliseRequest, Image], Fix | NoFix]
_FRAMES_KEPT, _LEAST_KEPT, _BYTES_KEPT = 64, 8, 512 * 2**20
"""64 frames of 12 MP in colour would take 2.3 GB."""
_DEFAULT_LATENCY_NS = 200_000_000


class RecordedFrames:
    """Frames by number from a stream in the order of recording.

    Requests ask for recent ones: the last 64 are kept, fewer (but 8) where they take more than 512 MiB.
    """

    def __init__(self, frames: Iterator[tuple[int, Image]]) -> None:
        self._frames = frames
        self._kept: OrderedDict[int, Image] = OrderedDict()
        self._n_bytes = 0

    def get(self, frame_id: int) -> Image | None:
        """Pixels of a frame, None where it was not recorded."""
        while frame_id not in self._kept and not (self._kept and next(reversed(self._kept)) > frame_id):
            following = next(self._frames, None)
            if following is None:
                return None
            self._keep(*following)
        return self._kept.get(frame_id)

    def _keep(self, frame_id: int, pixels: Image) -> None:
        again = self._kept.get(frame_id)
        self._kept[frame_id] = pixels
        self._n_bytes += pixels.nbytes - (0 if again is None else again.nbytes)
        while len(self._kept) > _FRAMES_KEPT or (self._n_bytes > _BYTES_KEPT and len(self._kept) > _LEAST_KEPT):
            self._n_bytes -= self._kept.popitem(last=False)[1].nbytes


def rerun(
    entries: Iterable[Entry],
    frames: RecordedFrames,
    answer: Answer,
    settings: CoreSettings,
    latency_ns: int = _DEFAULT_LATENCY_NS,
    terrain: TerrainAnswer | None = None,
    ground: Ground | None = None,
) -> Iterator[Entry]:
    """The entries of the new flight: recorded events but the worker's, new answers, new commands.

    `terrain` answers about the ground below the track, `ground` about the places that were asked about before arming (without it
    the recorded answers stand).
    Deterministic where `answer` is: the answer to a request made at t arrives at t + `latency_ns`, whatever it took here.
    """
    from visloc_companion.core.navigator import Navigator  # loads filterpy: only who flies waits

    navigator = Navigator(settings)
    due: list[tuple[int, int, Fix | NoFix]] = []

    def taken(event: object, now_ns: int) -> Iterator[Entry]:
        entry = Entry(now_ns, event, None)  # type: ignore[arg-type]
        yield entry
        for command in navigator.on(entry.event, now_ns):  # type: ignore[arg-type]
            yield Entry(now_ns, None, command)
            if isinstance(command, LocaliseRequest | TerrainRequest):
                found = (
                    _answered(command, frames, answer)
                    if isinstance(command, LocaliseRequest)
                    else about_terrain(terrain, command)
                )
                found = replace(found, t_rx_ns=now_ns + latency_ns)
                heapq.heappush(due, (now_ns + latency_ns, command.request_id, found))

    for entry in entries:
        while due and due[0][0] <= entry.now_ns:
            arrival_ns, _, found = heapq.heappop(due)
            yield from taken(found, arrival_ns)
        if isinstance(entry.event, MapAtGnss) and ground is not None:
            yield from taken(look(ground, entry.event.place, entry.event.t_rx_ns), entry.now_ns)
        elif entry.event is not None and not isinstance(entry.event, (Fix, NoFix, WorkerState)):
            yield from taken(entry.event, entry.now_ns)


def recorded_latency_ns(entries: Iterable[Entry]) -> int:
    """Median time from a recorded request to its answer; 200 ms where there is none."""
    asked: dict[int, int] = {}
    found: list[int] = []
    for entry in entries:
        if isinstance(entry.command, LocaliseRequest):
            asked[entry.command.request_id] = entry.now_ns
        elif isinstance(entry.event, (Fix, NoFix)) and entry.event.request_id in asked:
            found.append(entry.now_ns - asked[entry.event.request_id])
    return round(statistics.median(found)) if found else _DEFAULT_LATENCY_NS


def _answered(request: LocaliseRequest, frames: RecordedFrames, answer: Answer) -> Fix | NoFix:
    pixels = frames.get(request.frame.frame_id)
    if pixels is None:
        return no_fix(request, "rerun", Reason.BAD_FRAME, "the frame was not recorded")
    return answer(request, pixels)
