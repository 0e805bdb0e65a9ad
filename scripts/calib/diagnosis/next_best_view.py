"""What one view more would tell: which of many proposals narrows a pose's worst direction most.

A proposal is measured as the target was: what a sensor found of it in the recorded placement most
alike is carried along with the target, and what that says of the unknowns is added to what all
recordings say, at the noise that was found. First order, as crossvalidation is.
"""

from dataclasses import dataclass, replace

import numpy as np

from calib.diagnosis.consider_covariance import (
    couple_corrections,
    unestimated_couplings,
    unestimated_range_errors,
)
from calib.diagnosis.observability import describe_pose_direction, least_certain_direction
from calib.diagnosis.view_candidates import list_view_candidates
from calib.estimation import pose_chain
from calib.estimation.measurement_assignment import assign_measurements
from calib.estimation.nlp.information_matrix import covariance_from_information, invert_information
from calib.estimation.nlp.measurement_factor import joint_information
from calib.estimation.pose_chain import (
    T_body_target,
    T_robot_body,
    prior_means_and_weights,
)
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS
from calib.estimation.round_solution import (
    build_nlp,
    cameras_at_estimate,
    linearize_measurements,
)
from calib.geometry.se3 import invert_pose, transform_points
from calib.io.pose_block import pose_json
from calib.sensors.camera.camera_model import CameraModel
from calib.views.field_of_view import check_camera_visibility, check_lidar_visibility

N_SIMILAR_PLACEMENTS = 4  # such views, of which the σ is told too


@dataclass(frozen=True)
class AddedInformation:
    """What a new placement says of the unknowns of some numbers, columns (m,), that others share:
    information H (m, m), and how its slopes (m, q) depend on errors that nobody estimates."""

    columns: np.ndarray
    information: np.ndarray
    unestimated_coupling: np.ndarray


@dataclass(frozen=True)
class CurrentInformation:
    """What all recordings say: covariance P (n, n) of the unknowns but for the errors that nobody
    estimates (considered.told), their G (n, q) and σ (q,)."""

    unknowns_covariance: np.ndarray
    unestimated_coupling: np.ndarray
    unestimated_sigma: np.ndarray

    @classmethod
    def from_result(cls, setup, result):
        weight = prior_means_and_weights(setup, result.state)[1]
        P = covariance_from_information(joint_information(result.solve_result.factors, weight))
        return cls(P, *unestimated_couplings(setup, result))

    def pose_covariance(self, pose_index, added=None, n_times=1):
        """(6, 6) of a sensor's pose, unknowns `own`, with so many placements like More besides."""
        rows, G = self.unknowns_covariance[pose_index], self.unestimated_coupling
        if added is not None:
            c, H = added.columns, n_times * added.information
            # Woodbury, for the rows of the sensor alone.
            mixed = np.eye(len(c)) + self.unknowns_covariance[np.ix_(c, c)] @ H
            rows = rows - rows[:, c] @ H @ np.linalg.solve(mixed, self.unknowns_covariance[c])
            G = G.copy()
            G[c] += n_times * added.unestimated_coupling
        follows = rows @ G * self.unestimated_sigma
        return rows[:, pose_index] + follows @ follows.T


def find_best_views(setup, result, sensors, options):
    """{sensor: what best_view says of it}."""
    if not sensors:
        return {}
    before = CurrentInformation.from_result(setup, result)
    return {n: find_best_view(setup, result, before, n, options) for n in sensors}


def find_best_view(setup, result, before, sensor, options):
    """{target, T_sensor_target, words, direction, unit, sigma, sigma_one, sigma_four} of the
    proposal that narrows the least certain direction of a sensor's pose the most, or None where
    there is none.

    sigma: of that direction now, m or rad as unit says; sigma_one, sigma_four: with one such
    placement more, and with four. options: min_returns and max_incidence_deg of a view.
    """
    first, best = 6 * sorted(setup.models).index(sensor), None
    own = slice(first, first + 6)
    weights, sigma, unit = least_certain_direction(before.pose_covariance(own))
    for name, T, words, more in candidate_placements(setup, result, sensor, options):
        spreads = [before.pose_covariance(own, more, n) for n in (1, N_SIMILAR_PLACEMENTS)]
        after = [float(np.sqrt(max(weights @ spread @ weights, 0.0))) for spread in spreads]
        if best is None or after[0] < best["sigma_one"]:
            best = {"target": name, "T_sensor_target": pose_json(T), "description": words}
            best |= {"sigma_one": after[0], "sigma_four": after[1]}
    if best is None:
        return None
    where = describe_pose_direction(weights, result.state.T_robot_sensor[sensor])
    return best | {"direction": where, "unit": unit, "sigma": sigma}


