from __future__ import annotations

import itertools
from dataclasses import replace

import pytest

from visloc_companion.core.modes import TRANSITIONS, Situation, next_mode
from visloc_companion.types import Mode

W, S, A, D, L = Mode.WAITING, Mode.SHADOW, Mode.AIDING, Mode.DEAD_RECKONING, Mode.LOST


def situation(ready: bool = True, due: bool = False, fix: bool = False, sigma_m: float = 1.0) -> Situation:
    return Situation(ready, due, fix, sigma_m, 60.0)


EXPECTED = [
    (W, situation(ready=False), W),
    (W, situation(), S),
    (W, situation(due=True, fix=True), S),
    (S, situation(), S),
    (S, situation(ready=False), W),
    (S, situation(sigma_m=61), L),
    (S, situation(due=True, fix=True), A),
    (S, situation(due=True), D),
    (S, situation(fix=True), S),
    (A, situation(due=True, fix=True), A),
    (A, situation(ready=False, due=True, fix=True), W),
    (A, situation(due=True, fix=True, sigma_m=61), L),
    (A, situation(fix=True), S),
    (A, situation(due=True), D),
    (D, situation(due=True), D),
    (D, situation(ready=False), W),
    (D, situation(due=True, sigma_m=61), L),
    (D, situation(), S),
    (D, situation(due=True, fix=True), A),
    (L, situation(ready=False), W),
    (L, situation(due=True, fix=True, sigma_m=40), L),
    (L, situation(sigma_m=29), S),
    (L, situation(due=True, fix=True, sigma_m=29), A),
    (L, situation(due=True, sigma_m=29), D),
    (L, situation(due=True, sigma_m=61), L),
    (L, replace(situation(due=True, fix=True, sigma_m=41), shared_m=40), A),
    (L, replace(situation(due=True, fix=True, sigma_m=52), shared_m=40), L),
    (L, replace(situation(due=True, fix=True, sigma_m=61), shared_m=60.5), L),
    (S, replace(situation(sigma_m=61), landed=True), S),
    (L, replace(situation(sigma_m=61), landed=True), S),
]


@pytest.mark.parametrize(("mode", "when", "then"), EXPECTED)
def test_each_transition(mode: Mode, when: Situation, then: Mode) -> None:
    assert next_mode(mode, when) is then


def test_every_row_of_the_table_is_expected_here() -> None:
    assert {(a, b) for a, b, _ in TRANSITIONS} == {(a, b) for a, _, b in EXPECTED if a is not b}


def test_injecting_modes_are_never_entered_unsure_or_unready() -> None:
    for mode, ready, due, fix, sigma in itertools.product(Mode, *[(False, True)] * 3, (1.0, 45.0, 100.0)):
        then = next_mode(mode, situation(ready, due, fix, sigma))
        if then in (A, D):
            assert ready
            assert due
            assert sigma <= 60
        if then is not mode and not ready:
            assert then is W


def test_a_landing_does_not_go_on_without_fixes_for_long() -> None:
    blind = Situation(ready=True, due=True, recent_fix=False, sigma_m=1.0, lost_sigma_m=60.0, stranded=True)
    assert next_mode(Mode.DEAD_RECKONING, blind) is Mode.LOST
    assert next_mode(Mode.LOST, blind) is Mode.LOST
    assert next_mode(Mode.SHADOW, blind) is Mode.LOST
    assert next_mode(Mode.SHADOW, replace(blind, recent_fix=True)) is Mode.AIDING
    assert next_mode(Mode.SHADOW, replace(blind, due=False)) is Mode.SHADOW
    assert next_mode(Mode.LOST, replace(blind, recent_fix=True)) is Mode.AIDING
    assert next_mode(Mode.LOST, replace(blind, stranded=False)) is Mode.DEAD_RECKONING
