from __future__ import annotations

from visloc_companion.adapters.logs.boot_axis import BootAxis, smallest_difference_ns
from visloc_companion.adapters.logs.recording import Losses

S_US, S_MS, S_NS = 1_000_000, 1000, 1_000_000_000
UNIX_US = 1_500_000_000 * S_US


def axis() -> tuple[BootAxis, Losses]:
    losses = Losses()
    return BootAxis(UNIX_US * 1000 - 100 * S_NS, losses), losses


def test_bursts_of_the_ground_station_do_not_shift_time() -> None:
    line, losses = axis()
    walls_s = [0.0, 2.0, 2.001, 2.002, 2.003]
    placed = [line.place(UNIX_US + round(w * S_US), 100_000 + 500 * k) for k, w in enumerate(walls_s)]
    assert [instant.t_ns / S_NS for instant in placed] == [100.0, 100.5, 101.0, 101.5, 102.0]
    assert losses == Losses()


def test_records_without_stamp_lie_at_the_last_stamped_one() -> None:
    line, _ = axis()
    before = line.place(UNIX_US - S_US, None)
    stamped = line.place(UNIX_US, 100_000)
    after = line.place(UNIX_US + S_US, None)
    assert (before.t_ns, stamped.t_ns, after.t_ns) == (99 * S_NS, 100 * S_NS, 100 * S_NS)
    assert line.place(UNIX_US + 60 * S_US, None).t_ns == 155 * S_NS, "a long stretch without stamps is not a standstill"


def test_a_step_of_the_ground_stations_clock_moves_no_record_behind_the_next_stamped_one() -> None:
    """Up to an hour of a flight would be heaped upon the record that was first after it."""
    line, losses = axis()
    line.place(UNIX_US, 100_000)
    stepped = UNIX_US + 600 * S_US
    assert line.place(stepped, None, 100_200).t_ns == 100_200_000_000
    assert line.place(stepped, 100_200, 100_200).t_ns == 100_200_000_000
    assert line.place(stepped + 60 * S_US, None, 150_000).t_ns == 150_000_000_000, (
        "a stretch without stamps is as long as they say"
    )
    assert line.place(stepped + 70 * S_US, None, 3_000).t_ns == 165_200_000_000, "the next one is of another boot"
    assert losses.reboots == 0


def test_what_comes_before_the_first_stamped_record_is_not_behind_it() -> None:
    line, _ = axis()
    assert line.place(UNIX_US + 3 * S_US, None, 100_500).t_ns == 100_500_000_000
    assert line.place(UNIX_US + 3 * S_US, 100_500, 100_500).t_ns == 100_500_000_000
    early, _ = axis()
    assert early.place(UNIX_US - 86_400 * S_US, None, 100_500).t_ns == 0


def test_time_never_goes_back_and_small_disorder_is_no_reboot() -> None:
    line, losses = axis()
    times = [line.place(UNIX_US + k, boot).t_ns for k, boot in enumerate((100_000, 100_400, 100_200, 100_600))]
    assert times == sorted(times)
    assert losses.reboots == 0


def test_a_reboot_continues_the_clock() -> None:
    line, losses = axis()
    line.place(UNIX_US, 100_000)
    again = line.place(UNIX_US + 7 * S_US, 2_000)
    assert again.rebooted
    assert again.t_ns == 107 * S_NS
    assert again.boot_shift_ns == 105 * S_NS
    following = line.place(UNIX_US + 8 * S_US, 3_000)
    assert not following.rebooted
    assert following.t_ns == 108 * S_NS
    assert losses.reboots == 1


def test_what_is_sent_twice_is_no_reboot() -> None:
    line, losses = axis()
    line.place(UNIX_US, 611_982)
    again = line.place(UNIX_US + 222_000, 610_541)
    assert (again.rebooted, again.t_ns, again.boot_shift_ns) == (False, 611_982_000_000, 0)
    assert line.place(UNIX_US + 2 * S_US, 612_300).t_ns == 612_300_000_000
    assert losses.reboots == 0
    line.place(UNIX_US + 3 * S_US, 6_000)
    assert line.place(UNIX_US + 7 * S_US, 3_000).rebooted, "it had the time to start again"


def test_hours_without_records_are_neither_a_reboot_nor_a_step() -> None:
    line, losses = axis()
    line.place(UNIX_US, 100_000)
    line.place(UNIX_US + 7200 * S_US, None)
    after = line.place(UNIX_US + 7200 * S_US, 7_300_000)
    assert (after.rebooted, after.t_ns, after.boot_shift_ns) == (False, 7300 * S_NS, 0)
    assert losses == Losses()
    assert line.place(UNIX_US + 7201 * S_US, 20_000_000).rebooted, "hours on one clock alone"


def test_the_boot_clock_goes_on_where_its_32_bits_overflow() -> None:
    line, losses = axis()
    before = line.place(UNIX_US, 2**32 - 50)
    after = line.place(UNIX_US + 100_000, 50)
    assert after.t_ns - before.t_ns == 100_000_000
    assert (after.rebooted, after.boot_shift_ns) == (False, 2**32 * 1_000_000)
    assert line.place(UNIX_US + 110_000, 2**32 - 40).t_ns == after.t_ns, "disorder"
    assert line.place(UNIX_US + 200_000, 150).t_ns - before.t_ns == 200_000_000
    assert losses == Losses()


def test_steps_of_the_wall_clock_change_nothing() -> None:
    line, losses = axis()
    line.place(UNIX_US, 100_000)
    assert line.place(UNIX_US - 9_000 * S_US, 101_000).t_ns == 101 * S_NS
    assert line.place(UNIX_US - 9_000 * S_US, None).t_ns == 101 * S_NS
    assert line.place(UNIX_US + 10**9 * S_US, None).t_ns == 101 * S_NS
    assert line.place(UNIX_US + 10**9 * S_US + S_US, 102_000).t_ns == 102 * S_NS
    assert losses.clock_steps == 2


def test_the_least_delayed_record_places_utc_and_a_reboot_ends_the_search() -> None:
    stamps = [(UNIX_US + 1_300, 1), (UNIX_US + 6_050, 6), (UNIX_US + 9 * S_US, 9_000), (UNIX_US + 60 * S_US, 1)]
    assert smallest_difference_ns(stamps) == (UNIX_US + 9 * S_US) * 1000 - 9 * S_NS
    assert smallest_difference_ns([]) == 0
