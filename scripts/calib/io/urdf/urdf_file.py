"""Read the joints of a URDF, and change their poses in place: every other byte stays as it was.

Expat says where each tag is; only the start tags of <origin> are written anew. A joint's origin
maps points of its child link into its parent link.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

import numpy as np

from calib.geometry.se3 import pose_from_rpy, pose_to_rpy
from calib.io.safe_names import plain_text, safe_name
from calib.io.status import InputError, escape_control_characters

XML_START_TAG = re.compile(rb"<(?:[^<>\"']|\"[^\"]*\"|'[^']*')*>")
JOINT_PARTS = ("parent", "child", "origin")

ByteSpan = tuple[int, int]


@dataclass(frozen=True)
class UrdfJoint:
    """A joint with the pose T_parent_child (4, 4) of its child link, or why it cannot be read.

    origin_byte_span: first and last byte of its <origin> tag; twice the place for one if it has
    none.
    """

    name: str
    type: str
    parent: str
    child: str
    T_parent_child: np.ndarray | None
    pose_error: str
    origin_byte_span: ByteSpan


@dataclass
class _JointElement:
    """A <joint>: its attributes and first byte; the same of its <parent>, <child> and <origin>."""

    attributes: dict[str, str]
    byte_offset: int
    parts: dict[str, tuple[dict[str, str], int]] = field(default_factory=dict)


def read_urdf_joints(data: bytes, file_name: str | Path) -> list[UrdfJoint]:
    """Read the joints of a URDF's bytes in order; file_name stands in messages.

    Raises InputError if it is not a URDF, or if two joints have the same child link.
    """
    parser = _JointParser(data)
    try:
        parser.parse()
    except expat.ExpatError as error:
        raise InputError(f"{file_name}: not valid XML: {error}") from None
    if parser.root != "robot":
        raise InputError(
            f"{file_name}: its root is <{plain_text(str(parser.root))}>, expected <robot>"
        )
    joints = [_make_joint(data, element, file_name) for element in parser.elements]
    children = [j.child for j in joints]
    duplicates = sorted({c for c in children if children.count(c) > 1})
    if duplicates:
        raise InputError(
            f"{file_name}: link {duplicates[0]} is the child of two joints, expected a tree"
        )
    return joints


class _JointParser:
    """Collects the joints directly below the root of an XML document."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.root: str | None = None
        self.elements: list[_JointElement] = []
        self._path: list[str] = []
        self._parser = expat.ParserCreate()
        self._parser.StartElementHandler = self._handle_start_tag
        self._parser.EndElementHandler = lambda name: self._path.pop()

    def parse(self) -> None:
        self._parser.Parse(self.data, True)

    def _handle_start_tag(self, name: str, attributes: dict[str, str]) -> None:
        self.root = self.root or name
        byte_offset = self._parser.CurrentByteIndex
        if self._path == [self.root] and name == "joint":
            self.elements.append(_JointElement(attributes, byte_offset))
        elif self._path == [self.root, "joint"] and name in JOINT_PARTS:
            self.elements[-1].parts[name] = attributes, byte_offset
        self._path.append(name)


def _make_joint(data: bytes, element: _JointElement, file_name: str | Path) -> UrdfJoint:
    name = element.attributes.get("name", "")
    origin, origin_offset = element.parts.get("origin", ({}, None))
    T_parent_child, pose_error = None, ""
    parent, child = (element.parts.get(key, ({}, 0))[0].get("link") for key in ("parent", "child"))
    if parent is None or child is None:
        raise InputError(
            f"{file_name}: joint '{safe_name(name)}' has no parent link or no child link"
        )
    try:
        T_parent_child = _parse_origin(origin)
    except ValueError as error:
        pose_error = str(error)
    if origin_offset is not None:
        span = _find_tag_span(data, "origin", origin_offset, file_name)
    else:
        _, end = _find_tag_span(data, "joint", element.byte_offset, file_name)
        span = end, end
    return UrdfJoint(
        name=safe_name(name),
        type=plain_text(element.attributes.get("type", "")),
        parent=safe_name(parent),
        child=safe_name(child),
        T_parent_child=T_parent_child,
        pose_error=pose_error,
        origin_byte_span=span,
    )


