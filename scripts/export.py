"""Files that robots load; the one job that fails on a failed verdict.

Reads   calibration.json, verdict.json; frames.parquet and placements.parquet of all sessions,
        guess.json and views.parquet of all their sensors, the former for lenses that the log tells;
        the URDF that is to be patched, where there is one
Writes  export/*, unless the verdict is fail; what stood there before is removed first; and adds the
        calibration to history/. The origins of the sensors' joints in that URDF, with a backup
        beside it
"""

import argparse
import os
import shutil
from collections.abc import Sequence

import numpy as np

from calib.export.accepted_calibrations import accept_calibration
from calib.export.calibrated_scene import build_export_scene, build_export_session
from calib.export.export_readme import README_FILE_NAME, render_export_readme
from calib.export.formats.format_registry import FORMATS
from calib.export.urdf_sensor_joints import compute_joint_origins
from calib.io.atomic_files import atomic_folder, atomic_write, remove_folder
from calib.io.parquet_tables import read_table
from calib.io.stage_cli import StageArgumentParser, logger, read_json, run_stage
from calib.io.status import InputError, Status
from calib.io.table_schemas import FRAMES_SCHEMA, PLACEMENTS_SCHEMA
from calib.io.urdf_file import read_urdf_joints, replace_joint_origins, urdf_backup_path
from calib.sensors.lens_from_log import with_lens_from_log


def read_export_sessions(args, calibration):
    """The formats' Sessions by name, of those with a message; per-sensor files come by session,
    then sensor, both sorted."""
    views, out = iter(args.views), {}
    used = sorted(args.options["sessions"].items())
    for (name, sensors), frames, table in zip(used, args.frames, args.placements, strict=True):
        columns, _, _ = read_table(frames, FRAMES_SCHEMA, ("log_time_ns",))
        placements, _, _ = read_table(table, PLACEMENTS_SCHEMA)
        paths = {s: next(views) for s in sorted(sensors)}
        if len(columns["log_time_ns"]):
            start = int(np.min(columns["log_time_ns"]))
            out[name] = build_export_session(name, start, calibration, placements, paths)
    return out


def complete_lens_options(args):
    """The options, with the lens of every camera whose parameters the config leaves to the log."""
    names = [n for _, used in sorted(args.options["sessions"].items()) for n in sorted(used)]
    guesses = zip(names, map(read_json, args.guesses), strict=True)
    return args.options | {"sensors": with_lens_from_log(args.options["sensors"], guesses)}


def patch_urdf(path, scene):
    """Place the sensors of a Scene in the URDF at a path; returns ({child link: T_parent_child},
    {sensor: Status of why it is not among them}).

    The file as it was before the first calibration stays beside it. It is replaced in one step,
    and only by what reads as it should.
    """
    path = path.resolve()
    data = path.read_bytes()
    joints = read_urdf_joints(data, path)
    placed, unplaced = compute_joint_origins(joints, scene)
    if unplaced and not placed:
        reasons = "; ".join(f"{n}: {status}" for n, status in sorted(unplaced.items()))
        raise InputError(f"{path.name}: no sensor can be placed in it: {reasons}")
    changed = replace_joint_origins(data, joints, placed)
    for joint in read_urdf_joints(changed, path):
        if (
            joint.child in placed
            and np.abs(joint.T_parent_child - placed[joint.child]).max() > 1e-12
        ):
            raise InputError(f"{path}: joint {joint.name} cannot be written; the file is untouched")
    if changed != data:
        backup = urdf_backup_path(path)
        if not backup.exists():
            replace_file(backup, data, path)
        replace_file(path, changed, path)
    return placed, unplaced


def replace_file(path, data, permissions_from):
    """Write a file in one step, with the permissions of another, and through to the disk."""
    with atomic_write(path) as part:
        with part.open("wb") as new:
            new.write(data)
            new.flush()
            os.fsync(new.fileno())
        shutil.copymode(permissions_from, part)


def write_export_files(folder, scene):
    """Write the files of all formats; returns {format: {file name: Status}}."""
    out = {}
    for name, module in FORMATS.items():
        out[name] = {}
        for file, content in sorted(module.render_files(scene).items()):
            out[name][file] = content if isinstance(content, Status) else Status()
            if isinstance(content, Status):
                logger.warning("not written: %s: %s", file, content)
                continue
            data = content.encode() if isinstance(content, str) else content
            path = folder / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
            logger.info("wrote %s (%s, %d bytes)", file, name, len(data))
    return out


def _parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = StageArgumentParser(__doc__)
    parser.add_path("--calibration", "calibration.json")
    parser.add_path("--verdict", "verdict.json")
    parser.add_paths("--frames", "frames.parquet of each session")
    parser.add_paths("--placements", "placements.parquet of each session")
    parser.add_paths("--guesses", "guess.json of each session and sensor")
    parser.add_paths("--views", "views.parquet of each session and sensor")
    parser.add_paths("--urdf", "URDF to update in place, if any")
    parser.add_path("--output", "folder to write")
    parser.add_path("--history", "folder of the accepted calibrations")
    return parser.parse_args(argv)


def main(argv=None):
    args = _parse_arguments(argv)
    remove_folder(args.output)
    calibration, judged = read_json(args.calibration), read_json(args.verdict)
    if judged["verdict"] == "fail":
        raise InputError(
            f"{calibration['rig']} is not exported, its calibration failed:\n  "
            + "\n  ".join(judged["reasons"])
        )
    described = build_export_scene(
        calibration, complete_lens_options(args), read_export_sessions(args, calibration)
    )
    mounted = {path: patch_urdf(path, described) for path in args.urdf}
    for path, (placed, unplaced) in mounted.items():
        logger.info("%s: placed %s", path, ", ".join(sorted(placed)) or "no joint")
        for name, status in sorted(unplaced.items()):
            logger.warning("%s: %s is not placed: %s", path, name, status)
    with atomic_folder(args.output) as folder:
        written = write_export_files(folder, described)
        (folder / README_FILE_NAME).write_text(
            render_export_readme(described, written, judged, mounted)
        )
        accepted = accept_calibration(args.history, calibration)
    logger.info("accepted as %s", accepted)


if __name__ == "__main__":
    run_stage(main)
