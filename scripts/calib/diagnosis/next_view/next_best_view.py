"""Next best view: the candidate placement that decreases the σ of a pose's worst direction most.

The information of a candidate (recorded_view) is added to that of all recordings, with the
estimated noise. This is first order, as leave-one-out is.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from calib.diagnosis.covariance.cluster_covariance import excess_map
from calib.diagnosis.covariance.consider_covariance import unestimated_couplings
from calib.diagnosis.next_view.recorded_view import (
    AddedInformation,
    RecordedView,
    distance_and_incidence,
    inlier_groups_by_placement,
)
from calib.diagnosis.next_view.view_candidates import list_view_candidates
from calib.diagnosis.observability import describe_pose_direction, least_certain_direction
from calib.estimation import pose_chain
from calib.estimation.estimation_problem import SensorModel, Setup
from calib.estimation.estimation_result import EstimationResult
from calib.estimation.nlp.information_matrix import covariance_from_information
from calib.estimation.nlp.measurement_factor import joint_information
from calib.estimation.pose_chain import prior_means_and_weights
from calib.io.pose_block import pose_json
from calib.sensors.camera.camera_model import CameraModel
from calib.targets.target_shapes import TargetShape
from calib.views.field_of_view import check_camera_visibility, check_lidar_visibility

N_SIMILAR_PLACEMENTS = 4  # for which σ is predicted, besides that for one


@dataclass(frozen=True)
class CurrentInformation:
    """The information of all recordings.

    unknowns_covariance: (n, n), without the errors that are not estimated. unestimated_coupling:
    (n, q) second derivatives of the cost by the unknowns and by these errors, whose σ is
    unestimated_sigma (q,), see consider_covariance. added_pose_covariance: (m, m), see
    cluster_covariance.
    """

    unknowns_covariance: np.ndarray
    unestimated_coupling: np.ndarray
    unestimated_sigma: np.ndarray
    added_pose_covariance: np.ndarray | None

    @classmethod
    def from_result(cls, setup: Setup, result: EstimationResult) -> "CurrentInformation":
        """Return the information of a result."""
        weight = prior_means_and_weights(setup, result.state)[1]
        P = covariance_from_information(joint_information(result.solved.factors, weight))
        added = result.solved.added_pose_covariance
        return cls(P, *unestimated_couplings(setup, result), added)

    def pose_covariance(
        self, pose_index: slice, added: AddedInformation | None = None, n_times: int = 1
    ) -> np.ndarray:
        """Return the covariance (6, 6) of a pose, with n_times the information of a placement more.

        pose_index: of the unknowns of the pose.
        """
        covariance = self._model_covariance(pose_index, added, n_times)
        if self.added_pose_covariance is None:
            return covariance
        now = self._model_covariance(pose_index, None, 1)
        G = excess_map(now, self.added_pose_covariance[pose_index, pose_index])
        return G @ covariance @ G.T

    def _model_covariance(
        self, pose_index: slice, added: AddedInformation | None, n_times: int
    ) -> np.ndarray:
        rows, G = self.unknowns_covariance[pose_index], self.unestimated_coupling
        if added is not None:
            c, H = added.columns, n_times * added.information
            # Woodbury, for the rows of the sensor alone.
            mixed = np.eye(len(c)) + self.unknowns_covariance[np.ix_(c, c)] @ H
            rows = rows - rows[:, c] @ H @ np.linalg.solve(mixed, self.unknowns_covariance[c])
            G = G.copy()
            G[c] += n_times * added.unestimated_coupling
        shift = rows @ G * self.unestimated_sigma
        return rows[:, pose_index] + shift @ shift.T


class CandidatePlacement(NamedTuple):
    """A target at T_sensor_target (4, 4), described in words, and the information it would add."""

    target: str
    T_sensor_target: np.ndarray
    description: str
    added: AddedInformation


def find_best_views(
    setup: Setup, result: EstimationResult, sensors: Sequence[str], options: dict[str, Any]
) -> dict[str, dict[str, Any] | None]:
    """Return the next best view of each sensor. options: as of find_best_view."""
    if not sensors:
        return {}
    current = CurrentInformation.from_result(setup, result)
    return {n: find_best_view(setup, result, current, n, options) for n in sensors}


def find_best_view(
    setup: Setup,
    result: EstimationResult,
    current: CurrentInformation,
    sensor: str,
    options: dict[str, Any],
) -> dict[str, Any] | None:
    """Return the candidate that decreases σ of the least certain direction of a pose most.

    None without candidates, else {target, T_sensor_target, description, direction, unit, sigma,
    sigma_one, sigma_four}. sigma: of this direction now, in m or rad (unit); sigma_one, sigma_four:
    predicted for one and for four such placements more. options: min_returns and max_incidence_deg.
    """
    best: dict[str, Any] | None = None
    first = 6 * sorted(setup.models).index(sensor)
    pose_index = slice(first, first + 6)
    weights, sigma, unit = least_certain_direction(current.pose_covariance(pose_index))
    for candidate in candidate_placements(setup, result, sensor, options):
        sigma_one, sigma_four = (
            _sigma_along(weights, current.pose_covariance(pose_index, candidate.added, n))
            for n in (1, N_SIMILAR_PLACEMENTS)
        )
        if best is None or sigma_one < best["sigma_one"]:
            best = {
                "target": candidate.target,
                "T_sensor_target": pose_json(candidate.T_sensor_target),
                "description": candidate.description,
                "sigma_one": sigma_one,
                "sigma_four": sigma_four,
            }
    if best is None:
        return None
    direction = describe_pose_direction(weights, result.state.T_robot_sensor[sensor])
    return best | {"direction": direction, "unit": unit, "sigma": sigma}


def _sigma_along(weights: np.ndarray, covariance: np.ndarray) -> float:
    """Return σ of the sum of a pose error's components (6,) with some weights (6,)."""
    return float(np.sqrt(max(weights @ covariance @ weights, 0.0)))


