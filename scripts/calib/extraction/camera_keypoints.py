"""Extract the corners of a target's pattern, or the contour of its colour, in a camera's views."""

from collections.abc import Mapping

import numpy as np

from calib.extraction.extraction_inputs import ExtractionContext, kept_rows, make_keypoint_columns
from calib.extraction.extraction_results import Extraction, ViewKeypoints
from calib.extraction.working_pose import (
    LOOSE_GATES,
    check_kept_views,
    estimate_working_pose,
    iterate_working_pose,
)
from calib.io.status import OK
from calib.sensors.camera.cylinder_silhouette import find_cylinder_silhouette
from calib.sensors.camera.images.image_messages import decode_png, to_grey
from calib.views.crop_windows import pixel_margin
from calib.views.field_of_view import check_camera_visibility
from calib.views.target_placements import Columns

# Times σ, that the working pose starts from: errors of the MCS exceed the σ of a corner.
CAMERA_NOISE_FACTOR = 100.0


def extract_camera_keypoints(context: ExtractionContext, views: Columns) -> Extraction:
    """Extract the keypoints of a camera (calib.extraction.extractor_registry)."""
    first = {
        i: extract_camera_view(context, views, i, context.T_robot_sensor) for i in kept_rows(views)
    }
    extraction = Extraction.collect(views, first)
    keypoints = extraction.keypoints
    if not extraction.n_keypoints:
        return extraction
    centre = context.predict_target_pose(int(keypoints["placement"][0]))[:3, 3]
    margin_px = pixel_margin(context.model, centre, context.pose_margin)
    T, _ = estimate_working_pose(
        context,
        keypoints,
        context.T_robot_sensor,
        context.associate_options | LOOSE_GATES,
        noise_factor=margin_px / keypoints["sigma"].min(),
    )
    return iterate_working_pose(
        context,
        views,
        lambda T: camera_keypoints_at_pose(context, views, T, first),
        T,
        CAMERA_NOISE_FACTOR,
    )


def extract_camera_view(
    context: ExtractionContext, views: Columns, i: int, T_robot_sensor: np.ndarray
) -> ViewKeypoints:
    """Extract the keypoints of the view in row i at a pose of the camera."""
    image = decode_png(views["png"][i])
    if context.targets[views["target"][i]].pattern:
        return extract_pattern_corners(context, views, i, image)
    return extract_color_contour(context, views, i, image, T_robot_sensor)


def camera_keypoints_at_pose(
    context: ExtractionContext,
    views: Columns,
    T_robot_sensor: np.ndarray,
    first_results: Mapping[int, ViewKeypoints],
) -> dict[int, ViewKeypoints]:
    """Return the results by row of the kept views at a pose of the camera.

    first_results: of every kept view at the initial guess. Corners are taken from these, because
    they do not depend on the pose.
    """
    statuses = check_kept_views(context, views, T_robot_sensor, check_camera_visibility)
    results = {}
    for i, first_result in first_results.items():
        if not statuses[i].ok:
            results[i] = ViewKeypoints(None, statuses[i], is_wanted=False)
        elif context.targets[views["target"][i]].pattern:
            results[i] = first_result
        else:
            results[i] = extract_camera_view(context, views, i, T_robot_sensor)
    return results


def extract_pattern_corners(
    context: ExtractionContext, views: Columns, i: int, image: np.ndarray
) -> ViewKeypoints:
    """Extract the corners of the pattern in the region (h, w, 3) of the view in row i."""
    pattern = context.targets[views["target"][i]].pattern
    assert pattern is not None
    offset = np.array([views["u0"][i], views["v0"][i]])
    corners, status = pattern.locate_corners(to_grey(image), context.model, offset)
    if corners is None:
        return ViewKeypoints(None, status)
    columns = make_keypoint_columns(
        views,
        i,
        "pattern_corner",
        corners.corner_index,
        uv=corners.uv,
        sigma=corners.sigma,
        whitening=corners.whitening,
    )
    return ViewKeypoints(columns, status)


def extract_color_contour(
    context: ExtractionContext,
    views: Columns,
    i: int,
    image: np.ndarray,
    T_robot_sensor: np.ndarray | None = None,
) -> ViewKeypoints:
    """Extract the contour of the coloured blob in the region (h, w, 3) of the view in row i.

    Only its straight sides are used, except for targets that are compared by points.
    """
    target = context.targets[views["target"][i]]
    assert target.color is not None  # cameras find targets without a pattern by their colour
    T_camera_target = context.predict_target_pose(int(views["placement"][i]), T_robot_sensor)
    offset = np.array([views["u0"][i], views["v0"][i]])
    silhouette, status = find_cylinder_silhouette(
        image,
        offset,
        target.color,
        context.model,
        target=target,
        T_camera_target=T_camera_target,
    )
    if silhouette is None:
        return ViewKeypoints(None, status)
    edges, sides = silhouette.edges, np.flatnonzero(silhouette.side)
    if not target.uses_exact_surface:
        index = np.zeros(len(edges.uv))
        columns = make_keypoint_columns(
            views, i, "template_silhouette", index, uv=edges.uv, sigma=edges.sigma
        )
    else:
        columns = make_keypoint_columns(
            views,
            i,
            "cylinder_limb",
            silhouette.side[sides],
            uv=edges.uv[sides],
            sigma=edges.sigma[sides],
        )
    return ViewKeypoints(columns, OK)
