"""Where joints of a robot's URDF must be for the sensors to sit where the calibration has them."""

import difflib

import numpy as np

from calib.export.calibrated_scene import T_BODY_OPTICAL
from calib.geometry import frame_graph, se3
from calib.io import urdf_file
from calib.io.status import failed

SAME = 1e-3  # rad: a joint turned so little off REP 103's is a convention, not a mount


def poses(joints, scene):
    """({child link: T_parent_child (4, 4)}, {sensor: Status of why none}) of a URDF's joints.

    The joint above a sensor's frame is placed; where that is only the turn from a camera's body to
    its optical frame, the one above it. Joints higher up go first: sensors may hang on sensors.
    """
    by_child = {j.child: j for j in joints}
    known, placed, unplaced = urdf_file.fixed(joints), {}, {}
    todo = [(_depth(by_child, s.frame), n) for n, s in scene.sensors.items()]
    for _, name in sorted(todo):
        sensor = scene.sensors[name]
        if sensor.frame == scene.parent:
            continue
        joint, T_child_sensor = _joint_of(sensor, by_child, placed)
        if joint is None:
            unplaced[name] = _without(sensor.frame, joints)
            continue
        why = _unfit(joint, scene, known)
        if why:
            unplaced[name] = why
            continue
        rest = {k: T for k, T in known.items() if k != (joint.parent, joint.child)}
        T_parent_link = frame_graph.chain(rest, scene.parent, joint.parent)
        T = se3.inverse(T_parent_link) @ sensor.T @ se3.inverse(T_child_sensor)
        placed[joint.child] = known[joint.parent, joint.child] = T
    return placed, unplaced


def _depth(by_child, link):
    """How many joints lie above a link."""
    seen = []
    while link in by_child and link not in seen:
        seen.append(link)
        link = by_child[link].parent
    return len(seen)


def _joint_of(sensor, by_child, placed):
    """(the Joint to place for a sensor, T_child_sensor below it), or (None, None)."""
    joint = by_child.get(sensor.frame)
    if joint is None:
        return None, None
    above = by_child.get(joint.parent)
    turned = joint.T is not None and se3.angle(se3.inverse(joint.T) @ T_BODY_OPTICAL)
    optical = sensor.kind == "camera" and joint.type == "fixed" and joint.T is not None
    if optical and turned < SAME and above is not None and above.child not in placed:
        return above, joint.T
    return joint, np.eye(4)


def _without(frame, joints):
    near = difflib.get_close_matches(frame, [j.child for j in joints], 1)
    remedy = f"Did you mean {near[0]}?" if near else "Add a link and a fixed joint of that name."
    return failed(f"no joint has the child link {frame}", "", "the frame of its messages", remedy)


def _unfit(joint, scene, known):
    """Why a joint cannot be placed, or None."""
    if joint.type != "fixed":
        return failed(f"joint {joint.name} is {joint.type}", joint.type, "fixed")
    if joint.T is None:
        return failed(f"joint {joint.name}: {joint.why}", "", "three plain numbers each")
    rest = {k: T for k, T in known.items() if k != (joint.parent, joint.child)}
    if frame_graph.chain(rest, scene.parent, joint.parent) is None:
        return failed(
            f"no fixed joints lead from {scene.parent} to {joint.parent}",
            remedy="State export.parent as a link that they join, with T_parent_robot.",
        )
    return None
