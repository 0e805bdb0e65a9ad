"""A ROS 2 launch file that publishes the static transforms, in XML: data that runs no code."""

import shlex
from xml.etree import ElementTree

from calib.export.calibrated_scene import ExportScene
from calib.export.formats.xml_document import render_xml_document
from calib.geometry.se3 import pose_to_quat
from calib.io.logs.ros_messages import FrameTransform
from calib.io.status import Status

TITLE = "a launch file with one static_transform_publisher for every frame (`ros2 launch <file>`)"
FILE_PATTERNS: tuple[str, ...] = ("static_transforms.launch.xml",)
CONVENTION = (
    "each maps points of child-frame-id into frame-id, p_parent = R p_child + (x y z); metres, "
    "quaternions x y z w"
)


def render_files(scene: ExportScene) -> dict[str, str | bytes | Status]:
    """Render static_transforms.launch.xml."""
    root = ElementTree.Element("launch")
    for transform in scene.static_transforms():
        name = "static_" + "".join(c if c.isalnum() else "_" for c in transform.child)
        args = shlex.join(_publisher_arguments(transform))
        node = {"pkg": "tf2_ros", "exec": "static_transform_publisher", "name": name, "args": args}
        ElementTree.SubElement(root, "node", node)
    head = [f"Static transforms of rig {scene.rig} for ROS 2: {CONVENTION}."]
    head += scene.describe_verdict()
    text = render_xml_document(root, [*head, *scene.describe_worked_points()])
    return {"static_transforms.launch.xml": text}


def _publisher_arguments(transform: FrameTransform) -> list[str]:
    x, y, z = transform.T_parent_child[:3, 3].tolist()
    qx, qy, qz, qw = pose_to_quat(transform.T_parent_child).tolist()
    pose = {"x": x, "y": y, "z": z, "qx": qx, "qy": qy, "qz": qz, "qw": qw}
    frames = {"frame-id": transform.parent, "child-frame-id": transform.child}
    return [word for key, value in (pose | frames).items() for word in (f"--{key}", str(value))]
