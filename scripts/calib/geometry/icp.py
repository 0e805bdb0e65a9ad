"""A template laid on a scan by iterated closest points."""

import numpy as np

from calib.geometry.se3 import invert_pose

MAX_ICP_DISTANCE_M = {
    "all": 0.2,
    "corners": 1.0,
}  # of a scan point from the template point it pulls
MAX_ICP_ITERATIONS = 200
ICP_RELATIVE_TOLERANCE = 1e-8  # relative change that counts as none


def register_template_icp(point_template, scan_xyz, T_sensor_target):
    """T_sensor_target (4, 4) of the template that lies best under measured point_template (n, 3).

    Point to point, from every scan point to its nearest template point, from the given pose:
    paper III-C. Inside a flat template nothing holds the scan, so what ICP says of a board's
    corners depends on where it starts.
    """
    import open3d as o3d  # 2 s, which only targets of the points method should pay

    scan, template = (
        o3d.geometry.PointCloud(o3d.utility.Vector3dVector(p))
        for p in (scan_xyz, point_template.xyz)
    )
    found = o3d.pipelines.registration.registration_icp(
        scan,
        template,
        MAX_ICP_DISTANCE_M[point_template.keypoint_mode],
        invert_pose(T_sensor_target),
        o3d.pipelines.registration.TransformationEstimationPointToPoint(),
        o3d.pipelines.registration.ICPConvergenceCriteria(
            ICP_RELATIVE_TOLERANCE, ICP_RELATIVE_TOLERANCE, MAX_ICP_ITERATIONS
        ),
    )
    return invert_pose(np.array(found.transformation))
