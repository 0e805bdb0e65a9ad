"""Which directions of a sensor's pose the data do not determine, in words, and what would."""

import numpy as np

from calib.estimation.nlp.information_matrix import decompose_information
from calib.geometry.se3 import mean_pose

UNDETERMINED_SIGMA = 0.5  # m or rad: a direction known no better than this is not known at all
LEVER_ARM_M = 1.0  # m, at which a turn counts as much as a shift
PARALLEL_DEG = 10.0  # axes that differ by less have one direction in common
AXIS_NAMES = "xyz"
# Of a target's place in its MCS body, in the order of a twist.
MOUNT_DIRECTION_NAMES = [
    f"{what} {axis}" for what in ("translation along", "rotation about") for axis in AXIS_NAMES
]
SINGLE_AXIS_DEG = 5.0  # rms: what turns no farther about any other axis turns about one only
GENERAL_ADVICE = (
    "Record placements that differ in that direction: the target tilted to all sides, nearer and "
    "farther, and at the sides of the view."
)


def find_undetermined_directions(information, n_sensors, sensor):
    """Directions (k, 6), unit twists of the sensor, that the data leave open.

    All that is no sensor's pose is marginalised; the other sensors are held.
    """
    own = np.arange(6 * sensor, 6 * sensor + 6)
    rows = np.concatenate([own, np.arange(6 * n_sensors, len(information))])
    values, vectors, rounding = decompose_information(information[np.ix_(rows, rows)])
    root = vectors[:6, ~rounding] / np.sqrt(values[~rounding])
    variances, directions = np.linalg.eigh(root @ root.T)
    # What is rounding has no variance at all: its directions come first, the loose ones after.
    null = vectors[:6, rounding]
    null = null / np.maximum(np.linalg.norm(null, axis=0), 1e-300)
    loose = directions[:, variances > UNDETERMINED_SIGMA**2]
    return _orthonormal_rows(np.hstack([null, loose]))


def _orthonormal_rows(directions):
    """Orthonormal rows (k, 6) that span the columns of directions (6, m)."""
    if directions.shape[1] == 0:
        return np.zeros((0, 6))
    u, s, _ = np.linalg.svd(directions, full_matrices=False)
    return u[:, s > 1e-3 * s[0]].T


def describe_pose_direction(direction, T_robot_sensor, shared_direction=None):
    """A unit twist (6,) of the sensor, by the axis of the robot's body that it is nearest to.

    shared_direction: (unit direction (3,) in the robot's frame, its name) that all targets share, or None.
    """
    R = T_robot_sensor[:3, :3]
    moves, turns = R @ direction[:3], R @ direction[3:]
    parts = (("translation along", moves), ("rotation about", turns))
    kind, part = max(parts, key=lambda item: np.linalg.norm(item[1]))
    part = part / np.linalg.norm(part)
    if shared_direction and abs(part @ shared_direction[0]) > np.cos(np.radians(PARALLEL_DEG)):
        return f"{kind} {shared_direction[1]}, {_describe_robot_axis(shared_direction[0])}"
    return f"{kind} {_describe_robot_axis(part)}"


def _describe_robot_axis(direction):
    """`z of the robot body`, or with its components where it is none of the axes."""
    axis = int(np.abs(direction).argmax())
    if abs(direction[axis]) > 0.95:
        return f"{AXIS_NAMES[axis]} of the robot body"
    # Adding zero turns a rounded -0 into 0.
    shown = np.round(direction * np.sign(direction[axis]), 2) + 0.0
    shown = ", ".join(f"{v:.2f}" for v in shown)
    return f"({shown}) of the robot body, mainly {AXIS_NAMES[axis]}"


def least_certain_direction(sensor_covariance):
    """The least certain direction of a covariance (6, 6): the weights (6,) of the numbers of a pose
    whose sum has that σ, the σ, and its unit, m or rad."""
    scale = np.repeat([1.0, LEVER_ARM_M], 3)
    values, vectors = np.linalg.eigh(scale[:, None] * sensor_covariance * scale)
    twist = vectors[:, -1]
    turning = np.linalg.norm(twist[3:]) > np.linalg.norm(twist[:3])
    length = LEVER_ARM_M if turning else 1.0
    sigma = np.sqrt(max(values[-1], 0.0)) / length
    return scale * twist / length, float(sigma), "rad" if turning else "m"


