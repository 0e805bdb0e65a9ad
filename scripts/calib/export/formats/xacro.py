"""A xacro macro that adds the sensors to a robot's description."""

import re
from xml.etree import ElementTree

from calib.export.formats import urdf, xml_document

TITLE = (
    'a xacro macro: include it and write <xacro:calibrated_sensors/>, with parent="…" where your '
    "link has another name"
)
CONVENTION = urdf.CONVENTION
SPACE = "http://www.ros.org/wiki/xacro"
HARMLESS = re.compile(r"[\w/.-]+")


def render(scene):
    """sensors.urdf.xacro."""
    ElementTree.register_namespace("xacro", SPACE)
    root = ElementTree.Element("robot")
    default = f":='{scene.parent}'" if HARMLESS.fullmatch(scene.parent) else ""
    attributes = {"name": "calibrated_sensors", "params": f"parent{default}"}
    macro = ElementTree.SubElement(root, f"{{{SPACE}}}macro", attributes)
    urdf.add_joints(macro, scene)
    for element in macro.iter():
        if element is not macro:
            _escape(element, scene.parent)
    head = f"Sensors of rig {scene.rig}: {CONVENTION}."
    return {"sensors.urdf.xacro": xml_document.document(root, [head, *scene.worked()])}


def _escape(element, parent):
    """Make the parent's name the macro's parameter; no other name is an expression."""
    for key, value in element.attrib.items():
        element.set(key, re.sub(r"\$+(?=[{(])", lambda m: 2 * m[0], value))
    if element.tag == "parent" and element.get("link") == parent:
        element.set("link", "${parent}")
