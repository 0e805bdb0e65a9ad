"""Files that robots load; the one job that fails on a failed verdict.

Reads   calibration.json, verdict.json; frames.parquet and placements.parquet of all sessions,
        guess.json and views.parquet of all their sensors, the former for lenses that the log tells;
        the URDF that is to be patched, where there is one
Writes  export/*, unless the verdict is fail; what stood there before is removed first; and adds the
        calibration to history/. The origins of the sensors' joints in that URDF, with a backup
        beside it
"""

import os
import shutil

import numpy as np

from calib.export import accepted_calibrations, export_readme, urdf_sensor_joints
from calib.export.calibrated_scene import scene, session
from calib.export.formats import format_registry
from calib.io import atomic_files, parquet_tables, stage_cli, table_schemas, urdf_file
from calib.io.stage_cli import logger
from calib.io.status import InputError, Status
from calib.sensors import lens_from_log


def read_sessions(args, calibration):
    """The formats' Sessions by name, of those with a message; per-sensor files come by session,
    then sensor, both sorted."""
    views, out = iter(args.views), {}
    used = sorted(args.options["sessions"].items())
    for (name, sensors), frames, table in zip(used, args.frames, args.placements, strict=True):
        columns, _, _ = parquet_tables.read(frames, table_schemas.FRAMES, ("log_t",))
        placements, _, _ = parquet_tables.read(table, table_schemas.PLACEMENTS)
        paths = {s: next(views) for s in sorted(sensors)}
        if len(columns["log_t"]):
            start = int(np.min(columns["log_t"]))
            out[name] = session(name, start, calibration, placements, paths)
    return out


def with_lenses(args):
    """The options, with the lens of every camera whose parameters the config leaves to the log."""
    names = [n for _, used in sorted(args.options["sessions"].items()) for n in sorted(used)]
    guesses = zip(names, map(stage_cli.read_json, args.guesses), strict=True)
    return args.options | {"sensors": lens_from_log.told(args.options["sensors"], guesses)}


def patch(path, described):
    """Place the sensors of a Scene in the URDF at a path; returns ({child link: T_parent_child},
    {sensor: Status of why it is not among them}).

    The file as it was before the first calibration stays beside it. It is replaced in one step,
    and only by what reads as it should.
    """
    path = path.resolve()
    data = path.read_bytes()
    joints = urdf_file.read(data, path)
    placed, unplaced = urdf_sensor_joints.poses(joints, described)
    if unplaced and not placed:
        reasons = "; ".join(f"{n}: {status}" for n, status in sorted(unplaced.items()))
        raise InputError(f"{path.name}: no sensor can be placed in it: {reasons}")
    changed = urdf_file.patched(data, joints, placed)
    for joint in urdf_file.read(changed, path):
        if joint.child in placed and np.abs(joint.T - placed[joint.child]).max() > 1e-12:
            raise InputError(f"{path}: joint {joint.name} cannot be written; the file is untouched")
    if changed != data:
        backup = urdf_file.backup_of(path)
        if not backup.exists():
            replace(backup, data, path)
        replace(path, changed, path)
    return placed, unplaced


def replace(path, data, like):
    """Write a file in one step, with the permissions of another, and through to the disk."""
    with atomic_files.whole(path) as part:
        with part.open("wb") as new:
            new.write(data)
            new.flush()
            os.fsync(new.fileno())
        shutil.copymode(like, part)


def write(folder, described):
    """Write the files of all formats; returns {format: {file name: Status}}."""
    out = {}
    for name, module in format_registry.FORMATS.items():
        out[name] = {}
        for file, content in sorted(module.render(described).items()):
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


def main(argv=None):
    args = stage_cli.parser(
        __doc__,
        calibration="input",
        verdict="input",
        frames="*input, one per session",
        placements="*input, one per session",
        guesses="*input, one per session and sensor",
        views="*input, one per session and sensor",
        urdf="*input and output, one or none",
        output="folder",
        history="folder of the calibrations that were accepted",
        options="slice of the config",
    ).parse_args(argv)
    atomic_files.remove_folder(args.output)
    calibration, judged = stage_cli.read_json(args.calibration), stage_cli.read_json(args.verdict)
    if judged["verdict"] == "fail":
        raise InputError(
            f"{calibration['rig']} is not exported, its calibration failed:\n  "
            + "\n  ".join(judged["reasons"])
        )
    described = scene(calibration, with_lenses(args), read_sessions(args, calibration))
    mounted = {path: patch(path, described) for path in args.urdf}
    for path, (placed, unplaced) in mounted.items():
        logger.info("%s: placed %s", path, ", ".join(sorted(placed)) or "no joint")
        for name, status in sorted(unplaced.items()):
            logger.warning("%s: %s is not placed: %s", path, name, status)
    with atomic_files.whole_folder(args.output) as folder:
        written = write(folder, described)
        (folder / export_readme.FILE).write_text(
            export_readme.render(described, written, judged, mounted)
        )
        accepted = accepted_calibrations.accept(args.history, calibration)
    logger.info("accepted as %s", accepted)


if __name__ == "__main__":
    stage_cli.run(main)
