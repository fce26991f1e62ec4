"""Dead reckoning of a plane on airspeed, heading and the wind that was learnt while a position was at hand."""

from __future__ import annotations

from visloc_companion.sim.estimators.estimator import InertialFilter

LEARN_TAU_S, PERIOD_S, SIGMA_MPS = 40.0, 0.2, 1.0


class WindDeadReckoning:
    """Learns the wind while aided and gives the filter a velocity while not."""

    def __init__(self) -> None:
        self._wind = [0.0, 0.0]
        self._due_s = 0.0
        self._age = 0

    def step(self, filter_: InertialFilter, air_velocity_ne_mps: tuple[float, float], aided: bool) -> None:
        """Learn (aided) or correct the velocity (not aided), five times a second."""
        if filter_.t_s < self._due_s:
            return
        self._due_s = filter_.t_s + PERIOD_S
        axes = (filter_.north, filter_.east)
        if aided:
            self._age += 1
            share = max(PERIOD_S / LEARN_TAU_S, 1.0 / self._age)
            for i, axis in enumerate(axes):
                self._wind[i] += share * (axis.v_now - air_velocity_ne_mps[i] - self._wind[i])
        else:
            for i, axis in enumerate(axes):
                innovation = air_velocity_ne_mps[i] + self._wind[i] - axis.v_now
                axis.correct_velocity(axis.v + innovation, SIGMA_MPS**2, axis.pull_v)
