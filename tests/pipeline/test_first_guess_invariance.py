"""Where within its uncertainty a first guess lies has no part in the result."""

import json
from pathlib import Path

import numpy as np
import pytest

import associate
import crop
import decode
import extract
import gate
import guess
import solve
from calib.geometry.se3 import invert_pose, make_pose, se3_log, so3_exp
from calib.io.parquet_tables import read_table
from calib.io.pose_block import pose_from_config
from calib.io.safe_yaml import load_yaml
from calib.io.stage_cli import read_json
from calib.io.table_schemas import PAIRS_SCHEMA
from helpers.small_run import (
    SMALL_ARGUMENTS,
    edit_yaml,
    list_job_commands,
    simulate_into,
    simulated_config_path,
)

pytestmark = pytest.mark.slow
ARGUMENTS = (
    f"{SMALL_ARGUMENTS} --range-noise-m 0.01 --image-noise 1.8 --mcs-noise-m 0.00015"
    " --mcs-noise-deg 0.02 --mcs-bias-m 0.0001 --mcs-bias-deg 0.01"
)
HOME = "results/sim/sim"
SENSORS = ("camera", "velodyne")
BOX = np.array([0.05, 0.05, 0.05, *np.radians([8, 8, 8])])
CORNERS = np.array([[1, 1, 1, 1, 1, 1], [-1, 1, -1, -1, 1, -1], [1, -1, 1, -1, -1, 1]])


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    """A small log, decoded and gated, with the arguments of all stages; works in its folder."""
    folder = simulate_into(tmp_path_factory.mktemp("starts"), ARGUMENTS)
    edit_yaml(simulated_config_path(folder), lambda c: c.update(crop={"max_frames": 1}))
    commands = list_job_commands(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for sensor in SENSORS:
            (Path(HOME) / sensor).mkdir(parents=True)
        decode.main(commands["decode", ""])
        gate.main(commands["gate", ""])
        yield commands


@pytest.fixture(scope="module")
def ends(here):
    """What the stages up to associate make of the truth and of corners of a box about it:
    [{sensor: (working pose, members)}]; and the solutions of the first and the last."""
    found, solved = [], []
    for corner in (np.zeros(6), *CORNERS):
        for sensor in SENSORS:
            guess.main(started(here["guess", sensor], corner * BOX))
            crop.main(here["crop", sensor])
            extract.main(here["extract", sensor])
        associate.main(here["associate", ""])
        pairs, _, notes = read_table(f"{HOME}/pairs.parquet", PAIRS_SCHEMA)
        found.append({s: (notes[s]["T_robot_sensor"], members(pairs, s)) for s in SENSORS})
        if len(found) in (1, 1 + len(CORNERS)):
            solve.main(here["solve", ""])
            solved.append(read_json("results/sim/solution.json")["sensors"])
    return found, solved


def started(arguments, off):
    """Arguments of guess with a stated pose that is off by a twist (6,), its rotation about the
    truth's own axes, and with the default uncertainty."""
    options = json.loads(arguments[-1])
    truth = load_yaml("config/rigs/sim.yaml")["truth"][options["name"]]
    T = pose_from_config(truth) @ make_pose(so3_exp(off[3:]), off[:3])
    options["sensor"]["T_robot_sensor"] = {"matrix": T.tolist()}
    options["sensor"]["guess_sigma"] = options["guess"]["sigma"]
    return [*arguments[:-1], json.dumps(options)]


def members(pairs, sensor):
    """Every member of a sensor: its target, view, kind and index, sorted."""
    mine = (pairs["sensor"] == sensor) & pairs["is_inlier"]
    columns = (pairs[k][mine].tolist() for k in ("target", "view", "kind", "feature_index"))
    return sorted(zip(*columns, strict=True))


@pytest.mark.parametrize("sensor", SENSORS)
def test_all_starts_end_with_the_same_views_and_members(ends, sensor):
    first, *others = (found[sensor][1] for found in ends[0])
    assert len(first) > 50
    assert all(other == first for other in others)


def test_the_lidar_s_members_lie_on_both_targets(ends):
    assert {target for target, *_ in ends[0][0]["velodyne"][1]} == {"board", "cylinder"}


@pytest.mark.parametrize("sensor", SENSORS)
def test_all_starts_give_extraction_one_working_pose_to_5_micrometres(ends, sensor):
    first, *others = (np.array(found[sensor][0]) for found in ends[0])
    for other in others:
        assert np.abs(se3_log(invert_pose(first) @ other)).max() < 5e-6


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_result_is_the_same_to_a_hundredth_of_sigma(ends, sensor):
    a, b = (one[sensor] for one in ends[1])
    sigma, again = (np.sqrt(np.diag(one["covariance"])) for one in (a, b))
    T, T_again = (np.array(one["T_robot_sensor"]["matrix"]) for one in (a, b))
    off = se3_log(invert_pose(T) @ T_again)
    assert (np.abs(off) < 0.01 * sigma).all()
    np.testing.assert_allclose(again, sigma, rtol=0.01)
