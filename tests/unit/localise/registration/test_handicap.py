from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.handicap import NATS, of_place, of_similarity, of_turn
from visloc_companion.localise.registration.similarity import about

UNIFORM = RegistrationPrior(10.0, 3.0, 0.05, 0.01, 0.01)
GAUSSIAN = replace(UNIFORM, gaussian=True)
CENTRE = np.array([40.0, -20.0, 5.0])


def test_places_of_a_uniform_prior_are_alike():
    assert of_similarity(about(CENTRE, 0.1, 1.03, np.array([30.0, 30.0, 0.0])), CENTRE, UNIFORM) == 0
    assert of_place(np.array([0.0, 30.0]), np.zeros(2), UNIFORM).tolist() == [0, 0]


def test_two_sigma_away_cost_as_much_as_that_makes_it_unlikely():
    assert NATS * of_place(np.array(20.0), np.array(0.0), GAUSSIAN) == pytest.approx(2.0)
    assert NATS * of_turn(-0.1, 1.0, GAUSSIAN) == pytest.approx(2.0)
    assert NATS * of_turn(0.0, np.exp(0.02), GAUSSIAN) == pytest.approx(2.0)
    T = about(CENTRE, 0.1, np.exp(-0.02), np.array([0.0, -20.0, 9.0]))
    assert NATS * of_similarity(T, CENTRE, GAUSSIAN) == pytest.approx(6.0), "height is no part of it"
