from __future__ import annotations

import math
from dataclasses import replace

import pytest

from visloc_companion.localise.candidates.ranking import CLEAR_LEAD, GRADIENT_RANK, Standing, lead

FAIR = Standing(score=0.4, coarse_score=0.4, block_z=20.0, prior_chi2=1.0, footprint_px=90.0)


@pytest.mark.parametrize(("name", "worse"), [("score", 0.3), ("block_z", 4.0), ("prior_chi2", 6.0)])
def test_weaker_evidence_ranks_lower(name, worse):
    assert replace(FAIR, **{name: worse}).strength(GRADIENT_RANK) < FAIR.strength(GRADIENT_RANK)


def test_lead_is_the_log_odds_against_all_others_together():
    strengths = [2.0, 1.0, 0.5]
    total = sum(math.exp(s) for s in strengths)
    share = math.exp(2.0) / total
    assert lead(strengths, 0) == pytest.approx(math.log(share / (1 - share)))


def test_lead_without_rivals_is_clear():
    assert lead([3.0], 0) == CLEAR_LEAD
    assert lead([50.0, 1.0], 0) == CLEAR_LEAD
