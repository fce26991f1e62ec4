"""The light of a frame and of the map's picture below it, found where the frame is believed to be."""

from __future__ import annotations

from dataclasses import replace

from visloc_companion.geo.sun import turn_between_deg, turned
from visloc_companion.localise.candidates.matching import Task
from visloc_companion.localise.features.grey import GREY
from visloc_companion.localise.mapped.light import COARSEST_M, WORKING_M, Light, sun_over, up_azimuth_deg
from visloc_companion.localise.mapped.relit_tiles import Lit, serves
from visloc_companion.localise.mapped.window import map_grid
from visloc_companion.localise.ortho_rectify import CameraPose, rectify_surface
from visloc_companion.localise.plan import view_box
from visloc_companion.types import Sun

LEAST_APART_DEG = 15.0
"""Suns that are nearer to each other light a wood alike."""
STEP_DEG = 6.0


def under_the_frames_sun(task: Task, pose: CameraPose) -> Task | None:
    """The task with the map as under the sun that the frame was taken in: as the prior has it, else as the frame shows it.

    None where that or the map's own is not to be seen, or both are alike; and over orthophotos in degrees. Raises OutsideMap.
    """
    frame_sun = (task.prior.sun or task.sun_seen) if serves(task.plan.frame) else None
    map_sun = None if frame_sun is None else _sun_of_map(task, pose)
    if frame_sun is None or map_sun is None or not _apart(map_sun, frame_sun):
        return None
    return replace(task, lit=Lit(task.relit, Light(_rounded(map_sun), _rounded(frame_sun))))


def with_sun_seen(task: Task, pose: CameraPose) -> Task:
    """The task with the sun that the frame shows from a pose; none where the map shows none and it would not be used."""
    return task if _sun_of_map(task, pose) is None else replace(task, sun_seen=_sun_of_frame(task, pose))


def _sun_of_map(task: Task, pose: CameraPose) -> Sun | None:
    if max(task.plan.finest_gsd_m, WORKING_M) > COARSEST_M:
        return None
    with task.watch:
        return task.suns.over(task.ref, task.plan.frame, task.view_ne_m(pose))


def _sun_of_frame(task: Task, pose: CameraPose) -> Sun | None:
    with task.watch:
        low, high = view_box(task.plan, pose)
        grid = map_grid(task.ref, task.plan.frame, low, high, max(task.plan.finest_gsd_m, WORKING_M), GREY)
    picture, seen = rectify_surface(task.level(grid.gsd_m), pose, grid)
    sun = sun_over(picture, seen & (grid.weight > 0), grid.surface_up_m, grid.gsd_m)
    return None if sun is None else turned(sun, up_azimuth_deg(grid.A_ne_pix))


def _apart(a: Sun, b: Sun) -> bool:
    return max(turn_between_deg(a, b), abs(a.elevation_deg - b.elevation_deg)) >= LEAST_APART_DEG


def _rounded(sun: Sun) -> Sun:
    """Tiles that are relit by it serve until the sun has gone on by as much as it is known."""
    return replace(sun, azimuth_deg=STEP_DEG * round(sun.azimuth_deg / STEP_DEG) % 360)