def candidate_placements(setup, result, sensor, options):
    """(target, T_sensor_target (4, 4), in words, More) of every proposal for a sensor that it would
    see."""
    state, model = result.state, setup.models[sensor]
    T_robot_sensor, seen = (
        state.T_robot_sensor[sensor],
        inlier_groups_by_placement(setup, result, sensor),
    )
    heights = [pose_chain.T_robot_target(setup, state, k)[2, 3] for k in seen]
    by_target = {}
    for k in seen:
        by_target.setdefault(setup.placements[k].target, []).append(k)
    for name, own in sorted(by_target.items()):
        target = setup.targets[name]
        if not target.uses_exact_surface:
            continue
        T = np.stack([pose_chain.T_sensor_target(setup, state, sensor, k) for k in own])
        limits = min(heights), max(heights)
        patterns = {k: RecordedView(setup, result, sensor, seen[k]) for k in own}
        for there in list_view_candidates(target, model, T, limits, T_robot_sensor):
            if not reason_not_visible(model, target, there.T_sensor_target, options):
                pattern = patterns[own[find_most_similar_pose(T, there.T_sensor_target, target)]]
                yield (
                    name,
                    there.T_sensor_target,
                    there.description,
                    pattern.added_information(there.T_sensor_target),
                )


def inlier_groups_by_placement(setup, result, sensor):
    """{placement: [(Group, Assignment)]} of the still ones that a sensor has members in."""
    out = {}
    for g, a in zip(setup.groups, result.assignments, strict=True):
        if g.sensor == sensor and not g.is_moving and (a.feature >= 0).any():
            out.setdefault(g.placement, []).append((g, a))
    return out


def reason_not_visible(model, target, T_sensor_target, options):
    """Why the sensor would not see a target well, in words; "" when it would."""
    of = check_camera_visibility if isinstance(model, CameraModel) else check_lidar_visibility
    return of(model, target, T_sensor_target, np.zeros(6), options)


def find_most_similar_pose(T, T_candidate, target):
    """Index of the pose of T (k, 4, 4) from which a target looks most as it would from `there`: as
    far off, and under the same incidence."""
    distance, cosine = _distance_and_incidence(target, T_candidate)
    found = np.array([_distance_and_incidence(target, t) for t in T])
    return int((np.abs(np.log(found[:, 0] / distance)) + np.abs(found[:, 1] - cosine)).argmin())


def _distance_and_incidence(target, T_sensor_target):
    """(distance, m, cosine of incidence) of a target."""
    centre = transform_points(T_sensor_target, target.centre)
    return np.linalg.norm(centre), target.check_facing(invert_pose(T_sensor_target)[:3, 3])[1]


