"""Registration of a template to a scan by iterative closest points (ICP)."""

from typing import Protocol

import numpy as np

from calib.geometry.se3 import invert_pose

# Maximum distance, m, from a scan point to its nearest template point, by what the keypoints are.
MAX_ICP_DISTANCE_M = {"all": 0.2, "corners": 1.0}
MAX_ICP_ITERATIONS = 200
ICP_RELATIVE_TOLERANCE = 1e-8  # a smaller relative change of fitness or RMSE ends the iteration


class Template(Protocol):
    """Points of a target: xyz (n, 3), target frame, m."""

    @property
    def xyz(self) -> np.ndarray: ...

    @property
    def keypoint_mode(self) -> str: ...


def register_template_icp(
    point_template: Template, scan_xyz: np.ndarray, T_sensor_target: np.ndarray
) -> np.ndarray:
    """Return T_sensor_target (4, 4) that best fits the template to a scan.

    scan_xyz: (n, 3) points on the target, sensor frame, m; T_sensor_target: start of the
    iteration. Point-to-point ICP from each scan point to its nearest template point (paper,
    section III-C). A flat template lets the scan slide within its plane, so the corners of a
    board depend on the start.
    """
    import open3d as o3d  # 2 s, which only targets of the points method should pay

    scan, template = (
        o3d.geometry.PointCloud(o3d.utility.Vector3dVector(p))
        for p in (scan_xyz, point_template.xyz)
    )
    registered = o3d.pipelines.registration.registration_icp(
        source=scan,
        target=template,
        max_correspondence_distance=MAX_ICP_DISTANCE_M[point_template.keypoint_mode],
        init=invert_pose(T_sensor_target),
        estimation_method=o3d.pipelines.registration.TransformationEstimationPointToPoint(),
        criteria=o3d.pipelines.registration.ICPConvergenceCriteria(
            relative_fitness=ICP_RELATIVE_TOLERANCE,
            relative_rmse=ICP_RELATIVE_TOLERANCE,
            max_iteration=MAX_ICP_ITERATIONS,
        ),
    )
    return invert_pose(np.array(registered.transformation))
