"""A ROS 2 launch file that publishes the static transforms. XML: it is data and runs no code."""

import shlex
from xml.etree import ElementTree

from calib.export.formats.xml_document import render_xml_document
from calib.geometry.se3 import pose_to_quat

TITLE = "a launch file with one static_transform_publisher for every frame (`ros2 launch <file>`)"
CONVENTION = (
    "each maps points of child-frame-id into frame-id, p_parent = R p_child + (x y z); metres, "
    "quaternions x y z w"
)


def render_files(scene):
    """static_transforms.launch.xml."""
    root = ElementTree.Element("launch")
    for edge in scene.static_transforms():
        name = "static_" + "".join(c if c.isalnum() else "_" for c in edge.child)
        words = [word for pair in _publisher_arguments(edge) for word in pair]
        args = " ".join(shlex.quote(str(word)) for word in words)
        node = {"pkg": "tf2_ros", "exec": "static_transform_publisher", "name": name, "args": args}
        ElementTree.SubElement(root, "node", node)
    head = f"Static transforms of rig {scene.rig} for ROS 2: {CONVENTION}."
    return {
        "static_transforms.launch.xml": render_xml_document(
            root, [head, *scene.describe_worked_points()]
        )
    }


def _publisher_arguments(edge):
    x, y, z = edge.T_parent_child[:3, 3].tolist()
    qx, qy, qz, qw = pose_to_quat(edge.T_parent_child).tolist()
    pose = {"x": x, "y": y, "z": z, "qx": qx, "qy": qy, "qz": qz, "qw": qw}
    frames = {"frame-id": edge.parent, "child-frame-id": edge.child}
    return [(f"--{key}", value) for key, value in (pose | frames).items()]
