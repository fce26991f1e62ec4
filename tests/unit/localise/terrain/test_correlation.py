"""Errors that are alike nearby: what they leave of a sum, against errors drawn."""

from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.localise.terrain.correlation import LENGTHS_M, MOST, correlated_outer


def lattice(n: int, spacing_m: float) -> np.ndarray:
    row, col = np.mgrid[0:n, 0:n]
    return np.column_stack([row.ravel(), col.ravel()]) * spacing_m


def test_it_is_the_variance_of_sums_over_errors_drawn() -> None:
    ne, rng = lattice(12, 50.0), np.random.default_rng(1)
    weights = np.column_stack([np.ones(len(ne)), np.sin(ne[:, 0] / 200.0)])
    squared = np.square(ne[:, None] - ne[None]).sum(-1)
    kernel = sum(np.exp(-squared / length**2) for length in LENGTHS_M) / 2 + 1e-9 * np.eye(len(ne))
    drawn = np.linalg.cholesky(kernel) @ rng.standard_normal((len(ne), 4000))
    sampled = np.cov(weights.T @ drawn)
    assert np.allclose(correlated_outer(weights, ne), sampled, rtol=0.1, atol=0.05 * sampled.max())


def test_far_apart_every_error_counts_alone_and_close_by_they_count_as_one() -> None:
    ones = np.ones((36, 1))
    assert correlated_outer(ones, lattice(6, 5000.0))[0, 0] == pytest.approx(36.0)
    assert correlated_outer(ones, lattice(6, 0.1))[0, 0] == pytest.approx(36.0**2, rel=1e-3)


def test_many_are_thinned_to_the_same_answer() -> None:
    ne = lattice(60, 10.0)
    assert len(ne) > 4 * MOST
    some = correlated_outer(np.ones((len(ne), 1)), ne)[0, 0]
    every = np.exp(-np.square(ne[::7, None] - ne[None, ::7]).sum(-1) / np.array(LENGTHS_M)[:, None, None] ** 2).mean(0).sum() * 49
    assert some == pytest.approx(every, rel=0.05)
