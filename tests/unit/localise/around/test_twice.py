"""Fixes that are computed twice: agreement passes, a flipped bit does not, a computer that errs again and again is refused."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from visloc_companion.errors import Reason
from visloc_companion.geo.se3 import quat_from_euler, quat_multiply
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.localise.around.twice import OFF_AFTER, CheckedTwice, difference
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import Fix, FrameRef, GeoPoint, Image, LocaliseRequest, NoFix, PosePrior

PLACE, LEVEL = GeoPoint(47.0, 8.0, 600.0), (1.0, 0.0, 0.0, 0.0)
COV = ((1.0, 0.0), (0.0, 1.0))
PIXELS = cast("Image", np.zeros((4, 4), np.uint8))
MAP = cast("ReferenceMap", None)


def request(n: int) -> LocaliseRequest:
    return LocaliseRequest(n, FrameRef(n, n, n, 0, 4, 4, 1), PosePrior(PLACE, LEVEL, COV, 1.0, 0.1, 0.1), 1)


def fix_of(asked: LocaliseRequest, place: GeoPoint = PLACE) -> Fix:
    frame = asked.frame
    return Fix(0, frame.t_ns, asked.request_id, frame.frame_id, "deep", place, LEVEL, COV, 1.0, 0.01, 1e-3, 100.0)


@dataclass
class Computer:
    """A localiser that answers with the prior's place; `flips` names the requests in which one bit of the latitude is wrong."""

    method: str = "deep"
    flips: set[int] = field(default_factory=set)
    bit: int = 36
    finds: bool = True
    asked: list[int] = field(default_factory=list)

    def localise(self, asked: LocaliseRequest, pixels: Image, ref: ReferenceMap) -> Fix | NoFix:
        self.asked.append(asked.request_id)
        if not self.finds:
            return NoFix(0, asked.frame.t_ns, asked.request_id, asked.frame.frame_id, self.method, Reason.NO_MATCH, 100.0)
        place = asked.prior.place
        if asked.request_id in self.flips:
            (bits,) = struct.unpack("<Q", struct.pack("<d", place.lat_deg))
            place = replace(place, lat_deg=struct.unpack("<d", struct.pack("<Q", bits ^ (1 << self.bit)))[0])
        return replace(fix_of(asked, place), method=self.method)


def answers(first: Computer, second: Computer, n: int, every: int = 4) -> list[Fix | NoFix]:
    checked = CheckedTwice(first, second, every)
    return [checked.localise(request(k), PIXELS, MAP) for k in range(1, n + 1)]


def test_every_nth_fix_is_computed_twice_and_the_time_says_so() -> None:
    first, second = Computer(), Computer()
    given_ = answers(first, second, 12)
    assert second.asked == [4, 8, 12]
    assert [answer.elapsed_ms for answer in given_] == [100.0, 100.0, 100.0, 200.0] * 3
    assert all(isinstance(answer, Fix) for answer in given_)
    assert CheckedTwice(first, second, 4).method == "deep"


def test_a_flipped_bit_gives_no_fix_and_the_next_ones_are_checked_too() -> None:
    first, second = Computer(flips={4}), Computer()
    given_ = answers(first, second, 9)
    wrong = given_[3]
    assert isinstance(wrong, NoFix)
    assert wrong.reason is Reason.COMPUTATION_DIFFERS
    assert "m apart" in wrong.detail
    assert (wrong.request_id, wrong.frame_id, wrong.elapsed_ms) == (4, 4, 200.0)
    assert second.asked == [4, 5, 9]  # the one after it at once, then as before
    assert sum(isinstance(answer, Fix) for answer in given_) == 8


def test_a_computer_that_errs_again_and_again_is_switched_off_for_good() -> None:
    first = Computer(flips=set(range(4, 4 + OFF_AFTER)))
    given_ = answers(first, Computer(), 20)
    reasons = [answer.reason for answer in given_ if isinstance(answer, NoFix)]
    assert reasons[: OFF_AFTER - 1] == [Reason.COMPUTATION_DIFFERS] * (OFF_AFTER - 1)
    assert set(reasons[OFF_AFTER - 1 :]) == {Reason.SWITCHED_OFF}
    assert len(reasons) == 20 - 3
    assert first.asked == list(range(1, 4 + OFF_AFTER)), "nothing is computed any more"


def test_who_of_the_two_errs_does_not_matter() -> None:
    assert isinstance(answers(Computer(), Computer(flips={4}), 4)[3], NoFix)


def test_only_fixes_of_the_checked_method_are_computed_twice() -> None:
    second = Computer()
    answers(Computer(finds=False), second, 12)
    answers(Computer(method="structure"), second, 12)
    assert second.asked == []


def test_a_second_computation_without_a_fix_differs() -> None:
    refused = answers(Computer(), Computer(finds=False), 4)[3]
    assert isinstance(refused, NoFix)
    assert refused.detail == "a fix, and then none: no_match"


@pytest.mark.parametrize(
    ("ned_m", "yaw_rad", "differs"),
    [
        ((0.0, 0.0, 0.0), 0.0, None),
        ((0.1, 0.1, -0.1), 0.001, None),
        ((0.3, 0.0, 0.0), 0.0, "0.3 m apart"),
        ((0.0, 0.0, 0.3), 0.0, "heights 0.3 m apart"),
        ((0.0, 0.0, 0.0), 0.01, "attitudes 0.573 degrees apart"),
    ],
)
def test_what_counts_as_a_difference(ned_m: tuple[float, float, float], yaw_rad: float, differs: str | None) -> None:
    found = fix_of(request(1))
    turned = quat_multiply(LEVEL, quat_from_euler(0.0, 0.0, yaw_rad))
    again = replace(found, place=geo_from_ned(ned_m, PLACE), q_ned_frd=turned)
    assert difference(found, again) == differs


@given(st.integers(0, 63))
def test_any_bit_of_a_latitude_is_noticed_or_is_less_than_the_tolerance(bit: int) -> None:
    """What passes is within 5 cm and a fifth of a sigma."""
    first = Computer(flips={1}, bit=bit)
    answer = answers(first, Computer(), 1, every=1)[0]
    wrong = Computer(flips={1}, bit=bit).localise(request(1), PIXELS, MAP)
    assert isinstance(wrong, Fix)
    off_m = abs(wrong.place.lat_deg - PLACE.lat_deg) * 111_000
    assert isinstance(answer, NoFix) == (not off_m < 0.25)
