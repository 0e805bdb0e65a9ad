"""A URDF of the sensors alone: a link for every frame, and a fixed joint above it."""

from xml.etree import ElementTree

from calib.export.calibrated_scene import ExportScene
from calib.export.formats.xml_document import render_xml_document
from calib.io.status import Status
from calib.io.urdf.urdf_file import origin_attributes

TITLE = "a URDF of the sensors alone, to look at or to copy joints from"
FILE_PATTERNS: tuple[str, ...] = ("sensors.urdf",)
CONVENTION = (
    "the origin of a joint maps points of its child link into its parent link, "
    "R = Rz(yaw) Ry(pitch) Rx(roll) of rpy; metres, radians"
)


def render_files(scene: ExportScene) -> dict[str, str | bytes | Status]:
    """Render sensors.urdf."""
    root = ElementTree.Element("robot", name=scene.rig)
    ElementTree.SubElement(root, "link", name=scene.parent_frame)
    add_urdf_joints(root, scene)
    head = [f"Sensors of rig {scene.rig}: {CONVENTION}.", *scene.describe_verdict()]
    text = render_xml_document(root, [*head, *scene.describe_worked_points()])
    return {"sensors.urdf": text}


def add_urdf_joints(element: ElementTree.Element, scene: ExportScene) -> None:
    """Add a link and a fixed joint to an XML element for every frame below the parent."""
    for transform in scene.static_transforms():
        child = transform.child
        ElementTree.SubElement(element, "link", name=child)
        joint = ElementTree.SubElement(element, "joint", name=f"{child}_joint", type="fixed")
        ElementTree.SubElement(joint, "parent", link=transform.parent)
        ElementTree.SubElement(joint, "child", link=child)
        ElementTree.SubElement(joint, "origin", origin_attributes(transform.T_parent_child))
