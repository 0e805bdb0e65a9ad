"""The joints of a URDF, and its poses changed in place: every other byte stays as it was.

The file is read with Expat, which tells where each tag stands; only the start tags of <origin> are
written anew. A joint's origin maps points of its child link into its parent link.
"""

import re
from dataclasses import dataclass
from xml.parsers import expat

import numpy as np

from calib.geometry.se3 import pose_from_rpy, pose_to_rpy
from calib.io.status import InputError

XML_START_TAG = re.compile(rb"<(?:[^<>\"']|\"[^\"]*\"|'[^']*')*>")


@dataclass(frozen=True)
class UrdfJoint:
    """A joint: T_parent_child (4, 4), None where the file states it in no plain numbers (`why`);
    the bytes (first, last) of its <origin> tag, or the place for one twice."""

    name: str
    type: str
    parent: str
    child: str
    T_parent_child: np.ndarray | None
    pose_error: str
    origin_byte_span: tuple


def read_urdf_joints(data, file_name):
    """[Joint] of a URDF's bytes in order; `where` names the file.

    Raises InputError where it is no URDF, or a link hangs on two joints.
    """
    reader = _JointParser(data)
    try:
        reader.parse()
    except expat.ExpatError as error:
        raise InputError(f"{file_name}: not valid XML: {error}") from None
    if reader.root != "robot":
        raise InputError(f"{file_name}: its root is <{reader.root}>, that of a URDF is <robot>")
    joints = [_make_joint(data, found, file_name) for found in reader.joints]
    children = [j.child for j in joints]
    twice = sorted({c for c in children if children.count(c) > 1})
    if twice:
        raise InputError(
            f"{file_name}: link {twice[0]} is the child of two joints, expected a tree"
        )
    return joints


class _JointParser:
    """What Expat says of the joints that stand directly below the root."""

    def __init__(self, data):
        self.data, self.root, self.joints, self._path = data, None, [], []
        self._parser = expat.ParserCreate()
        self._parser.StartElementHandler = self._handle_start_tag
        self._parser.EndElementHandler = lambda name: self._path.pop()

    def parse(self):
        self._parser.Parse(self.data, True)

    def _handle_start_tag(self, name, attributes):
        self.root = self.root or name
        at = self._parser.CurrentByteIndex
        if self._path == [self.root] and name == "joint":
            self.joints.append({"joint": attributes, "at": at})
        elif self._path == [self.root, "joint"] and name in ("parent", "child", "origin"):
            self.joints[-1] |= {name: attributes, f"{name} at": at}
        self._path.append(name)


def _make_joint(data, attributes, file_name):
    name = attributes["joint"].get("name", "")
    links = [attributes.get(k, {}).get("link") for k in ("parent", "child")]
    if None in links:
        raise InputError(f"{file_name}: joint {name!r} names no parent or no child link")
    origin = attributes.get("origin", {})
    try:
        T, why = _parse_origin(origin), ""
    except ValueError as error:
        T, why = None, str(error)
    tag = (
        _find_tag_span(data, "origin", attributes["origin at"], file_name)
        if "origin" in attributes
        else None
    )
    span = tag or _find_tag_span(data, "joint", attributes["at"], file_name)[1:] * 2
    return UrdfJoint(name, attributes["joint"].get("type", ""), *links, T, why, span)


def _parse_origin(origin):
    """T (4, 4) of the attributes of an <origin>; raises ValueError where they are no numbers."""
    other = sorted(set(origin) - {"xyz", "rpy"})
    if other:
        raise ValueError(f"its origin has {other[0]} beside xyz and rpy")
    values = []
    for key in ("xyz", "rpy"):
        text = origin.get(key, "0 0 0")
        if "$" in text:
            raise ValueError(f"its origin is an expression of xacro, {key}={text!r}")
        numbers = [float(word) for word in text.split()]
        if len(numbers) != 3 or not np.isfinite(numbers).all():
            raise ValueError(f"its origin has {key}={text!r}, expected three numbers")
        values.append(numbers)
    return pose_from_rpy(*values)


def _find_tag_span(data, name, byte_offset, file_name):
    """First and last byte of the start tag of an element that begins at a byte."""
    tag = XML_START_TAG.match(data, byte_offset)
    if tag is None or not tag[0].startswith(f"<{name}".encode()):
        raise InputError(
            f"{file_name}: encoded as neither UTF-8 nor ASCII; convert it, as with iconv"
        )
    return tag.span()


def urdf_backup_path(path):
    """Where a URDF (Path) is kept as it was before the first calibration was written into it."""
    return path.with_name(f"{path.name}.before-calibration")


def fixed_joint_transforms(joints):
    """{(parent, child): T_parent_child (4, 4)} of the fixed joints whose poses are known."""
    return {
        (j.parent, j.child): j.T_parent_child
        for j in joints
        if j.type == "fixed" and j.T_parent_child is not None
    }


def urdf_link_names(joints):
    """Names of all links that a joint holds, sorted."""
    return sorted({link for j in joints for link in (j.parent, j.child)})


def origin_attributes(T):
    """{xyz, rpy}: attributes of the <origin> of a pose (4, 4), to the last digit."""
    return {"xyz": format_urdf_numbers(T[:3, 3]), "rpy": format_urdf_numbers(pose_to_rpy(T))}


def format_urdf_numbers(values):
    """Numbers as a URDF separates them; 0 for -0."""
    return " ".join(repr(float(v) + 0.0) for v in values)


def replace_joint_origins(data, joints, T_parent_child_by_link):
    """The bytes of a URDF with other origins: poses {child link: T_parent_child (4, 4)}."""
    for joint in sorted(joints, key=lambda j: j.origin_byte_span, reverse=True):
        if joint.child in T_parent_child_by_link:
            first, last = joint.origin_byte_span
            tag = _replace_origin_tag(data, joint, T_parent_child_by_link[joint.child])
            data = data[:first] + tag + data[last:]
    return data


def _replace_origin_tag(data, joint, T):
    """The <origin> tag of a joint with another pose; a new one as far in as what follows it."""
    first, last = joint.origin_byte_span
    tag = data[first:last]
    if not tag:
        tag = re.match(rb"\s*", data[first:])[0] + b"<origin/>"
    for key, text in origin_attributes(T).items():
        tag = _set_attribute(tag, key.encode(), text.encode())
    return tag


def _set_attribute(tag, key, text):
    there = re.compile(rb"(?<=\s)%s\s*=\s*(?:\"[^\"]*\"|'[^']*')" % key)
    new = b'%s="%s"' % (key, text)
    if there.search(tag):
        return there.sub(new, tag, count=1)
    end = re.search(rb"\s*/?>$", tag).start()
    return tag[:end] + b" " + new + tag[end:]
