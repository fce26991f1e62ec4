"""A journal whose recorded frames are localised anew: an old flight with another map, localiser or configuration."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any, Literal

import numpy as np

from visloc_companion.adapters.camera.calibration import wrong_size
from visloc_companion.app.ground_check import ground_of
from visloc_companion.app.journal import Entry, header_left, read_frames, read_header, read_journal
from visloc_companion.app.journal_header import JournalHeader
from visloc_companion.app.replay import flown_config
from visloc_companion.app.rerun import RecordedFrames, recorded_latency_ns, rerun
from visloc_companion.app.settings import core_settings
from visloc_companion.app.worker_process import no_fix, open_localiser
from visloc_companion.cli.progress import bar
from visloc_companion.config import Config
from visloc_companion.core.filter.lasting import BY_SHAPE
from visloc_companion.core.terrain.terrain_aiding import METHOD as TERRAIN
from visloc_companion.errors import ConfigError, JournalError, Reason, stated_in
from visloc_companion.evaluate.gate import Check
from visloc_companion.evaluate.record import FlightRecord, from_entries
from visloc_companion.evaluate.reports.report_map import MapImage
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.maps.pack import PackMap
from visloc_companion.types import Fix, GeoPoint, Image, LocaliseRequest, NoFix

_NS_PER_S = 1e9


@dataclass(slots=True)
class RerunSource:
    """What the navigator decides now, on the answers that its recorded frames get now.

    `config` replaces the flight's own configuration, `pack` the map that it names; `stated_in` is the configuration's file.
    """

    path: Path
    config: Config | None
    stated_in: Path
    pack: Path | None
    salvage: bool
    pace: Callable[[int], None] | None = None
    latency: Literal["arrival", "computation"] = "computation"
    result: dict[str, Any] = field(default_factory=dict)
    _reference: PackMap | None = None
    _refused: str = ""

    def record(self) -> FlightRecord:
        """Fly it. Raises JournalError where there are no frames; MapError, ModelError, ConfigError where nothing can be asked."""
        damages: list[str] = []
        entries = list(read_journal(self.path, salvage=self.salvage, on_damage=damages.append))
        header = header_left(self.path) if self.salvage and self.config is not None else read_header(self.path)
        config = self._effective(header)
        frames = self._frames()
        with stated_in(self.stated_in):
            over = open_localiser(config)
        self._reference = over.reference if isinstance(over.reference, PackMap) else None

        def answer(request: LocaliseRequest, pixels: Image) -> Fix | NoFix:
            fault = wrong_size(pixels, config.camera)
            return over(request, pixels) if fault is None else no_fix(request, over.localiser.method, Reason.BAD_FRAME, fault)

        with bar(self.path.name, _duration_s(entries)) as advance:
            flown = list(
                rerun(
                    _told(entries, advance, self.pace),
                    frames,
                    answer,
                    core_settings(config),
                    latency_ns=recorded_latency_ns(entries),
                    terrain=over.terrain,
                    ground=None if self._reference is None else ground_of(self._reference),
                )
            )
        record = from_entries(flown)
        self._refused = commonest_refusal(flown)
        self.result = {
            "rerun": {"method": over.localiser.method, "map": config.map.pack, **compared(entries, flown)},
            "damages": damages,
            "verdicts": record.changes(record.verdicts),
            "modes": record.changes(record.modes),
        }
        return record

    def _effective(self, header: JournalHeader) -> Config:
        """The configuration of this run. Raises ConfigError where it states no lens or names no map.

        The keys that a flight trusted are files of its aircraft: they count where a configuration is given.
        """
        config = self.config or _without_keys(flown_config(header, self.path))
        if config.camera.unstated:
            raise ConfigError(
                f"{', '.join(config.camera.unstated)} not stated",
                where=f"{self.stated_in}: camera",
                remedy="write the calibration's values: none is assumed, nor taken from the flight's own configuration",
            )
        if self.pack is not None:
            config = config.model_copy(update={"map": config.map.model_copy(update={"pack": str(self.pack)})})
        if not config.map.pack:
            raise ConfigError("names no map", where=str(self.stated_in), remedy="give the pack with --map")
        return config

    def _frames(self) -> RecordedFrames:
        stream = read_frames(self.path)
        first = next(stream, None)
        if first is None:
            raise JournalError(
                "holds no frames", where=str(self.path), remedy="record them: journal.record_frames = true; or leave --rerun out"
            )
        return RecordedFrames(chain([first], stream))

    def facts(self) -> dict[str, Any]:
        """Answers beside those of the flight, what was damaged, verdicts and modes over time."""
        return self.result

    def notes(self) -> list[str]:
        """What came out, in words."""
        found = self.result["rerun"]
        words = [
            f"Recorded frames were localised anew by {found['method']} over {found['map']}: "
            f"{found['n_fixes']} fixes, {found['n_fixes_in_flight']} in flight."
        ]
        if not found["n_fixes"] and self._refused:
            words.append(f"No frame was placed: {self._refused}.")
        if found["n_frames_of_both"]:
            words.append(
                f"{found['n_frames_of_both']} frames have a fix in both; these are {found['apart_median_m']:.2f} m apart "
                f"(median; 95 % {found['apart_p95_m']:.2f} m)."
            )
        if found["n_not_recorded"]:
            words.append(f"{found['n_not_recorded']} frames were asked for and are not in the journal.")
        return [*words, *(f"Damaged: {damage}." for damage in self.result["damages"])]

    def checks(self) -> list[Check]:
        """Nothing besides the gate."""
        return []

    def map_image(self, record: FlightRecord) -> MapImage | None:
        """The pack's ortho under the tracks."""
        from visloc_companion.evaluate.map_image import map_image

        return map_image(self._reference, record) if self._reference is not None else None


