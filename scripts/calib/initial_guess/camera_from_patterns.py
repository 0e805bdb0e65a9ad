"""A camera from the patterns that its images show: every image alone tells where it sits."""

from itertools import zip_longest

import numpy as np

from calib.geometry.se3 import invert_pose, mean_pose, transform_points
from calib.initial_guess.bearing_pnp import solve_planar_pnp
from calib.initial_guess.camera_from_blobs import find_camera_from_blobs
from calib.initial_guess.frame_sampling import read_samples
from calib.initial_guess.pose_guess import PoseGuess
from calib.initial_guess.pose_voting import (
    agreement_tolerance,
    describe_scatter,
    is_decisive,
    min_pose_sigma,
    no_consensus_status,
    vote_for_pose,
)
from calib.sensors.camera.images.image_messages import to_grey

MAX_REPROJECTION_RATIO = (
    4.0  # a reading that reprojects this much worse than the best of its image is out
)
MAX_REPROJECTION_SHARE = (
    0.1  # of the corners' spacing: a reading that reprojects worse is none of this pattern
)


def find_camera_pose(camera, targets, samples, read_frame, options):
    """Found: by printed patterns; by coloured bodies where they show too little."""
    patterned = [
        [k for k in samples if k.target == n] for n in sorted(targets) if targets[n].pattern
    ]
    readings, seen = [], 0
    # In turn over the targets, until enough is found.
    in_turn = (k for turn in zip_longest(*patterned) for k in turn if k is not None)
    for look, image in read_samples(in_turn, read_frame):
        found = read_pattern_poses(camera, targets[look.target], image)
        readings += [(look.placement, look.T_robot_target @ invert_pose(T)) for T in found]
        seen += bool(found)
        if seen >= options["max_pattern_images"]:
            break
    by_pattern = vote_pattern_pose(readings, seen, sum(map(len, patterned)), options)
    if by_pattern.status.ok or not any(targets[k.target].color for k in samples):
        return by_pattern
    by_color = find_camera_from_blobs(camera, targets, samples, read_frame, options)
    return by_color if by_color.status.ok or not seen else by_pattern


def read_pattern_poses(camera, target, image):
    """[T_camera_target (4, 4)]: every reading of the target's pattern in an image (h, w, 3)."""
    uv = target.pattern.detect_corners_fast(to_grey(image))
    return [] if uv is None else solve_pattern_poses(camera, target, uv)


def solve_pattern_poses(camera, target, uv):
    """[T_camera_target (4, 4)] of corners uv (n, 2) in the detector's order, as it may be read.

    Every labelling and both solutions of a plane are tried; what shows the target from where it
    cannot be seen, or reprojects much worse than another, is left out.
    """
    corners = target.pattern.corners()
    rays, ok = camera.unproject(uv)
    if not ok.all():
        return []
    found = []
    for labels in target.pattern.corner_orders():
        for T in solve_planar_pnp(rays, corners[labels]):
            again, valid = camera.project(transform_points(T, corners[labels]))
            if valid.all() and target.check_facing(invert_pose(T)[:3, 3])[0]:
                found.append((np.sqrt(((again - uv) ** 2).sum(1).mean()), T))
    spacing = np.sort(np.linalg.norm(uv[:, None] - uv[None], axis=-1), axis=1)[:, 1].mean()
    best = min((misfit for misfit, _ in found), default=np.inf)
    most = min(MAX_REPROJECTION_SHARE * spacing, MAX_REPROJECTION_RATIO * best + 0.1)
    return [T for misfit, T in found if misfit <= most]


def vote_pattern_pose(readings, n_seen, n_samples, options):
    """Found: the mean of the readings, one per placement, that agree."""
    group = np.array([g for g, _ in readings], int)
    T = np.reshape([T for _, T in readings], (-1, 4, 4))
    tolerance = agreement_tolerance(options)
    rows, rival = vote_for_pose(T, group, tolerance) if len(T) else (group, 0)
    least = options["min_placements"]
    if len(rows) < least or not is_decisive(len(rows), rival):
        return PoseGuess(
            status=no_consensus_status("pattern", len(rows), rival, n_seen, n_samples, least)
        )
    mean, xi = mean_pose(T[rows])
    sigma = np.maximum(np.sqrt((xi**2).sum(0) / (len(xi) - 1) / len(xi)), min_pose_sigma(options))
    basis = f"the pattern in {len(rows)} of {n_seen} images that show one, {n_samples} placements"
    return PoseGuess(mean, sigma, basis + f", agree to {describe_scatter(xi)}")
