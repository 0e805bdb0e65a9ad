"""A cylinder's silhouette in an image: the largest blob of its colour, its edge to a fraction of a
pixel, and which of its points lie on the straight sides.

Pixels are (u, v) with (0, 0) at the centre of the top-left pixel; colours are BGR, grey levels.
"""

from typing import NamedTuple

import cv2
import numpy as np
from scipy.ndimage import binary_erosion

from calib.io.status import OK, Status, failure_status
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.camera.silhouette_edges import SubpixelEdges, refine_outline
from calib.targets.color import Color
from calib.targets.target_shapes import TargetShape

MIN_BLOB_AREA_PX2 = 1000
MAX_BLOB_AREA_RATIO = 1.5  # to the expected area, and its inverse
MIN_LIMB_POINTS = 20
CENTRAL_LIMB_SHARE = 0.35  # of the blob's length, to either side of its middle: limbs, never caps
MAX_FLANK_SINE = np.sin(np.deg2rad(30))  # between a limb's normals and those of the blob's axis
MIN_BLOB_AXIS_COSINE = np.cos(np.deg2rad(25))  # between the blob's axis and the expected one
MAX_LIMB_DISTANCE_PX = 1.5  # off the plane of a limb
LIMB_END_TRIM_PX = 8  # cut off where a limb ends
LIMB_OUTLIER_MARGIN_PX = 0.5  # off the plane of a limb, beyond 2 sigma, of a measured edge
# Scales, px, of Tukey's weight in the rounds of a limb's fit; None: all weigh the same.
LIMB_FIT_SCALES_PX = (None, 3.0, 1.0, 0.5, 0.3, 0.3)


class Silhouette(NamedTuple):
    """The closed edge of a cylinder, in pixels of the whole image.

    side: (n,) of each point, the sign of d · (c × a) for its ray d, the axis' direction a and a
    point c on it; 0 is off the limbs.
    """

    edges: SubpixelEdges
    side: np.ndarray


def find_cylinder_silhouette(
    image: np.ndarray,
    offset: np.ndarray,
    color: Color,
    camera: CameraModel,
    *,
    target: TargetShape,
    T_camera_target: np.ndarray,
) -> tuple[Silhouette | None, Status]:
    """Find the silhouette of a cylinder of a colour in a region (h, w, 3) uint8 of an image.

    offset: (2,) pixel of the image at the region's (0, 0). The pose (4, 4) may be a guess.
    """
    outline = find_color_contour(image, color)
    if outline is None:
        return None, failure_status(
            "nothing of the target's colour", remedy="Check `color` of the target, and the light."
        )
    expected_area = _predict_area(camera, target, T_camera_target)
    status = check_color_blob(image, outline, expected_area)
    if not status.ok:
        return None, status
    edges = refine_outline(image, outline)
    edges = edges._replace(uv=edges.uv + offset)
    side = assign_limb_sides(edges, camera, T_camera_target)
    count = np.count_nonzero(side)
    if count < MIN_LIMB_POINTS:
        return None, failure_status(
            "too little of the cylinder's straight sides is visible",
            f"{count} points",
            f"{MIN_LIMB_POINTS} or more",
            "Remove what hides it, or place it in front of a plain background.",
        )
    return Silhouette(edges, side), OK


def find_color_contour(image: np.ndarray, color: Color) -> np.ndarray | None:
    """Return the border pixels (n, 2), in order, of the largest blob of a colour, holes filled.

    Returns None if there is no such blob.
    """
    square = np.ones((3, 3), np.uint8)
    mask = cv2.morphologyEx(np.pad(color.mask(image).astype(np.uint8), 2), cv2.MORPH_CLOSE, square)
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, square)
    blobs = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    if not blobs:
        return None
    return max(blobs, key=cv2.contourArea)[:, 0].astype(float) - 2


def check_color_blob(image: np.ndarray, outline: np.ndarray, expected_area: float) -> Status:
    """Return whether a blob's outline (n, 2) can be a target of the expected area, px²."""
    area = cv2.contourArea(outline.astype(np.float32))
    if area < MIN_BLOB_AREA_PX2:
        return failure_status(
            "the blob of the target's colour is too small",
            f"{area:.0f} px²",
            f"{MIN_BLOB_AREA_PX2} px² or more",
            "Bring the target nearer, or check `color` of the target.",
        )
    height, width = image.shape[:2]
    if (outline.min(0) < 1).any() or (outline.max(0) > [width - 2, height - 2]).any():
        return failure_status(
            "the blob of the target's colour touches the border of the image region",
            "",
            "a target wholly in view",
            "Move the target towards the middle of the view.",
        )
    if not expected_area / MAX_BLOB_AREA_RATIO < area < expected_area * MAX_BLOB_AREA_RATIO:
        return failure_status(
            "the blob of the target's colour does not have the target's size",
            f"{area:.0f} px²",
            f"{expected_area:.0f} px² within a factor {MAX_BLOB_AREA_RATIO}",
            "Remove other things of that colour and what hides the target, or check the guess.",
        )
    return OK


