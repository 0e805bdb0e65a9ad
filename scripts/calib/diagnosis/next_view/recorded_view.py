"""The measurements of a recorded placement, moved to another pose of the target, and what they add.

A new placement has its own errors of the motion capture poses, which are marginalised.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calib.diagnosis.covariance.consider_covariance import (
    couple_corrections,
    unestimated_range_errors,
)
from calib.estimation import pose_chain
from calib.estimation.estimation_problem import MeasurementGroup, SensorModel, Setup
from calib.estimation.estimation_result import EstimationResult
from calib.estimation.measurement_assignment import assign_measurements
from calib.estimation.nlp.information_matrix import invert_information
from calib.estimation.nlp.measurement_factor import Factor
from calib.estimation.residuals.assignment import Assignment
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS
from calib.estimation.round_solution import (
    build_nlp,
    cameras_at_estimate,
    linearize_measurements,
    targets_at_estimate,
)
from calib.geometry.se3 import invert_pose, transform_points
from calib.sensors.camera.camera_model import CameraModel
from calib.targets.target_shapes import TargetShape

MIN_COS_INCIDENCE = 1e-3  # so that the ratio of lidar returns stays finite


@dataclass(frozen=True)
class AddedInformation:
    """Information (m, m) of a new placement about the unknowns that it shares with others.

    columns: (m,) indices of these unknowns. unestimated_coupling: (m, q) second derivatives of the
    cost by them and by the errors that are not estimated, see consider_covariance.
    """

    columns: np.ndarray
    information: np.ndarray
    unestimated_coupling: np.ndarray


class AssignedGroup(NamedTuple):
    """A group of measurements and its Assignment."""

    group: MeasurementGroup
    assignment: Assignment


class InlierGroup(NamedTuple):
    """The inliers of a group, and the ranges (n, 1), m, of the features that they measured."""

    group: MeasurementGroup
    ranges: np.ndarray


class ViewGeometry(NamedTuple):
    """Distance, m, of a target from the sensor, and cosine of incidence."""

    distance: float
    cos_incidence: float


def inlier_groups_by_placement(
    setup: Setup, result: EstimationResult, sensor: str
) -> dict[int, list[AssignedGroup]]:
    """Return the groups of a sensor that have inliers, by placement; without moving views."""
    out: dict[int, list[AssignedGroup]] = {}
    for group, assignment in zip(setup.groups, result.assignments, strict=True):
        has_inliers = (assignment.feature >= 0).any()
        if group.sensor == sensor and not group.is_moving and has_inliers:
            out.setdefault(group.placement, []).append(AssignedGroup(group, assignment))
    return out


def distance_and_incidence(target: TargetShape, T_sensor_target: np.ndarray) -> ViewGeometry:
    """Return how a sensor sees a target at a pose (4, 4)."""
    centre = transform_points(T_sensor_target, target.centre)
    _, cosine = target.check_facing(invert_pose(T_sensor_target)[:3, 3])
    return ViewGeometry(float(np.linalg.norm(centre)), float(cosine))


class RecordedView:
    """The measurements that a sensor made of a target in one placement.

    assigned_groups: all groups with inliers of the sensor in that placement.
    """

    def __init__(
        self,
        setup: Setup,
        result: EstimationResult,
        sensor: str,
        assigned_groups: Sequence[AssignedGroup],
    ) -> None:
        self.setup: Setup = setup
        self.sensor: str = sensor
        self.inlier_groups: list[InlierGroup] = [select_group_inliers(g) for g in assigned_groups]
        self.placement_index: int = assigned_groups[0].group.placement
        self.T_sensor_target: np.ndarray = pose_chain.T_sensor_target(
            setup, result.state, sensor, self.placement_index
        )
        # A new placement has its own motion capture errors. Nothing is known of them: zero.
        mocap_errors = result.state.mocap_errors.copy()
        mocap_errors[setup.robot_error_index[self.placement_index]] = 0
        mocap_errors[setup.body_error_index[self.placement_index]] = 0
        self.state = replace(result.state, mocap_errors=mocap_errors)
        view_setup = replace(setup, groups=[inliers.group for inliers in self.inlier_groups])
        self.nlp = build_nlp(view_setup)
        self.nlp.set_models(
            cameras_at_estimate(view_setup, self.state), targets_at_estimate(setup, self.state)
        )

    def added_information(self, T_sensor_target: np.ndarray) -> AddedInformation:
        """Return what the same measurements would add with the target at T_sensor_target (4, 4)."""
        setup = self._setup_at_pose(T_sensor_target)
        ratio_by_unit = self._measurement_ratio(T_sensor_target)
        assignments = [
            replace(a, geometric_weight=a.geometric_weight * ratio_by_unit[_unit(group)])
            for group, a in zip(setup.groups, assign_measurements(setup, self.state), strict=True)
        ]
        factors = linearize_measurements(setup, self.nlp, self.state, assignments)
        coupling = couple_corrections(
            setup=setup,
            state=self.state,
            assignments=assignments,
            factors=factors,
            corrections=[c for c, _ in unestimated_range_errors(setup, self.state)],
        )
        return _marginalize_mocap_errors(factors, coupling, setup)

    def _setup_at_pose(self, T_sensor_target: np.ndarray) -> Setup:
        """Return the Setup with the groups of this view alone, moved with their target.

        The motion capture pose of the body is set so that the target is at T_sensor_target (4, 4).
        """
        setup, state, k = self.setup, self.state, self.placement_index
        placement = setup.placements[k]
        # Correction for moved markers of the robot: the placement holds poses without it.
        T_robot_body = pose_chain.T_robot_body(setup, state, k)
        T_markers = T_robot_body @ invert_pose(placement.T_robot_body)
        T_robot_target = state.T_robot_sensor[self.sensor] @ T_sensor_target
        T_target_body = invert_pose(pose_chain.T_body_target(setup, state, k))
        T_measured = invert_pose(T_markers) @ T_robot_target @ T_target_body
        T_new_old = T_sensor_target @ invert_pose(self.T_sensor_target)
        placements = list(setup.placements)
        placements[k] = replace(placement, T_robot_body=T_measured)
        groups = [
            move_measurements(inliers, setup.models[self.sensor], T_new_old)
            for inliers in self.inlier_groups
        ]
        return replace(setup, placements=placements, groups=groups)

    def _measurement_ratio(self, T_sensor_target: np.ndarray) -> dict[str, float]:
        """Return, by unit, the expected number of measurements over that of the recorded view.

        Lidar returns (m) decrease with distance² and with incidence; crossings of an outline (rad)
        decrease with the distance; the number of image features (px) is constant.
        """
        target = self.setup.targets[self.setup.placements[self.placement_index].target]
        recorded = distance_and_incidence(target, self.T_sensor_target)
        new = distance_and_incidence(target, T_sensor_target)
        per_distance = recorded.distance / new.distance
        returns = (
            per_distance**2
            * max(new.cos_incidence, MIN_COS_INCIDENCE)
            / max(recorded.cos_incidence, MIN_COS_INCIDENCE)
        )
        return {"px": 1.0, "m": returns, "rad": per_distance}


def _unit(group: MeasurementGroup) -> str:
    return RESIDUAL_KINDS[group.kind].UNIT


def select_group_inliers(assigned: AssignedGroup) -> InlierGroup:
    """Return the measurements that have a feature, and its range."""
    group, assignment = assigned
    is_inlier = assignment.feature >= 0
    keypoints = _select_rows(group.keypoints, is_inlier)
    return InlierGroup(replace(group, keypoints=keypoints), assignment.range[is_inlier, None])


def _select_rows(columns: dict[str, np.ndarray], is_selected: np.ndarray) -> dict[str, np.ndarray]:
    return {name: np.asarray(column)[is_selected] for name, column in columns.items()}


def move_measurements(
    inliers: InlierGroup, model: SensorModel, T_new_old: np.ndarray
) -> MeasurementGroup:
    """Return the group as measured if all features were moved by T_new_old (4, 4), sensor frame.

    Pixels that leave the image are dropped.
    """
    group, ranges = inliers
    keypoints = group.keypoints
    if isinstance(model, CameraModel):
        ray, _ = model.unproject(keypoints["uv"])
        points = ray / np.linalg.norm(ray, axis=1)[:, None] * ranges
        uv, is_valid = model.project(transform_points(T_new_old, points))
        is_visible = is_valid & model.is_in_image(uv)
        return replace(group, keypoints=_select_rows(keypoints | {"uv": uv}, is_visible))
    length = np.linalg.norm(keypoints["xyz"], axis=1)[:, None]
    points = transform_points(T_new_old, keypoints["xyz"] / length * ranges)
    if _unit(group) == "rad":
        points = points / np.linalg.norm(points, axis=1)[:, None]
    return replace(group, keypoints=keypoints | {"xyz": points})


def _marginalize_mocap_errors(
    factors: Sequence[Factor], coupling: np.ndarray, setup: Setup
) -> AddedInformation:
    """Return the information of a new placement, with its motion capture errors marginalised.

    coupling: (n, q) of the n unknowns with the errors that are not estimated.
    """
    columns = np.unique(np.concatenate([f.columns for f in factors]))
    H = np.zeros((len(columns), len(columns)))
    for factor in factors:
        at = np.searchsorted(columns, factor.columns)
        H[np.ix_(at, at)] += factor.hessian_x
    is_mocap = (columns >= setup.n_pose_unknowns) & (columns < setup.n_chain_unknowns)
    # These unknowns are in units of their σ: the information of their prior is the identity.
    H_mocap = H[np.ix_(is_mocap, is_mocap)] + np.eye(is_mocap.sum())
    gain = H[np.ix_(~is_mocap, is_mocap)] @ invert_information(H_mocap)
    return AddedInformation(
        columns=columns[~is_mocap],
        information=H[np.ix_(~is_mocap, ~is_mocap)] - gain @ H[np.ix_(is_mocap, ~is_mocap)],
        unestimated_coupling=coupling[columns[~is_mocap]] - gain @ coupling[columns[is_mocap]],
    )
