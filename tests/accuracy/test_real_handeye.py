"""A real recording: Vicon poses of a body with a board, and a camera's poses of the board.

The poses stand as the pixels of a pattern that has them. Its corners lie 0.5 m from its middle,
where 5 mm weigh as much as the 0.5° by which the camera's poses err: turning alone tells 16 ms,
places alone 21 ms.
"""

import numpy as np
import pytest

from calib.estimation.corrections.clock_offset import TimeOffsetCorrection
from calib.estimation.estimation_problem import MeasurementGroup, Setup
from calib.estimation.moving_view_poses import TargetPath, make_moving_placement
from calib.estimation.solver import estimate_poses
from calib.geometry.se3 import invert_pose, mean_pose, pose_from_xyz_quat, transform_points
from calib.geometry.units import NS_PER_S
from calib.initial_guess.hand_eye import solve_mount
from calib.initial_guess.pose_voting import PoseTolerance
from calib.mocap.body_trajectory import Trajectory
from calib.mocap.moving_pose_fit import fit_local_motion
from calib.sensors.camera.camera_model import CameraModel
from calib.targets.board import Board
from calib.targets.patterns.checkerboard import Checkerboard
from calib.views import moving_view_selection
from helpers.real_data import find_shared_data
from helpers.synthetic_setup import ASSOCIATE_SETTINGS

pytestmark = pytest.mark.real

EDGE = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])
BOARD = Board(EDGE, 0.0, Checkerboard(4, 4, 0.25, (-0.375, -0.375)))
CAMERA = CameraModel("radtan", (200.0, 200.0, 319.5, 239.5, 0.0, 0.0, 0.0, 0.0), (640, 480))
MOCAP = {
    "pose_sigma": {"xyz_m": 5e-5, "rpy_deg": 0.01},
    "pose_bias_sigma": {"xyz_m": 1e-4, "rpy_deg": 0.01},
}


def poses(name):
    """Stamps (n,), ns, and poses (n, 4, 4) of a file, without stamps that do not increase."""
    rows = np.loadtxt(find_shared_data(f"mcs/{name}"), delimiter=",")
    t = np.round(rows[:, 0] * NS_PER_S).astype(np.int64)
    keep = np.append(True, t[1:] > np.maximum.accumulate(t)[:-1])
    return t[keep], pose_from_xyz_quat(rows[keep, 1:4], rows[keep, 4:])


@pytest.fixture(scope="module")
def setup():
    """A static camera and views of the moving body: its poses of the board as pixels of corners."""
    t, T_world_body = poses("asl_vicon.csv")
    path = Trajectory(t, T_world_body, round(0.05 * NS_PER_S))
    stamps, T_camera_board = poses("asl_camera.csv")
    fits = [fit_local_motion(path, int(s)) for s in stamps]
    seen = [i for i, f in enumerate(fits) if f is not None]
    some = seen[:: len(seen) // 20]
    mount = solve_mount(
        [(fits[i].T_robot_body, [T_camera_board[i]]) for i in some], None, PoseTolerance(0.1, 0.1)
    )
    assert mount.status.ok
    T_world_camera = mean_pose(
        [fits[i].T_robot_body @ mount.value @ invert_pose(T_camera_board[i]) for i in some]
    )[0]
    fast = [i for i in seen if moving_view_selection._has_useful_speed(fits[i].velocity)]
    places, groups = [], []
    for i in fast[:: max(1, len(fast) // 400)]:
        places.append(
            make_moving_placement(
                TargetPath("board", mount.value, path),
                session="s",
                sensor="camera",
                time_ns=int(stamps[i]),
                mocap_noise=MOCAP,
            )
        )
        uv, _ = CAMERA.project(transform_points(T_camera_board[i], BOARD.pattern.corners()))
        n = len(uv)
        columns = {
            "view": np.full(n, i),
            "stamp_ns": np.full(n, stamps[i]),
            "placement": np.full(n, i),
        }
        columns |= {"kind": np.full(n, "pattern_corner"), "feature_index": np.arange(n), "uv": uv}
        columns |= {"xyz": np.full((n, 3), np.nan), "sigma": np.full(n, 0.5)}
        columns["whitening"] = np.tile([1.0, 0.0, 1.0], (n, 1))
        groups.append(
            MeasurementGroup("camera", len(places) - 1, "pattern_corner", columns, is_moving=True)
        )
    made = Setup(
        {"camera": CAMERA},
        {"board": BOARD},
        places,
        groups,
        ASSOCIATE_SETTINGS,
        {},
        initial_mounts={"board": mount.value},
        corrections=(TimeOffsetCorrection("camera", np.array([0.1])),),
    )
    return made, {"camera": T_world_camera}


def test_vicon_is_14_to_22_ms_ahead_of_the_camera_as_three_others_found(setup):
    made, start = setup
    result = estimate_poses(
        made, start, max_rounds=60, tolerance_m=1e-7, tolerance_rad=1e-7, initial_noise_factor=10.0
    )
    assert 0.014 < result.state.correction_values[0] < 0.022
