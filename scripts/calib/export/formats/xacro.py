"""A xacro macro that adds the sensors to a robot's description."""

import re
from xml.etree import ElementTree

from calib.export.formats import urdf
from calib.export.formats.urdf import add_urdf_joints
from calib.export.formats.xml_document import render_xml_document

TITLE = (
    'a xacro macro: include it and write <xacro:calibrated_sensors/>, with parent="…" where your '
    "link has another name"
)
CONVENTION = urdf.CONVENTION
XACRO_NAMESPACE = "http://www.ros.org/wiki/xacro"
PLAIN_NAME_PATTERN = re.compile(r"[\w/.-]+")


def render_files(scene):
    """sensors.urdf.xacro."""
    ElementTree.register_namespace("xacro", XACRO_NAMESPACE)
    root = ElementTree.Element("robot")
    default = (
        f":='{scene.parent_frame}'" if PLAIN_NAME_PATTERN.fullmatch(scene.parent_frame) else ""
    )
    attributes = {"name": "calibrated_sensors", "params": f"parent{default}"}
    macro = ElementTree.SubElement(root, f"{{{XACRO_NAMESPACE}}}macro", attributes)
    add_urdf_joints(macro, scene)
    for element in macro.iter():
        if element is not macro:
            _escape_attributes(element, scene.parent_frame)
    head = f"Sensors of rig {scene.rig}: {CONVENTION}."
    return {
        "sensors.urdf.xacro": render_xml_document(root, [head, *scene.describe_worked_points()])
    }


def _escape_attributes(element, parent):
    """Make the parent's name the macro's parameter; no other name is an expression."""
    for key, value in element.attrib.items():
        element.set(key, re.sub(r"\$+(?=[{(])", lambda m: 2 * m[0], value))
    if element.tag == "parent" and element.get("link") == parent:
        element.set("link", "${parent}")
