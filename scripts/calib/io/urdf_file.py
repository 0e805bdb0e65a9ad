"""The joints of a URDF, and its poses changed in place: every other byte stays as it was.

The file is read with Expat, which tells where each tag stands; only the start tags of <origin> are
written anew. A joint's origin maps points of its child link into its parent link.
"""

import re
from dataclasses import dataclass
from xml.parsers import expat

import numpy as np

from calib.geometry import se3
from calib.io.status import InputError

TAG = re.compile(rb"<(?:[^<>\"']|\"[^\"]*\"|'[^']*')*>")


@dataclass(frozen=True)
class Joint:
    """A joint: T_parent_child (4, 4), None where the file states it in no plain numbers (`why`);
    the bytes (first, last) of its <origin> tag, or the place for one twice."""

    name: str
    type: str
    parent: str
    child: str
    T: np.ndarray | None
    why: str
    span: tuple


def read(data, where):
    """[Joint] of a URDF's bytes in order; `where` names the file.

    Raises InputError where it is no URDF, or a link hangs on two joints.
    """
    reader = _Reader(data)
    try:
        reader.parse()
    except expat.ExpatError as error:
        raise InputError(f"{where}: not valid XML: {error}") from None
    if reader.root != "robot":
        raise InputError(f"{where}: its root is <{reader.root}>, that of a URDF is <robot>")
    joints = [_joint(data, found, where) for found in reader.joints]
    children = [j.child for j in joints]
    twice = sorted({c for c in children if children.count(c) > 1})
    if twice:
        raise InputError(f"{where}: link {twice[0]} is the child of two joints, expected a tree")
    return joints


class _Reader:
    """What Expat says of the joints that stand directly below the root."""

    def __init__(self, data):
        self.data, self.root, self.joints, self._path = data, None, [], []
        self._parser = expat.ParserCreate()
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = lambda name: self._path.pop()

    def parse(self):
        self._parser.Parse(self.data, True)

    def _start(self, name, attributes):
        self.root = self.root or name
        at = self._parser.CurrentByteIndex
        if self._path == [self.root] and name == "joint":
            self.joints.append({"joint": attributes, "at": at})
        elif self._path == [self.root, "joint"] and name in ("parent", "child", "origin"):
            self.joints[-1] |= {name: attributes, f"{name} at": at}
        self._path.append(name)


def _joint(data, found, where):
    name = found["joint"].get("name", "")
    links = [found.get(k, {}).get("link") for k in ("parent", "child")]
    if None in links:
        raise InputError(f"{where}: joint {name!r} names no parent or no child link")
    origin = found.get("origin", {})
    try:
        T, why = _pose(origin), ""
    except ValueError as error:
        T, why = None, str(error)
    tag = _tag(data, "origin", found["origin at"], where) if "origin" in found else None
    span = tag or _tag(data, "joint", found["at"], where)[1:] * 2
    return Joint(name, found["joint"].get("type", ""), *links, T, why, span)


def _pose(origin):
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
    return se3.from_rpy(*values)


def _tag(data, name, at, where):
    """First and last byte of the start tag of an element that begins at a byte."""
    tag = TAG.match(data, at)
    if tag is None or not tag[0].startswith(f"<{name}".encode()):
        raise InputError(f"{where}: encoded as neither UTF-8 nor ASCII; convert it, as with iconv")
    return tag.span()


def backup_of(path):
    """Where a URDF (Path) is kept as it was before the first calibration was written into it."""
    return path.with_name(f"{path.name}.before-calibration")


def fixed(joints):
    """{(parent, child): T_parent_child (4, 4)} of the fixed joints whose poses are known."""
    return {(j.parent, j.child): j.T for j in joints if j.type == "fixed" and j.T is not None}


def links(joints):
    """Names of all links that a joint holds, sorted."""
    return sorted({link for j in joints for link in (j.parent, j.child)})


def origin(T):
    """{xyz, rpy}: attributes of the <origin> of a pose (4, 4), to the last digit."""
    return {"xyz": numbers(T[:3, 3]), "rpy": numbers(se3.to_rpy(T))}


def numbers(values):
    """Numbers as a URDF separates them; 0 for -0."""
    return " ".join(repr(float(v) + 0.0) for v in values)


def patched(data, joints, poses):
    """The bytes of a URDF with other origins: poses {child link: T_parent_child (4, 4)}."""
    for joint in sorted(joints, key=lambda j: j.span, reverse=True):
        if joint.child in poses:
            first, last = joint.span
            tag = _with_pose(data, joint, poses[joint.child])
            data = data[:first] + tag + data[last:]
    return data


def _with_pose(data, joint, T):
    """The <origin> tag of a joint with another pose; a new one as far in as what follows it."""
    first, last = joint.span
    tag = data[first:last]
    if not tag:
        tag = re.match(rb"\s*", data[first:])[0] + b"<origin/>"
    for key, text in origin(T).items():
        tag = _with_attribute(tag, key.encode(), text.encode())
    return tag


def _with_attribute(tag, key, text):
    there = re.compile(rb"(?<=\s)%s\s*=\s*(?:\"[^\"]*\"|'[^']*')" % key)
    new = b'%s="%s"' % (key, text)
    if there.search(tag):
        return there.sub(new, tag, count=1)
    end = re.search(rb"\s*/?>$", tag).start()
    return tag[:end] + b" " + new + tag[end:]
