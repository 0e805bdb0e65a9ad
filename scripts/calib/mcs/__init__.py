"""Motion capture messages: which types carry poses of bodies, and how.

To add a type: a function of the message that gives its Poses, in the file of its family, and one
line in TYPES.
"""

from calib.mcs import arrays, stamped, transforms, vicon

TYPES = {
    "tf2_msgs/msg/TFMessage": transforms.message,
    "tf/msg/tfMessage": transforms.message,
    "geometry_msgs/msg/TransformStamped": transforms.one,
    "geometry_msgs/msg/PoseStamped": stamped.pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": stamped.with_covariance,
    "nav_msgs/msg/Odometry": stamped.odometry,
    "mocap4r2_msgs/msg/RigidBodies": arrays.rigid_bodies,
    "motion_capture_tracking_interfaces/msg/NamedPoseArray": arrays.named_poses,
    "vicon_receiver/msg/Position": vicon.position,
    "vicon_msgs/msg/Position": vicon.position,
}
