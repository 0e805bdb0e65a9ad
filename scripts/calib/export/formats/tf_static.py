"""/tf_static of each recording as an MCAP that opens beside it: stamped at its first message, and
hung on the robot's MCS body, which the recording's own /tf moves about."""

from calib.export import mcap_writer
from calib.export.calibrated_scene import Edge, worked_point
from calib.geometry import se3

TITLE = "/tf_static to open beside a recording, in Foxglove or with `ros2 bag play`; latched"
CONVENTION = (
    "each transform maps points of child_frame_id into header.frame_id, p_parent = R(rotation) "
    "p_child + translation; metres, quaternions x y z w"
)


def render(scene):
    """tf_static_<session>.mcap of every session."""
    return {f"tf_static_{n}.mcap": _file(scene, s) for n, s in scene.sessions.items()}


def _file(scene, session):
    edges = tree(scene, session)
    points = "\n".join(worked_point(e.child, e.parent, e.T) for e in edges)
    about = {"convention": CONVENTION, "worked_point": points}
    return mcap_writer.to_bytes([mcap_writer.transforms(session.start, edges)], about)


def tree(scene, session):
    """The frames of a scene below the robot's body, as it was in a session."""
    T_body_parent = se3.inverse(scene.T_parent_robot @ session.T_robot_body)
    if scene.parent == scene.body:
        # The recording moves a frame of that name: sensors hang on it where it then was.
        first = [e for e in scene.edges() if e.parent == scene.parent]
        rest = [e for e in scene.edges() if e.parent != scene.parent]
        return [Edge(scene.body, e.child, T_body_parent @ e.T, e.sensor) for e in first] + rest
    return [Edge(scene.body, scene.parent, T_body_parent, ""), *scene.edges()]
