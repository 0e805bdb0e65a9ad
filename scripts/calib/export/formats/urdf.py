"""A URDF of the sensors alone: a link for every frame, and a fixed joint above it."""

from xml.etree import ElementTree

from calib.export.formats import xml_document
from calib.io import urdf_file

TITLE = "a URDF of the sensors alone, to look at or to copy joints from"
CONVENTION = (
    "the origin of a joint maps points of its child link into its parent link, "
    "R = Rz(yaw) Ry(pitch) Rx(roll) of rpy; metres, radians"
)


def render(scene):
    """sensors.urdf."""
    root = ElementTree.Element("robot", name=scene.rig)
    ElementTree.SubElement(root, "link", name=scene.parent)
    add_joints(root, scene)
    head = f"Sensors of rig {scene.rig}: {CONVENTION}."
    return {"sensors.urdf": xml_document.document(root, [head, *scene.worked()])}


def add_joints(element, scene):
    """Add a link and a fixed joint to an XML element for every frame below the parent's."""
    for edge in scene.edges():
        ElementTree.SubElement(element, "link", name=edge.child)
        joint = ElementTree.SubElement(element, "joint", name=f"{edge.child}_joint", type="fixed")
        ElementTree.SubElement(joint, "parent", link=edge.parent)
        ElementTree.SubElement(joint, "child", link=edge.child)
        ElementTree.SubElement(joint, "origin", urdf_file.origin(edge.T))