def describe_least_certain_direction(sensor_covariance, T_robot_sensor):
    """The least certain direction of a covariance (6, 6), in words, and its σ, m or rad."""
    weights, sigma, _ = least_certain_direction(sensor_covariance)
    return describe_pose_direction(weights, T_robot_sensor), sigma


def normals_and_axes(targets, T_robot_target):
    """{"normals": (k, 3), "axes": (m, 3)}: directions in the robot's frame of the flat and of the
    round targets of some shapes, at T_robot_target (n, 4, 4)."""
    flat = np.array([len(s.outline_edges()) > 0 for s in targets], bool)
    T = np.reshape(T_robot_target, (-1, 4, 4))
    return {"normals": T[flat, :3, 2], "axes": T[~flat, :3, 0]}


def largest_angle_deg(directions):
    """Largest angle, deg, between two of some lines (k, 3), at most 90; None of fewer than two."""
    if len(directions) < 2:
        return None
    return float(np.degrees(np.arccos(np.clip(np.abs(directions @ directions.T), 0, 1)).max()))


def direction_spread_deg(seen):
    """{"normals", "axes": spread, deg} of what `axes` says, where there are two or more."""
    found = {k: largest_angle_deg(v) for k, v in seen.items()}
    return {k: v for k, v in found.items() if v is not None}


def rotation_spread_deg(T_body):
    """By how much poses T_body (n, 4, 4), n ≥ 3, turn about their mean: rms (3,), deg, largest
    first, and the axes of that, rows (3, 3) in the body's frame."""
    _, xi = mean_pose(T_body)
    _, size, axes = np.linalg.svd(xi[:, 3:], full_matrices=False)
    return np.degrees(size) / np.sqrt(len(xi)), axes


def single_rotation_axis(T_body):
    """The one axis (3,), in the body's frame, about which poses T_body (n, 4, 4), n ≥ 3, differ;
    None of those that turn about others too, or not at all."""
    rms, axes = rotation_spread_deg(T_body)
    return axes[0] if rms[0] > SINGLE_AXIS_DEG > rms[1] else None


def shared_direction(seen):
    """(direction (3,), name) that all targets of `axes` share, or None."""
    names = {"normals": "the boards' common normal", "axes": "the cylinders' common axis"}
    found = {k: v for k, v in seen.items() if len(v)}
    if len(found) != 1:
        return None
    ((kind, lines),) = found.items()
    wide = largest_angle_deg(lines)
    if wide is not None and wide > PARALLEL_DEG:
        return None
    return np.linalg.svd(lines)[2][0], names[kind]


def advise_views(directions, n_placements, is_lidar):
    """Which views would determine what is open or loose: a sentence.

    directions: what `axes` says of the placements used; n_placements: how many; is_lidar: whether the sensor
    is one, to which a board is a plane with an outline.
    """
    if n_placements < 3:
        return f"Hold a target still in at least 3 different places that it sees; {n_placements} so far."
    flat, round_ = largest_angle_deg(directions["normals"]), largest_angle_deg(directions["axes"])
    lone = len(directions["axes"]) and not len(directions["normals"])
    if lone and (round_ or 0.0) < 30:
        return (
            f"All axes of the cylinder lie within {round_ or 0.0:.0f}° of each other: hold it "
            "tilted by 30° or more about another axis, in two places at least; more views with "
            "the same tilt do not help."
        )
    if (
        is_lidar
        and len(directions["normals"])
        and not len(directions["axes"])
        and (flat or 0.0) < 30
    ):
        return (
            f"All boards face the same way within {flat or 0.0:.0f}°: turn the board by 20 to 40° "
            "to the left, to the right, up and down."
        )
    return GENERAL_ADVICE


def describe_next_view(best):
    """What to record next and what it would do, of gain.best_view."""
    scale, unit = (np.degrees(1), "°") if best["unit"] == "rad" else (1e3, " mm")
    now, one, four = (f"{best[k] * scale:.2g}" for k in ("sigma", "sigma_one", "sigma_four"))
    return (
        f"Hold the {best['target']} still {best['description']}: σ of {best['direction']} "
        f"{now} → {one}{unit} by one such placement, {four}{unit} by four."
    )
