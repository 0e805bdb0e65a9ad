"""Which directions of a sensor's pose the data do not determine, in words."""

import numpy as np

from calib.estimation import eigen

UNDETERMINED = 0.5  # m or rad: a direction known no better than this is not known at all
AXES = {
    "translation": ("along x (forward)", "along y (left)", "along z (up)"),
    "rotation": ("roll, about x", "pitch, about y", "yaw, about z"),
}


def undetermined(information, n_sensors, sensor):
    """Directions (k, 6), unit twists of the sensor, that the data leave open.

    The MCS errors are marginalised; the other sensors are held.
    """
    own = np.arange(6 * sensor, 6 * sensor + 6)
    rows = np.concatenate([own, np.arange(6 * n_sensors, len(information))])
    values, vectors, rounding = eigen(information[np.ix_(rows, rows)])
    root = vectors[:6, ~rounding] / np.sqrt(values[~rounding])
    variances, directions = np.linalg.eigh(root @ root.T)
    # What is rounding has no variance at all: its directions come first, the loose ones after.
    null = vectors[:6, rounding]
    null = null / np.maximum(np.linalg.norm(null, axis=0), 1e-300)
    loose = directions[:, variances > UNDETERMINED**2]
    return _independent(np.hstack([null, loose]))


def _independent(directions):
    """Orthonormal rows (k, 6) that span the columns of directions (6, m)."""
    if directions.shape[1] == 0:
        return np.zeros((0, 6))
    u, s, _ = np.linalg.svd(directions, full_matrices=False)
    return u[:, s > 1e-3 * s[0]].T


def in_words(direction, T_robot_sensor):
    """A unit twist (6,) of the sensor named by the robot axis it is nearest to.

    The sensor moves along or turns about its own origin; the axes named are the robot's.
    """
    R = T_robot_sensor[:3, :3]
    moves, turns = R @ direction[:3], R @ direction[3:]
    kind, part = max(
        (("translation", moves), ("rotation", turns)), key=lambda item: np.linalg.norm(item[1])
    )
    axis = int(np.abs(part).argmax())
    share = np.abs(part[axis]) / np.linalg.norm(part)
    mixed = (
        ""
        if share > 0.95
        else f" mainly, of direction ({part[0]:.2f}, {part[1]:.2f}, {part[2]:.2f})"
    )
    return f"{kind} {AXES[kind][axis]} of the robot{mixed}"


def weakest(sensor_covariance, T_robot_sensor):
    """The least certain direction of a covariance (6, 6), in words, and its σ, m or rad."""
    values, vectors = np.linalg.eigh(sensor_covariance)
    return in_words(vectors[:, -1], T_robot_sensor), float(np.sqrt(max(values[-1], 0.0)))
