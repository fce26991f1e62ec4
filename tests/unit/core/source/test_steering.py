"""When a vehicle that is too low for fixes gets no positions any more."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

from visloc_companion.core.gnss import GnssMonitor
from visloc_companion.core.settings import CoreSettings
from visloc_companion.core.source.steering import LOW_VELOCITY_SIGMA_MPS, Steering
from visloc_companion.core.source.switching import SourceSwitch
from visloc_companion.types import GnssVerdict, Mode, NavState, Verdict

TICK_S = 0.1
WINDOW_S = CoreSettings().navigator.low_dead_reckoning_s


class Landing:
    """GNSS is denied, a fix came at 0 s, and none since; a Tick every 0.1 s."""

    def __init__(self) -> None:
        monitor = SimpleNamespace(verdict=GnssVerdict(Verdict.DENIED, 0, (), ()))
        self.monitor = monitor
        self.steering = Steering(CoreSettings(), cast(GnssMonitor, monitor), SourceSwitch(allowed=False))
        self.t_s = 0.0
        self.steering.taken(0, anew=True)

    def until(
        self, end_s: float, sigma_v_mps: float | None, *, low: bool = True, armed: bool = True, sigma_m: float = 2.0
    ) -> Mode:
        cov_m2 = ((sigma_m**2, 0.0), (0.0, sigma_m**2))
        variance = None if sigma_v_mps is None else ((sigma_v_mps**2, 0.0), (0.0, 0.04))
        while self.t_s < end_s:
            self.t_s += TICK_S
            now_ns = round(self.t_s * 1e9)
            state = NavState(now_ns, (0.0, 0.0, -10.0), (1.0, 0.0, 0.5), cov_m2, 1.0, 0.0, variance)
            self.steering.change_mode(state, True, low, armed, now_ns)
        return self.steering.mode


def test_a_sure_velocity_carries_on_for_the_whole_window() -> None:
    landing = Landing()
    assert landing.until(WINDOW_S - 0.5, LOW_VELOCITY_SIGMA_MPS - 0.1) is Mode.DEAD_RECKONING
    assert landing.until(WINDOW_S + 0.5, LOW_VELOCITY_SIGMA_MPS - 0.1) is Mode.LOST


def test_a_velocity_that_may_be_far_off_is_not_held_down_to_the_ground() -> None:
    landing = Landing()
    assert landing.until(3.0, 0.5) is Mode.DEAD_RECKONING
    assert landing.until(3.5, LOW_VELOCITY_SIGMA_MPS + 0.1) is Mode.LOST


def test_a_smaller_claim_without_a_fix_changes_nothing() -> None:
    """The claim falls when the autopilot's own velocity takes over, which rests on what it was sent."""
    landing = Landing()
    landing.until(3.5, LOW_VELOCITY_SIGMA_MPS + 0.1)
    assert landing.until(6.0, 0.5) is Mode.LOST
    landing.steering.taken(round(landing.t_s * 1e9), anew=False)
    assert landing.until(7.0, 0.5) is Mode.AIDING


def test_a_vehicle_that_has_landed_is_not_lost_and_may_be_carried_away() -> None:
    landing = Landing()
    assert landing.until(WINDOW_S + 1.0, 0.5) is Mode.LOST
    assert landing.until(WINDOW_S + 2.0, 0.5, armed=False) is Mode.SHADOW
    assert not landing.steering.believed
    assert landing.until(WINDOW_S + 3.0, 0.5) is Mode.LOST, "a take-off without positions"
    assert Landing().until(WINDOW_S + 1.0, 0.5, armed=False) is Mode.SHADOW


def test_a_landed_vehicle_is_not_lost_however_long_it_stands() -> None:
    landing = Landing()
    assert landing.until(WINDOW_S + 1.0, 0.5, sigma_m=70.0) is Mode.LOST
    assert landing.until(WINDOW_S + 2.0, 0.5, armed=False, sigma_m=70.0) is Mode.SHADOW
    assert landing.until(WINDOW_S + 60.0, 0.5, armed=False, sigma_m=400.0) is Mode.SHADOW
    assert landing.until(WINDOW_S + 61.0, 0.5, sigma_m=400.0) is Mode.LOST, "a take-off from nobody knows where"


def test_higher_up_it_is_carried_on() -> None:
    landing = Landing()
    assert landing.until(WINDOW_S + 5.0, LOW_VELOCITY_SIGMA_MPS + 0.5, low=False) is Mode.DEAD_RECKONING


def test_a_velocity_without_a_covariance_is_judged_by_the_window_alone() -> None:
    assert Landing().until(WINDOW_S - 0.5, None) is Mode.DEAD_RECKONING


def put_down() -> Landing:
    """Landed, disarmed and armed again, by which the window is over."""
    landing = Landing()
    landing.until(4.0, 0.5, armed=False)
    landing.until(WINDOW_S + 1.0, 0.5)
    return landing


def test_a_vehicle_that_was_put_down_gets_positions_from_a_fix_on_and_not_from_a_height_on() -> None:
    landing = put_down()
    assert landing.until(WINDOW_S + 2.0, 0.5, low=False) is Mode.LOST, "it may have been carried before it took off"
    landing.steering.taken(round(landing.t_s * 1e9), anew=False)
    assert landing.until(WINDOW_S + 3.0, 0.5, low=False) is Mode.AIDING
    assert landing.until(2 * WINDOW_S + 5.0, 0.5, low=False) is Mode.DEAD_RECKONING


def test_a_vehicle_that_flew_low_is_carried_on_higher_up() -> None:
    landing = Landing()
    assert landing.until(WINDOW_S + 1.0, 0.5) is Mode.LOST
    assert landing.until(WINDOW_S + 2.0, 0.5, low=False) is Mode.DEAD_RECKONING


def test_a_gnss_that_is_trusted_tells_where_it_took_off() -> None:
    landing = put_down()
    landing.monitor.verdict = GnssVerdict(Verdict.OK, 0, (), ())
    assert landing.until(WINDOW_S + 2.0, 0.5, low=False) is Mode.SHADOW
    landing.monitor.verdict = GnssVerdict(Verdict.DENIED, 0, (), ())
    assert landing.until(WINDOW_S + 3.0, 0.5, low=False) is Mode.DEAD_RECKONING


def test_where_a_vehicle_was_put_down_the_operator_may_say_another_place() -> None:
    landing = Landing()
    landing.until(2.0, 0.5, armed=False)
    assert not landing.steering.believed
    landing.until(3.0, 0.5)
    assert not landing.steering.believed
    landing.steering.taken(round(landing.t_s * 1e9), anew=False)
    assert landing.steering.believed
