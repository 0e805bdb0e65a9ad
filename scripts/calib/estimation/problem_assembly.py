"""Build the estimation problem: the Setup of the keypoints of one or several sessions.

The only place that turns keypoints into a Setup: stages extract, associate and solve use it.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from calib.estimation.estimation_problem import MeasurementGroup, Placement, SensorModel, Setup
from calib.estimation.measurement_groups import group_keypoints, make_still_placements
from calib.estimation.residuals.residual_registry import uses_template_points
from calib.io.parquet_tables import select_rows
from calib.io.pose_block import pose_sigma_from_config
from calib.io.status import Status
from calib.sensors.lens_from_log import find_lens_mismatches
from calib.sensors.sensor_models import sensor_model_from_config
from calib.targets.target_shapes import target_from_config

INITIAL_NOISE_FACTOR = 10.0  # least factor on the configured noise at the start of solve


@dataclass(frozen=True)
class SessionKeypoints:
    """The keypoints of one session, and what earlier stages know of its sensors.

    keypoints: columns of keypoints.parquet of all sensors, with `sensor`, and of solve with
    `candidate_feature` (pairs.parquet); placements: by number; T_robot_sensor: (4, 4) working poses
    by sensor, of those that have keypoints; guesses: guess.json by sensor; statuses: by sensor;
    log_start_ns: None if the session is a part of a cut one.
    """

    session: str
    keypoints: dict[str, np.ndarray]
    placements: dict[int, Placement]
    T_robot_sensor: dict[str, np.ndarray]
    guesses: dict[str, dict[str, Any]] = field(default_factory=dict)
    statuses: dict[str, Status] = field(default_factory=dict)
    log_start_ns: int | None = None

    def without_sensor(self, sensor: str, status: Status) -> "SessionKeypoints":
        """Return the session without the keypoints of a sensor, whose status is now this one."""
        rows = np.asarray(self.keypoints["sensor"]) != sensor
        return replace(
            self,
            keypoints=select_rows(self.keypoints, rows),
            statuses=self.statuses | {sensor: status},
        )


def session_keypoints_from_notes(
    *,
    session: str,
    keypoints: dict[str, np.ndarray],
    notes: Mapping[str, dict[str, Any]],
    placement_columns: dict[str, np.ndarray],
    mounts: dict[str, np.ndarray],
    options: dict[str, Any],
) -> SessionKeypoints:
    """Return a session from its tables.

    notes: {T_robot_sensor, guess, status} by sensor, as the notes of pairs.parquet; mounts:
    T_body_target (4, 4) of the targets whose mount was found by a guess.
    """
    guesses = {n: note["guess"] for n, note in notes.items()}
    poses = {n: note["T_robot_sensor"] for n, note in notes.items()}
    placements = make_still_placements(
        placement_columns,
        session,
        targets=options["targets"],
        mocap_noise=options["mocap"],
        mounts=mounts,
        clock_error_s=max(g["time_offset_s"]["sigma"] for g in guesses.values()),
    )
    return SessionKeypoints(
        session=session,
        keypoints=keypoints,
        placements=placements,
        T_robot_sensor={n: np.array(T) for n, T in poses.items() if T is not None},
        guesses=guesses,
        statuses={n: Status.from_dict(note["status"]) for n, note in notes.items()},
    )


def mounts_from_guesses(guesses: Iterable[Mapping[str, dict[str, Any]]]) -> dict[str, np.ndarray]:
    """Return T_body_target (4, 4) by target, of the first guess that found its mount.

    guesses: guess.json by sensor, of every session.
    """
    mounts: dict[str, np.ndarray] = {}
    for guess_by_sensor in guesses:
        for _, guess in sorted(guess_by_sensor.items()):
            for target, mount in sorted(guess["mounts"].items()):
                mounts.setdefault(target, np.array(mount["T_body_target"]["matrix"]))
    return mounts


def reject_lens_mismatches(sessions: Sequence[SessionKeypoints]) -> list[SessionKeypoints]:
    """Return the sessions without cameras whose CameraInfo differs between sessions."""
    mismatches = find_lens_mismatches({s.session: s.guesses for s in sessions})
    out = list(sessions)
    for sensor, status in mismatches.items():
        out = [s.without_sensor(sensor, status) if sensor in s.guesses else s for s in out]
    return out


def assemble_setup(
    sessions: Sequence[SessionKeypoints],
    *,
    models: dict[str, SensorModel],
    targets: dict[str, Any],
    associate_options: dict[str, Any],
    sensor_priors: dict[str, tuple[np.ndarray, np.ndarray]] | None = None,
) -> Setup:
    """Return the Setup of all keypoints: placements that were seen, and groups of keypoints."""
    placements: list[Placement] = []
    groups: list[MeasurementGroup] = []
    for session in sessions:
        numbers = sorted(set(np.asarray(session.keypoints["placement"]).tolist()))
        index_by_number = {number: len(placements) + i for i, number in enumerate(numbers)}
        placements += [session.placements[number] for number in numbers]
        for sensor in sensors_with_keypoints([session]):
            rows = select_rows(session.keypoints, session.keypoints["sensor"] == sensor)
            groups += group_keypoints(rows, sensor, index_by_number)
    return Setup(
        models=models,
        targets=targets,
        placements=placements,
        groups=groups,
        associate_options=associate_options,
        sensor_priors=sensor_priors or {},
        log_starts_ns={s.session: t for s in sessions if (t := s.log_start_ns) is not None},
    )


def sensors_with_keypoints(sessions: Sequence[SessionKeypoints]) -> list[str]:
    """Return the names of the sensors that have keypoints: session by session, sorted in each."""
    names: dict[str, None] = {}
    for session in sessions:
        names |= dict.fromkeys(sorted(set(np.asarray(session.keypoints["sensor"]).tolist())))
    return list(names)


def build_setup(
    sessions: Sequence[SessionKeypoints], mounts: dict[str, np.ndarray], options: dict[str, Any]
) -> tuple[Setup, dict[str, np.ndarray]]:
    """Return the Setup of a rig as configured, and the poses by sensor from which to start.

    mounts: T_body_target (4, 4) of the targets whose mount is estimated because it is not stated.
    Each sensor starts at the working pose of the first session that has its keypoints.
    """
    names = sensors_with_keypoints(sessions)
    blocks = {n: options["sensors"][n] for n in names}
    setup = assemble_setup(
        sessions,
        models={n: sensor_model_from_config(block) for n, block in blocks.items()},
        targets={n: target_from_config(block) for n, block in options["targets"].items()},
        associate_options=options["associate"],
    )
    seen_targets = {p.target for p in setup.placements}
    setup = replace(
        setup,
        initial_mounts={n: T for n, T in mounts.items() if n in seen_targets},
        estimable_intrinsics={
            n: len(block.get("params", ()))
            for n, block in blocks.items()
            if block["kind"] == "camera"
        },
        mount_sigma={
            n: pose_sigma_from_config(block["alignment_sigma"])
            for n, block in options["targets"].items()
            if "alignment_sigma" in block and n not in mounts
        },
    )
    first = {n: next(s for s in sessions if n in sensors_with_keypoints([s])) for n in names}
    return setup, {n: session.T_robot_sensor[n] for n, session in first.items()}


def best_time_offset_guess(sensor: str, sessions: Sequence[SessionKeypoints]) -> dict[str, Any]:
    """Return the time offset guess {value, sigma, source} with the smallest σ of all sessions.

    Clocks drift from one session to the next by less than the guesses are uncertain.
    """
    guesses = [s.guesses[sensor]["time_offset_s"] for s in sessions if sensor in s.guesses]
    return min(guesses, key=lambda guess: guess["sigma"])


def statuses_before_solve(
    sensors: Iterable[str], sessions: Sequence[SessionKeypoints]
) -> dict[str, tuple[Status, dict[str, Any]]]:
    """Return status and guess of every sensor before solve: ok if it has keypoints anywhere."""
    out = {}
    for sensor in sensors:
        seen = [s for s in sessions if sensor in s.statuses]
        best = next((s for s in seen if s.statuses[sensor].ok), seen[0])
        guess = best.guesses[sensor] | {"time_offset_s": best_time_offset_guess(sensor, sessions)}
        out[sensor] = best.statuses[sensor], guess
    return out


def iteration_limits(setup: Setup, options: dict[str, Any]) -> dict[str, Any]:
    """Return the limits of estimate_poses from block `solve` of the config."""
    by_points = any(uses_template_points(g.kind) for g in setup.groups)
    prefix = "points_" if by_points else ""
    return {
        "max_rounds": options["max_rounds"],
        "initial_noise_factor": INITIAL_NOISE_FACTOR,
        "tolerance_m": options[f"{prefix}tolerance_m"],
        "tolerance_rad": options[f"{prefix}tolerance_rad"],
    }
