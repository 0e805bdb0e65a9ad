"""/tf_static of each recording as an MCAP that opens beside it: stamped at its first message, and
hung on the robot's MCS body, which the recording's own /tf moves about."""

from calib.export.calibrated_scene import StaticTransform, format_worked_point
from calib.export.mcap_writer import encode_mcap, make_static_tf_message
from calib.geometry.se3 import invert_pose

TITLE = "/tf_static to open beside a recording, in Foxglove or with `ros2 bag play`; latched"
CONVENTION = (
    "each transform maps points of child_frame_id into header.frame_id, p_parent = R(rotation) "
    "p_child + translation; metres, quaternions x y z w"
)


def render_files(scene):
    """tf_static_<session>.mcap of every session."""
    return {
        f"tf_static_{n}.mcap": _render_tf_static_mcap(scene, s) for n, s in scene.sessions.items()
    }


def _render_tf_static_mcap(scene, session):
    edges = list_session_transforms(scene, session)
    points = "\n".join(format_worked_point(e.child, e.parent, e.T_parent_child) for e in edges)
    about = {"convention": CONVENTION, "worked_point": points}
    return encode_mcap([make_static_tf_message(session.start_ns, edges)], about)


def list_session_transforms(scene, session):
    """The frames of a scene below the robot's body, as it was in a session."""
    T_body_parent = invert_pose(scene.T_parent_robot @ session.T_robot_body)
    if scene.parent_frame == scene.robot_body:
        # The recording moves a frame of that name: sensors hang on it where it then was.
        first = [e for e in scene.static_transforms() if e.parent == scene.parent_frame]
        rest = [e for e in scene.static_transforms() if e.parent != scene.parent_frame]
        return [
            StaticTransform(scene.robot_body, e.child, T_body_parent @ e.T_parent_child, e.sensor)
            for e in first
        ] + rest
    return [
        StaticTransform(scene.robot_body, scene.parent_frame, T_body_parent, ""),
        *scene.static_transforms(),
    ]
