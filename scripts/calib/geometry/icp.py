"""A template laid on a scan by iterated closest points."""

import numpy as np

from calib.geometry import se3

FARTHEST_M = {"all": 0.2, "corners": 1.0}  # of a scan point from the template point it pulls
ROUNDS = 200
SMALLEST = 1e-8  # relative change that counts as none


def icp(points, measured, T_sensor_target):
    """T_sensor_target (4, 4) of the template that lies best under measured points (n, 3).

    Point to point, from every scan point to its nearest template point, from the given pose:
    paper III-C. Inside a flat template nothing holds the scan, so what ICP says of a board's
    corners depends on where it starts.
    """
    import open3d as o3d  # 2 s, which only targets of the points method should pay

    scan, template = (
        o3d.geometry.PointCloud(o3d.utility.Vector3dVector(p)) for p in (measured, points.template)
    )
    found = o3d.pipelines.registration.registration_icp(
        scan,
        template,
        FARTHEST_M[points.keypoints],
        se3.inverse(T_sensor_target),
        o3d.pipelines.registration.TransformationEstimationPointToPoint(),
        o3d.pipelines.registration.ICPConvergenceCriteria(SMALLEST, SMALLEST, ROUNDS),
    )
    return se3.inverse(np.array(found.transformation))
