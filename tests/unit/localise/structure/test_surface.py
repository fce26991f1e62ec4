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