def _without_keys(config: Config) -> Config:
    return config.model_copy(update={"map": config.map.model_copy(update={"trusted_keys": ()})})


def compared(old: Iterable[Entry], new: Iterable[Entry]) -> dict[str, Any]:
    """The fixes of two runs of one flight: how many each has, and how far those of the same frames are apart (m)."""
    then, now = _places(old), _places(new)
    both = sorted(then.keys() & now.keys())
    apart_m = [float(np.hypot(*ned_from_geo(now[frame], then[frame])[:2])) for frame in both]
    return {
        "n_fixes_in_flight": len(then),
        "n_fixes": len(now),
        "n_not_recorded": sum(isinstance(e.event, NoFix) and e.event.method == "rerun" for e in new),
        "n_frames_of_both": len(both),
        "apart_median_m": float(np.median(apart_m)) if both else None,
        "apart_p95_m": float(np.percentile(apart_m, 95)) if both else None,
    }


def commonest_refusal(entries: Iterable[Entry]) -> str:
    """Why most frames have no fix, with what was said of the first of them; empty where none was refused."""
    refused = [entry.event for entry in entries if isinstance(entry.event, NoFix)]
    if not refused:
        return ""
    ((reason, count),) = Counter(event.reason for event in refused).most_common(1)
    said = next(event.detail for event in refused if event.reason is reason)
    return f"{count} of {len(refused)} are {reason}" + (f" ({said})" if said else "")


def _places(entries: Iterable[Entry]) -> dict[tuple[int, bool], GeoPoint]:
    """Where each fix of a frame puts it, by frame and whether it is by shape."""
    fixes = (entry.event for entry in entries if isinstance(entry.event, Fix))
    return {(fix.frame_id, fix.method in BY_SHAPE): fix.place for fix in fixes if fix.method != TERRAIN}


def _told(entries: list[Entry], advance: Callable[[float], None], pace: Callable[[int], None] | None) -> Iterator[Entry]:
    """The entries, each when `pace` lets it go, and to `advance` the seconds that have gone by."""
    told_s = 0.0
    for entry in entries:
        if pace is not None:
            pace(entry.now_ns)
        done_s = (entry.now_ns - entries[0].now_ns) / _NS_PER_S
        if done_s - told_s >= 1.0:
            told_s = done_s
            advance(done_s)
        yield entry


def _duration_s(entries: list[Entry]) -> float:
    return (entries[-1].now_ns - entries[0].now_ns) / _NS_PER_S if entries else 0.0
