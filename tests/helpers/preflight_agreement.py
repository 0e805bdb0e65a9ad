"""Preflight and a whole run on the same recording, in this process, for many configs."""

import json
import os
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import yaml

import associate
import crop
import decode
import extract
import gate
import guess
import preflight
import solve
from calib.io.parquet_tables import read_table
from calib.io.stage_cli import read_json
from calib.io.table_schemas import CAMERA_VIEWS_SCHEMA, LIDAR_VIEWS_SCHEMA
from calib.verdict.rig_verdict import rig_findings
from helpers.small_run import load_common_rules

REFUSAL_CHECKS = {"status", "placements", "tilt_deg"}
VIEW_SCHEMAS = {"camera": CAMERA_VIEWS_SCHEMA, "lidar": LIDAR_VIEWS_SCHEMA}


class SensorOutcome(NamedTuple):
    """Whether a sensor is refused, why, and its placements.

    placements: used; of preflight: as expected (None if its pose is not stated). kept: by crop; of
    preflight: possible.
    """

    is_refused: bool
    reason: str
    placements: int | None
    kept: int


class Outcomes(NamedTuple):
    """Outcomes by sensor of preflight and of the run, and the findings of preflight."""

    preflight: dict[str, SensorOutcome]
    run: dict[str, SensorOutcome]
    findings: list[dict]


class StageRunner:
    """Runs the stages of one session `sim` of a rig `sim` in the working directory."""

    def __init__(self, folder):
        os.chdir(folder)
        settings = yaml.safe_load(Path("config/config.yaml").read_text())
        self.rules = load_common_rules(settings)
        self.sensors = sorted(self.rules["RIGS"]["sim"]["sensors"])
        self.home = "results/sim/sim"
        for sensor in self.sensors:
            Path(self.home, sensor).mkdir(parents=True, exist_ok=True)

    def _wildcards(self, sensor=""):
        return SimpleNamespace(rig="sim", session="sim", sensor=sensor)

    def _run(self, stage, paths, sensor=""):
        wildcards = self._wildcards(sensor)
        name = stage.__name__
        make = self.rules.get(f"{name}_options")
        options = make(wildcards) if make else self.rules["sensor_options"](name, wildcards)
        words = []
        for key, value in paths.items():
            values = value if isinstance(value, list) else [value]
            words += [
                f"--{key}",
                *(v.format(h=self.home, s=f"{self.home}/{sensor}") for v in values),
            ]
        stage.main([*words, "--options", options])

    def run_preflight(self):
        """Run decode, gate and preflight."""
        common = {"mocap": "{h}/mocap.parquet", "audit": "{h}/log.json"}
        self._run(decode, {**common, "frames": "{h}/frames.parquet"})
        self._run(gate, {**common, "output": "{h}/placements.parquet"})
        self._run(
            preflight,
            {
                "audits": ["{h}/log.json"],
                "mocap": ["{h}/mocap.parquet"],
                "frames": ["{h}/frames.parquet"],
                "placements": ["{h}/placements.parquet"],
                "json": "results/sim/preflight.json",
                "text": "results/sim/preflight.txt",
            },
        )
        return read_json("results/sim/preflight.json")

    def run_to_solution(self):
        """Run the stages from guess to solve."""
        tables = {k: f"{{h}}/{k}.parquet" for k in ("mocap", "placements", "frames")}
        audit, start = {"audit": "{h}/log.json"}, {"guess": "{s}/guess.json"}
        views = {"views": "{s}/views.parquet", "moving-views": "{s}/moving_views.parquet"}
        for sensor in self.sensors:
            reads_log = self.rules["guess_reads_log"](self._wildcards(sensor))
            searched = {k: [v] if reads_log else [] for k, v in tables.items()}
            self._run(guess, searched | audit | {"output": "{s}/guess.json"}, sensor)
            kept = {"output": views["views"], "moving-views": views["moving-views"]}
            self._run(crop, tables | audit | start | kept, sensor)
            sources = {k: tables[k] for k in ("mocap", "placements")}
            keypoints = {"output": "{s}/keypoints.parquet"}
            keypoints["moving-keypoints"] = "{s}/moving_keypoints.parquet"
            evidence = {"frames": tables["frames"]} | audit
            self._run(extract, views | sources | start | evidence | keypoints, sensor)
        keypoints = [f"{self.home}/{s}/keypoints.parquet" for s in self.sensors]
        pairs = {"placements": tables["placements"], "output": "{h}/pairs.parquet"}
        self._run(associate, {"keypoints": keypoints} | pairs)
        moving = [f"{self.home}/{s}/moving_keypoints.parquet" for s in self.sensors]
        files = {"pairs": ["{h}/pairs.parquet"], "placements": [tables["placements"]]}
        outputs = {k: f"results/sim/{k}.parquet" for k in ("residuals", "iterations")}
        files |= {"mocap": [tables["mocap"]], "moving-keypoints": moving}
        self._run(solve, files | outputs | {"solution": "results/sim/solution.json"})
        return read_json("results/sim/solution.json")

    def count_kept_placements(self, sensor):
        """Return how many placements of all targets crop has kept."""
        kind = self.rules["RIGS"]["sim"]["sensors"][sensor]["kind"]
        path = Path(self.home, sensor, "views.parquet")
        views, _, _ = read_table(path, VIEW_SCHEMAS[kind])
        return len(np.unique(views["placement"][views["kept"]]))


def refusals_by_sensor(findings, sensors):
    """Return the first failing finding on views or status of each sensor, "" without one."""
    return {
        sensor: next(
            (
                f["text"]
                for f in findings
                if f["level"] == "fail" and f["check"] in REFUSAL_CHECKS and sensor in f["sensors"]
            ),
            "",
        )
        for sensor in sensors
    }


def compare_on_config(folder):
    """Return the Outcomes on the config and log of a folder."""
    runner = StageRunner(folder)
    told = runner.run_preflight()
    refused = refusals_by_sensor(told["findings"], runner.sensors)
    forecast = {
        n: SensorOutcome(
            told["levels"][n] == "fail",
            s["sessions"]["sim"]["status"]["reason"] or refused[n],
            s["placements"]["expected"],
            s["placements"]["possible"],
        )
        for n, s in told["sensors"].items()
    }
    solution = runner.run_to_solution()
    limits = json.loads(runner.rules["judge_options"](SimpleNamespace(rig="sim")))["judge"]
    findings = rig_findings(solution, limits).findings
    refused = refusals_by_sensor(findings, runner.sensors)
    run = {
        n: SensorOutcome(
            bool(refused[n]),
            s["status"]["reason"] or refused[n],
            s["placements"] or 0,
            runner.count_kept_placements(n),
        )
        for n, s in solution["sensors"].items()
    }
    return Outcomes(forecast, run, told["findings"])
