"""Relative poses of two sensors, and their σ for a task: mm at a distance, px in an image."""

import itertools
from typing import Any, NamedTuple

import numpy as np

from calib.geometry.se3 import (
    inverse_pose_covariance,
    invert_pose,
    relative_pose_covariance,
    so3_hat,
)
from calib.geometry.units import DEG_PER_RAD, MM_PER_M
from calib.report.data.run_data import ReportRun
from calib.report.number_format import format_number
from calib.report.sections.extrinsics import format_pose_error, is_gimbal_locked, tabulate_pose
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.sensor_models import camera_from_config

TASK_RANGES_M = (2.0, 5.0, 10.0, 20.0)
N_DIRECTIONS = 200
N_IMAGE_GRID = (16, 12)  # columns and rows of the grid over an image
DIFFERENCE_STEP_M = 1e-4  # of a finite difference at 1 m


class PairCamera(NamedTuple):
    """A camera of a pair: T_other_camera (4, 4) and the covariance (6, 6) of its perturbation."""

    camera: str
    other: str
    model: CameraModel
    T_other_camera: np.ndarray
    covariance: np.ndarray


def list_sensor_pairs(run: ReportRun) -> list[dict[str, Any]]:
    """Return T_a_b of every two sensors with a pose, with σ from their joint covariance."""
    joint = run.calibration["joint_covariance"]
    order = joint["order"] if joint else []
    pairs = []
    for a, b in itertools.combinations(order, 2):
        rows = [6 * order.index(n) + i for n in (a, b) for i in range(6)]
        T_robot_a = np.array(run.sensors[a]["T_robot_sensor"]["matrix"])
        T_robot_b = np.array(run.sensors[b]["T_robot_sensor"]["matrix"])
        block = np.array(joint["matrix"])[np.ix_(rows, rows)]
        covariance = relative_pose_covariance(T_robot_a, T_robot_b, block)
        T_a_b = invert_pose(T_robot_a) @ T_robot_b
        T_true = _true_relative_pose(run, a, b)
        pairs.append(
            {
                "a": a,
                "b": b,
                "T": T_a_b,
                "covariance": covariance,
                "is_gimbal_locked": is_gimbal_locked(T_a_b),
                "rows": tabulate_pose(T_a_b, covariance, T_true=T_true),
                "error": format_pose_error(T_a_b, covariance, T_true),
            }
        )
    return pairs


def _true_relative_pose(run: ReportRun, a: str, b: str) -> np.ndarray | None:
    T_robot_a, T_robot_b = run.T_robot_sensor_true(a), run.T_robot_sensor_true(b)
    if T_robot_a is None or T_robot_b is None:
        return None
    return invert_pose(T_robot_a) @ T_robot_b


def point_covariance(T_a_b: np.ndarray, covariance: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return covariances (n, 3, 3), m², in frame a of points (n, 3), m, exactly known in frame b.

    covariance (6, 6): of the right perturbation of T_a_b.
    """
    J = np.concatenate([np.tile(np.eye(3), (len(points), 1, 1)), -so3_hat(points)], axis=2)
    J = T_a_b[:3, :3] @ J
    return J @ np.asarray(covariance) @ np.swapaxes(J, 1, 2)


def max_directional_sigma(covariances: np.ndarray) -> np.ndarray:
    """Return the largest σ (n,) along any direction of covariances (n, k, k)."""
    return np.sqrt(np.linalg.eigvalsh(covariances)[:, -1])


def fibonacci_directions(n: int = N_DIRECTIONS) -> np.ndarray:
    """Return unit vectors (n, 3) that cover the sphere evenly: a Fibonacci lattice."""
    z = 1 - (2 * np.arange(n) + 1) / n
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(n)
    horizontal = np.sqrt(1 - z**2)
    return np.column_stack([horizontal * np.cos(angle), horizontal * np.sin(angle), z])


def point_uncertainty_m(T_a_b: np.ndarray, covariance: np.ndarray, distance_m: float) -> float:
    """Return the σ, m, in frame a of a point at a distance from sensor b.

    It is the largest over all directions of the error and of the point.
    """
    points = distance_m * fibonacci_directions()
    return float(max_directional_sigma(point_covariance(T_a_b, covariance, points)).max())


def projection_uncertainty_px(
    model: CameraModel, covariance: np.ndarray, distance_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels (n, 2) and the σ (n,), px, of a point of another sensor that falls there.

    covariance (6, 6): of the right perturbation of T_other_camera; distance_m: from the camera.
    """
    width, height = model.size_px
    u, v = (
        np.linspace(0, size - 1, n) for size, n in zip((width, height), N_IMAGE_GRID, strict=True)
    )
    pixels = np.stack(np.meshgrid(u, v), -1).reshape(-1, 2)
    rays, is_valid = model.unproject(pixels)
    pixels, points = pixels[is_valid], distance_m * rays[is_valid]
    # In the camera frame: the perturbation is that of the camera itself.
    covariances = point_covariance(np.eye(4), covariance, points)
    step = DIFFERENCE_STEP_M * distance_m
    J = np.stack(
        [
            (model.project(points + d)[0] - model.project(points - d)[0]) / (2 * step)
            for d in step * np.eye(3)
        ],
        axis=-1,
    )
    return pixels, max_directional_sigma(J @ covariances @ np.swapaxes(J, 1, 2))


def list_pair_cameras(run: ReportRun, pair: dict[str, Any]) -> list[PairCamera]:
    """Return the cameras of a pair of list_sensor_pairs."""
    a, b, T_a_b, covariance = (pair[k] for k in ("a", "b", "T", "covariance"))
    cameras = []
    if run.sensors[b]["kind"] == "camera":
        model = camera_from_config(run.options["sensors"][b])
        cameras.append(PairCamera(b, a, model, T_a_b, covariance))
    if run.sensors[a]["kind"] == "camera":
        model = camera_from_config(run.options["sensors"][a])
        inverse = inverse_pose_covariance(T_a_b, covariance)
        cameras.append(PairCamera(a, b, model, invert_pose(T_a_b), inverse))
    return cameras


def tabulate_task_accuracy(run: ReportRun, pairs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row per pair: σ of a point at TASK_RANGES_M, mm, and in each camera, px.

    px: (camera, [(median, worst) over the image, per range]).
    """
    rows = []
    for pair in pairs:
        px = []
        for camera in list_pair_cameras(run, pair):
            sigmas = [
                projection_uncertainty_px(camera.model, camera.covariance, r)[1]
                for r in TASK_RANGES_M
            ]
            texts = [(format_number(np.median(s), 2), format_number(s.max(), 2)) for s in sigmas]
            px.append((camera.camera, texts))
        uncertainty_m = [
            point_uncertainty_m(pair["T"], pair["covariance"], r) for r in TASK_RANGES_M
        ]
        sigma_m, sigma_rad = np.sqrt(np.diag(pair["covariance"])).reshape(2, 3).max(1)
        rows.append(
            {
                "name": f"{pair['a']} – {pair['b']}",
                "sigma_mm": format_number(sigma_m * MM_PER_M, 2),
                "sigma_deg": format_number(sigma_rad * DEG_PER_RAD, 2),
                "mm": [format_number(v * MM_PER_M, 2) for v in uncertainty_m],
                "px": px,
            }
        )
    return rows
