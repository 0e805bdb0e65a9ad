"""Container × motion capture × lidar driver × kind of image: the same scene, the same extrinsics.

Every two values of any two axes meet in a cell at least once (covering). Of every cell each stream
is decoded, and held against that of the same value in the cells that were taken to the end: poses,
stamps, points and pixels equal to the last bit, where the message holds the same bits. All that
follows decode is a function of these. Every value of every axis is in a cell that goes on to
calibration.json, whose poses are those of the reference, and the truth, to 1e-6 m and rad.
"""

import hashlib
import json
import tempfile
from functools import cache
from itertools import combinations, product
from pathlib import Path

import numpy as np
import pytest
import yaml

import associate
import crop
import decode
import extract
import gate
import guess
import judge
import solve
from calib.geometry.se3 import invert_pose, rotation_angle
from calib.io.logs.open_log import fingerprint_log, open_log
from calib.io.parquet_tables import select_rows
from calib.sensors.lidar.clouds.cloud_messages import read_raw_cloud
from calib.sensors.lidar.clouds.raw_cloud import stack_xyz
from calib.sensors.sensor_models import with_log_metadata
from calib.views.sensor_croppers import make_frame_reader
from helpers import driver_recordings, log_containers
from helpers.driver_recordings import (
    FOCAL_LENGTH_PX,
    IMAGE_VARIANTS,
    LIDAR_VARIANTS,
    MOCAP_VARIANTS,
    make_driver_recording,
    record_driver_scene,
)
from helpers.log_containers import LOG_CONTAINERS, decode_tables, write_in_container
from helpers.small_run import list_job_commands
from simulation.config_and_truth import rounded_pose_json
from simulation.world.room_scene import SIMULATED_TARGETS

AXES = {
    "container": list(LOG_CONTAINERS),
    "mocap": list(MOCAP_VARIANTS),
    "driver": list(LIDAR_VARIANTS),
    "image": list(IMAGE_VARIANTS),
}
# SQLite files of Humble and older tell nothing of types that ROS does not ship.
OWN = {"RigidBodies", "NamedPoseArray", "Position", "livox_custom", "foxglove"}
OWN |= {"foxglove raw", "foxglove png"}


def possible(cell):
    return "no definitions" not in cell[0] or not OWN & set(cell)


def covering(axes):
    """Cells in which every possible pair of values of two axes occurs: each begins with the first
    pair that is missing, and takes of every other axis the value that brings most of those left."""
    places = [(i, value) for i, axis in enumerate(axes) for value in axis]
    pairs = {p: None for p in combinations(places, 2) if p[0][0] != p[1][0]}
    pending = {p for p in pairs if possible([v for _, v in p])}
    cells = []
    for pair in pairs:
        if pair in pending:
            chosen = dict(pair)
            for i, axis in enumerate(axes):
                if i not in chosen:
                    fits = [v for v in axis if possible([*chosen.values(), v])]
                    chosen[i] = max(fits, key=lambda v: len(_met(chosen | {i: v}) & pending))
            pending -= _met(chosen)
            cells.append(tuple(chosen[i] for i in range(len(axes))))
    return cells


def _met(chosen):
    return set(combinations(sorted(chosen.items()), 2))


CELLS = covering(list(AXES.values()))
REFERENCE = ("mcap, zstd", "TFMessage", "velodyne", "bgr8")
# One line of returns does not make a board: of these the points are compared.
ONE_LINE = "laserscan"


def whole(cells):
    """Those of the cells, one by one that with the most values still missing, until every value of
    every axis is in one."""
    chosen = [REFERENCE]
    missing = {(i, v) for i, axis in enumerate(AXES.values()) for v in axis if v != ONE_LINE}
    missing -= set(enumerate(REFERENCE))
    fits = [c for c in cells if ONE_LINE not in c]
    while missing:
        chosen.append(max(fits, key=lambda c: len(missing & set(enumerate(c)))))
        missing -= set(enumerate(chosen[-1]))
    return chosen


WHOLE = whole(CELLS)


def with_own_definitions(cells):
    """The first cell of every pair of a container and a type that ROS does not ship: the container
    must carry its definition."""
    first = {}
    for cell in cells:
        for value in OWN & set(cell):
            first.setdefault((cell[0], value), cell)
    return set(first.values())


