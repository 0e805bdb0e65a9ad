"""Write a recording with a fault: motion capture and ranges without noise, config and truth."""

import argparse
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from benchmarking.fault_matrix.config_mistakes import WrittenConfig, edit_config
from benchmarking.fault_matrix.matrix_faults import MatrixFault
from calib.io.logs.ros_messages import RosMessage
from simulate import draw_sessions, parse_simulation_arguments
from simulation.config_and_truth import simulated_log_path, write_simulated_config, write_truth
from simulation.ros_log import write_simulated_mcap
from simulation.session_recording import SessionTruth, generate_messages

# Noise that the draws put on keypoints and poses instead. That of images moves corners by little.
DRAWN_NOISE = {
    "range_noise_m": 0.0, "mcs_noise_m": 0.0, "mcs_noise_deg": 0.0, "mcs_wander_m": 0.0,
    "mcs_wander_deg": [0.0] * 3, "mcs_bias_m": 0.0, "mcs_bias_deg": 0.0,
}  # fmt: skip
# Settings that save time: more frames of a placement tell little; a hundredth of σ is enough.
CROP_SETTINGS = {"max_frames": 3}
SOLVE_SETTINGS = {"tolerance_m": 1e-6, "tolerance_rad": 1e-6}


def write_fault_recording(folder: Path, fault: MatrixFault) -> argparse.Namespace:
    """Write a recording with a fault into a folder; return the arguments of simulate.py.

    The config is the one for the recording with noise.
    """
    words = f"{fault.recording} {fault.arguments}".split()
    args = parse_simulation_arguments([str(folder), *words])
    sessions, guesses = draw_sessions(args)
    write_simulated_config(folder / "config", args.rig, sessions, guesses)
    hide_truth(folder / "config")
    if fault.change_config:
        edit_config(folder / "config", fault.change_config)
    write_truth(folder / "truth.json", sessions, guesses)
    for session in map(_without_drawn_noise, sessions):
        messages: Iterable[RosMessage] = generate_messages(session)
        if fault.change_messages:
            messages = fault.change_messages(list(messages))
        path = folder / simulated_log_path(session.name)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_simulated_mcap(path, messages)
    return args


def _without_drawn_noise(session: SessionTruth) -> SessionTruth:
    """Return a session whose messages have no noise but that of the images."""
    quiet = argparse.Namespace(**(vars(session.arguments) | DRAWN_NOISE))
    biases = {name: np.zeros_like(b) for name, b in session.mcs_biases.items()}
    return replace(session, arguments=quiet, mcs_biases=biases)


def hide_truth(folder: Path) -> None:
    """Take the truth out of a simulated config, and put settings in that save time."""

    def change(config: WrittenConfig) -> None:
        config.rig.pop("truth", None)
        for block, settings in (("crop", CROP_SETTINGS), ("solve", SOLVE_SETTINGS)):
            config.pipeline[block] = config.pipeline.get(block, {}) | settings

    edit_config(folder, change)


def read_yaml(path: Path) -> dict:
    """Return the content of a YAML file."""
    return dict(yaml.safe_load(path.read_text()))
