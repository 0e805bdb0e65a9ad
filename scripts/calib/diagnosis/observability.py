"""Which directions of a sensor pose the data determine, and which views would improve it."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from calib.estimation.nlp.information_matrix import decompose_information
from calib.geometry.rotation_spread import rotation_spread_deg
from calib.geometry.units import DEG_PER_RAD, MM_PER_M
from calib.targets.board import Board

UNDETERMINED_SIGMA = 0.5  # m or rad: a direction with a larger σ counts as undetermined
LEVER_ARM_M = 1.0  # distance at which a rotation is compared with a translation
PARALLEL_DEG = 10.0  # axes that differ by less count as parallel
MIN_AXIS_COMPONENT = 0.95  # of a direction that is called by the name of one axis
MIN_BASIS_RATIO = 1e-3  # smallest singular value of a basis over the largest
AXIS_NAMES = "xyz"
# Directions of T_body_target, in the order of a twist.
MOUNT_DIRECTION_NAMES = [
    f"{what} {axis}" for what in ("translation along", "rotation about") for axis in AXIS_NAMES
]
SINGLE_AXIS_DEG = 5.0  # rms: poses that rotate less about every other axis rotate about one only
MIN_ADVISED_SPREAD_DEG = 30.0  # spread of target directions below which more tilt is advised
MIN_ADVISED_PLACEMENTS = 3
GENERAL_ADVICE = (
    "Record placements that differ in that direction: the target tilted to all sides, nearer and "
    "farther, and at the sides of the view."
)

TargetDirections = dict[str, np.ndarray]  # see normals_and_axes


class PrincipalDirection(NamedTuple):
    """A principal direction of a pose covariance.

    weights: (6,) of the components of a pose error whose sum has the standard deviation sigma, in
    `unit`, m or rad.
    """

    weights: np.ndarray
    sigma: float
    unit: str

    @property
    def sigma_m(self) -> float:
        """The standard deviation, of rotations as the shift that they make at LEVER_ARM_M."""
        return self.sigma * LEVER_ARM_M if self.unit == "rad" else self.sigma


class SharedDirection(NamedTuple):
    """A unit direction (3,), robot frame, that all targets share, and its name."""

    direction: np.ndarray
    name: str


def find_undetermined_directions(
    information: np.ndarray, n_sensors: int, sensor_index: int
) -> np.ndarray:
    """Return directions (k, 6), unit twists of one sensor, that the data do not determine.

    information: (n, n), sensors first. Unknowns that are no sensor pose are marginalised; the other
    sensors are held.
    """
    own = np.arange(6 * sensor_index, 6 * sensor_index + 6)
    rows = np.concatenate([own, np.arange(6 * n_sensors, len(information))])
    values, vectors, is_rounding = decompose_information(information[np.ix_(rows, rows)])
    root = vectors[:6, ~is_rounding] / np.sqrt(values[~is_rounding])
    variances, directions = np.linalg.eigh(root @ root.T)
    # Directions without information have no variance either: they come first.
    null = vectors[:6, is_rounding]
    null = null / np.maximum(np.linalg.norm(null, axis=0), 1e-300)
    uncertain = directions[:, variances > UNDETERMINED_SIGMA**2]
    return _orthonormal_rows(np.hstack([null, uncertain]))


def _orthonormal_rows(directions: np.ndarray) -> np.ndarray:
    """Return orthonormal rows (k, 6) that span the columns of directions (6, m)."""
    if directions.shape[1] == 0:
        return np.zeros((0, 6))
    u, s, _ = np.linalg.svd(directions, full_matrices=False)
    return u[:, s > MIN_BASIS_RATIO * s[0]].T


def describe_pose_direction(
    direction: np.ndarray,
    T_robot_sensor: np.ndarray,
    shared_direction: SharedDirection | None = None,
) -> str:
    """Return a unit twist (6,) of a sensor as text, by the nearest axis of the robot body.

    shared_direction: of all targets, named instead of the axis if the twist is parallel to it.
    """
    R = T_robot_sensor[:3, :3]
    parts = (
        ("translation along", R @ direction[:3]),
        ("rotation about", R @ direction[3:]),
    )
    kind, axis = max(parts, key=lambda item: np.linalg.norm(item[1]))
    axis = axis / np.linalg.norm(axis)
    if shared_direction:
        shared, name = shared_direction
        if abs(axis @ shared) > np.cos(np.radians(PARALLEL_DEG)):
            return f"{kind} {name}, {_describe_robot_axis(shared)}"
    return f"{kind} {_describe_robot_axis(axis)}"


def _describe_robot_axis(direction: np.ndarray) -> str:
    """Return `z of the robot body`, or the components if the direction is not near an axis."""
    axis = int(np.abs(direction).argmax())
    if abs(direction[axis]) > MIN_AXIS_COMPONENT:
        return f"{AXIS_NAMES[axis]} of the robot body"
    # Adding zero turns a rounded -0 into 0.
    rounded = np.round(direction * np.sign(direction[axis]), 2) + 0.0
    components = ", ".join(f"{v:.2f}" for v in rounded)
    return f"({components}) of the robot body, mainly {AXIS_NAMES[axis]}"


def principal_directions(sensor_covariance: np.ndarray) -> list[PrincipalDirection]:
    """Return the six principal directions of a covariance (6, 6), the least certain first.

    Rotations are compared with translations at LEVER_ARM_M.
    """
    scale = np.repeat([1.0, LEVER_ARM_M], 3)
    variances, twists = np.linalg.eigh(scale[:, None] * sensor_covariance * scale)
    out = []
    for variance, twist in zip(variances[::-1], twists.T[::-1], strict=True):
        is_rotation = np.linalg.norm(twist[3:]) > np.linalg.norm(twist[:3])
        length = LEVER_ARM_M if is_rotation else 1.0
        sigma = float(np.sqrt(max(variance, 0.0)) / length)
        unit = "rad" if is_rotation else "m"
        out.append(PrincipalDirection(scale * twist / length, sigma, unit))
    return out


def least_certain_direction(sensor_covariance: np.ndarray) -> PrincipalDirection:
    """Return the least certain principal direction of a covariance (6, 6)."""
    return principal_directions(sensor_covariance)[0]


def normals_and_axes(targets: Sequence[Any], T_robot_target: np.ndarray) -> TargetDirections:
    """Return {"normals": (k, 3), "axes": (m, 3)} of boards and of round targets, robot frame.

    targets: n shapes. T_robot_target: (n, 4, 4). A template cloud has neither.
    """
    is_flat = np.array([isinstance(t, Board) for t in targets], bool)
    is_round = np.array([bool(t.symmetry_axes) for t in targets], bool)
    T = np.reshape(T_robot_target, (-1, 4, 4))
    return {"normals": T[is_flat, :3, 2], "axes": T[is_round, :3, 0]}


def largest_angle_deg(directions: np.ndarray) -> float | None:
    """Return the largest angle, deg, between two of k lines (k, 3), at most 90; None if k < 2."""
    if len(directions) < 2:
        return None
    return float(np.degrees(np.arccos(np.clip(np.abs(directions @ directions.T), 0, 1)).max()))


def direction_spread_deg(directions: TargetDirections) -> dict[str, float]:
    """Return the largest angle, deg, between normals and between axes, where there are two."""
    angles = {kind: largest_angle_deg(lines) for kind, lines in directions.items()}
    return {kind: angle for kind, angle in angles.items() if angle is not None}


def single_rotation_axis(T_body: np.ndarray) -> np.ndarray | None:
    """Return the axis (3,), body frame, if poses (n, 4, 4), n ≥ 3, rotate about a single one."""
    rms, axes = rotation_spread_deg(T_body)
    return axes[0] if rms[0] > SINGLE_AXIS_DEG > rms[1] else None


def shared_direction(directions: TargetDirections) -> SharedDirection | None:
    """Return the direction that all targets share, None if there is none."""
    names = {"normals": "the boards' common normal", "axes": "the cylinders' common axis"}
    kinds = [kind for kind, lines in directions.items() if len(lines)]
    if len(kinds) != 1:
        return None
    (kind,) = kinds
    spread = largest_angle_deg(directions[kind])
    if spread is not None and spread > PARALLEL_DEG:
        return None
    return SharedDirection(np.linalg.svd(directions[kind])[2][0], names[kind])


def advise_views(directions: TargetDirections, n_placements: int, is_lidar: bool) -> str:
    """Return which views would determine undetermined or uncertain directions.

    directions: of the targets in the placements used, whose number is n_placements. For a lidar, a
    board is only a plane with an outline.
    """
    if n_placements < MIN_ADVISED_PLACEMENTS:
        return (
            f"Hold a target still in at least {MIN_ADVISED_PLACEMENTS} different places that the "
            f"sensor sees; {n_placements} so far."
        )
    has_boards, has_cylinders = len(directions["normals"]) > 0, len(directions["axes"]) > 0
    axis_spread = largest_angle_deg(directions["axes"]) or 0.0
    if has_cylinders and not has_boards and axis_spread < MIN_ADVISED_SPREAD_DEG:
        return (
            f"All axes of the cylinder lie within {axis_spread:.0f}° of each other: hold it "
            "tilted by 30° or more about another axis, in two places at least; more views with "
            "the same tilt do not help."
        )
    normal_spread = largest_angle_deg(directions["normals"]) or 0.0
    only_boards = has_boards and not has_cylinders
    if is_lidar and only_boards and normal_spread < MIN_ADVISED_SPREAD_DEG:
        return (
            f"All boards face the same way within {normal_spread:.0f}°: turn the board by 20 to "
            "40° to the left, to the right, up and down."
        )
    return GENERAL_ADVICE


def describe_next_view(next_view: dict[str, Any]) -> str:
    """Return what to record next and how σ improves. next_view: of next_best_view."""
    scale, unit = (DEG_PER_RAD, "°") if next_view["unit"] == "rad" else (MM_PER_M, " mm")
    now, one, four = (f"{next_view[k] * scale:.2g}" for k in ("sigma", "sigma_one", "sigma_four"))
    return (
        f"Hold the {next_view['target']} still {next_view['description']}: σ of "
        f"{next_view['direction']} {now} → {one}{unit} with one such placement, {four}{unit} with "
        "four."
    )
