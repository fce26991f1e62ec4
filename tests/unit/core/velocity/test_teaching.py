from __future__ import annotations

from visloc_companion.core.velocity.teaching import AIR_FADES_NS, RARE_NS, SEEN_NS, SETTLED_BY, UNTAUGHT_LOSS, Teaching

S = 1_000_000_000


def test_settled_by_itself_or_by_what_was_recognised() -> None:
    teaching = Teaching()
    assert not teaching.settled
    teaching.velocity_known = True
    assert teaching.settled
    teaching.velocity_known = False
    for k in range(SETTLED_BY):
        assert not teaching.settled
        teaching.recognised(k * S)
    assert teaching.settled
    teaching.restarted()
    assert not teaching.settled


def test_accelerations_drive_while_two_have_told_the_velocity_lately() -> None:
    """1 m/s of the autopilot's is lost at 0.5 m/s^2 in 2 s, times UNTAUGHT_LOSS."""
    teaching = Teaching()
    teaching.velocity_known = True
    teaching.told(10 * S)
    assert not teaching.lasts(10 * S, 1.0, 0.5), "one alone"
    teaching.told(11 * S)
    until_ns = 10 * S + round(UNTAUGHT_LOSS * 2 * S)
    assert teaching.lasts(until_ns, 1.0, 0.5)
    assert not teaching.lasts(until_ns + 1, 1.0, 0.5)
    teaching.told(9 * S)
    assert teaching.lasts(until_ns, 1.0, 0.5), "a late one takes no place from later ones"
    teaching.velocity_known = False
    assert not teaching.lasts(11 * S, 1.0, 0.5), "not settled"


def test_blind_once_nothing_was_recognised_for_a_while() -> None:
    teaching = Teaching()
    teaching.recognised(5 * S)
    teaching.recognised(4 * S)
    teaching.told(6 * S)
    assert not teaching.blind(5 * S + SEEN_NS)
    assert teaching.blind(5 * S + SEEN_NS + 1)


def test_rare_where_two_are_not_recognised_in_a_while() -> None:
    teaching = Teaching()
    for k in range(20):
        teaching.recognised(10 * S + k * S // 4)
        assert not teaching.rare(10 * S + k * S // 4 + S) or k == 0
    last_ns = 10 * S + 19 * S // 4
    for k in range(1, 5):
        teaching.recognised(last_ns + 2 * k * S)
        assert teaching.rare(last_ns + 2 * k * S + S // 4), "one in two seconds"
    teaching.recognised(last_ns + 8 * S + S)
    assert not teaching.rare(last_ns + 8 * S + RARE_NS)
    assert teaching.rare(last_ns + 8 * S + RARE_NS + 1)


def test_what_is_known_is_its_own_again_some_time_after_the_air_told_it() -> None:
    teaching = Teaching()
    assert teaching.own(0)
    teaching.air_told(5 * S)
    teaching.recognised(6 * S)
    assert not teaching.own(5 * S + AIR_FADES_NS)
    assert teaching.own(5 * S + AIR_FADES_NS + 1)


def test_gusts_count_beside_rare_fixes_alone() -> None:
    teaching = Teaching()
    teaching.recognised(20 * S)
    assert teaching.since_air_s(21 * S) == AIR_FADES_NS * 1e-9
    teaching.air_told(21 * S)
    assert teaching.since_air_s(22 * S) == 1.0
    assert teaching.since_air_s(20 * S + SEEN_NS + 1) == 0.0
