"""A daemon that has never taken a fix says so, and why."""

from __future__ import annotations

from visloc_companion.core.camera.unmatched_watch import AFTER_NS, FEWEST, UnmatchedWatch
from visloc_companion.core.terrain.terrain_aiding import METHOD as TERRAIN
from visloc_companion.errors import Reason
from visloc_companion.types import NoFix, Notice

MS = 1_000_000


def said(watch: UnmatchedWatch, n: int, every_ms: int, method: str = "image", since: int = 0) -> list[Notice]:
    """What is told of so many refused frames, of which each third is for another reason."""
    told = []
    for k in range(since, since + n):
        reason = Reason.AMBIGUOUS if k % 3 == 0 else Reason.NO_MATCH
        told += watch.on_refusal(NoFix(0, 0, k, k, method, reason, 1.0), k * every_ms * MS)
    return [notice for notice in told if isinstance(notice, Notice)]


def test_frames_that_are_never_recognised_are_told_once_with_the_reasons() -> None:
    (notice,) = said(UnmatchedWatch(), 500, 500)
    assert notice.text == "visloc: no fix yet, no_match"
    assert notice.to_operator
    reasons = dict(notice.data)
    assert list(reasons) == ["no_match", "ambiguous"]
    assert sum(map(float, reasons.values())) == AFTER_NS // (500 * MS) + 1


def test_it_takes_both_time_and_frames() -> None:
    assert said(UnmatchedWatch(), AFTER_NS // (500 * MS), 500) == []
    assert said(UnmatchedWatch(), FEWEST - 1, 5000) == []


def test_after_a_fix_nothing_is_said() -> None:
    watch = UnmatchedWatch()
    assert said(watch, 100, 500) == []
    watch.recognised()
    assert said(watch, 900, 500, since=100) == []


def test_the_terrain_is_no_frame() -> None:
    assert said(UnmatchedWatch(), 500, 500, method=TERRAIN) == []


def test_the_longest_reason_fits_the_screen() -> None:
    assert all(len(f"visloc: no fix yet, {reason.value}") <= 50 for reason in Reason)
