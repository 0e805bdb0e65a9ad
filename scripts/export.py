"""Write the files that robots load; this is the one job that fails on a failed verdict.

Reads   calibration.json, verdict.json; frames.parquet and placements.parquet of all sessions;
        guess.json (for lenses from the log) and views.parquet of all their sensors; the URDF to
        patch, if there is one
Writes  export/*, unless the verdict is fail; earlier exports are removed first. A folder that holds
        other files is refused.
        The next file of history/, unless the calibration is the newest one there.
        The origins of the sensors' joints in the URDF, with a backup beside it
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib.export.accepted_calibrations import accept_calibration
from calib.export.calibrated_scene import ExportScene, ExportSession
from calib.export.export_readme import README_FILE_NAME, render_export_readme
from calib.export.formats.format_registry import FORMATS, is_export_file
from calib.export.scene_from_calibration import build_export_scene, build_export_session
from calib.io.atomic_files import atomic_folder, create_file, remove_folder
from calib.io.parquet_tables import read_table
from calib.io.stage_cli import StageArgumentParser, logger, read_json, run_stage
from calib.io.status import InputError, Status
from calib.io.table_schemas import FRAMES_SCHEMA, PLACEMENTS_SCHEMA
from calib.io.urdf.patch_urdf import patch_urdf
from calib.io.urdf.sensor_joints import SensorJoints
from calib.sensors.lens_from_log import with_lens_from_log


def read_export_sessions(
    args: argparse.Namespace, calibration: dict[str, Any]
) -> dict[str, ExportSession]:
    """Read the sessions with at least one message, by name.

    The files of sensors come by session, then by sensor, both sorted.
    """
    view_paths, sessions = iter(args.views), {}
    used = sorted(args.options["sessions"].items())
    for (name, sensors), frames_path, placements_path in zip(
        used, args.frames, args.placements, strict=True
    ):
        frames, _, _ = read_table(frames_path, FRAMES_SCHEMA, ("log_time_ns",))
        placements, _, _ = read_table(placements_path, PLACEMENTS_SCHEMA)
        paths = {sensor: next(view_paths) for sensor in sorted(sensors)}
        if len(frames["log_time_ns"]):
            sessions[name] = build_export_session(
                name,
                start_ns=int(np.min(frames["log_time_ns"])),
                calibration=calibration,
                placements=placements,
                view_paths=paths,
            )
    return sessions


def complete_lens_options(args: argparse.Namespace) -> dict[str, Any]:
    """Return the options with the lens of every camera whose parameters come from the log."""
    names = [n for _, sensors in sorted(args.options["sessions"].items()) for n in sorted(sensors)]
    guesses = zip(names, map(read_json, args.guesses), strict=True)
    return args.options | {"sensors": with_lens_from_log(args.options["sensors"], guesses)}


def patch_urdfs(paths: list[Path], scene: ExportScene) -> dict[Path, SensorJoints]:
    """Place the sensors in the URDFs, and log which joints hold them."""
    joints_by_urdf = {}
    for path in paths:
        joints = patch_urdf(path, scene.sensors.values(), scene.parent_frame)
        joints_by_urdf[path] = joints
        logger.info("%s: placed %s", path, ", ".join(sorted(joints.origins)) or "no joint")
        for name, status in sorted(joints.unplaced.items()):
            logger.warning("%s: %s is not placed: %s", path, name, status)
    return joints_by_urdf


def write_export_files(folder: Path, scene: ExportScene) -> dict[str, dict[str, Status]]:
    """Write the files of all formats; returns the status of each file by format."""
    status_by_format: dict[str, dict[str, Status]] = {}
    for name, export_format in FORMATS.items():
        status_by_format[name] = {}
        for file, content in sorted(export_format.render_files(scene).items()):
            if isinstance(content, Status):
                status_by_format[name][file] = content
                logger.warning("not written: %s: %s", file, content)
                continue
            status_by_format[name][file] = Status()
            data = content.encode() if isinstance(content, str) else content
            path = folder / file
            path.parent.mkdir(parents=True, exist_ok=True)
            create_file(path, data)
            logger.info("wrote %s (%s, %d bytes)", file, name, len(data))
    return status_by_format


def _is_own_file(name: str) -> bool:
    return name == README_FILE_NAME or is_export_file(name)


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


def main(argv: Sequence[str] | None = None) -> None:
    """Run the stage."""
    args = _parse_arguments(argv)
    remove_folder(args.output, _is_own_file)
    calibration, verdict = read_json(args.calibration), read_json(args.verdict)
    if verdict["verdict"] == "fail":
        raise InputError(
            f"{calibration['rig']}: the verdict is fail, so nothing is exported. Remove the causes "
            "and run again:\n  " + "\n  ".join(verdict["reasons"])
        )
    sessions = read_export_sessions(args, calibration)
    scene = build_export_scene(calibration, complete_lens_options(args), sessions)
    joints_by_urdf = patch_urdfs(args.urdf, scene)
    with atomic_folder(args.output, _is_own_file) as folder:
        status_by_format = write_export_files(folder, scene)
        readme = render_export_readme(scene, status_by_format, verdict, joints_by_urdf)
        create_file(folder / README_FILE_NAME, readme.encode())
        name = accept_calibration(args.history, calibration)
    logger.info("accepted as %s/%s.json", args.history, name)


if __name__ == "__main__":
    run_stage(main)
