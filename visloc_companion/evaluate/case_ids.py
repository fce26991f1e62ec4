"""What must hold of the ids of cases and their truth: a truth that is matched with another case makes errors that are none."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from pathlib import Path

from visloc_companion.errors import CasesError


def require_distinct(ids: Sequence[str], path: Path) -> None:
    """Raises CasesError where there is no id at all, or one is there twice."""
    if not ids:
        raise CasesError("holds no case", where=str(path), remedy="write one row or entry a case")
    identity, n = Counter(ids).most_common(1)[0]
    if n > 1:
        raise CasesError(f"id {identity!r} is there {n} times", where=str(path), remedy="give every case an id of its own")


def require_truth_of(cases: Collection[str], truth: Collection[str], path: Path) -> None:
    """Raises CasesError for a truth that tells of none of the cases."""
    if truth and not set(cases) & set(truth):
        one = next(iter(truth))
        raise CasesError(
            f"tells of none of the cases (it has {one!r}, they have {next(iter(cases))!r})",
            where=str(path),
            remedy="use their ids",
        )