# Container, types and encodings are independent but for the definitions of types: these cells have
# every value and every such pair; the other pairs take longer.
FAST_CELLS = {*WHOLE, *with_own_definitions(CELLS)}
CELL_PARAMS = [pytest.param(c, marks=() if c in FAST_CELLS else pytest.mark.slow) for c in CELLS]
WHOLE_PARAMS = [
    pytest.param(c, marks=() if i < 4 else pytest.mark.slow) for i, c in enumerate(WHOLE)
]
# By how much these kinds of images move a corner, px; all others keep every grey level.
LOSSY = {"jpeg": 0.05, "bayer_rggb8": 0.06, "nv12": 0.05, "yuv422": 0.01}
AWAY_M = 2.0  # of the board
# Of these the poses differ in the last bits: 32-bit floats; products of transforms.
ROUNDED = {"Position", "TFMessage, a chain"}


# --- the pipeline, in this process

HOME = "results/matrix/matrix"
SENSORS = ("camera", "lidar")
BODIES = {"robot_body": 0, "board_body": 1}  # in the options; by their number in MOCAP's names


@pytest.fixture(scope="module")
def commands(tmp_path_factory):
    """{(stage, sensor or ""): arguments}, as Snakemake makes them of a config."""
    folder = tmp_path_factory.mktemp("config")
    known = record_driver_scene()
    zero = {"xyz_m": 1e-8, "rpy_deg": 1e-6}
    sensors = {
        "lidar": {
            "kind": "lidar",
            "topic": driver_recordings.CLOUD_TOPIC,
            "azimuth_step_deg": 0.5,
            "elevation_step_deg": 2.0,
            "range_sigma_m": 0.001,
        },
        "camera": {
            "kind": "camera",
            "topic": driver_recordings.IMAGE_TOPIC,
            "model": "radtan",
            "size_px": list(driver_recordings.IMAGE_SIZE_PX),
            "params": list(driver_recordings.LENS_PARAMS),
        },
    }
    for name, T in known.guess_poses.items():
        sensors[name]["T_robot_sensor"] = rounded_pose_json(T)
    mocap = {
        "topics": ["/tf"],
        "map": log_containers.MAP_FRAME,
        "pose_sigma": zero,
        "pose_bias_sigma": zero,
    }
    written = {
        "config.yaml": {
            "sessions": {"matrix": {"rig": "matrix", "log": "a.mcap"}},
            "crop": {"max_frames": 3, "max_moving_views": 4},
        },
        "rigs/matrix.yaml": {"body": "robot_body", "mocap": mocap, "sensors": sensors},
        "targets/panel.yaml": SIMULATED_TARGETS["board"] | {"body": "board_body"},
    }
    for path, content in written.items():
        path = folder / "config" / path
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(yaml.safe_dump(content))
    write_in_container("mcap, zstd", folder, make_driver_recording("TFMessage", "velodyne", "bgr8"))
    return list_job_commands(folder)


def options(command, kind, driver, log):
    """The options of a command for a log with that kind of motion capture and lidar."""
    _, topics, names = MOCAP_VARIANTS[kind]
    given = _renamed(json.loads(command[-1]), names)
    if driver == "laserscan":
        given = _flat(given)
    given |= {"log": log} if "log" in given else {}
    if "fingerprint" in given:
        given |= {"fingerprint": fingerprint_log(log)}
        given["mocap"] |= {"topics": topics}
    return given


def _renamed(value, names):
    """The same with the bodies called as in the log."""
    if isinstance(value, dict):
        return {k: _renamed(v, names) for k, v in value.items()}
    if isinstance(value, list):
        return [_renamed(v, names) for v in value]
    return names[BODIES[value]] if value in BODIES else value


FLAT = {"azimuth_step_deg": 0.25, "elevation_step_deg": 0.5}


def _flat(value):
    """The same with the steps of a 2-D scanner."""
    if not isinstance(value, dict):
        return value
    found = {k: _flat(v) for k, v in value.items()}
    return found | FLAT if FLAT.keys() <= value.keys() else found


