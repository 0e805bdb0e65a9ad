"""The plane that most points lie on."""

import numpy as np

from calib.geometry.ransac_plane import largest_plane_inliers


def test_a_point_that_is_drawn_twice_does_not_put_everything_on_the_plane():
    rng = np.random.default_rng(0)
    wall = np.column_stack([rng.uniform(-3, 3, 90), np.full(90, 4.0), rng.uniform(-1, 1, 90)])
    thing = np.column_stack([rng.uniform(-1, 1, 20), np.full(20, 3.0), rng.uniform(-1, 1, 20)])
    points = np.concatenate([wall, thing])
    for seed in range(20):
        found = largest_plane_inliers(points, 0.02, np.random.default_rng(seed), n_draws=200)
        assert np.array_equal(found, points[:, 1] == 4)


def test_a_plane_that_leans_too_far_is_none():
    floor = np.random.default_rng(1).uniform([-1, -1, 0], [1, 1, 0], (50, 3))
    for normal, count in (((0, 0, 1), 50), ((0, 1, 0), 0)):
        found = largest_plane_inliers(
            floor,
            0.01,
            np.random.default_rng(2),
            n_draws=50,
            normal=np.array(normal, float),
            min_cosine=0.5,
        )
        assert found.sum() == count
