from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.localise.warp import MIN_BLOCKS, GroundErrors, warp_covariance

AXIS = np.linspace(-50.0, 50.0, 6)
AT = np.stack(np.meshgrid(AXIS, AXIS), -1).reshape(-1, 2)
N = len(AT)
MEAN = np.zeros((6, N, 2))
MEAN[0, :, 0] = MEAN[1, :, 1] = 1 / N
"""A pose whose position follows the mean displacement of the blocks."""


def left_over(apart_m):
    """Displacements (N, 2) less the shift, turn and scale that explain most of them."""
    z, at = apart_m @ np.array([1, 1j]), AT @ np.array([1, 1j])
    model = np.column_stack([np.ones_like(at), at])
    rest = z - model @ np.linalg.lstsq(model, z, rcond=None)[0]
    return np.column_stack([rest.real, rest.imag])


def claimed(apart_m, gsd_m=1.0, weights=None):
    return warp_covariance(GroundErrors(AT, left_over(apart_m), MEAN), np.ones(N) if weights is None else weights, gsd_m)


def field(rng, sigma_m):
    """A smooth random field over the blocks, correlated over 100 m."""
    apart = np.linalg.norm(AT[:, None] - AT, axis=-1)
    kernel = np.exp(-0.5 * (apart / 120.0) ** 2) + 1e-9 * np.eye(N)
    return sigma_m * np.linalg.cholesky(kernel) @ rng.normal(size=(N, 2))


@pytest.mark.parametrize("noise_m", [0.05, 0.1])
def test_claim_is_what_a_smooth_field_moves_the_pose_by(noise_m):
    """Of a field that stands out of the noise; in more noise the prior, that most pairs are bent by little, claims less."""
    rng = np.random.default_rng(3)
    moved, claims = [], []
    for _ in range(60):
        bent = field(rng, 1.0)
        moved.append(bent.mean(0) @ bent.mean(0) / 2)
        claims.append(claimed(bent + rng.normal(0, noise_m, (N, 2)))[0, 0])
    assert 0.4 < np.mean(claims) / np.mean(moved) < 1.6


def test_noise_of_each_block_is_hardly_taken_for_a_bend():
    rng = np.random.default_rng(4)
    of_noise = np.mean([claimed(rng.normal(0, 0.5, (N, 2)))[0, 0] for _ in range(30)])
    of_field = np.mean([claimed(field(rng, 0.5) + rng.normal(0, 0.1, (N, 2)))[0, 0] for _ in range(30)])
    assert of_noise < 0.3 * of_field


def test_a_shear_is_seen_and_a_turn_is_not():
    shear = np.column_stack([0.01 * AT[:, 1], np.zeros(N)])
    turn = np.column_stack([-0.01 * AT[:, 1], 0.01 * AT[:, 0]])
    calm = np.random.default_rng(5).normal(0, 0.1, (N, 2))
    assert claimed(calm + turn)[0, 0] == pytest.approx(claimed(calm)[0, 0], rel=1e-6)
    assert claimed(calm + shear)[0, 0] > 4 * claimed(calm)[0, 0]


def test_claim_follows_the_resolution():
    bent = field(np.random.default_rng(6), 0.5)
    np.testing.assert_allclose(claimed(5 * bent, 5.0), 25 * claimed(bent, 1.0), rtol=1e-9)


def test_blocks_without_weight_say_nothing():
    rng = np.random.default_rng(7)
    calm = rng.normal(0, 0.05, (N, 2))
    torn, weights = calm.copy(), np.ones(N)
    torn[:6] += (8.0, 0.0)
    weights[:6] = 1e-6
    rest = GroundErrors(AT, torn, MEAN)
    assert warp_covariance(rest, weights, 1.0)[0, 0] < 4 * warp_covariance(GroundErrors(AT, calm, MEAN), weights, 1.0)[0, 0]


def test_few_blocks_claim_nothing():
    few = slice(MIN_BLOCKS - 1)
    errors = GroundErrors(AT[few], np.ones((MIN_BLOCKS - 1, 2)), MEAN[:, few])
    assert not warp_covariance(errors, np.ones(MIN_BLOCKS - 1), 1.0).any()
