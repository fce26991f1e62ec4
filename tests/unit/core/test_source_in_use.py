"""What the navigator does about a source that the autopilot accepts and does not use."""

from __future__ import annotations

from itertools import pairwise

from tests.unit.core.flown import World, started
from visloc_companion.core.source.switching import SHUN_NS
from visloc_companion.types import EkfSource, Injection, SwitchSource

G, V = EkfSource.GNSS, EkfSource.VISION
UNUSED = "does not use"


def drag(t_s: float) -> tuple[float, float]:
    return (0.0, max(0.0, t_s - 20.0))


def switches(w: World) -> list[tuple[float, EkfSource]]:
    return [(t, c.source) for t, c in w.commands if isinstance(c, SwitchSource)]


def test_a_vision_that_is_not_used_is_left_for_a_gnss_that_has_a_position(world: type[World]) -> None:
    w = started(world, pull_m=drag, unused=lambda t, source: source is V).fly(60)
    asked = [(t, source) for t, source in switches(w) if t > 20]
    (to_vision_s, first), (back_s, second) = asked[:2]
    assert (first, second) == (V, G)
    assert 3.0 <= back_s - to_vision_s <= 4.0
    assert len(w.notices(UNUSED)) == 1
    assert all(source is G for t, source in asked[1:] if t < back_s + SHUN_NS * 1e-9)


def test_without_gnss_the_operator_is_told_and_vision_is_kept(world: type[World]) -> None:
    w = started(world, jammed=lambda t: t > 20, unused=lambda t, source: source is V).fly(40)
    assert len(w.notices(UNUSED)) == 1
    assert [source for t, source in switches(w) if t > 20] == [V]
    assert any(isinstance(c, Injection) for t, c in w.commands if t > 38)


def test_a_gnss_that_is_not_used_is_left_again(world: type[World]) -> None:
    w = started(world, jammed=lambda t: 20 < t < 30, unused=lambda t, source: source is G and t > 30).fly(75)
    asked = [(t, source) for t, source in switches(w) if t > 20]
    assert [source for _, source in asked[:3]] == [V, G, V]
    (back_s, _), (again_s, _) = asked[1:3]
    assert 3.0 <= again_s - back_s <= 4.0
    sent = [t for t, c in w.commands if isinstance(c, Injection) and back_s < t < again_s]
    assert len(sent) >= 29  # positions go on until GNSS is seen to be used


def test_positions_go_on_while_the_order_back_to_vision_is_lost(world: type[World]) -> None:
    """GNSS is trusted and not used; three tries to come back to vision are not answered."""

    faults = {"jammed": lambda t: 20 < t < 30, "unused": lambda t, source: source is G and t > 30, "deaf": lambda t: 52 < t < 55}
    w = started(world, **faults).fly(75)
    asked = [(t, source) for t, source in switches(w) if t > 30]
    assert [source for _, source in asked[:3]] == [G, V, V]
    sent = [t for t, c in w.commands if isinstance(c, Injection) and t > 30]
    assert max(after - before for before, after in pairwise(sent)) < 0.15
    assert sent[-1] > 74.8
    assert asked[2][0] - asked[1][0] < 3.2
    assert w.source is V


def test_injection_ends_when_gnss_is_seen_to_be_used(world: type[World]) -> None:
    w = started(world, jammed=lambda t: 20 < t < 30).fly(75)
    back_s = next(t for t, source in switches(w) if t > 30)
    last_s = max(t for t, c in w.commands if isinstance(c, Injection))
    assert 3.0 <= last_s - back_s <= 4.0
    assert w.notices(UNUSED) == []
