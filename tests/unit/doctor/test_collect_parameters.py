"""Reading parameters over a bad line, and counting what it loses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.doctor.collect.numbers import Numbers
from visloc_companion.doctor.collect.parameters import Parameters
from visloc_companion.types import AutopilotKind


class Line:
    """A conversation in no time: the list comes to a third, and of what is asked for one in `every` is answered."""

    def __init__(self, count: int, every: int) -> None:
        self.system_id, self.kind, self.listeners = 1, AutopilotKind.ARDUPILOT, list[Callable[[Message], None]]()
        self._count, self._every, self.asked, self.waits = count, every, 0, 0

    def send(self, message: Message) -> None:
        if message.get_type() == "PARAM_REQUEST_LIST":
            for index in range(0, self._count, 3):
                self._answer(index)
        else:
            self.asked += 1
            if self._every and self.asked % self._every == 0:
                self._answer(message.param_index)

    def _answer(self, index: int) -> None:
        kind = mav.MAV_PARAM_TYPE_REAL32
        for listener in self.listeners:
            listener(mav.MAVLink_param_value_message(f"P{index}".encode(), float(index), kind, self._count, index))

    async def until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        del timeout_s
        self.waits += 1
        return condition()


async def test_a_bad_line_gives_all_parameters_as_long_as_some_come() -> None:
    """1300 parameters, of which two thirds are lost at first and half of every question."""
    line: Any = Line(1300, 2)
    parameters = Parameters(line)
    await parameters.read_all(20.0)
    assert (len(parameters.values), parameters.expected) == (1300, 1300)


async def test_a_line_that_says_no_more_is_given_up() -> None:
    line: Any = Line(1300, 0)
    parameters = Parameters(line)
    await parameters.read_all(20.0)
    assert len(parameters.values) == 434
    assert line.waits < 10


async def test_px4s_checksum_is_no_parameter() -> None:
    """It would hide that one was lost."""
    line: Any = Line(4, 1)
    parameters = Parameters(line)
    for listener in line.listeners:
        listener(mav.MAVLink_param_value_message(b"_HASH_CHECK", 1.0, mav.MAV_PARAM_TYPE_UINT32, 4, 65535))
    assert parameters.values == {}


@pytest.mark.parametrize(
    ("numbers", "unknown", "lost"),
    [
        ([254, 255, 0, 1], 0, 0.0),
        ([10, 12, 13, 14], 0, 0.2),
        ([10, 12, 13, 14], 1, 0.0),
        ([10, 12, 11, 13], 0, 0.0),
        ([250, 4], 0, 9 / 11),
    ],
)
def test_gaps_in_the_numbers_are_losses(numbers: list[int], unknown: int, lost: float) -> None:
    """Not what was overtaken, nor what was of another kind than is read."""
    counted = Numbers()
    for number in numbers:
        counted.take(number)
    assert counted.lost_share(unknown) == pytest.approx(lost)
