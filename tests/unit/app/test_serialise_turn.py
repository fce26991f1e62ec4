"""Answers that say how the camera turned, in journals of now and of before."""

from __future__ import annotations

import json

from visloc_companion.app.serialise import from_json, to_json
from visloc_companion.errors import Reason
from visloc_companion.types import NoFix, Turn

COV = ((1e-6, 1e-8, 0.0), (1e-8, 2e-6, 0.0), (0.0, 0.0, 3e-6))
ANSWER = NoFix(3, 2, 1, 1, "deep", Reason.NO_MATCH, 5.0, turn=Turn(1, 2, (0.8, 0.6, 0.0, 0.0), COV))


def test_a_turn_is_kept_exactly() -> None:
    assert from_json(to_json(ANSWER)) == ANSWER


def test_a_journal_of_before_reads_without_one() -> None:
    old = json.loads(to_json(ANSWER))
    del old["turn"]
    read = from_json(json.dumps(old))
    assert isinstance(read, NoFix)
    assert read.turn is None
