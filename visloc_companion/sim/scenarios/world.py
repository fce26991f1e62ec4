"""Flights without GNSS over a world that is not as the map has it, or cannot be seen."""

from __future__ import annotations

from visloc_companion.sim import faults
from visloc_companion.sim.changes import Change
from visloc_companion.sim.scenarios.base import Expectation, Scenario, by_name
from visloc_companion.types import Mode

JAM_S, FAULT_S = 15.0, 25.0
RATE_HZ = 2.0
UNSOLVABLE = Expectation(
    median_error_m=None,
    max_error_m=None,
    modes=(Mode.AIDING, Mode.DEAD_RECKONING, Mode.LOST),
    final_modes=(Mode.LOST,),
    failsafe=True,
)
"""Nothing can be recognised: the daemon must say so, first that it has no fixes, then that it is lost, and take no wrong one."""

SEASON_CHANGE = Scenario(
    "season_change",
    "GNSS is jammed for good over deep snow; the map is of a summer.",
    150.0,
    faults.jam(30.0),
    Expectation(
        median_error_m=3.0, max_error_m=15.0, structure_share=0.2, final_modes=(Mode.AIDING, Mode.DEAD_RECKONING)
    ),  # over snow there are seconds between fixes
    date="snow",
    pictures=True,
)

WORLD: dict[str, Scenario] = by_name(
    SEASON_CHANGE,
    Scenario(
        "stale_map",
        "From 250 m of the way on, half of the land was felled, ploughed over or built on since the map was made.",
        60.0,
        faults.jam(JAM_S),
        Expectation(median_error_m=3.0, max_error_m=15.0, dead_reckoning_m=60.0, final_modes=(Mode.AIDING, Mode.DEAD_RECKONING)),
        changes=(
            Change("felled", 250.0, share=0.6),
            Change("ploughed", 250.0, share=0.5),
            Change("built", 250.0, share=0.15),
        ),
        frame_rate_hz=RATE_HZ,
        pictures=True,
    ),
    Scenario(
        "haze",
        "The air leaves 2 % of the contrast at 400 m.",
        60.0,
        faults.jam(JAM_S) + faults.these(faults.Haze(FAULT_S, 400.0)),
        frame_rate_hz=RATE_HZ,
        pictures=True,
    ),
    Scenario(
        "over_water",
        "From 250 m to 600 m of the way there is nothing but waves; then land again.",
        100.0,
        faults.jam(JAM_S),
        Expectation(
            median_error_m=3.0,
            max_error_m=15.0,
            dead_reckoning_m=60.0,
            modes=(Mode.AIDING, Mode.DEAD_RECKONING, Mode.AIDING),
            final_modes=(Mode.AIDING, Mode.DEAD_RECKONING),
        ),
        changes=(Change("water", 250.0, 600.0),),
        frame_rate_hz=RATE_HZ,
        pictures=True,
    ),
    Scenario(
        "open_sea",
        "From 250 m of the way on there is nothing but waves, all around.",
        190.0,
        faults.jam(JAM_S),
        UNSOLVABLE,
        changes=(Change("water", 250.0, all_else=True),),
        course="out_to_sea",
        frame_rate_hz=1.0,
        pictures=True,
    ),
    Scenario(
        "map_edge",
        "The way leads out of the map and back; the land goes on.",
        90.0,
        faults.jam(JAM_S),
        Expectation(
            median_error_m=3.0,
            max_error_m=15.0,
            dead_reckoning_m=60.0,
            modes=(Mode.AIDING, Mode.DEAD_RECKONING, Mode.AIDING),
            final_modes=(Mode.AIDING,),
        ),
        course="over_the_edge",
        frame_rate_hz=RATE_HZ,
        pictures=True,
    ),
    Scenario(
        "map_shifted",
        "The whole map lies 8 m east of the truth.",
        60.0,
        faults.jam(JAM_S) + faults.these(faults.MapShift(0.0, 8.0)),
        Expectation(median_error_m=9.0, max_error_m=12.0, wrong_fix_m=12.0),
        frame_rate_hz=RATE_HZ,
        pictures=True,
    ),
)
