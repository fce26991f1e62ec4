"""Bounded queues."""

from __future__ import annotations

import asyncio

import pytest

from visloc_companion.app.mailbox import Mailbox


async def test_newest_wins_drops_the_oldest_and_counts() -> None:
    box: Mailbox[int] = Mailbox(2, newest_wins=True)
    assert [box.put(i) for i in range(4)] == [True, True, False, False]
    assert (len(box), box.taken, box.dropped, box.peak) == (2, 4, 2, 2)
    assert [await box.get(), await box.get()] == [2, 3]


async def test_oldest_wins_refuses_the_newest() -> None:
    box: Mailbox[int] = Mailbox(2, newest_wins=False)
    assert [box.put(i) for i in range(4)] == [True, True, False, False]
    assert [await box.get(), await box.get()] == [0, 1]
    assert (box.taken, box.dropped) == (2, 2)


async def test_get_waits_for_an_entry() -> None:
    box: Mailbox[str] = Mailbox(1, newest_wins=True)
    getter = asyncio.create_task(box.get())
    await asyncio.sleep(0)
    assert not getter.done()
    box.put("a")
    assert await getter == "a"


async def test_clear_forgets_what_waits() -> None:
    box: Mailbox[int] = Mailbox(3, newest_wins=True)
    box.put(1)
    box.put(2)
    assert box.clear() == 2
    getter = asyncio.create_task(box.get())
    await asyncio.sleep(0)
    box.put(3)
    assert await getter == 3


def test_a_mailbox_holds_something() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        Mailbox(0, newest_wins=True)
