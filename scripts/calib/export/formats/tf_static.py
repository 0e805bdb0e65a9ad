"""/tf_static of each recording as an MCAP that opens beside it.

It is stamped at the recording's first message. Its root is the robot's MCS body, which the
recording's own /tf moves.
"""

from calib.export.calibrated_scene import ExportScene, ExportSession, format_worked_point
from calib.export.export_mcap import encode_mcap, make_static_tf_message
from calib.geometry.se3 import invert_pose
from calib.io.logs.ros_messages import FrameTransform
from calib.io.status import Status

TITLE = "/tf_static to open beside a recording, in Foxglove or with `ros2 bag play`; latched"
FILE_PATTERNS: tuple[str, ...] = ("tf_static_*.mcap",)
CONVENTION = (
    "each transform maps points of child_frame_id into header.frame_id, p_parent = R(rotation) "
    "p_child + translation; metres, quaternions x y z w"
)


def render_files(scene: ExportScene) -> dict[str, str | bytes | Status]:
    """Render tf_static_<session>.mcap of every session."""
    return {
        f"tf_static_{n}.mcap": _render_tf_static_mcap(scene, s) for n, s in scene.sessions.items()
    }


def _render_tf_static_mcap(scene: ExportScene, session: ExportSession) -> bytes:
    transforms = list_session_transforms(scene, session)
    worked = "\n".join(format_worked_point(t.child, t.parent, t.T_parent_child) for t in transforms)
    verdict = "\n".join(scene.describe_verdict()) or scene.verdict
    about = {"convention": CONVENTION, "verdict": verdict, "worked_point": worked}
    return encode_mcap([make_static_tf_message(session.start_ns, transforms)], about)


def list_session_transforms(scene: ExportScene, session: ExportSession) -> list[FrameTransform]:
    """List the frames below the robot's MCS body, where the body was mounted in a session."""
    transforms = scene.static_transforms()
    T_body_parent = invert_pose(scene.T_parent_robot @ session.T_robot_body)
    if scene.parent_frame != scene.robot_body:
        return [FrameTransform(scene.robot_body, scene.parent_frame, T_body_parent), *transforms]
    # The recording moves a frame of that name: the sensors hang on it where it was then.
    return [
        FrameTransform(scene.robot_body, t.child, T_body_parent @ t.T_parent_child)
        for t in transforms
        if t.parent == scene.parent_frame
    ] + [t for t in transforms if t.parent != scene.parent_frame]