def calibrated(folder, commands, kind, driver, log):
    """calibration.json of a log, taken through all stages in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for name in SENSORS:
            Path(HOME, name).mkdir(parents=True)

        def run(module, sensor=""):
            command = commands[module.__name__, sensor]
            given = options(command, kind, driver, log)
            module.main([*command[:-1], json.dumps(given)])

        for module in (decode, gate):
            run(module)
        for sensor, module in product(SENSORS, (guess, crop, extract)):
            run(module, sensor)
        for module in (associate, solve, judge):
            run(module)
        return json.loads(Path("results/matrix/calibration.json").read_text())


def streams(log, given, sensors):
    """{axis: digest} of what decode makes of each stream: poses and stamps; points, rings and
    times; pixels. given: the options of decode; sensors: their blocks of the rig."""
    columns, frames, audit = decode_tables(log, given)
    bodies = [select_rows(columns, columns["body"] == body) for body in given["bodies"]]
    out = {"mocap": _digest(*(b[k] for b in bodies for k in ("stamp_ns", "xyz", "quat", "fault")))}
    opened = open_log(log)
    for name, axis in (("lidar", "driver"), ("camera", "image")):
        assert audit["sensors"][name]["status"]["ok"]
        mine = select_rows(frames, frames["sensor"] == name)
        block = with_log_metadata(sensors[name], audit["sensors"][name])
        read = make_frame_reader(opened, block, mine)
        content = [read(i) for i in range(len(mine["stamp_ns"]))]
        content = [a for c in content for a in (c if isinstance(c, tuple) else (c,))]
        out[axis] = _digest(mine["stamp_ns"], *content)
    return out


@pytest.fixture(scope="module")
def found(commands):
    """calibration.json and streams by cell, each made when it is asked for."""
    sensors = {n: json.loads(commands["crop", n][-1])["sensor"] for n in SENSORS}

    @cache
    def of(cell, to_the_end=False):
        with tempfile.TemporaryDirectory() as folder:
            container, *recorded = cell
            log = write_in_container(container, Path(folder), make_driver_recording(*recorded))
            if to_the_end:
                return poses(calibrated(folder, commands, *recorded[:2], log))
            given = options(commands["decode", ""], *recorded[:2], log)
            return streams(log, given, sensors)

    return of


def poses(calibration):
    """{sensor: T_robot_sensor (4, 4)} of a calibration.json."""
    assert all(s["status"]["ok"] for s in calibration["sensors"].values()), calibration["reasons"]
    return {n: np.array(s["T_robot_sensor"]["matrix"]) for n, s in calibration["sensors"].items()}


def off(one, other):
    """By how much two poses (4, 4) differ: the larger of m and rad."""
    T = invert_pose(one) @ other
    return max(np.linalg.norm(T[:3, 3]), rotation_angle(T[:3, :3]))


def name(cell):
    return " - ".join(cell)


def test_every_possible_pair_of_values_is_in_a_cell_and_every_value_in_one_that_goes_to_the_end():
    axes = list(AXES.values())
    for (i, one), (k, other) in combinations(enumerate(axes), 2):
        for pair in product(one, other):
            assert not possible(pair) or any((c[i], c[k]) == pair for c in CELLS)
    for i, axis in enumerate(axes):
        assert {c[i] for c in WHOLE} == set(axis) - {ONE_LINE}


@pytest.mark.parametrize("cell", WHOLE_PARAMS, ids=name)
def test_the_pipeline_ends_in_the_same_extrinsics(found, cell):
    got, reference, true = (
        found(cell, True),
        found(REFERENCE, True),
        record_driver_scene().T_robot_sensor,
    )
    assert off(reference["lidar"], got["lidar"]) < 1e-6
    assert off(true["lidar"], got["lidar"]) < 1e-6
    limit = LOSSY.get(cell[3], 0.0) * AWAY_M / FOCAL_LENGTH_PX
    assert off(reference["camera"], got["camera"]) < 1e-6 + limit
    assert off(true["camera"], got["camera"]) < 2e-4 + limit


@pytest.mark.parametrize("cell", CELL_PARAMS, ids=name)
def test_every_stream_of_a_cell_is_that_of_a_cell_which_goes_to_the_end(found, cell):
    got = found(cell)
    for i, axis in enumerate(("mocap", "driver", "image"), 1):
        if cell[i] != ONE_LINE:
            same = next(c for c in WHOLE if c[i] == cell[i])
            assert got[axis] == found(same)[axis], axis
    if cell[1] not in ROUNDED:
        assert got["mocap"] == found(REFERENCE)["mocap"]


def test_points_of_a_laserscan_are_those_of_a_cloud_of_the_same_beam_to_a_micrometre():
    ((t, echoes), *_) = record_driver_scene().single_beam_scans
    scan, cloud = (
        read_raw_cloud(LIDAR_VARIANTS[driver](t, echoes)) for driver in (ONE_LINE, "velodyne")
    )
    one, other = stack_xyz(scan), stack_xyz(cloud)
    assert len(one) == len(other) > 100
    assert np.abs(one - other).max() < 1e-6


def _digest(*arrays):
    found = hashlib.sha256()
    for array in arrays:
        array = np.ascontiguousarray(array)
        found.update(repr((array.shape, array.dtype.str)).encode() + array.tobytes())
    return found.hexdigest()
