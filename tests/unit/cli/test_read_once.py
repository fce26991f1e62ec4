from __future__ import annotations

import gc

import pytest

from visloc_companion.cli.read_once import read_once


def test_no_garbage_is_looked_for_in_what_is_read_nor_later() -> None:
    with read_once():
        assert not gc.isenabled()
        kept = [[number] for number in range(1000)]
    assert gc.isenabled()
    assert not any(each is kept for each in gc.get_objects())  # what is frozen is not among them


def test_garbage_is_looked_for_again_after_a_flight_that_cannot_be_read() -> None:
    with pytest.raises(ValueError, match="damaged"), read_once():
        raise ValueError("damaged")
    assert gc.isenabled()
