"""A URDF of the sensors alone: a link for every frame, and a fixed joint above it."""

from xml.etree import ElementTree

from calib.export.formats.xml_document import render_xml_document
from calib.io.urdf_file import origin_attributes

TITLE = "a URDF of the sensors alone, to look at or to copy joints from"
CONVENTION = (
    "the origin of a joint maps points of its child link into its parent link, "
    "R = Rz(yaw) Ry(pitch) Rx(roll) of rpy; metres, radians"
)


def render_files(scene):
    """sensors.urdf."""
    root = ElementTree.Element("robot", name=scene.rig)
    ElementTree.SubElement(root, "link", name=scene.parent_frame)
    add_urdf_joints(root, scene)
    head = f"Sensors of rig {scene.rig}: {CONVENTION}."
    return {"sensors.urdf": render_xml_document(root, [head, *scene.describe_worked_points()])}


def add_urdf_joints(element, scene):
    """Add a link and a fixed joint to an XML element for every frame below the parent's."""
    for edge in scene.static_transforms():
        ElementTree.SubElement(element, "link", name=edge.child)
        joint = ElementTree.SubElement(element, "joint", name=f"{edge.child}_joint", type="fixed")
        ElementTree.SubElement(joint, "parent", link=edge.parent)
        ElementTree.SubElement(joint, "child", link=edge.child)
        ElementTree.SubElement(joint, "origin", origin_attributes(edge.T_parent_child))
