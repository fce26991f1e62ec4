"""The terms of a flight's horizontal protection levels, as the navigator states them, in the order in which they add up."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import NamedTuple

from visloc_companion.core import integrity
from visloc_companion.core.filter.alike import Alike, none
from visloc_companion.core.filter.by_gnss import released
from visloc_companion.core.filter.propagation import N_STATES
from visloc_companion.core.filter.separation import NONE, Solutions
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import FloatArray

NEVER_OFF = none(N_STATES, 2)


class Terms(NamedTuple):
    """Metres. The level, and what adds up to it: the level of the filter's own error alone; what the map's registration adds as
    configured; what doubts of map, lens and aim add to that; the places where the vehicle is if fixes are wrong; what GNSS takes
    off it, or adds; and the age of the last fix."""

    level_m: float
    own_m: float
    map_m: float
    doubts_m: float
    wrong_fixes_m: float
    gnss_m: float
    age_m: float


def of_levels(terms: Sequence[Terms], levels_m: Sequence[float]) -> list[Terms]:
    """Those of some of the levels, in their order: not every one is told."""
    rest = iter(terms)
    return [next(each for each in rest if each.level_m == level_m) for level_m in levels_m]


@contextmanager
def noted(map_sigma_m: float) -> Iterator[list[Terms]]:
    """The terms of each level that is stated meanwhile, in a process that flies one flight over a map of this 1-sigma."""
    level_m, aged, found = integrity.protection_level_m, integrity.aged, list[Terms]()

    def stated_m(
        x: FloatArray, P: FloatArray, without: Solutions, alike: Alike, settings: NavigatorSettings, gnss_false: float = 1.0
    ) -> float:
        own_m = level_m(x, P, NONE, NEVER_OFF, replace(settings, map_sigma_m=0.0))
        with_map_m = level_m(x, P, NONE, NEVER_OFF, replace(settings, map_sigma_m=map_sigma_m))
        doubted_m = level_m(x, P, NONE, NEVER_OFF, settings)
        by_fixes_m = level_m(x, P, released(without), alike, settings)
        all_m = level_m(x, P, without, alike, settings, gnss_false)
        found.append(
            Terms(all_m, own_m, with_map_m - own_m, doubted_m - with_map_m, by_fixes_m - doubted_m, all_m - by_fixes_m, 0.0)
        )
        return all_m

    def aged_m(new_m: float, age_of_fix_s: float) -> float:
        old_m = aged(new_m, age_of_fix_s)
        found[-1] = found[-1]._replace(level_m=old_m, age_m=old_m - new_m)
        return old_m

    integrity.protection_level_m, integrity.aged = stated_m, aged_m
    try:
        yield found
    finally:
        integrity.protection_level_m, integrity.aged = level_m, aged
