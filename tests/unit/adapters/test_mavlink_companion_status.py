"""What ground stations read of the companion's state."""

import math

from visloc_companion.adapters.mavlink.companion_status import computer_status, named_values
from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.types import ComputerLoad, Report

MIB = 2**20
LOAD = ComputerLoad(3600.5, (0.256, 1.0), 61.4, 700 * MIB, 4000 * MIB, 9000 * MIB, 30000 * MIB)


def through_the_wire(message):
    return mav.MAVLink(None).decode(bytearray(message.pack(mav.MAVLink(None, 1, 197))))


def test_the_computer_in_the_units_of_the_message():
    seen = through_the_wire(computer_status(LOAD, 5_000_000_000))
    assert (seen.time_usec, seen.uptime) == (5_000_000, 3_600_500)
    assert (seen.cpu_cores[:3], seen.cpu_combined[:2]) == ([26, 100, 255], [63, 255])
    assert (seen.temperature_core[:2], seen.temperature_board) == ([61, 127], 127)
    assert (seen.ram_usage, seen.ram_total) == (700, 4000)
    assert (seen.storage_usage[:2], seen.storage_total[:2], seen.storage_type[:2]) == (
        [9000, 2**32 - 1],
        [30000, 2**32 - 1],
        [0, 2**32 - 1],
    )
    assert seen.link_type == [2**32 - 1] * 6


def test_what_is_not_known_is_marked():
    seen = through_the_wire(computer_status(ComputerLoad(None, (), None, None, None, None, None), 0))
    assert (seen.cpu_cores, seen.cpu_combined) == ([255] * 8, [255] * 10)
    assert (seen.temperature_core[0], seen.ram_usage, seen.storage_total[0], seen.storage_type[0]) == (127, *[2**32 - 1] * 3)


def test_more_cores_than_the_message_has_and_absurd_numbers():
    load = ComputerLoad(1e9, (7.0,) * 20, 1e4, 2**60, 2**60, 2**60, 2**60)
    seen = through_the_wire(computer_status(load, 2**62))
    assert seen.cpu_cores == [100] * 8
    assert (seen.temperature_core[0], seen.ram_usage) == (126, 2**32 - 2)


def test_values_are_floats_or_integers_by_name():
    report = Report(70_000_000, (("VL_PL", 12.5), ("VL_MODE", 2), ("VL_NONE", math.nan), ("TOO_LONG_A_NAME", -(2**40))))
    seen = [through_the_wire(message) for message in named_values(report)]
    assert [message.get_type() for message in seen] == [
        "NAMED_VALUE_FLOAT", "NAMED_VALUE_INT", "NAMED_VALUE_FLOAT", "NAMED_VALUE_INT",
    ]  # fmt: skip
    assert [message.name for message in seen] == ["VL_PL", "VL_MODE", "VL_NONE", "TOO_LONG_A"]
    assert (seen[0].value, seen[1].value, seen[3].value) == (12.5, 2, -(2**31))
    assert math.isnan(seen[2].value)
    assert {message.time_boot_ms for message in seen} == {70}
