"""Why not one frame of a recorded flight was asked for, which its figures show as no fix and no refusal."""

from __future__ import annotations

from collections.abc import Iterable

from visloc_companion.types import Event, PriorPose


def unasked_noted(n_frames: int, n_requests: int, events: Iterable[tuple[int, Event]], min_height_m: float) -> list[str]:
    """A sentence where frames were there and none was localised; `min_height_m` is what counts as flying above home."""
    if not n_frames or n_requests:
        return []
    heights_m = [event.h_rel_m for _, event in events if isinstance(event, PriorPose)]
    if heights_m and max(map(abs, heights_m)) < min_height_m:
        why = (
            f"the log has the vehicle between {min(heights_m):.1f} and {max(heights_m):.1f} m above its home all the time, and "
            f"less than {min_height_m:g} m counts as on the ground (navigator.min_height_m)"
        )
    else:
        why = "at their times there was never position, velocity, attitude and height enough to say where to look"
    return [f"WARNING: none of the {n_frames} frames was localised: {why}."]