def _parse_origin(origin: Mapping[str, str]) -> np.ndarray:
    """Return the pose (4, 4) of the attributes of an <origin>; raises ValueError if they are no
    plain numbers."""
    unknown = sorted(set(origin) - {"xyz", "rpy"})
    if unknown:
        raise ValueError(f"its origin has {safe_name(unknown[0])} beside xyz and rpy")
    values = []
    for key in ("xyz", "rpy"):
        text = origin.get(key, "0 0 0")
        if "$" in text:
            raise ValueError(
                f"its origin is an expression of xacro, {key}='{escape_control_characters(text)}'"
            )
        numbers = [float(word) for word in text.split()]
        if len(numbers) != 3 or not np.isfinite(numbers).all():
            raise ValueError(
                f"its origin has {key}='{escape_control_characters(text)}', expected three numbers"
            )
        values.append(numbers)
    return pose_from_rpy(*values)


def _find_tag_span(data: bytes, name: str, byte_offset: int, file_name: str | Path) -> ByteSpan:
    """Return the first and the last byte of the start tag of an element at an offset."""
    tag = XML_START_TAG.match(data, byte_offset)
    if tag is None or not tag[0].startswith(f"<{name}".encode()):
        raise InputError(
            f"{file_name}: encoded as neither UTF-8 nor ASCII; convert it, as with iconv"
        )
    return tag.span()


def urdf_backup_path(path: Path) -> Path:
    """Return where a URDF is kept as it was before the first calibration was written into it."""
    return path.with_name(f"{path.name}.before-calibration")


def fixed_joint_transforms(joints: Iterable[UrdfJoint]) -> dict[tuple[str, str], np.ndarray]:
    """Return T_parent_child (4, 4) by (parent, child) of the fixed joints whose poses are known."""
    return {
        (j.parent, j.child): j.T_parent_child
        for j in joints
        if j.type == "fixed" and j.T_parent_child is not None
    }


def urdf_link_names(joints: Iterable[UrdfJoint]) -> list[str]:
    """Return the names of all links that a joint holds, sorted."""
    return sorted({link for j in joints for link in (j.parent, j.child)})


def origin_attributes(T: np.ndarray) -> dict[str, str]:
    """Return the attributes xyz and rpy of the <origin> of a pose (4, 4), to the last digit."""
    return {"xyz": format_urdf_numbers(T[:3, 3]), "rpy": format_urdf_numbers(pose_to_rpy(T))}


def format_urdf_numbers(values: Iterable[float]) -> str:
    """Format numbers as a URDF separates them; -0 becomes 0."""
    return " ".join(repr(float(v) + 0.0) for v in values)


def replace_joint_origins(
    data: bytes, joints: Sequence[UrdfJoint], origins: Mapping[str, np.ndarray]
) -> bytes:
    """Return the bytes of a URDF with other origins {child link: T_parent_child (4, 4)}."""
    # From the end, so that earlier bytes stay where they are.
    for joint in sorted(joints, key=lambda j: j.origin_byte_span, reverse=True):
        if joint.child in origins:
            first, last = joint.origin_byte_span
            tag = _replace_origin_tag(data, joint, origins[joint.child])
            data = data[:first] + tag + data[last:]
    return data


def _replace_origin_tag(data: bytes, joint: UrdfJoint, T: np.ndarray) -> bytes:
    """Return the <origin> tag of a joint with another pose; a new one indented as what follows."""
    first, last = joint.origin_byte_span
    tag = data[first:last]
    if not tag:
        indent = re.match(rb"\s*", data[first:])
        tag = (indent[0] if indent else b"") + b"<origin/>"
    for key, text in origin_attributes(T).items():
        tag = _set_attribute(tag, key.encode(), text.encode())
    return tag


def _set_attribute(tag: bytes, key: bytes, text: bytes) -> bytes:
    pattern = re.compile(rb"(?<=\s)%s\s*=\s*(?:\"[^\"]*\"|'[^']*')" % key)
    attribute = b'%s="%s"' % (key, text)
    if pattern.search(tag):
        return pattern.sub(attribute, tag, count=1)
    end = re.search(rb"\s*/?>$", tag)
    assert end, "a start tag ends in >"
    return tag[: end.start()] + b" " + attribute + tag[end.start() :]
