"""Where the map goes on beyond a square that was searched: what whoever searches it square by square need not ask."""

from __future__ import annotations

import numpy as np

from visloc_companion.localise.ortho_rectify import MapGrid
from visloc_companion.localise.plan import SearchPlan
from visloc_companion.types import MAP_SIDES

SAMPLES = 201


def map_at_sides(grid: MapGrid, plan: SearchPlan) -> dict[str, float]:
    """Share (0 to 1) of each side of the square in which the plan searches that lies on the map, of a map window that holds the
    square as far as the map goes; none where no square was asked for, or less than the square is searched."""
    if not plan.within_m <= plan.radius_cap_m:
        return {}
    inverse = np.linalg.inv(grid.A_ne_pix[:, :2])
    height, width = grid.weight.shape
    along = np.linspace(-plan.within_m, plan.within_m, SAMPLES)
    shares = {}
    for name, (north, east) in MAP_SIDES.items():
        off = np.column_stack([north * plan.within_m + abs(east) * along, east * plan.within_m + abs(north) * along])
        u, v = np.rint(inverse @ (plan.pose.p_ned_m[:2] + off - grid.A_ne_pix[:, 2]).T).astype(int)
        inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        known = grid.weight[v[inside], u[inside]] > 0
        shares[name] = float(known.sum()) / SAMPLES
    return shares
