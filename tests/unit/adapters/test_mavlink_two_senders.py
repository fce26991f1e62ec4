"""A second autopilot with the number of the one that is listened to."""

from __future__ import annotations

from tests.unit.adapters.session_talk import talk
from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.two_senders import QUIET_NS, TwoSenders
from visloc_companion.testing.conversation import Conversation
from visloc_companion.testing.fake_autopilot import FakeAutopilot
from visloc_companion.types import Attitude, LinkChanged, RequestMessage

S = 1_000_000_000
ATTITUDE = mav.MAVLINK_MSG_ID_ATTITUDE


def beside(talking: Conversation, other: FakeAutopilot, seconds: float, boot_ns: int) -> list[str]:
    """Both speak in turn; what is warned of."""
    warned: list[str] = []
    for _ in range(round(seconds * 100)):
        talking.run(0.01)
        other.step(talking.now_ns - boot_ns)
        talking.events += talking.session.receive(other.outgoing(), talking.now_ns)
        warned += talking.session.warnings()
    return warned


def test_two_autopilots_of_one_number_are_told_once_with_the_remedy_and_not_listened_to() -> None:
    talking, other = talk(system_id=7), FakeAutopilot(system_id=7)
    other.rates_hz[ATTITUDE] = 20.0
    talking.session.request(RequestMessage(ATTITUDE, 20.0), talking.now_ns)
    talking.run(5.0)
    assert talking.session.warnings() == []
    boot_ns = talking.now_ns - 3600 * S
    warned = beside(talking, other, 60.0, boot_ns)
    assert len(warned) <= 5
    assert warned[-1].startswith("two autopilots with system id 7 are on the link")
    assert "MAV_SYSID" in warned[-1]
    assert "MAV_SYS_ID" in warned[-1]
    told = [text for text in talking.autopilot.texts if "autopilots" in text]
    assert told == ["visloc: 2 autopilots with system id 7, unused"]
    assert len(told[0]) <= 50
    links = [event for event in talking.events if isinstance(event, LinkChanged)]
    assert not links[-1].up
    assert len(links) <= 12
    n_events = len(talking.events)
    beside(talking, other, 5.0, boot_ns)
    assert len(talking.events) == n_events


def test_two_that_were_started_within_seconds_are_told_as_well() -> None:
    """Neither's clock goes back by as much as a restarted one's; positions of both were taken in turn."""
    talking, other = talk(system_id=7), FakeAutopilot(system_id=7)
    other.rates_hz[ATTITUDE] = 20.0
    talking.session.request(RequestMessage(ATTITUDE, 20.0), talking.now_ns)
    talking.run(5.0)
    boot_ns = 2 * S + 7_000_000
    warned = beside(talking, other, 10.0, boot_ns)
    assert warned[-1].startswith("two autopilots with system id 7 are on the link")
    assert [text for text in talking.autopilot.texts if "autopilots" in text] == ["visloc: 2 autopilots with system id 7, unused"]
    n_events = len(talking.events)
    assert beside(talking, other, 30.0, boot_ns) == []
    assert len(talking.events) == n_events
    talking.run(QUIET_NS / S + 3.0)
    assert talking.session.link.up


def attitude(t_boot_ns: int) -> Attitude:
    return Attitude(0, t_boot_ns, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def test_one_that_is_heard_by_two_ways_is_one() -> None:
    """The slower way brings all half a second later, and so what the other has lost."""
    two, told = TwoSenders(), []
    for k in range(1500):
        now_ns = 100 * S + k * S // 50
        if k % 5:
            told.append(two.in_turn(attitude(now_ns), now_ns))
        told.append(two.in_turn(attitude(now_ns - S // 2), now_ns))
    assert not any(told)


def test_messages_that_overtake_each_other_are_of_one() -> None:
    two = TwoSenders()
    assert not any(two.in_turn(attitude((100 + k + (9 if k % 2 else 0)) * S // 50), k * S // 50) for k in range(1500))


def test_one_that_is_alone_again_is_listened_to_and_asked_for_its_streams() -> None:
    talking, other = talk(), FakeAutopilot()
    other.rates_hz[ATTITUDE] = 20.0
    talking.session.request(RequestMessage(ATTITUDE, 20.0), talking.now_ns)
    talking.run(5.0)
    beside(talking, other, 10.0, talking.now_ns - 3600 * S)
    assert not talking.session.link.up
    talking.autopilot.rates_hz.clear()
    events = talking.run(QUIET_NS / S + 3.0)
    assert [event.up for event in events if isinstance(event, LinkChanged)][:1] == [True]
    assert sum(isinstance(event, Attitude) for event in events) > 10
    assert talking.session.link.up


def test_an_autopilot_that_is_restarted_again_and_again_is_one() -> None:
    two = TwoSenders()
    assert not any(two.went_back(k * 6 * S) for k in range(100))
    assert not two.there(600 * S)
