"""What the σ of two sensors' relative pose means for a task: mm at a distance, px in an image."""

import numpy as np

from calib.geometry.se3 import inverse_pose_covariance, invert_pose, so3_hat
from calib.geometry.units import DEG_PER_RAD, MM_PER_M
from calib.report.number_format import format_number
from calib.sensors.sensor_models import camera_from_config

TASK_RANGES_M = (2.0, 5.0, 10.0, 20.0)  # m
N_DIRECTIONS = 200
N_IMAGE_GRID = (16, 12)  # of an image, columns and rows
DIFFERENCE_STEP_M = 1e-4  # m, of a finite difference at 1 m


def point_covariance(T_a_b, covariance, p_b):
    """Covariances (n, 3, 3), m², in frame a, of points p_b (n, 3), m, that sensor b measures
    exactly; covariance (6, 6): of the right perturbation of T_a_b."""
    J = np.concatenate([np.tile(np.eye(3), (len(p_b), 1, 1)), -so3_hat(p_b)], axis=2)
    J = T_a_b[:3, :3] @ J
    return J @ np.asarray(covariance) @ np.swapaxes(J, 1, 2)


def max_directional_sigma(covariances):
    """Largest σ (n,) of covariances (n, k, k) along any direction."""
    return np.sqrt(np.linalg.eigvalsh(covariances)[:, -1])


def fibonacci_directions(n=N_DIRECTIONS):
    """Unit vectors (n, 3), evenly over the sphere: a Fibonacci lattice."""
    z = 1 - (2 * np.arange(n) + 1) / n
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(n)
    flat = np.sqrt(1 - z**2)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])


def point_uncertainty_m(T_a_b, covariance, distance):
    """σ, m, of a point so far, m, from sensor b in frame a: in the worst direction, and at worst
    over all directions in which it may lie."""
    return float(
        max_directional_sigma(
            point_covariance(T_a_b, covariance, distance * fibonacci_directions())
        ).max()
    )


def projection_uncertainty_px(model, T_s_c, covariance, distance):
    """(pixels (n, 2), σ (n,), px): where points so far, m, from a camera fall that sensor s
    measures exactly, and how sure that is.

    covariance (6, 6): of the right perturbation of T_s_c."""
    width, height = model.size_px
    u, v = (
        np.linspace(0, size - 1, n) for size, n in zip((width, height), N_IMAGE_GRID, strict=True)
    )
    uv = np.stack(np.meshgrid(u, v), -1).reshape(-1, 2)
    rays, ok = model.unproject(uv)
    uv, p = uv[ok], distance * rays[ok]
    # Of the point in the camera: the perturbation is the camera's own, seen the other way round.
    moved = point_covariance(np.eye(4), covariance, p)
    step = DIFFERENCE_STEP_M * distance
    J = [(model.project(p + d)[0] - model.project(p - d)[0]) / (2 * step) for d in step * np.eye(3)]
    J = np.stack(J, -1)
    return uv, max_directional_sigma(J @ moved @ np.swapaxes(J, 1, 2))


def list_pair_cameras(run, pair):
    """[(camera, model, T_s_c, covariance)] of the cameras of a pair of `extrinsics.between`."""
    T, covariance, out = pair["T"], pair["covariance"], []
    if run.sensors[pair["b"]]["kind"] == "camera":
        out.append((pair["b"], T, covariance))
    if run.sensors[pair["a"]]["kind"] == "camera":
        inverse = inverse_pose_covariance(T, covariance)
        out.append((pair["a"], invert_pose(T), inverse))
    return [(n, camera_from_config(run.options["sensors"][n]), T, C) for n, T, C in out]


def tabulate_task_accuracy(run, pairs):
    """What every pair of `extrinsics.between` knows of a point at RANGES: [{name, mm, px}]; px:
    [(camera, [(median, worst) over the image])]."""
    out = []
    for pair in pairs:
        mm = [
            point_uncertainty_m(pair["T"], pair["covariance"], r) * MM_PER_M for r in TASK_RANGES_M
        ]
        seen = []
        for camera, model, T, covariance in list_pair_cameras(run, pair):
            sigma = [projection_uncertainty_px(model, T, covariance, r)[1] for r in TASK_RANGES_M]
            told = [(format_number(np.median(s), 2), format_number(s.max(), 2)) for s in sigma]
            seen.append((camera, told))
        sigma = np.sqrt(np.diag(pair["covariance"])).reshape(2, 3).max(1)
        told = {
            "sigma_mm": format_number(sigma[0] * MM_PER_M, 2),
            "sigma_deg": format_number(sigma[1] * DEG_PER_RAD, 2),
        }
        told |= {
            "name": f"{pair['a']} – {pair['b']}",
            "mm": [format_number(v, 2) for v in mm],
        }
        out.append(told | {"px": seen})
    return out
