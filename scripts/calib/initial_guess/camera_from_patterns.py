"""Find the pose of a camera from the printed patterns in its images.

Each image alone gives the pose, up to a few readings of the pattern; the reading on which most
placements agree is right.
"""

from collections.abc import Mapping, Sequence
from itertools import zip_longest
from typing import Any, NamedTuple

import numpy as np

from calib.geometry.se3 import invert_pose, mean_pose, transform_points
from calib.initial_guess.bearing_pnp import solve_planar_pnp
from calib.initial_guess.camera_from_blobs import count_required_blobs, find_camera_from_blobs
from calib.initial_guess.initial_guess import PoseGuess
from calib.initial_guess.pose_voting import (
    PoseTolerance,
    PoseVote,
    SearchCounts,
    describe_scatter,
    is_decisive,
    min_pose_sigma,
    no_consensus_status,
    too_few_samples_status,
    vote_for_pose,
)
from calib.io.status import OK, Status
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.camera.images.image_messages import to_grey
from calib.targets.target_shapes import TargetShape
from calib.views.initial_guess_frames import FrameSample, read_samples
from calib.views.sensor_croppers import FrameReader

# A reading is left out if it reprojects worse than this many times the best one of its image, or
# than this share of the spacing of the corners.
MAX_REPROJECTION_RATIO = 4.0
MAX_REPROJECTION_SHARE = 0.1


class PatternReading(NamedTuple):
    """T_robot_camera (4, 4) by one reading of the pattern in one placement."""

    placement: int
    T_robot_camera: np.ndarray


def find_camera_pose(
    camera: CameraModel,
    targets: Mapping[str, TargetShape],
    samples: list[FrameSample],
    read_frame: FrameReader,
    options: dict[str, Any],
) -> PoseGuess:
    """Search T_robot_camera by printed patterns, or by coloured bodies if these do not suffice.

    options: block `guess`.
    """
    by_target = [
        [sample for sample in samples if sample.target == name]
        for name in sorted(targets)
        if targets[name].pattern
    ]
    # One placement of each target after the other, until enough images show a pattern.
    in_turn = (s for turn in zip_longest(*by_target) for s in turn if s is not None)
    readings, n_found = [], 0
    for sample, image in read_samples(in_turn, read_frame):
        poses = read_pattern_poses(camera, targets[sample.target], image)
        readings += [
            PatternReading(sample.placement, sample.T_robot_target @ invert_pose(T)) for T in poses
        ]
        n_found += bool(poses)
        if n_found >= options["max_pattern_images"]:
            break
    by_pattern = vote_pattern_pose(readings, n_found, sum(map(len, by_target)), options)
    if by_pattern.status.ok or not any(targets[s.target].color for s in samples):
        return by_pattern
    by_color = find_camera_from_blobs(camera, targets, samples, read_frame, options)
    return by_color if by_color.status.ok or not n_found else by_pattern


def check_camera_samples(
    targets: Mapping[str, TargetShape], sampled_targets: Sequence[str], options: dict[str, Any]
) -> Status:
    """Return ok if there are enough placements to search a camera's pose in (SampleCheck)."""
    n_pattern = sum(targets[name].pattern is not None for name in sampled_targets)
    n_color = sum(targets[name].color is not None for name in sampled_targets)
    n_required = options["min_placements"]
    if n_pattern >= n_required or n_color >= count_required_blobs(options):
        return OK
    if n_pattern or not n_color:
        return too_few_samples_status("target with a pattern", n_pattern, n_required)
    return too_few_samples_status("target with a color", n_color, count_required_blobs(options))


def read_pattern_poses(
    camera: CameraModel, target: TargetShape, image: np.ndarray
) -> list[np.ndarray]:
    """Return T_camera_target (4, 4) for every reading of the pattern in an image (h, w, 3)."""
    assert target.pattern is not None
    uv = target.pattern.detect_corners_fast(to_grey(image))
    return [] if uv is None else solve_pattern_poses(camera, target, uv)


def solve_pattern_poses(
    camera: CameraModel, target: TargetShape, uv: np.ndarray
) -> list[np.ndarray]:
    """Return T_camera_target (4, 4) for every reading of corners uv (n, 2) in detected order.

    Every labelling and both solutions of a plane are tried. Readings that show the target from
    behind, or reproject much worse than the best one, are left out.
    """
    assert target.pattern is not None
    corners = target.pattern.corners()
    rays, is_valid = camera.unproject(uv)
    if not is_valid.all():
        return []
    readings = []
    for labels in target.pattern.corner_orders():
        for T in solve_planar_pnp(rays, corners[labels]):
            projected, is_projected = camera.project(transform_points(T, corners[labels]))
            if is_projected.all() and target.check_facing(invert_pose(T)[:3, 3])[0]:
                readings.append((np.sqrt(((projected - uv) ** 2).sum(1).mean()), T))
    spacing = np.sort(np.linalg.norm(uv[:, None] - uv[None], axis=-1), axis=1)[:, 1].mean()
    best = min((error for error, _ in readings), default=np.inf)
    limit = min(MAX_REPROJECTION_SHARE * spacing, MAX_REPROJECTION_RATIO * best + 0.1)
    return [T for error, T in readings if error <= limit]


def vote_pattern_pose(
    readings: list[PatternReading], n_found: int, n_searched: int, options: dict[str, Any]
) -> PoseGuess:
    """Return the mean of the readings that agree, one per placement.

    n_found: placements whose image shows a pattern, of n_searched.
    """
    group = np.array([placement for placement, _ in readings], int)
    T = np.reshape([pose for _, pose in readings], (-1, 4, 4))
    vote = PoseVote(group, 0)
    if len(T):
        vote = vote_for_pose(T, group, PoseTolerance.from_options(options))
    n_agreeing, n_required = len(vote.rows), options["min_placements"]
    if n_agreeing < n_required or not is_decisive(n_agreeing, vote.n_rival_votes):
        counts = SearchCounts(n_agreeing, vote.n_rival_votes, n_found, n_searched, n_required)
        return PoseGuess(status=no_consensus_status("pattern", counts))
    mean, xi = mean_pose(T[vote.rows])
    sigma = np.maximum(np.sqrt((xi**2).sum(0) / (len(xi) - 1) / len(xi)), min_pose_sigma(options))
    basis = (
        f"the pattern in {n_agreeing} of {n_found} images that show one, {n_searched} placements, "
        f"agree to {describe_scatter(xi)}"
    )
    return PoseGuess(mean, sigma, basis)
