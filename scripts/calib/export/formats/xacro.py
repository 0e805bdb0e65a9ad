"""A xacro macro that adds the sensors to a robot's description."""

import re
from xml.etree import ElementTree

from calib.export.calibrated_scene import ExportScene
from calib.export.formats import urdf
from calib.export.formats.urdf import add_urdf_joints
from calib.export.formats.xml_document import render_xml_document
from calib.io.status import Status

TITLE = (
    'a xacro macro: include it and write <xacro:calibrated_sensors/>, with parent="…" where your '
    "link has another name"
)
FILE_PATTERNS: tuple[str, ...] = ("sensors.urdf.xacro",)
CONVENTION = urdf.CONVENTION
XACRO_NAMESPACE = "http://www.ros.org/wiki/xacro"
PLAIN_NAME_PATTERN = re.compile(r"[\w/.-]+")


def render_files(scene: ExportScene) -> dict[str, str | bytes | Status]:
    """Render sensors.urdf.xacro."""
    ElementTree.register_namespace("xacro", XACRO_NAMESPACE)
    root = ElementTree.Element("robot")
    has_plain_name = PLAIN_NAME_PATTERN.fullmatch(scene.parent_frame)
    default = f":='{scene.parent_frame}'" if has_plain_name else ""
    attributes = {"name": "calibrated_sensors", "params": f"parent{default}"}
    macro = ElementTree.SubElement(root, f"{{{XACRO_NAMESPACE}}}macro", attributes)
    add_urdf_joints(macro, scene)
    for element in macro.iter():
        if element is not macro:
            _escape_attributes(element, scene.parent_frame)
    head = [f"Sensors of rig {scene.rig}: {CONVENTION}.", *scene.describe_verdict()]
    text = render_xml_document(root, [*head, *scene.describe_worked_points()])
    return {"sensors.urdf.xacro": text}


def _escape_attributes(element: ElementTree.Element, parent: str) -> None:
    """Escape names that xacro would evaluate, and make the parent's name the macro's parameter."""
    for key, value in element.attrib.items():
        element.set(key, re.sub(r"\$+(?=[{(])", lambda m: 2 * m[0], value))
    if element.tag == "parent" and element.get("link") == parent:
        element.set("link", "${parent}")
