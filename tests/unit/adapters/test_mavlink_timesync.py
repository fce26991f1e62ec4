"""TIMESYNC beside boot times of 32 bits."""

from __future__ import annotations

from visloc_companion.adapters.mavlink.codec import decode
from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.adapters.mavlink.timesync import Timesync
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.types import Attitude, Gnss, Imu

MS, S = 1_000_000, 1_000_000_000
PERIOD_NS = 2**32 * MS


def boot_ns(message: Message, t_rx_ns: int) -> int:
    (event,) = decode(message, t_rx_ns)
    assert isinstance(event, Attitude | Imu | Gnss)
    return event.t_boot_ns


def test_an_autopilot_that_is_up_for_fifty_days_steps_once() -> None:
    clock, timesync, steps = ClockOffset(), Timesync(), []
    for k in range(1000):
        t_ns = 100 * S + k * 20 * MS
        up_ns = PERIOD_NS - 10 * S + k * 20 * MS
        attitude_ns = boot_ns(mav.MAVLink_attitude_message(up_ns // MS % 2**32, *[0.0] * 6), t_ns)
        assert boot_ns(mav.MAVLink_highres_imu_message(up_ns // 1000, 0.0, 0.0, -9.8, *[0.0] * 10, 0), t_ns) == attitude_ns
        assert boot_ns(mav.MAVLink_gps_raw_int_message(up_ns // 1000, 3, 1, 1, 0, 0, 0, 0, 0, 9), t_ns) == attitude_ns
        steps.append(clock.on_arrival(t_ns, attitude_ns))
        if k % 50 == 0:
            asked = timesync.ask(t_ns)
            _, sample = timesync.take(mav.MAVLink_timesync_message(up_ns + MS, asked.ts1), t_ns + 2 * MS)
            assert sample is not None
            steps.append(clock.on_exchange(sample))
    assert len([step for step in steps if step is not None]) == 1
