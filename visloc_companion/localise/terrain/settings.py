"""What terrain matching takes for granted; the fitted numbers say on what (benchmarks/terrain_fit.py)."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TerrainSettings:
    """`correlation_m`: side of the ground over which errors of the model and crowns are alike (one independent sounding each);
    `false_slope`: slope that the model's own errors pretend, in its sigma over that length; `thin_cell_m`: the lowest
    sounding of each such cell is used; `max_sigma_m`: worst 1-sigma of a fix, or `sigma_share` of the prior's where that is
    more (a lost vehicle is helped by little); `max_probability_wrong`: what is still answered; `search_cell_m`: the search's
    cells are no finer; `most_work`: cells times hypotheses of the search, more than which makes its cells coarser."""

    correlation_m: float = 90.0
    false_slope: float = 1.5
    thin_cell_m: float = 10.0
    max_sigma_m: float = 10.0
    sigma_share: float = 0.2
    max_probability_wrong: float = 0.1
    search_cell_m: float = 20.0
    most_work: float = 5e5
