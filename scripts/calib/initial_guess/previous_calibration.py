"""First guesses read back from what robots load: a URDF, or an earlier calibration.json."""

import json
from pathlib import Path

from calib.io.pose_block import pose_from_config, pose_json
from calib.io.status import InputError
from calib.io.urdf.urdf_file import fixed_joint_transforms, read_urdf_joints, urdf_backup_path


def read_previous_calibration(path, config):
    """{sensor: {source, T_robot_sensor}} of a calibration.json, or {sensor: {source, static}} of a
    URDF, its fixed joints as the static transforms of log.json; config: the rig. Poses as JSON.

    Raises InputError for a file that is neither, or none of this rig.
    """
    reader = _poses_from_calibration if Path(path).suffix == ".json" else _transforms_from_urdf
    return reader(Path(path), config)


def _poses_from_calibration(path, config):
    if path.resolve().is_relative_to(Path("results").resolve()):
        raise InputError(
            f"guess_from: {path}: copy it out of results/: a result that were its own first guess "
            "would run everything again each time"
        )
    try:
        sensors = json.loads(path.read_text())["sensors"]
        poses = {n: s["T_robot_sensor"] for n, s in sensors.items() if s["T_robot_sensor"]}
        known = {
            n: pose_from_config({k: T[k] for k in ("xyz_m", "quat_xyzw")}) for n, T in poses.items()
        }
    except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
        raise InputError(f"guess_from: {path}: no calibration.json: {error!r}") from None
    if not set(known) & set(config["sensors"]):
        raise InputError(
            f"guess_from: {path}: knows {', '.join(sorted(known)) or 'no pose'}, of this rig's "
            f"sensors none: {', '.join(sorted(config['sensors']))}"
        )
    return {
        n: {"source": path.name, "T_robot_sensor": pose_json(known[n])}
        for n in sorted(set(known) & set(config["sensors"]))
    }


def _transforms_from_urdf(path, config):
    """What the joints were before a calibration was written into them: a first guess that followed
    from the result would run everything again each time."""
    known = fixed_joint_transforms(read_urdf_joints(path.read_bytes(), path))
    backup = urdf_backup_path(path)
    if backup.is_file():
        before = fixed_joint_transforms(read_urdf_joints(backup.read_bytes(), backup))
        known |= {edge: T for edge, T in before.items() if edge in known}
    links = {link for edge in known for link in edge}
    parent, body = config["export"].get("parent", {}), config["body"]
    if "T_parent_robot" in parent:
        known[parent["frame"], body] = pose_from_config(parent["T_parent_robot"])
    if not links & {body, parent["frame"] if "T_parent_robot" in parent else body}:
        raise InputError(
            f"guess_from: {path}: no link {body} hangs on a fixed joint; state as export.parent a "
            f"link of it, frame, with T_parent_robot; links: {', '.join(sorted(links)) or 'none'}"
        )
    static = [
        {
            "parent": a,
            "child": b,
            "T": {k: pose_json(T)[k] for k in ("xyz_m", "quat_xyzw")},
        }
        for (a, b), T in sorted(known.items())
    ]
    return {n: {"source": path.name, "static": static} for n in sorted(config["sensors"])}
