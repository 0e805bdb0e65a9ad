"""Preflight refuses what a run refuses, for the same reason, and counts the same placements."""

import os
import shutil

import numpy as np
import pytest
import yaml

import solve
from helpers.preflight_agreement import compare_on_config
from helpers.small_run import simulate_into

ARGUMENTS = (
    "--placements 5 --hold-s 0.7 --move-s 0.4 --sector-deg 40 --camera-hz 4 --seed 5 "
    "--guess-error-m 0.01 --guess-error-deg 1"
)
N_CONFIGS = 40
FAST_CONFIGS = {
    "images of another size": {"size_px": [1280, 960]},
    "an unknown mount and rotations about one axis": {
        "upright": True, "mount": "unknown", "targets": ["board"], "camera_pose": True,
    },
}  # fmt: skip
DEFAULT_CHOICES = {
    "upright": False,
    "mount": "stated",
    "targets": ["board", "cylinder"],
    "camera_pose": True,
    "lidar_pose": True,
    "size_px": [900, 700],
    "camera_topic": "/camera/image_raw",
    "pattern": True,
    "color": True,
    "max_range_m": 100.0,
    "crop": {},
    "min_agreeing": 3,
    "fail_placements": 3,
}


def draw_choices(seed):
    """Choices of a random config."""
    rng = np.random.default_rng(seed)

    def draw(*options):
        return options[rng.integers(len(options))]

    return {
        "upright": draw(False, False, True),
        "mount": draw("stated", "unknown"),
        "targets": draw(["board"], ["cylinder"], ["board", "cylinder"]),
        "camera_pose": draw(True, True, False),
        "lidar_pose": draw(True, True, False),
        "size_px": draw(*[[900, 700]] * 6, [1280, 960], [450, 350]),
        "camera_topic": draw(*["/camera/image_raw"] * 9, "/camera/image"),
        "pattern": draw(True, True, True, False),
        "color": draw(True, True, False),
        "max_range_m": draw(100.0, 100.0, 2.0, 0.8),
        "crop": {
            "max_placements": draw(60, 60, 4, 2),
            "min_distance_m": draw(0.05, 0.05, 0.6, 3.0),
            "min_angle_deg": draw(5, 20, 60),
            "max_incidence_deg": draw(75, 75, 30),
        },
        "min_agreeing": draw(3, 5, 6),
        "fail_placements": draw(2, 3, 5),
    }


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """The logs of a robot and targets that turn about all axes, and about the vertical only."""
    folder = tmp_path_factory.mktemp("agreement")
    free = simulate_into(folder / "free", ARGUMENTS)
    return {False: free, True: simulate_into(folder / "upright", f"{ARGUMENTS} --upright")}


@pytest.fixture
def compare(logs, tmp_path, monkeypatch):
    """A function that compares preflight and run on a config of these choices."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(solve, "find_best_views", lambda *arguments: {})  # slow, decides nothing

    def outcomes(**choices):
        choices = DEFAULT_CHOICES | choices
        folder = tmp_path / "run"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(logs[choices["upright"]] / "config", folder / "config")
        os.symlink(logs[choices["upright"]] / "logs", folder / "logs")
        write_config(folder / "config", choices)
        return compare_on_config(folder)

    return outcomes


def write_config(folder, choices):
    """Change the config of a simulated log as chosen."""
    rig = yaml.safe_load((folder / "rigs/sim.yaml").read_text())
    camera, lidar = rig["sensors"]["camera"], rig["sensors"]["velodyne"]
    camera |= {"size_px": choices["size_px"], "topic": choices["camera_topic"]}
    lidar["range_m"] = [0.3, choices["max_range_m"]]
    for sensor, is_stated in ((camera, choices["camera_pose"]), (lidar, choices["lidar_pose"])):
        if not is_stated:
            del sensor["T_robot_sensor"]
    (folder / "rigs/sim.yaml").write_text(yaml.safe_dump(rig))
    board = yaml.safe_load((folder / "targets/board.yaml").read_text())
    if choices["mount"] == "unknown":
        board["mount"] = "unknown"
    elif not choices["pattern"]:
        del board["pattern"]
    (folder / "targets/board.yaml").write_text(yaml.safe_dump(board))
    cylinder = yaml.safe_load((folder / "targets/cylinder.yaml").read_text())
    if not choices["color"]:
        del cylinder["color"]
    (folder / "targets/cylinder.yaml").write_text(yaml.safe_dump(cylinder))
    session = {"rig": "sim", "log": "logs/sim.mcap", "targets": choices["targets"]}
    config = {
        "sessions": {"sim": session},
        "crop": choices["crop"],
        "guess": {"min_placements": choices["min_agreeing"]},
        "judge": {"fail_placements": choices["fail_placements"], "warn_placements": 6},
        "solve": {"estimate": {"time_offset": False}},
    }
    (folder / "config.yaml").write_text(yaml.safe_dump(config))


def require_agreement(outcomes):
    """Require that preflight told the truth on every sensor."""
    for name, told in outcomes.preflight.items():
        run = outcomes.run[name]
        where = (name, told, run, outcomes.findings)
        if told.is_refused:
            assert run.is_refused, where
            require_same_cause(told.reason, run.reason, where)
        elif run.is_refused and told.placements is not None:
            # Within the σ of its stated pose, more placements may be in view than are.
            assert told.placements < told.kept, where
            assert any(name in f["sensors"] for f in outcomes.findings), where
        if told.placements is not None and not told.is_refused and not run.is_refused:
            # Near a limit of its view, the true pose decides on a placement, not the stated one.
            assert abs(run.placements - told.placements) <= 1 and run.kept == told.kept, where
        if not told.is_refused:
            assert run.placements <= told.kept, where


def require_same_cause(told, run, where):
    """Require the same reason; too few or parallel views may also be what they leave open."""
    if "has no view of a target" in told:
        # Extraction looks at the images, and may name the mistake.
        assert told == run or "is of another resolution than its images" in run, where
    elif "placements " in told or "differ by at most" in told:
        consequences = ("the data do not determine", "is unknown and not found in the data")
        assert (
            "placements " in run
            or "differ by at most" in run
            or any(words in run for words in consequences)
        ), where
    else:
        assert told == run, where


@pytest.mark.pipeline
@pytest.mark.parametrize("choices", FAST_CONFIGS.values(), ids=FAST_CONFIGS)
def test_preflight_and_run_refuse_the_same_sensor_for_the_same_reason(compare, choices):
    outcomes = compare(**choices)
    assert outcomes.preflight["camera"].is_refused
    require_agreement(outcomes)


@pytest.mark.slow
@pytest.mark.pipeline
@pytest.mark.parametrize("seed", range(N_CONFIGS))
def test_preflight_and_run_agree_on_random_configs(compare, seed):
    require_agreement(compare(**draw_choices(seed)))


def test_random_configs_are_of_every_kind():
    drawn = [draw_choices(seed) for seed in range(N_CONFIGS)]
    for key, default in DEFAULT_CHOICES.items():
        assert len({str(choices[key]) for choices in drawn}) >= 2, (key, default)
