import tracemalloc

import numpy as np

from visloc_companion.localise.structure.surface import Points, upper_surface


def test_a_cell_keeps_its_upper_surface():
    ground = Points(np.array([[0.2, 0.2, 0.0], [1.3, 0.2, 0.1], [0.3, 0.3, 0.1]]), np.full(3, 0.1))
    roof = Points(np.array([[0.4, 0.4, 12.0]]), np.array([0.1]))
    merged = upper_surface([ground, roof], 1.0)
    np.testing.assert_allclose(merged.m, [[0.4, 0.4, 12.0], [1.3, 0.2, 0.1]])


def test_better_heights_weigh_more_and_only_pairs_lower_the_sigma():
    one = Points(np.array([[0.0, 0, 1.0], [0.2, 0, 1.0], [0.4, 0, 1.0]]), np.full(3, 0.1))
    other = Points(np.array([[0.0, 0, 1.3]]), np.array([0.2]))
    merged = upper_surface([one, other], 1.0)
    assert 1.0 < merged.m[0, 2] < 1.05
    assert 0.05 < merged.sigma_m[0] < 0.12
    assert upper_surface([one], 1.0).sigma_m[0] == np.float64(0.1)
    both = upper_surface([Points(one.m, one.sigma_m), Points(one.m, one.sigma_m)], 1.0)
    np.testing.assert_allclose(both.sigma_m, 0.1 / np.sqrt(2))


def test_no_points_stay_none():
    assert len(upper_surface([Points(np.zeros((0, 3)), np.zeros(0))], 1.0).m) == 0


def test_points_far_apart_are_as_alone_and_take_no_memory_for_the_cells_between_them():
    rng = np.random.default_rng(1)
    here = [Points(rng.uniform(0, [8, 8, 3], (200, 3)), rng.uniform(0.1, 0.3, 200)) for _ in range(2)]
    here[0].m[0, :2] = 0.0
    alone = upper_surface(here, 0.5)
    there = [Points(points.m + np.array([2048.0, 2048.0, 0.0]), points.sigma_m) for points in here]
    corner = Points(np.zeros((1, 3)), np.array([0.1]))
    tracemalloc.start()
    both = upper_surface([corner, *there], 0.5)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_allclose(both.m[1:] - [2048.0, 2048.0, 0.0], alone.m, atol=1e-9)
    np.testing.assert_allclose(both.sigma_m[1:], alone.sigma_m)
    assert peak < 1e6, "17 million cells took 0.7 GB"