def candidate_placements(
    setup: Setup, result: EstimationResult, sensor: str, options: dict[str, Any]
) -> Iterator[CandidatePlacement]:
    """Yield the candidates that a sensor would see, for every target with inliers.

    options: min_returns and max_incidence_deg.
    """
    state, model = result.state, setup.models[sensor]
    recorded = inlier_groups_by_placement(setup, result, sensor)
    heights = [pose_chain.T_robot_target(setup, state, k)[2, 3] for k in recorded]
    by_target: dict[str, list[int]] = {}
    for k in recorded:
        by_target.setdefault(setup.placements[k].target, []).append(k)
    for name, placements in sorted(by_target.items()):
        target = setup.targets[name]
        if not target.uses_exact_surface:
            continue
        T = np.stack([pose_chain.T_sensor_target(setup, state, sensor, k) for k in placements])
        views = [RecordedView(setup, result, sensor, recorded[k]) for k in placements]
        limits = min(heights), max(heights)
        candidates = list_view_candidates(
            target=target,
            model=model,
            T_sensor_targets=T,
            heights_m=limits,
            T_robot_sensor=state.T_robot_sensor[sensor],
        )
        for T_new, text in candidates:
            if not reason_not_visible(model, target, T_new, options):
                view = views[find_most_similar_pose(T, T_new, target)]
                yield CandidatePlacement(name, T_new, text, view.added_information(T_new))


def reason_not_visible(
    model: SensorModel,
    target: TargetShape,
    T_sensor_target: np.ndarray,
    options: dict[str, Any],
) -> str:
    """Return why a sensor would not see a target at a pose (4, 4) well enough; "" if it would.

    options: min_returns and max_incidence_deg.
    """
    if isinstance(model, CameraModel):
        return check_camera_visibility(model, target, T_sensor_target, np.zeros(6), options)
    return check_lidar_visibility(model, target, T_sensor_target, np.zeros(6), options)


def find_most_similar_pose(T: np.ndarray, T_candidate: np.ndarray, target: TargetShape) -> int:
    """Return which pose in T (k, 4, 4) has the most similar distance and incidence."""
    distance, cosine = distance_and_incidence(target, T_candidate)
    recorded = np.array([distance_and_incidence(target, t) for t in T])
    difference = np.abs(np.log(recorded[:, 0] / distance)) + np.abs(recorded[:, 1] - cosine)
    return int(difference.argmin())
