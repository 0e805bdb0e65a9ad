"""Cases of damaged and hostile logs and configs.

A case: (folder, generator) -> warnings, "" if there are none; errors are not caught here.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import decode
import gate
from benchmarking.fuzzing.byte_damage import BYTE_DAMAGES
from benchmarking.fuzzing.hostile_messages import make_hostile_messages
from benchmarking.fuzzing.random_configs import draw_config_files
from benchmarking.fuzzing.small_recordings import (
    FUZZ_CONTAINERS,
    SENSOR_GROUPS,
    fuzz_decode_options,
    make_fuzz_messages,
    write_fuzz_log,
)
from calib.io.config import default_config_blocks, load_config
from calib.io.logs.open_log import open_log
from calib.io.parquet_tables import read_table
from calib.io.pose_block import pose_from_config
from calib.io.safe_yaml import load_yaml
from calib.io.stage_cli import read_json
from calib.io.status import InputError
from calib.io.table_schemas import FRAMES_SCHEMA
from calib.sensors.camera.images.image_messages import read_bgr
from calib.sensors.lidar.clouds import cloud_messages
from calib.sensors.lidar.clouds.cloud_layout import CloudLayout
from calib.sensors.sensor_models import sensor_model_from_config
from calib.targets.target_shapes import target_from_config

DECODE_OUTPUTS = ("mocap", "frames", "audit")
GATE_MOCAP = {
    "pose_sigma": {"xyz_m": 2e-4, "rpy_deg": 0.02},
    "pose_bias_sigma": {"xyz_m": 1e-4, "rpy_deg": 0.01},
    "max_gap_s": 0.05,
    "use_measured_noise": True,
}


def run_damaged_config(folder: Path, rng: np.random.Generator) -> str:
    """Load a damaged config, and make all that the stages make from it."""
    for name, content in draw_config_files(rng).items():
        path = folder / "config" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    stated = load_yaml(folder / "config/config.yaml")
    settings, rigs, targets = load_config(stated, folder / "config")
    json.dumps([settings, rigs, targets], sort_keys=True, allow_nan=False)
    for name in rigs:
        for block in rigs[name]["sensors"].values():
            if "T_robot_sensor" in block:
                pose_from_config(block["T_robot_sensor"])
            if "camera_info" not in block:
                sensor_model_from_config(block)
    for target in targets.values():
        pose_from_config(target["T_body_target"])
        target_from_config(target)
    return ""


def run_damaged_log(folder: Path, rng: np.random.Generator) -> str:
    """Decode a good log, in a random container, with damaged bytes."""
    names = SENSOR_GROUPS[rng.integers(len(SENSOR_GROUPS))]
    container = list(FUZZ_CONTAINERS)[rng.integers(len(FUZZ_CONTAINERS))]
    path = write_fuzz_log(container, folder / "log", make_fuzz_messages(names))
    path.write_bytes(
        BYTE_DAMAGES[rng.integers(len(BYTE_DAMAGES))](bytearray(path.read_bytes()), rng)
    )
    return decode_and_reread(folder, str(path), fuzz_decode_options(names))


def run_hostile_log(folder: Path, rng: np.random.Generator) -> str:
    """Decode a log, in a random container, with meaningless values in its messages."""
    names = SENSOR_GROUPS[rng.integers(len(SENSOR_GROUPS))]
    # The writer of bags accepts only ordered log times, and fewer types.
    container = rng.choice([c for c in FUZZ_CONTAINERS if not c.startswith("bag")])
    path = write_fuzz_log(container, folder / "log", make_hostile_messages(names, rng))
    return decode_and_reread(folder, str(path), fuzz_decode_options(names))


def decode_and_reread(folder: Path, log: str, options: dict[str, Any]) -> str:
    """Decode and gate a log and read its messages again; return the warnings."""
    out = {k: folder / "out" / k for k in DECODE_OUTPUTS}
    arguments = [w for k, path in out.items() for w in (f"--{k}", str(path))]
    try:
        decode.main([*arguments, "--options", json.dumps(options | {"log": log})])
    finally:
        written = sorted(p.name for p in (folder / "out").glob("*"))
        assert written in ([], sorted(DECODE_OUTPUTS)), f"files left: {written}"
    audit = read_json(out["audit"])
    _run_gate(folder, out)
    reread_faults = _reread_messages(
        log, read_table(out["frames"], FRAMES_SCHEMA)[0], options, audit
    )
    statuses = [a["status"] for k in ("bodies", "sensors") for a in audit[k].values()]
    reasons = [s["reason"] for s in statuses if not s["ok"]]
    return "; ".join([*audit["faults"], *reasons, *reread_faults])


def _run_gate(folder: Path, output_paths: dict[str, Path]) -> None:
    options = {
        "mocap": GATE_MOCAP,
        "gate": default_config_blocks()["gate"],
        "body": "robot",
        "targets": {"board": "board"},
    }
    files = {
        "--mocap": output_paths["mocap"],
        "--audit": output_paths["audit"],
        "--output": folder / "out" / "placements",
    }
    arguments = [word for key, path in files.items() for word in (key, str(path))]
    gate.main([*arguments, "--options", json.dumps(options)])


def _reread_messages(
    log: str, frames: dict[str, np.ndarray], options: dict[str, Any], audit: dict[str, Any]
) -> list[str]:
    """Read the messages again, as crop does; return the errors."""
    opened, errors = open_log(log), []
    for name, block in options["sensors"].items():
        if not audit["sensors"][name]["status"]["ok"]:
            continue
        read = _message_reader(block, audit["sensors"][name])
        for i in np.flatnonzero(frames["sensor"] == name):
            file_index, log_time_ns, index_at_log_time = (
                int(frames[k][i]) for k in ("file_index", "log_time_ns", "index_at_log_time")
            )
            try:
                read(
                    opened.read_message_content(
                        block["topic"], file_index, log_time_ns, index_at_log_time
                    )
                )
            except InputError as error:
                errors.append(str(error))
    return errors


def _message_reader(block: dict[str, Any], sensor_audit: dict[str, Any]) -> Callable[[Any], Any]:
    """Return the function with which crop reads the messages of a sensor."""
    if block["kind"] == "camera":
        return read_bgr
    layout = CloudLayout.from_dict(sensor_audit["layout"])
    return lambda message: cloud_messages.read_points(message, layout)
