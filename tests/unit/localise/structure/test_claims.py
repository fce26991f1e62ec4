import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.localise.registration.base import NotRegistered, Registered
from visloc_companion.localise.structure.claims import MOST_CHI2, judged


def registered(correlation: float, rival: float, prior_chi2: float = 3.0, overlap: float = 1.0) -> Registered:
    evidence = (("correlation", correlation), ("overlap", overlap), ("rival", rival), ("prior_chi2", prior_chi2))
    return Registered(np.eye(4), np.eye(3), 0.01, 0.01, 0.5, evidence)


def probability(*given: float) -> float:
    found = judged(registered(*given), 1.0)
    assert isinstance(found, Registered)
    return found.probability_wrong


def test_a_place_far_ahead_of_the_next_is_believed_and_one_that_is_not_is_refused() -> None:
    assert probability(0.7, 0.3) < 0.001
    found = judged(registered(0.4, 0.39), 0.05)
    assert isinstance(found, NotRegistered)
    assert found.reason is Reason.AMBIGUOUS
    assert dict(found.evidence)["probability_wrong"] > 0.05


def test_lead_overlap_and_nearness_to_the_prior_make_a_place_likelier() -> None:
    assert probability(0.45, 0.35) < probability(0.40, 0.35)
    assert probability(0.45, 0.35, 3.0, 1.0) < probability(0.45, 0.35, 3.0, 0.8)
    assert probability(0.45, 0.35, 3.0) < probability(0.45, 0.35, 12.0)
    assert probability(0.45, 0.35, MOST_CHI2) == pytest.approx(probability(0.45, 0.35, 500.0))
