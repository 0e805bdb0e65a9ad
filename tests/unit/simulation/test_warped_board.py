"""Boards that are bowed and twisted, as rays meet them."""

from dataclasses import replace

import numpy as np
import pytest

from calib.targets.target_shapes import target_from_config
from simulation.world.ray_surfaces import intersect_board
from simulation.world.room_scene import SIMULATED_TARGETS, build_scene

WARP = (0.005, -0.003, 0.002)


def board_params(warp):
    return next(s for s in build_scene(["board"], board_warp=warp).surfaces if s.name == "board")


def rays(n=200):
    """Origins and directions (3, n) from 2 to 3 m before the board, to points of it."""
    rng = np.random.default_rng(0)
    o = np.stack([*rng.uniform(-1, 1, (2, n)), rng.uniform(2, 3, n)])
    hit = np.stack([*rng.uniform(-0.3, 0.3, (2, n)), np.zeros(n)])
    return o, hit - o


@pytest.mark.parametrize("warp", [(0.005, 0.0, 0.0), (0.0, 0.0, 0.002), WARP])
def test_rays_meet_the_warped_face_to_a_nanometre(warp):
    o, d = rays()
    t, face = intersect_board(board_params(warp).shape_params, o, d)
    x, y, z = o + t * d
    u, v = x / 0.7071, y / 0.7071
    expected = warp[0] * (1 - u * u) + warp[1] * (1 - v * v) + warp[2] * u * v
    np.testing.assert_allclose(z, expected, atol=1e-9)
    assert (face > 0).all()


def test_the_simulated_face_is_the_one_that_the_estimation_fits():
    o, d = rays()
    t, _ = intersect_board(board_params(WARP).shape_params, o, d)
    board = target_from_config(SIMULATED_TARGETS["board"] | {"thickness_m": 0.0})
    flat_xy = np.column_stack([*(o + t * d)[:2], np.zeros(len(t))])
    np.testing.assert_allclose(
        replace(board, warp=WARP).lift(flat_xy)[:, 2], (o + t * d)[2], atol=1e-9
    )


def test_from_behind_a_warped_board_shows_its_back():
    o, d = rays()
    behind = np.diag([1.0, 1.0, -1.0])
    _, face = intersect_board(board_params(WARP).shape_params, behind @ o, behind @ d)
    assert (face == 0).all()


def test_a_flat_board_is_met_where_its_plane_is():
    o, d = rays()
    t, _ = intersect_board(board_params((0.0, 0.0, 0.0)).shape_params, o, d)
    np.testing.assert_array_equal(t, -o[2] / d[2])
