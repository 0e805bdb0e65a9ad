"""The noise that draws put on exact keypoints and poses."""

from argparse import Namespace

import numpy as np
import pytest

from benchmarking.fault_matrix.noise_redraw import add_keypoint_noise, add_mocap_noise

RNG_SEED = 4


def make_mocap(n):
    """n poses of each of two bodies at the origin, 100 Hz, one of them a fault."""
    body = np.repeat(["robot", "board"], n)
    fault = np.full(2 * n, "", dtype="U8")
    fault[3] = "jump"
    return {
        "body": body,
        "stamp_ns": np.tile(np.arange(n) * 10_000_000, 2),
        "xyz": np.zeros((2 * n, 3)),
        "quat": np.tile([0.0, 0.0, 0.0, 1.0], (2 * n, 1)),
        "fault": fault,
    }


def room(**changes):
    quiet = {"mcs_noise_m": 0.0, "mcs_noise_deg": 0.0, "mcs_wander_m": 0.0}
    return Namespace(**quiet | {"mcs_wander_deg": [0.0] * 3, "mcs_wander_s": 3.0} | changes)


def test_white_noise_scatters_samples_by_the_stated_mm_and_leaves_faults_alone():
    noise = room(mcs_noise_m=0.00015, mcs_noise_deg=0.02)
    found = add_mocap_noise(make_mocap(4000), noise, np.random.default_rng(RNG_SEED))
    assert found["xyz"].std() == pytest.approx(0.00015, rel=0.03)
    assert np.degrees(2 * found["quat"][:, :3].std()) == pytest.approx(0.02, rel=0.03)
    assert not found["xyz"][3].any()


def test_slow_noise_is_kept_from_sample_to_sample_and_differs_between_bodies():
    noise = room(mcs_wander_m=0.0005)
    xyz = add_mocap_noise(make_mocap(9000), noise, np.random.default_rng(RNG_SEED))["xyz"]
    xyz = np.delete(xyz, 3, axis=0)
    assert xyz.std() == pytest.approx(0.0005, rel=0.25)
    steps = np.diff(xyz[:8000], axis=0)
    # A Gauss-Markov process of 3 s at 100 Hz: sqrt(2 * 0.01 / 3) of its σ from sample to sample.
    assert steps.std() == pytest.approx(0.0005 * np.sqrt(2 * 0.01 / 3), rel=0.05)
    assert not np.allclose(xyz[:100], xyz[9000:9100])


def test_returns_scatter_along_their_beams_and_corners_by_0_3_px_and_rays_not_at_all():
    kinds = np.repeat(["target_surface", "pattern_corner", "board_outline"], 2000)
    xyz = np.tile([0.0, 3.0, 4.0], (6000, 1))
    uv = np.full((6000, 2), 100.0)
    columns = {"kind": kinds, "xyz": xyz, "uv": uv}
    found = add_keypoint_noise(columns, 0.01, np.random.default_rng(RNG_SEED))
    returns = found["xyz"][:2000]
    assert np.linalg.norm(returns, axis=1).std() == pytest.approx(0.01, rel=0.05)
    np.testing.assert_allclose(returns[:, 1] / returns[:, 2], 0.75)
    assert found["uv"][2000:4000].std() == pytest.approx(0.3, rel=0.05)
    np.testing.assert_array_equal(found["xyz"][4000:], xyz[4000:])
