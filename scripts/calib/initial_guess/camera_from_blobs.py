"""Find the pose of a camera from coloured bodies in its images.

Each blob gives a bearing, an axis and a size. Three bearings to bodies of known position leave at
most four poses (perspective three-point problem); the other blobs decide between them. All blobs
that agree are then fitted together.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import cv2
import numpy as np
from scipy.optimize import least_squares

from calib.geometry.se3 import invert_pose, se3_exp, transform_points
from calib.initial_guess.bearing_pnp import solve_p3p
from calib.initial_guess.initial_guess import PoseGuess
from calib.initial_guess.pose_voting import SearchCounts, min_pose_sigma, no_consensus_status
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.camera.cylinder_silhouette import MIN_BLOB_AREA_PX2, find_color_contour
from calib.targets.color import Color
from calib.targets.target_shapes import TargetShape
from calib.views.initial_guess_frames import FrameSample, read_samples
from calib.views.sensor_croppers import FrameReader

MIN_BLOB_PLACEMENTS = 4  # three give poses, the fourth decides between them
MAX_TRIPLE_BLOBS = 8  # blobs that triples are drawn from
MAX_BLOB_STARTS = 10  # poses by three blobs that are fitted to all
# Misfits of position, axis and size after the fit, in units of the size of the blob.
MAX_BLOB_MISFIT = 0.1
HIDDEN_BLOB_MISFIT = 10.0  # of a blob where the target would be outside of what the lens sees
BLOB_FIT_SCALE = 0.02  # of the robust loss


class BlobView(NamedTuple):
    """A frame and the features (5,), px, of the blob in it (blob_features)."""

    sample: FrameSample
    features: np.ndarray


class BlobPose(NamedTuple):
    """T_robot_camera (4, 4), None without blobs, and the rows of the blobs that agree with it."""

    T_robot_camera: np.ndarray | None
    rows: np.ndarray


class BlobFit(NamedTuple):
    """T_robot_camera (4, 4) and its σ (6,), m and rad."""

    T_robot_camera: np.ndarray
    sigma: np.ndarray


def count_required_blobs(options: dict[str, Any]) -> int:
    """Return how many placements must agree on a pose by colour. options: block `guess`."""
    return max(MIN_BLOB_PLACEMENTS, options["min_placements"])


def find_camera_from_blobs(
    camera: CameraModel,
    targets: Mapping[str, TargetShape],
    samples: Sequence[FrameSample],
    read_frame: FrameReader,
    options: dict[str, Any],
) -> PoseGuess:
    """Search the pose that most blobs of the targets' colours agree on. options: block `guess`."""
    blobs: list[BlobView] = []
    colored = [sample for sample in samples if targets[sample.target].color]
    for sample, image in read_samples(colored, read_frame):
        color = targets[sample.target].color
        assert color is not None  # `colored` has no others
        features = read_blob(color, image)
        blobs += [] if features is None else [BlobView(sample, features)]
        if len(blobs) >= options["max_pattern_images"]:
            break
    n_required = count_required_blobs(options)
    pose = BlobPose(None, np.zeros(0, int))
    if len(blobs) >= n_required:
        pose = find_best_blob_pose(camera, targets, blobs)
    n_agreeing = len(pose.rows)
    if pose.T_robot_camera is None or n_agreeing < n_required:
        counts = SearchCounts(n_agreeing, 0, len(blobs), len(colored), n_required)
        return PoseGuess(status=no_consensus_status("coloured body", counts))
    fit = fit_blob_pose(camera, targets, [blobs[i] for i in pose.rows], pose.T_robot_camera)
    basis = f"the coloured body in {n_agreeing} of {len(blobs)} images that show one"
    return PoseGuess(fit.T_robot_camera, np.maximum(fit.sigma, min_pose_sigma(options)), basis)


def read_blob(color: Color, image: np.ndarray) -> np.ndarray | None:
    """Return the features (5,) of the largest blob of a colour in an image (h, w, 3).

    None if there is none, it is too small, or it reaches the border of the image.
    """
    outline = find_color_contour(image, color)
    if outline is None or cv2.contourArea(outline.astype(np.float32)) < MIN_BLOB_AREA_PX2:
        return None
    height, width = image.shape[:2]
    is_cut = (outline.min(0) < 1).any() or (outline.max(0) > [width - 2, height - 2]).any()
    return None if is_cut else blob_features(outline)


