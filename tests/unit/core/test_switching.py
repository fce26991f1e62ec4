from __future__ import annotations

from visloc_companion.core.switching import RETRY_NS, RETRY_REFUSED_NS, SourceSwitch
from visloc_companion.types import EkfSource, Notice, SourceSwitched, SwitchSource

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


def test_where_it_is_not_allowed_the_operator_is_asked_once() -> None:
    switch = SourceSwitch(allowed=False)
    assert switch.want(G, 0) == []
    (notice,) = switch.want(V, 1)
    assert isinstance(notice, Notice)
    assert notice.to_operator
    assert len(notice.text) <= 50
    assert switch.want(V, 10**12) == []
    assert len(switch.want(G, 10**12)) == 1