def _predict_area(camera: CameraModel, target: TargetShape, T_camera_target: np.ndarray) -> float:
    """Return the area, px², of the target's outline; 0 if the lens cannot see all of it."""
    points = target.outline_points() @ T_camera_target[:3, :3].T + T_camera_target[:3, 3]
    uv, is_valid = camera.project(points)
    return cv2.contourArea(cv2.convexHull(uv.astype(np.float32))) if is_valid.all() else 0.0


def assign_limb_sides(
    edges: SubpixelEdges, camera: CameraModel, T_camera_target: np.ndarray
) -> np.ndarray:
    """Return the side (n,), -1 or 1, of edges (in pixels of the image) on a limb, 0 elsewhere.

    A limb lies in a plane through the camera, whatever the lens. Each is fitted to the points on
    one side of the blob's own main axis; the guess only shows which of its ends is which. All are 0
    if the cylinder is seen so much from its end that the blob is not longest along its axis.
    """
    side = np.zeros(len(edges.uv), int)
    middle, axis, is_aligned = _main_axis(edges.uv, camera, T_camera_target)
    rays, has_ray = camera.unproject(edges.uv)
    rays_outward, has_ray_outward = camera.unproject(edges.uv + edges.normal)
    along = (edges.uv - middle) @ axis
    ends = camera.unproject(middle + 0.2 * np.outer([-1, 1], np.ptp(along) * axis))[0]
    half = np.where(rays @ np.cross(*ends) > 0, 1, -1)
    is_usable = has_ray & has_ray_outward & is_aligned
    is_flank = is_usable & edges.is_measured & (np.abs(edges.normal @ axis) < MAX_FLANK_SINE)
    is_flank &= np.abs(along - (along.max() + along.min()) / 2) < CENTRAL_LIMB_SHARE * np.ptp(along)
    for sign in (-1, 1):
        is_seed = is_flank & (half == sign)
        if np.count_nonzero(is_seed) >= MIN_LIMB_POINTS:
            distance = np.abs(_distance_from_plane(rays, rays_outward, is_seed))
            is_near = is_usable & (half == sign) & (distance < MAX_LIMB_DISTANCE_PX)
            is_inlier = distance < LIMB_OUTLIER_MARGIN_PX + 2 * edges.sigma
            side[_trim_limb_ends(is_near) & edges.is_measured & is_inlier] = sign
    return side


def _main_axis(
    uv: np.ndarray, camera: CameraModel, T_camera_target: np.ndarray
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Return middle (2,), px, and main axis (2,) of the area in an outline uv (n, 2).

    The axis points to the end that the guess puts at +x; the last value says whether the guess
    agrees on its direction.
    """
    m = cv2.moments(uv.astype(np.float32))
    spread = np.array([[m["mu20"], m["mu11"]], [m["mu11"], m["mu02"]]])
    axis = np.linalg.eigh(spread)[1][:, 1]
    half = T_camera_target[:3, 0] * 0.01 * np.linalg.norm(T_camera_target[:3, 3])
    low, high = camera.project(T_camera_target[:3, 3] + np.outer([-1, 1], half))[0]
    cosine = axis @ (high - low) / max(np.linalg.norm(high - low), 1e-9)
    middle = np.array([m["m10"], m["m01"]]) / m["m00"]
    return middle, np.copysign(1, cosine) * axis, bool(abs(cosine) > MIN_BLOB_AXIS_COSINE)


def _distance_from_plane(
    rays: np.ndarray, rays_outward: np.ndarray, is_seed: np.ndarray
) -> np.ndarray:
    """Return the distances (n,), px outwards, of rays (n, 3) from the plane of most seeds (n,).

    rays_outward: (n, 3) the rays one pixel outwards, which convert angles into pixels.
    """
    weight = is_seed.astype(float)
    distance = np.zeros(len(rays))
    for scale in LIMB_FIT_SCALES_PX:
        if scale is not None:
            weight = is_seed * np.clip(1 - (distance / (3 * scale)) ** 2, 0, None) ** 2
        normal = np.linalg.eigh((rays * weight[:, None]).T @ rays)[1][:, 0]
        distance = rays @ normal / np.maximum(np.abs((rays_outward - rays) @ normal), 1e-12)
    return distance


def _trim_limb_ends(is_straight: np.ndarray) -> np.ndarray:
    """Clear the flags (n,) of a closed row that are LIMB_END_TRIM_PX or less from a cleared one."""
    n = LIMB_END_TRIM_PX
    row = np.concatenate([is_straight[-n:], is_straight, is_straight[:n]])
    return binary_erosion(row, np.ones(2 * n + 1))[n:-n]