def blob_features(outline: np.ndarray) -> np.ndarray:
    """Return features (5,), px, of the area inside an outline (n, 2).

    Its centroid (u, v), and the symmetric square root of its second central moments (uu, uv, vv),
    which describes axis and size.
    """
    origin = outline.mean(0)
    p, q = outline - origin, np.roll(outline - origin, -1, 0)
    cross = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
    area = cross.sum() / 2
    centroid = cross @ (p + q) / (6 * area)
    products = _outer_products(p, p) + _outer_products(q, q) + _outer_products(p + q, p + q)
    moments = np.einsum("n,nij->ij", cross, products) / 24
    values, vectors = np.linalg.eigh(moments / area - np.outer(centroid, centroid))
    root = vectors * np.sqrt(np.maximum(values, 0)) @ vectors.T
    return np.concatenate([origin + centroid, root[[0, 0, 1], [0, 1, 1]]])


def _outer_products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, :, None] * b[:, None, :]


def blob_misfit(
    camera: CameraModel,
    targets: Mapping[str, TargetShape],
    blobs: Sequence[BlobView],
    T_robot_camera: np.ndarray,
) -> np.ndarray:
    """Return differences (k, 5) of expected and measured features, in units of the blob's size."""
    misfit = np.full((len(blobs), 5), HIDDEN_BLOB_MISFIT)
    for i, (sample, features) in enumerate(blobs):
        T = invert_pose(T_robot_camera) @ sample.T_robot_target
        uv, is_valid = camera.project(transform_points(T, targets[sample.target].outline_points()))
        if is_valid.all():
            hull = cv2.convexHull(uv.astype(np.float32), returnPoints=False)[:, 0]
            misfit[i] = (blob_features(uv[hull]) - features) / np.linalg.norm(features[2:])
    return misfit


def find_best_blob_pose(
    camera: CameraModel, targets: Mapping[str, TargetShape], blobs: Sequence[BlobView]
) -> BlobPose:
    """Return the pose that fits most blobs best.

    Poses by three blobs are inaccurate if these are close together, so the best of them are fitted
    to all blobs.
    """
    starts = sorted(solve_blob_triples(camera, targets, blobs), key=lambda start: start[0])
    best, lowest_cost = BlobPose(None, np.zeros(0, int)), np.inf
    for _, start in starts[:MAX_BLOB_STARTS]:
        T = fit_blob_pose(camera, targets, blobs, start).T_robot_camera
        size = np.abs(blob_misfit(camera, targets, blobs, T)).max(1)
        cost = np.minimum(size, MAX_BLOB_MISFIT).sum()
        if cost < lowest_cost:
            best, lowest_cost = BlobPose(T, np.flatnonzero(size < MAX_BLOB_MISFIT)), cost
    return best


def solve_blob_triples(
    camera: CameraModel, targets: Mapping[str, TargetShape], blobs: Sequence[BlobView]
) -> list[tuple[float, np.ndarray]]:
    """Return (misfit of all blobs, T_robot_camera (4, 4)) for every three blobs."""
    rays, _ = camera.unproject(np.array([features[:2] for _, features in blobs]))
    centres = np.array(
        [transform_points(s.T_robot_target, targets[s.target].centre) for s, _ in blobs]
    )
    starts = []
    for triple in combinations(range(min(len(blobs), MAX_TRIPLE_BLOBS)), 3):
        for T in solve_p3p(rays[list(triple)], centres[list(triple)]):
            size = np.abs(blob_misfit(camera, targets, blobs, T)).max(1)
            starts.append((np.minimum(size, 1).sum(), T))
    return starts


def fit_blob_pose(
    camera: CameraModel,
    targets: Mapping[str, TargetShape],
    blobs: Sequence[BlobView],
    T_robot_camera: np.ndarray,
) -> BlobFit:
    """Fit the pose to all blobs by robust least squares, from a pose near it.

    σ follows from the scatter of the residuals, five per blob.
    """

    def residual(xi: np.ndarray) -> np.ndarray:
        return blob_misfit(camera, targets, blobs, T_robot_camera @ se3_exp(xi)).reshape(-1)

    fit = least_squares(
        residual, np.zeros(6), loss="soft_l1", f_scale=BLOB_FIT_SCALE, x_scale="jac"
    )
    variance = 2 * fit.cost / max(len(fit.fun) - 6, 1)
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * variance
    return BlobFit(T_robot_camera @ se3_exp(fit.x), np.sqrt(np.diag(covariance)))
