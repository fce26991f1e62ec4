"""Answers that a collection keeps."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.cloud_sets.cloud_answers import CloudAnswer
from benchmarks.cloud_sets.kept_answers import kept

NOWHERE = np.full(3, np.inf)
ANSWERS = [
    CloudAnswer(
        "a_00", "a", "field", "A", "hard", 0.9, "", 0.02, 0.3, np.array([0.1, -0.2, 0.3]), np.eye(3) / 3, {"overlap": 0.5}, 1.5
    ),
    CloudAnswer("b_00", "b", "water", "B", "hard", 0.0, "low_texture", 1.0, np.inf, NOWHERE, np.eye(3), {}, 0.1),
]


def test_what_was_collected_is_taken_up_again_exactly_and_each_part_once(tmp_path):
    def again():
        raise AssertionError

    kept(tmp_path / "answers", "one", lambda: ANSWERS)
    assert kept(tmp_path / "answers", "other", lambda: []) == []
    found = kept(tmp_path / "answers", "one", again)
    assert [(a.case, a.evidence, a.reason, a.mtre_m, a.horizontal_m, a.wrong) for a in found] == [
        (a.case, a.evidence, a.reason, a.mtre_m, a.horizontal_m, a.wrong) for a in ANSWERS
    ]
    np.testing.assert_array_equal(found[0].covariance_m2, ANSWERS[0].covariance_m2)


def test_what_stops_before_its_end_keeps_nothing(tmp_path):
    def stops():
        yield ANSWERS[0]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        kept(tmp_path, "one", stops)
    assert len(kept(tmp_path, "one", lambda: ANSWERS)) == 2
