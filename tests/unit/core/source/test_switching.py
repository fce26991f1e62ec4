from __future__ import annotations

from visloc_companion.core.source.switching import HAND_BACK_NS, RETRY_NS, RETRY_REFUSED_NS, SHUN_NS, SourceSwitch
from visloc_companion.core.source.use_check import JUDGE_NS
from visloc_companion.types import EkfSource, EstimatorStatus, Notice, SourceSwitched, SwitchSource

G, V = EkfSource.GNSS, EkfSource.VISION


def test_asks_until_confirmed_and_then_not_again() -> None:
    switch = SourceSwitch(allowed=True)
    assert switch.want(V, 0) == [SwitchSource(V)]
    assert switch.want(V, RETRY_NS - 1) == []
    assert switch.want(V, RETRY_NS) == [SwitchSource(V)]
    assert switch.source is G
    switch.confirmed(SourceSwitched(0, V, accepted=True), RETRY_NS)
    assert switch.source is V
    assert switch.want(V, 10 * RETRY_NS) == []
    assert switch.want(G, 10 * RETRY_NS) == [SwitchSource(G)]


def test_the_first_wish_is_sent_even_for_what_is_assumed() -> None:
    switch = SourceSwitch(allowed=True)
    assert switch.want(G, 0) == [SwitchSource(G)]
    switch.confirmed(SourceSwitched(0, G, accepted=True), 1)
    assert switch.want(G, 2) == []
    switch.restarted()
    assert switch.want(G, 3) == [SwitchSource(G)]


def test_a_refusal_reaches_the_operator_and_is_tried_later() -> None:
    switch = SourceSwitch(allowed=True)
    switch.want(V, 0)
    (notice,) = switch.confirmed(SourceSwitched(0, V, accepted=False, detail="denied"), 100)
    assert isinstance(notice, Notice)
    assert notice.to_operator
    assert switch.want(V, RETRY_NS) == []
    assert switch.want(V, 100 + RETRY_REFUSED_NS) == [SwitchSource(V)]


def test_what_nobody_answered_is_ordered_again_soon() -> None:
    """Without a position an autopilot's failsafe comes within 5 to 8 s."""
    switch = SourceSwitch(allowed=True)
    switch.want(V, 0)
    (notice,) = switch.confirmed(SourceSwitched(0, V, accepted=False, answered=False), 2 * RETRY_NS // 3)
    assert isinstance(notice, Notice)
    assert (notice.to_operator, notice.text[-13:]) == (True, "not confirmed")
    assert switch.want(V, RETRY_NS) == [SwitchSource(V)]
    (again,) = switch.confirmed(SourceSwitched(0, V, accepted=False, answered=False), 2 * RETRY_NS)
    assert isinstance(again, Notice)
    assert not again.to_operator, "once, until it answers"


def test_where_it_is_not_allowed_the_operator_is_asked_once() -> None:
    switch = SourceSwitch(allowed=False)
    assert switch.want(G, 0) == []
    (notice,) = switch.want(V, 1)
    assert isinstance(notice, Notice)
    assert notice.to_operator
    assert len(notice.text) <= 50
    assert switch.want(V, 10**12) == []
    assert len(switch.want(G, 10**12)) == 1


def report(ratio: float) -> EstimatorStatus:
    return EstimatorStatus(0, ratio, 0.1, 0.1, True, False, None)


def switched(source: EkfSource, *, shows_use: bool = True) -> SourceSwitch:
    """On a source that the autopilot then reports not to use."""
    switch = SourceSwitch(allowed=True)
    switch.want(source, 0)
    switch.confirmed(SourceSwitched(0, source, accepted=True, shows_use=shows_use), 0)
    for n in range(8):
        switch.hear(report(0.2), n * JUDGE_NS // 6)
    return switch


def test_a_source_that_is_not_used_is_told_of_and_left_for_the_other() -> None:
    switch = switched(V)
    assert switch.verify(True, JUDGE_NS - 1) == []
    (notice,) = switch.verify(True, JUDGE_NS)
    assert isinstance(notice, Notice)
    assert (notice.to_operator, len(notice.text) <= 50) == (True, True)
    assert switch.shuns(V, JUDGE_NS + 1)
    assert not switch.shuns(V, JUDGE_NS + SHUN_NS)
    assert not switch.shuns(G, JUDGE_NS + 1)
    assert switch.verify(True, 2 * JUDGE_NS) == []


def test_without_another_source_it_is_only_told() -> None:
    switch = switched(V)
    (notice,) = switch.verify(False, JUDGE_NS)
    assert isinstance(notice, Notice)
    assert len(notice.text) <= 50
    assert not switch.shuns(V, JUDGE_NS + 1)


def test_what_leaves_no_trace_is_not_judged() -> None:
    assert switched(V, shows_use=False).verify(True, 10 * JUDGE_NS) == []


def test_vision_is_left_only_when_gnss_is_seen_to_be_used() -> None:
    switch = switched(V)
    assert switch.leaving_vision(0)
    switch.confirmed(SourceSwitched(0, G, accepted=True), 10 * JUDGE_NS)
    assert switch.leaving_vision(10 * JUDGE_NS)
    for n in range(8):
        switch.hear(report(0.2 + 0.01 * n), 10 * JUDGE_NS + n * JUDGE_NS // 6)
    assert switch.verify(True, 11 * JUDGE_NS) == []
    assert not switch.leaving_vision(11 * JUDGE_NS)


def test_an_operator_has_a_minute_to_go_back_to_gnss() -> None:
    switch = SourceSwitch(allowed=False)
    assert not switch.leaving_vision(0)
    switch.want(V, 0)
    assert switch.leaving_vision(10**12)
    switch.want(G, 10**12)
    assert switch.leaving_vision(10**12 + HAND_BACK_NS - 1)
    assert not switch.leaving_vision(10**12 + HAND_BACK_NS)


def unused_gnss() -> SourceSwitch:
    """Vision was left for a GNSS that is seen not to be used, while vision is at hand."""
    switch = switched(G)
    switch.confirmed(SourceSwitched(0, V, accepted=True), 0)
    switch.confirmed(SourceSwitched(0, G, accepted=True), 0)
    for n in range(8):
        switch.hear(report(0.2), n * JUDGE_NS // 6)
    assert len(switch.verify(True, JUDGE_NS)) == 1
    return switch


def test_positions_go_on_where_the_way_back_from_an_unused_gnss_is_not_confirmed() -> None:
    switch = unused_gnss()
    assert switch.leaving_vision(JUDGE_NS)
    switch.want(V, JUDGE_NS)
    switch.confirmed(SourceSwitched(0, V, accepted=False), 2 * JUDGE_NS)
    assert switch.leaving_vision(3 * JUDGE_NS)
    switch.confirmed(SourceSwitched(0, V, accepted=True), 10 * JUDGE_NS)
    switch.confirmed(SourceSwitched(0, G, accepted=True, shows_use=False), 20 * JUDGE_NS)
    assert not switch.leaving_vision(20 * JUDGE_NS)


def test_a_source_that_was_not_used_is_ordered_and_judged_anew() -> None:
    switch = unused_gnss()
    later_ns = JUDGE_NS + SHUN_NS
    assert switch.want(G, later_ns) == [SwitchSource(G)]
    switch.confirmed(SourceSwitched(0, G, accepted=True), later_ns)
    assert switch.want(G, later_ns + RETRY_NS) == []
    for n in range(8):
        switch.hear(report(0.2), later_ns + n * JUDGE_NS // 6)
    assert len(switch.verify(True, later_ns + JUDGE_NS)) == 1