class RecordedView:
    """What a sensor found of a target in one placement, to be carried elsewhere."""

    def __init__(self, setup, result, sensor, found):
        self.setup, self.sensor, self.inlier_groups = (
            setup,
            sensor,
            [select_group_inliers(*f) for f in found],
        )
        self.placement_index = found[0][0].placement
        self.T_sensor_target = pose_chain.T_sensor_target(
            setup, result.state, sensor, self.placement_index
        )
        # A new placement has errors of the MCS of its own, of which nothing is known yet.
        y = result.state.mocap_errors.copy()
        y[
            [
                setup.robot_error_index[self.placement_index],
                setup.body_error_index[self.placement_index],
            ]
        ] = 0
        self.state = replace(result.state, mocap_errors=y)
        alone = replace(setup, groups=[g for g, _ in self.inlier_groups])
        self.nlp = build_nlp(alone)
        self.nlp.set_models(cameras_at_estimate(alone, self.state))

    def added_information(self, T_sensor_target):
        """The More of the same measurements of the target at T_sensor_target (4, 4)."""
        there = self._setup_at_pose(T_sensor_target)
        found = zip(there.groups, assign_measurements(there, self.state), strict=True)
        more = self._measurement_ratio(T_sensor_target)
        assigned = [
            replace(a, geometric_weight=a.geometric_weight * more[RESIDUAL_KINDS[g.kind].UNIT])
            for g, a in found
        ]
        parts = linearize_measurements(there, self.nlp, self.state, assigned)
        unknown = unestimated_range_errors(there, self.state)
        G = couple_corrections(there, self.state, assigned, parts, [c for c, _ in unknown])
        return _marginalize_mocap_errors(parts, G, there)

    def _setup_at_pose(self, T_sensor_target):
        """The Setup of this placement alone, its target at T_sensor_target and its measurements
        with it."""
        setup, state, k = self.setup, self.state, self.placement_index
        place = setup.placements[k]
        markers = T_robot_body(setup, state, k) @ invert_pose(place.T_robot_body)
        T_robot_target = state.T_robot_sensor[self.sensor] @ T_sensor_target
        T_target_body = invert_pose(T_body_target(setup, state, k))
        there = replace(place, T_robot_body=invert_pose(markers) @ T_robot_target @ T_target_body)
        move = T_sensor_target @ invert_pose(self.T_sensor_target)
        groups = [
            move_measurements(g, r, setup.models[self.sensor], move) for g, r in self.inlier_groups
        ]
        places = [there if i == k else p for i, p in enumerate(setup.placements)]
        return replace(setup, placements=places, groups=groups)

    def _measurement_ratio(self, T_sensor_target):
        """How many times as many measurements there are, by unit: a lidar's returns thin out with
        the distance and the slant, its crossings of an outline with the distance alone."""
        target = self.setup.targets[self.setup.placements[self.placement_index].target]
        (near, steep), (far, flat) = (
            _distance_and_incidence(target, self.T_sensor_target),
            _distance_and_incidence(target, T_sensor_target),
        )
        returns = (near / far) ** 2 * max(flat, 1e-3) / max(steep, 1e-3)
        return {"px": 1.0, "m": returns, "rad": near / far}


def select_group_inliers(group, assigned):
    """(Group, ranges (n, 1)) of the members alone."""
    kept = assigned.feature >= 0
    return replace(group, keypoints=_select_rows(group.keypoints, kept)), assigned.range[kept, None]


def _select_rows(columns, kept):
    return {name: np.asarray(column)[kept] for name, column in columns.items()}


def move_measurements(group, ranges, model, T_new_old):
    """The group with its measurements where they would be, had what they meet at ranges (n, 1)
    moved by (4, 4), sensor frame, m; without pixels that leave the image."""
    k = group.keypoints
    if isinstance(model, CameraModel):
        ray, _ = model.unproject(k["uv"])
        p = ray / np.linalg.norm(ray, axis=1)[:, None] * ranges
        uv, seen = model.project(transform_points(T_new_old, p))
        return replace(group, keypoints=_select_rows(k | {"uv": uv}, seen & model.is_in_image(uv)))
    length = np.linalg.norm(k["xyz"], axis=1)[:, None]
    p = transform_points(T_new_old, k["xyz"] / length * ranges)
    if RESIDUAL_KINDS[group.kind].UNIT == "rad":
        p = p / np.linalg.norm(p, axis=1)[:, None]
    return replace(group, keypoints=k | {"xyz": p})


def _marginalize_mocap_errors(parts, G, setup):
    """The More of the parts of one new placement, its MCS errors marginalised; G (n, q): how the
    slopes by the unknowns depend on errors that nobody estimates."""
    columns = np.unique(np.concatenate([p.columns for p in parts]))
    H = np.zeros((len(columns), len(columns)))
    for part in parts:
        at = np.searchsorted(columns, part.columns)
        H[np.ix_(at, at)] += part.hessian_x
    alone = (columns >= setup.n_pose_unknowns) & (columns < setup.n_chain_unknowns)
    own = H[np.ix_(alone, alone)] + np.eye(alone.sum())
    through = H[np.ix_(~alone, alone)] @ invert_information(own)
    H_left = H[np.ix_(~alone, ~alone)] - through @ H[np.ix_(alone, ~alone)]
    G_left = G[columns[~alone]] - through @ G[columns[alone]]
    return AddedInformation(columns[~alone], H_left, G_left)
