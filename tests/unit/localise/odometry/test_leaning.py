"""A camera that leans looks at ground that it is not above: what a rangefinder read there on the way counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from visloc_companion.geo.camera import FOCAL_SHARE
from visloc_companion.localise.flow import FrameToFrame
from visloc_companion.localise.odometry.base import Step

HEIGHT_M, AHEAD_M, FRAMES = 60.0, 7.0, 24
LEAN_DEG = (0.0, -35.0, 0.0)


def late_legs(odo, ground, seed: int, surface=None) -> tuple[np.ndarray, np.ndarray]:
    """(L,) by which share displacements of the second half are too long, and (L,) what they claim for it. Each height that is
    read errs by 1.5 m, as over woods; with a surface the altitude is 3 m too high."""
    rng = np.random.default_rng(seed)
    points = odo.path(FRAMES, (AHEAD_M, 0.0, 0.0), (-AHEAD_M * FRAMES / 2, 0.0, -HEIGHT_M))
    flow, shares, claims = FrameToFrame(odo.MODEL), [], []
    for k, p in enumerate(points):
        read_m = -p[2] - ground.slope * p[0] + rng.normal(0, 1.5)
        sight = odo.sight(ground.frame(p, LEAN_DEG, seed=k), k, p, LEAN_DEG, height_m=read_m)
        if surface is not None:
            place = (float(p[0]), float(p[1]))
            sight = replace(sight, up_m=sight.up_m + 3.0, sigma_up_m=3.0, place_ne_m=place, sigma_place_m=1.0)
        step = flow.step(sight, surface)
        if isinstance(step, Step) and 2 * k > FRAMES:
            o = step.odometry
            true_m = AHEAD_M * (o.t_to_ns - o.t_from_ns) / odo.PERIOD_NS
            shares.append(o.displacement_ned_m[0] / true_m - 1)
            claims.append(o.sigma_scale)
    return np.array(shares), np.array(claims)


def test_without_a_surface_the_ground_is_where_it_was_read_behind(odo) -> None:
    """35 degrees of lean over a slope of a tenth: what lies up to 100 m behind the foot is seen, and was flown over."""
    ground = odo.Ground(odo.texture(), slope=0.1)
    shares = [late_legs(odo, ground, seed)[0] for seed in range(6)]
    assert all(len(share) == FRAMES // 2 - 1 for share in shares)
    assert np.sqrt(np.mean(np.square(shares))) < 0.016  # 0.018 by what was read within 42 m of the foot


def test_heights_read_where_it_looks_outdo_the_altitude(odo) -> None:
    ground = odo.Ground(odo.texture())
    shares, claims = late_legs(odo, ground, 0, ground.surface())
    assert np.abs(shares).max() < 2 * claims.max()
    assert np.sqrt(claims.max() ** 2 - FOCAL_SHARE**2) < 0.016  # 0.019 by what was read within 42 m of the foot
