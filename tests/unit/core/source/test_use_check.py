"""Whether an autopilot uses the source that it was switched to."""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from visloc_companion.core.source.use_check import GIVE_UP_NS, JUDGE_NS, UseCheck
from visloc_companion.types import EkfSource, EstimatorStatus

G, V = EkfSource.GNSS, EkfSource.VISION
S = 1_000_000_000


def report(ratio: float | None, *, ok: bool = True, aided: bool | None = None, gnss: bool | None = None) -> EstimatorStatus:
    return EstimatorStatus(0, ratio, 0.1, 0.1, ok, False, gnss, aided)


def judged(source: EkfSource, reports: Iterable[EstimatorStatus], after_ns: int = JUDGE_NS) -> bool | None:
    """Reports twice a second from the switch on, then the verdict."""
    check = UseCheck()
    check.begin(source, 0)
    for n, status in enumerate(reports):
        check.hear(status, n * S // 2)
    return check.judged(after_ns)


def test_ardupilot_uses_what_changes_its_ratio():
    assert judged(V, [report(0.2 + 0.01 * n) for n in range(7)]) is True
    assert judged(V, [report(0.2)] * 7) is False
    assert judged(V, [report(1.2 + 0.01 * n) for n in range(7)]) is False
    assert judged(V, [report(0.2 + 0.01 * n, ok=False) for n in range(7)]) is False


def test_a_switch_that_takes_a_moment_is_in_use():
    assert judged(V, [report(0.2)] * 4 + [report(0.1), report(0.12), report(0.1)]) is True


def test_px4_says_what_aids_it():
    assert judged(V, [report(0.1, aided=True, gnss=False)] * 7) is True
    assert judged(V, [report(0.1, aided=False, gnss=False)] * 7) is False
    assert judged(G, [report(0.1, aided=True, gnss=False)] * 7) is False
    assert judged(G, [report(0.1, aided=True, gnss=True)] * 7) is True
    assert judged(V, [report(1.3, aided=True)] * 7) is False


@pytest.mark.parametrize("reports", [[], [report(0.2)] * 3, [report(None)] * 7, [report(0.0)] * 7])
def test_nothing_is_judged_on_too_little(reports):
    assert judged(V, reports) is None
    assert judged(V, reports, GIVE_UP_NS) is None


def test_it_is_judged_once_and_not_before_its_time():
    check = UseCheck()
    check.begin(V, 0)
    for n in range(7):
        check.hear(report(0.2), n * S // 2)
    assert check.judged(JUDGE_NS - 1) is None
    assert check.judged(JUDGE_NS) is False
    assert check.judged(JUDGE_NS) is None
    assert check.source is None


def test_a_newer_switch_begins_anew():
    check = UseCheck()
    check.begin(V, 0)
    for n in range(7):
        check.hear(report(0.2 + 0.01 * n), n * S // 2)
    check.begin(G, 4 * S)
    assert check.judged(4 * S + JUDGE_NS) is None
    check.stop()
    assert check.judged(100 * S) is None
