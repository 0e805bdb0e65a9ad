"""How well measurements and model agree, by sensor: usage, residuals, rejected measurements."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from calib.diagnosis.leave_one_out import LeaveOneOut
from calib.diagnosis.observability import TargetDirections, normals_and_axes
from calib.estimation import pose_chain
from calib.estimation.estimation_problem import MeasurementGroup, Setup
from calib.estimation.estimation_result import EstimationResult
from calib.estimation.noise.repeated_residuals import CornerResiduals, repeated_shares
from calib.estimation.residuals.assignment import Assignment
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS, uses_template_points
from calib.geometry.se3 import invert_pose, se3_log
from calib.sensors.camera.camera_model import CameraModel

TAIL_SIGMA = 3.0
TAIL_QUANTILE, NORMAL_TAIL_QUANTILE = 0.8, 1.2816  # of absolute values of N(0, 1) 80 % are below
# Kinds whose features are parts of the target; features of the others are parts of the sensor.
TARGET_FEATURE_KINDS = ("pattern_corner", "board_outline")
UNIT_BY_SENSOR_KIND = {"camera": "px", "lidar": "m"}


class RejectionRegions(NamedTuple):
    """Where outliers of one kind of measurement lie.

    positive, negative: candidates beyond the gate, by the sign of their residual. no_candidate:
    measurements that the geometry rules out.
    """

    positive: str
    negative: str
    no_candidate: str


REJECTION_REGIONS = {
    "cylinder_cap": RejectionRegions(
        "before the end", "behind the end", "off the end's rim or at grazing incidence"
    ),
    "target_surface": RejectionRegions(
        "before the surface", "behind the surface", "off the rim or at grazing incidence"
    ),
    "board_outline": RejectionRegions(
        "outside the outline", "inside the outline", "at a corner or along the scan"
    ),
    "cylinder_limb": RejectionRegions("outside the limb", "inside the limb", "near an end"),
    "pattern_corner": RejectionRegions(
        "off its place", "off its place", "not distinguishable from others"
    ),
}
DEFAULT_REJECTION_REGIONS = RejectionRegions(
    "far from the target", "far from the target", "not considered"
)

SensorGroups = list[tuple[MeasurementGroup, Assignment]]


def usage_counts(
    sensor: str, sensor_kind: str, setup: Setup, result: EstimationResult
) -> dict[str, Any]:
    """Return what of a sensor's measurements was used, and the rms of the residuals.

    rms: in the unit of the sensor kind, over measurements of that unit.
    """
    placements: set[int] = set()
    views: set[tuple[str, int]] = set()
    squares, n_candidates, n_inliers = [], 0, 0
    unit = UNIT_BY_SENSOR_KIND[sensor_kind]
    for group, assignment in sensor_groups(sensor, setup, result):
        is_inlier = assignment.feature >= 0
        n_candidates += int(assignment.is_candidate.sum())
        n_inliers += int((is_inlier & assignment.is_candidate).sum())
        if is_inlier.any():
            placements.add(group.placement)
            session = setup.placements[group.placement].session
            views |= {(session, int(v)) for v in np.unique(group.keypoints["view"][is_inlier])}
        if unit == RESIDUAL_KINDS[group.kind].UNIT:
            squares.append((assignment.residual[is_inlier] ** 2).sum(1))
    squared = np.concatenate(squares) if squares else np.zeros(0)
    return {
        "placements": len(placements),
        "observations": len(views),
        "points": n_inliers,
        "rejected_share": 1 - n_inliers / n_candidates if n_candidates else 0.0,
        "residual": {
            "rms": float(np.sqrt(squared.mean())) if len(squared) else None,
            "unit": unit,
        },
        "rejected_by_region": rejected_by_region(sensor, setup, result),
    }


def sensor_groups(sensor: str, setup: Setup, result: EstimationResult) -> SensorGroups:
    """Return the groups of one sensor with their assignments, without moving views."""
    pairs = zip(setup.groups, result.assignments, strict=True)
    return [(g, a) for g, a in pairs if g.sensor == sensor and not g.is_moving]


def rejected_by_region(sensor: str, setup: Setup, result: EstimationResult) -> list[dict[str, Any]]:
    """Return [{target, kind, region, count, n_measurements}] of the outliers of a sensor.

    n_measurements: extracted measurements of this kind on the target.
    """
    counts: dict[tuple[str, str, str], int] = {}
    n_measurements: dict[tuple[str, str], int] = {}
    for group, assignment in sensor_groups(sensor, setup, result):
        target = setup.placements[group.placement].target
        is_outlier, value = assignment.feature < 0, assignment.residual[:, 0]
        masks = (
            assignment.is_candidate & (value >= 0),
            assignment.is_candidate & (value < 0),
            ~assignment.is_candidate,
        )
        of_kind = target, group.kind
        n_measurements[of_kind] = n_measurements.get(of_kind, 0) + len(is_outlier)
        regions = REJECTION_REGIONS.get(group.kind, DEFAULT_REJECTION_REGIONS)
        for region, mask in zip(regions, masks, strict=True):
            key = target, group.kind, region
            counts[key] = counts.get(key, 0) + int(np.sum(is_outlier & mask))
    return [
        {
            "target": target,
            "kind": kind,
            "region": region,
            "count": count,
            "n_measurements": n_measurements[target, kind],
        }
        for (target, kind, region), count in sorted(counts.items())
        if count
    ]


def fit_statistics(
    sensor: str, setup: Setup, result: EstimationResult
) -> dict[str, dict[str, Any]]:
    """Return how well one sensor's residuals fit the noise model, by kind of measurement.

    rejected_share: of the candidates, outside the gate. sigma: noise; ideal_sigma: what extraction
    or the config would allow, both in unit. common_variance_share: of the variance, common to all
    repetitions in a placement. tail_share, systematic_ratio, repeated: see the functions of these
    names. Kinds that use template points do not follow this model.
    """
    out: dict[str, dict[str, Any]] = {}
    all_groups = sensor_groups(sensor, setup, result)
    for kind in sorted({g.kind for g, _ in all_groups}):
        if uses_template_points(kind):
            continue
        groups = [(g, a) for g, a in all_groups if g.kind == kind]
        noise = result.state.noise[sensor, kind]
        sizes = np.concatenate([np.abs(a.standardized)[a.feature >= 0] for _, a in groups])
        n_candidates = sum(int(a.is_candidate.sum()) for _, a in groups)
        ideal_sigma = float(np.median(np.concatenate([g.keypoints["sigma"] for g, _ in groups])))
        out[kind] = {
            "rejected_share": 1 - len(sizes) / n_candidates if n_candidates else 0.0,
            "sigma": noise.total * ideal_sigma,
            "ideal_sigma": ideal_sigma,
            "unit": RESIDUAL_KINDS[kind].UNIT,
            "common_variance_share": noise.common**2 / noise.total**2,
            "tail_share": tail_share(sizes),
            "systematic_ratio": systematic_residual_ratio(groups),
            "repeated": repeated_residuals_json(setup, groups),
        }
    return out


def tail_share(sizes: np.ndarray) -> float:
    """Return the share of absolute standardized residuals beyond 3 times their own robust scale.

    It is 0.27 % for a normal distribution. The scale is the larger one of σ = 1 and what their 80 %
    quantile shows, so that a noise that differs between views is no tail, but outliers are.
    """
    if not sizes.size:
        return 0.0
    scale = max(1.0, float(np.quantile(sizes, TAIL_QUANTILE)) / NORMAL_TAIL_QUANTILE)
    return float(np.mean(sizes > TAIL_SIGMA * scale))


def repeated_residuals_json(setup: Setup, groups: SensorGroups) -> dict[str, float] | None:
    """Return what the corner residuals of a camera repeat, by its cause; None for other kinds."""
    camera = setup.models[groups[0][0].sensor]
    is_used = any((a.feature >= 0).any() for _, a in groups)
    if groups[0][0].kind != "pattern_corner" or not isinstance(camera, CameraModel) or not is_used:
        return None
    columns = []
    targets = sorted(setup.targets)
    for g, a in groups:
        rows, n = a.feature >= 0, int((a.feature >= 0).sum())
        target = targets.index(setup.placements[g.placement].target)
        corner = a.feature[rows] * len(targets) + target
        uv = np.asarray(g.keypoints["uv"])[rows]
        columns.append((a.residual[rows], np.full(n, g.placement), corner, uv))
    corners = CornerResiduals(*(np.concatenate(parts) for parts in zip(*columns, strict=True)))
    return repeated_shares(corners, camera.size_px)._asdict()


def systematic_residual_ratio(groups: SensorGroups) -> float:
    """Return the rms of the mean residuals of features over all placements, in their σ.

    It is 1 if placements are independent. groups: of one kind.
    """
    sums: dict[int, np.ndarray] = {}
    weights: dict[int, float] = {}
    for group, assignment in groups:
        is_inlier = assignment.feature >= 0
        features = group.keypoints["feature_index"]
        if group.kind in TARGET_FEATURE_KINDS:
            features = assignment.candidate_feature
        for feature in np.unique(features[is_inlier]).tolist():
            rows = is_inlier & (features == feature)
            total = assignment.weight[rows] @ assignment.standardized[rows]
            sums[feature] = sums.get(feature, 0.0) + total
            weights[feature] = weights.get(feature, 0.0) + assignment.weight[rows].sum()
    means = [np.mean(sums[k] ** 2) / weights[k] for k in sums if weights[k] > 0]
    return float(np.sqrt(np.mean(means))) if means else 1.0


def guess_deviation_in_sigma(T_robot_sensor: np.ndarray, guess: dict[str, Any]) -> float | None:
    """Return the largest component by which a pose (4, 4) differs from its guess, in its σ.

    guess: guess.json. None without a guess.
    """
    if guess["T_robot_sensor"] is None:
        return None
    T_guess = np.array(guess["T_robot_sensor"]["matrix"])
    shift = se3_log(invert_pose(T_guess) @ T_robot_sensor)
    return float((np.abs(shift) / np.array(guess["sigma"])).max())


def target_directions(
    sensor: str, setup: Setup, result: EstimationResult
) -> tuple[TargetDirections, int]:
    """Return the target directions of the placements that a sensor used, and their number."""
    groups = sensor_groups(sensor, setup, result)
    used = sorted({g.placement for g, a in groups if (a.feature >= 0).any()})
    shapes = [setup.targets[setup.placements[k].target] for k in used]
    poses = [pose_chain.T_robot_target(setup, result.state, k) for k in used]
    return normals_and_axes(shapes, np.reshape(poses, (-1, 4, 4))), len(used)


def leave_one_out_statistics(
    sensor: str, leave_one_outs: Sequence[LeaveOneOut]
) -> dict[str, Any] | None:
    """Return the rms leave-one-out errors of one sensor, None if there are none.

    error_over_sigma: the error over its predicted σ, over n_directions.
    """
    errors = [
        left.error_by_sensor[sensor] for left in leave_one_outs if sensor in left.error_by_sensor
    ]
    if not errors:
        return None
    twists = np.stack([e.error for e in errors])
    n_directions = sum(e.n_directions for e in errors)
    return {
        "placements": len(errors),
        "n_directions": n_directions,
        "rms_m": float(np.sqrt(np.mean(np.sum(twists[:, :3] ** 2, 1)))),
        "rms_rad": float(np.sqrt(np.mean(np.sum(twists[:, 3:] ** 2, 1)))),
        "error_over_sigma": float(np.sqrt(sum(e.nees for e in errors) / n_directions)),
    }


def influences_json(setup: Setup, leave_one_outs: Sequence[LeaveOneOut]) -> list[dict[str, Any]]:
    """Return [{session, target, placement, sensors}] of the placements that were left out.

    sensors: {name: {influence, nees, n_directions}}; influence is None if the other placements do
    not determine the pose.
    """
    numbers = {g.placement: int(g.keypoints["placement"][0]) for g in setup.groups}
    out = []
    for left in leave_one_outs:
        place = setup.placements[left.placement]
        names = left.error_by_sensor or left.influence_by_sensor
        out.append(
            {
                "session": place.session,
                "target": place.target,
                "placement": numbers[left.placement],
                "sensors": {name: _influence_json(left, name) for name in names},
            }
        )
    return out


def _influence_json(left: LeaveOneOut, sensor: str) -> dict[str, Any]:
    influence, error = left.influence_by_sensor[sensor], left.error_by_sensor.get(sensor)
    return {
        "influence": influence if np.isfinite(influence) else None,
        "nees": error.nees if error else None,
        "n_directions": error.n_directions if error else 0,
    }
