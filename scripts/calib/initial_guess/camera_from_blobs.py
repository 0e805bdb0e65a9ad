"""A camera from the coloured bodies that its images show: each blob is a bearing, an axis, a size.

Three bearings to bodies of known place leave at most four poses (the perspective three-point
problem); what the other blobs look like says which. All that agree are then fitted together.
"""

from itertools import combinations

import cv2
import numpy as np
from scipy.optimize import least_squares

from calib.geometry.se3 import invert_pose, se3_exp, transform_points
from calib.initial_guess.bearing_pnp import solve_p3p
from calib.initial_guess.frame_sampling import read_samples
from calib.initial_guess.pose_guess import PoseGuess
from calib.initial_guess.pose_voting import min_pose_sigma, no_consensus_status
from calib.sensors.camera.cylinder_silhouette import MIN_BLOB_AREA_PX2, find_color_contour

MIN_BLOB_PLACEMENTS = 4  # placements: three give poses, another says which
MAX_TRIPLE_BLOBS = 8  # blobs that triples are drawn from
MAX_BLOB_STARTS = 10  # poses by three blobs that are fitted to all
MAX_BLOB_MISFIT = (
    0.1  # of a blob's own size: what its place, axis and size may be off after the fit
)
HIDDEN_BLOB_MISFIT = 10.0  # misfit of a blob where the lens would see no target


def find_camera_from_blobs(camera, targets, samples, read_frame, options):
    """Found: the pose that most blobs of the targets' colours agree on."""
    seen, wanted = [], [k for k in samples if targets[k.target].color]
    for look, image in read_samples(wanted, read_frame):
        blob = read_blob(targets[look.target].color, image)
        seen += [] if blob is None else [(look, blob)]
        if len(seen) >= options["max_pattern_images"]:
            break
    least = max(MIN_BLOB_PLACEMENTS, options["min_placements"])
    T, rows = find_best_blob_pose(camera, targets, seen) if len(seen) >= least else (None, [])
    if len(rows) < least:
        counts = len(rows), 0, len(seen), len(wanted), least
        return PoseGuess(status=no_consensus_status("coloured body", *counts))
    T, sigma = fit_blob_pose(camera, targets, [seen[i] for i in rows], T)
    basis = f"the coloured body in {len(rows)} of {len(seen)} images that show one"
    return PoseGuess(T, np.maximum(sigma, min_pose_sigma(options)), basis)


def read_blob(color, image):
    """Features (5,) of the largest blob of a colour in an image (h, w, 3), if it is all in it."""
    outline = find_color_contour(image, color)
    if outline is None or cv2.contourArea(outline.astype(np.float32)) < MIN_BLOB_AREA_PX2:
        return None
    height, width = image.shape[:2]
    cut = (outline.min(0) < 1).any() or (outline.max(0) > [width - 2, height - 2]).any()
    return None if cut else blob_features(outline)


def blob_features(outline):
    """Features (5,), px, of the area in an outline (n, 2): its middle, and the symmetric root of
    its second moments (uu, uv, vv), which tells its axis and its size."""
    rough = outline.mean(0)
    p, q = outline - rough, np.roll(outline - rough, -1, 0)
    cross = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
    area = cross.sum() / 2
    middle = cross @ (p + q) / (6 * area)
    both = (
        np.einsum(
            "n,nij->ij",
            cross,
            _outer_products(p, p) + _outer_products(q, q) + _outer_products(p + q, p + q),
        )
        / 24
    )
    values, vectors = np.linalg.eigh(both / area - np.outer(middle, middle))
    root = vectors * np.sqrt(np.maximum(values, 0)) @ vectors.T
    return np.concatenate([rough + middle, root[[0, 0, 1], [0, 1, 1]]])


def _outer_products(a, b):
    return a[:, :, None] * b[:, None, :]


def blob_misfit(camera, targets, blobs, T_robot_camera):
    """Differences (k, 5) of the blobs' features from those expected, in units of their size."""
    out = np.full((len(blobs), 5), HIDDEN_BLOB_MISFIT)
    for i, (look, blob) in enumerate(blobs):
        T = invert_pose(T_robot_camera) @ look.T_robot_target
        uv, valid = camera.project(transform_points(T, targets[look.target].outline_points()))
        if valid.all():
            hull = cv2.convexHull(uv.astype(np.float32), returnPoints=False)[:, 0]
            expected = blob_features(uv[hull])
            out[i] = (expected - blob) / np.linalg.norm(blob[2:])
    return out


def find_best_blob_pose(camera, targets, blobs):
    """(T_robot_camera (4, 4), rows of the blobs that agree with it) of what fits most blobs best.

    Poses by three blobs are far off when those lie close together: the likeliest are fitted to all.
    """
    starts = sorted(solve_blob_triples(camera, targets, blobs), key=lambda s: s[0])[
        :MAX_BLOB_STARTS
    ]
    best, rows, lowest = None, [], np.inf
    for _, start in starts:
        T, _ = fit_blob_pose(camera, targets, blobs, start)
        size = np.abs(blob_misfit(camera, targets, blobs, T)).max(1)
        if np.minimum(size, MAX_BLOB_MISFIT).sum() < lowest:
            best, rows = T, np.flatnonzero(size < MAX_BLOB_MISFIT)
            lowest = np.minimum(size, MAX_BLOB_MISFIT).sum()
    return best, rows


def solve_blob_triples(camera, targets, blobs):
    """[(misfit of all blobs, T_robot_camera (4, 4))] of every three blobs."""
    rays, _ = camera.unproject(np.array([blob[:2] for _, blob in blobs]))
    middles = [transform_points(k.T_robot_target, targets[k.target].centre) for k, _ in blobs]
    out = []
    for triple in combinations(range(min(len(blobs), MAX_TRIPLE_BLOBS)), 3):
        for T in solve_p3p(rays[list(triple)], np.array(middles)[list(triple)]):
            size = np.abs(blob_misfit(camera, targets, blobs, T)).max(1)
            out.append((np.minimum(size, 1).sum(), T))
    return out


def fit_blob_pose(camera, targets, blobs, T_robot_camera):
    """(T_robot_camera (4, 4), σ (6,)) that fits the blobs best, robustly, from a pose near it.

    σ from the scatter of what is left, five numbers per blob.
    """

    def residual(x):
        return blob_misfit(camera, targets, blobs, T_robot_camera @ se3_exp(x)).reshape(-1)

    found = least_squares(residual, np.zeros(6), loss="soft_l1", f_scale=0.02, x_scale="jac")
    scale = 2 * found.cost / max(len(found.fun) - 6, 1)
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * scale
    return T_robot_camera @ se3_exp(found.x), np.sqrt(np.diag(covariance))
