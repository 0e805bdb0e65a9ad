"""The inputs of a report, made by hand: a camera, a lidar, a board and a pipe."""

import copy
import json
import re
from pathlib import Path
from unittest.mock import MagicMock, patch

import numpy as np

import report
from calib.geometry.se3 import invert_pose, make_pose, pose_from_rpy, pose_to_quat, transform_points
from calib.io.config import default_config_blocks, validate_and_complete
from calib.io.parquet_tables import concatenate_columns, empty_columns, select_rows, write_table
from calib.io.pose_block import pose_json
from calib.io.stage_cli import write_json
from calib.io.status import OK, failure_status
from calib.io.table_schemas import (
    FRAMES_SCHEMA,
    ITERATIONS_SCHEMA,
    KEYPOINTS_SCHEMA,
    PLACEMENTS_SCHEMA,
    RESIDUALS_SCHEMA,
)
from calib.report.data import run_data
from calib.report.figures import figure_encoding, rig_figure
from calib.report.figures.figure_encoding import Drawing
from calib.sensors.camera.images.image_messages import encode_png
from calib.sensors.sensor_models import camera_from_config
from calib.targets.target_shapes import target_from_config
from report import FIGURE_COLUMNS

ROOT = Path(__file__).parents[2]
REPORT_TEMPLATES = sorted((ROOT / "workflow" / "report").rglob("*.*"))
BOARD_CONFIG = {
    "body": "mcs/board",
    "shape": "board",
    "outline_m": [[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]],
    "thickness_m": 0,
    "pattern": {
        "kind": "checkerboard",
        "inner_corners": [4, 3],
        "square_m": 0.1,
        "first_corner_m": [-0.15, -0.1],
    },
    "T_body_target": {"xyz_m": [0, 0, 0], "rpy_deg": [0, 0, 0]},
}
PIPE_CONFIG = {
    "body": "mcs/pipe",
    "shape": "cylinder",
    "length_m": 0.8,
    "radius_m": 0.1,
    "T_body_target": {"xyz_m": [0, 0, 0], "rpy_deg": [0, 0, 0]},
}
CAMERA_CONFIG = {
    "kind": "camera",
    "topic": "/image",
    "model": "radtan",
    "size_px": [320, 240],
    "params": [200, 200, 160, 120, 0, 0, 0, 0],
}
LIDAR_CONFIG = {"kind": "lidar", "topic": "/points", "azimuth_step_deg": 0.2}
SENSOR_CONFIGS = {"left": CAMERA_CONFIG, "top": LIDAR_CONFIG}
VERDICT_LIMITS = {
    "warn_sigma_m": 0.005,
    "fail_sigma_m": 0.02,
    "warn_sigma_deg": 0.25,
    "fail_sigma_deg": 1.0,
    "warn_rejected": 0.2,
    "fail_rejected": 0.5,
    "warn_placements": 5,
    "fail_placements": 3,
    "warn_leave_one_out": 2.0,
    "fail_leave_one_out": 4.0,
    "warn_split_half": 4.0,
}
REJECTED_REGION_JSON = {
    "target": "board",
    "kind": "target_surface",
    "region": "before the surface",
    "count": 7,
    "n_measurements": 70,
}
NEXT_VIEW_JSON = {
    "target": "board",
    "T_sensor_target": pose_json(make_pose(None, [0.0, 0.0, 2.0])),
    "description": "2.0 m away, its face turned 40° left as the sensor sees it",
    "direction": "translation along z of the robot body",
    "unit": "m",
    "sigma": 0.003,
    "sigma_one": 0.0024,
    "sigma_four": 0.0016,
}
SPLIT_HALVES_JSON = {
    "adopted": [[{"name": "beam_offsets", "subject": "top"}], []],
    "sensors": {
        "top": {
            "shift": [0.003, 0.0, 0.004, 0.0, 0.0, 0.01],
            "sigma": [0.001] * 3 + [0.005] * 3,
            "nees": 30.0,
            "n_directions": 6,
            "placements": [5, 4],
        }
    },
}
LEAVE_ONE_OUT_JSON = {
    "placements": 2,
    "n_directions": 12,
    "rms_m": 0.002,
    "rms_rad": 0.01,
    "error_over_sigma": 1.1,
}
T_ROBOT_SENSOR = {
    "left": pose_from_rpy([0.1, 0.02, 0.3], np.radians([-90, 0, -90])),
    "top": pose_from_rpy([0.2, -0.05, 0.6], np.radians([0, 0, 30])),
}
GUESS_ERROR = pose_from_rpy([0.03, 0.0, 0.04], np.radians([0, 0, 2]))
POSE_SIGMA = np.array([0.001, 0.002, 0.003, 1e-4, 2e-4, 3e-4])
MISSING_PATTERN = failure_status("no checkerboard in the region", "none", "4 × 3 inner corners")
NO_VIEW = failure_status(
    "left has no view of a target", "40 not still", "1 or more", "Record its view."
)
# Two placements of the board before the robot, one of the pipe.
TARGET_POSITIONS = (
    ("board", [2.0, 0.1, 0.3]),
    ("board", [2.5, -0.2, 0.4]),
    ("pipe", [2.0, 0.4, 0.5]),
)
R_ROBOT_BOARD = pose_from_rpy([0, 0, 0], np.radians([90, 0, -90]))[:3, :3]


def make_placement_columns():
    """Columns of three still intervals, 2 s each."""
    n = len(TARGET_POSITIONS)
    pose = [
        make_pose(R_ROBOT_BOARD if name == "board" else None, xyz) for name, xyz in TARGET_POSITIONS
    ]
    return {
        "placement": np.arange(n),
        "target": [name for name, _ in TARGET_POSITIONS],
        "kind": ["still"] * n,
        "start_ns": np.arange(n) * 4 * 10**9,
        "end_ns": np.arange(n) * 4 * 10**9 + 2 * 10**9,
        "xyz": [xyz for _, xyz in TARGET_POSITIONS],
        "quat": pose_to_quat(np.array(pose)),
        "samples": np.full(n, 200),
        "effective_samples": np.full(n, 150.0),
        "mean_pose_sigma_factor": np.full(n, 0.1),
        "residual_drift": np.zeros((n, 6)),
        **{
            f"{name}_slow_{quantity}": np.zeros((n, 6))
            for name in ("robot", "body")
            for quantity in ("sigma", "time_s")
        },
        "covariance": np.zeros((n, 36)),
    }


def true_T_sensor_target(sensor, placement):
    """T_sensor_target (4, 4) by the truth."""
    name, xyz = TARGET_POSITIONS[placement]
    T_robot_target = make_pose(R_ROBOT_BOARD if name == "board" else None, xyz)
    return invert_pose(T_ROBOT_SENSOR[sensor]) @ T_robot_target


def draw_target_returns(placement, rng):
    """Returns (300, 3), target frame, on the face of a target."""
    if TARGET_POSITIONS[placement][0] == "board":
        return rng.uniform([-0.4, -0.3, 0], [0.4, 0.3, 1e-9], (300, 3))
    angle, x = rng.uniform(-1, 1, 300), rng.uniform(-0.4, 0.4, 300)
    return np.column_stack([x, -0.1 * np.cos(angle), 0.1 * np.sin(angle)])


def make_view_columns(sensor, rng):
    """Columns of views.parquet: each placement kept once, and one frame that is not still."""
    camera = sensor == "left"
    shown = [
        k for k in range(len(TARGET_POSITIONS)) if not camera or TARGET_POSITIONS[k][0] == "board"
    ]
    n = len(shown) + 1
    columns = {
        "view": np.arange(n),
        "stamp_ns": np.array([10**9 + 4 * 10**9 * k for k in shown] + [3 * 10**9]),
        "target": [TARGET_POSITIONS[k][0] for k in shown] + ["board"],
        "placement": np.array([*shown, -1]),
        "kept": np.array([True] * len(shown) + [False]),
        "reason": [""] * len(shown) + ["not still"],
    }
    if camera:
        image = rng.integers(0, 255, (240, 320, 3), np.uint8)
        png = [encode_png(image)] * len(shown) + [b""]
        return columns | {"u0": np.zeros(n), "v0": np.zeros(n), "png": png}
    clouds = [
        transform_points(true_T_sensor_target(sensor, k), draw_target_returns(k, rng))
        for k in shown
    ]
    xyz = [c.astype(np.float32).reshape(-1) for c in clouds] + [np.zeros(0, np.float32)]
    ring = [np.arange(300) % 16 for _ in shown] + [np.zeros(0, np.int32)]
    dt = [np.zeros(300, np.int64) for _ in shown] + [np.zeros(0, np.int64)]
    intensity = [np.full(len(t), np.nan, np.float32) for t in dt]
    return columns | {"xyz": xyz, "ring": ring, "point_time_ns": dt, "intensity": intensity}


def make_measurement_columns(sensor, views, rng):
    """(keypoints, residuals) columns of the kept views, consistent with each other."""
    camera = camera_from_config(CAMERA_CONFIG)
    keypoints, residuals = [], []
    for i in np.flatnonzero(views["kept"]):
        T = true_T_sensor_target(sensor, views["placement"][i])
        if sensor == "left":
            p = target_from_config(BOARD_CONFIG).pattern.corners()
            uv = camera.project(transform_points(T, p))[0] + rng.normal(0, 0.05, (len(p), 2))
            value, sigma, kind = rng.normal(0, 0.05, (len(p), 2)), 0.05, "pattern_corner"
            measured, xyz = np.column_stack([uv, np.zeros(len(p))]), np.full((len(p), 3), np.nan)
        else:
            xyz = np.reshape(views["xyz"][i], (-1, 3)).astype(float)
            value = np.column_stack([rng.normal(0, 0.01, len(xyz)), np.zeros(len(xyz))])
            uv, sigma, kind = np.full((len(xyz), 2), np.nan), 0.01, "target_surface"
            measured = transform_points(invert_pose(T), xyz)
        n = len(value)
        shared = {
            "view": np.full(n, views["view"][i]),
            "target": np.full(n, views["target"][i]),
            "placement": np.full(n, views["placement"][i]),
            "kind": np.full(n, kind),
            "feature_index": np.arange(n) % 16,
            "sigma": np.full(n, sigma),
            "whitening": np.tile([1.0, 0.0, 1.0], (n, 1)),
            "intensity": np.full(n, np.nan),
        }
        keypoints.append(
            shared | {"stamp_ns": np.full(n, views["stamp_ns"][i]), "xyz": xyz, "uv": uv}
        )
        more = {"value": value, "measured": measured, "weight": (np.arange(n) % 10 > 0) * 0.9}
        more |= {
            "range_m": np.full(n, 2.0) + rng.uniform(0, 1, n),
            "cos_incidence": rng.uniform(0.5, 1, n),
        }
        more |= {"session": np.full(n, "s1"), "sensor": np.full(n, sensor)}
        still = {"is_moving": np.zeros(n, bool), "speed_mps": np.zeros(n)}
        residuals.append(shared | more | still)
        moving = {"is_moving": np.ones(n, bool), "speed_mps": np.linspace(0.1, 0.7, n)}
        residuals.append(shared | more | moving)
    return keypoints, residuals


def make_frame_columns():
    """Columns of the messages of both sensors: 10 Hz, 20 ms late in the log."""
    t = np.tile(np.arange(40) * 10**8, 2)
    place = {
        "file_index": np.zeros(80),
        "index_at_log_time": np.zeros(80),
        "size": np.full(80, 1000),
    }
    return {
        "sensor": np.repeat(sorted(SENSOR_CONFIGS), 40),
        "stamp_ns": t,
        "log_time_ns": t + 20 * 10**6,
    } | place


def join_columns(parts, schema):
    """Columns of several parts."""
    return concatenate_columns(parts, schema)


def make_log_audit():
    """An audit of a healthy log."""
    ok = OK.to_dict()
    body = {"status": ok, "poses": 1200, "faults": {"repeated": 3}, "rate_hz": 100.0}
    sensor = {"status": ok, "messages": 40, "rate_hz": 10.0}
    return {
        "fingerprint": ["s1.mcap 123456 00ffab"],
        "topics": {
            "/image": {"type": "sensor_msgs/msg/Image", "messages": 40},
            "/points": {"type": "sensor_msgs/msg/PointCloud2", "messages": 40},
            "/tf": {"type": "tf2_msgs/msg/TFMessage", "messages": 1200},
        },
        "bodies": {
            b: body | {"longest_gap_s": 0.02} for b in ("mcs/board", "mcs/pipe", "mcs/robot")
        },
        "sensors": {n: sensor | {"frame": f"{n}_frame"} for n in SENSOR_CONFIGS},
        "static": [],
    }


TIME_OFFSET_JSON = {"value": 0.0, "sigma": 0.05, "source": "config"}


def make_guess_json(sensor):
    """The first guess, off by centimetres and degrees."""
    T = pose_json(T_ROBOT_SENSOR[sensor] @ GUESS_ERROR)
    sigma = [0.05] * 3 + [0.09] * 3
    known = {
        "T_robot_sensor": T,
        "sigma": sigma,
        "source": "config",
        "time_offset_s": TIME_OFFSET_JSON,
    }
    return known | {"status": OK.to_dict(), "frame": f"{sensor}_frame"}


def make_sensor_result(sensor):
    """A solved sensor of calibration.json."""
    guess = make_guess_json(sensor)
    return {
        "kind": SENSOR_CONFIGS[sensor]["kind"],
        "frame": f"{sensor}_frame",
        "status": OK.to_dict(),
        "verdict": "pass",
        "guess": {k: guess[k] for k in ("T_robot_sensor", "sigma", "source", "time_offset_s")},
        "T_robot_sensor": pose_json(T_ROBOT_SENSOR[sensor]),
        "covariance": np.diag(POSE_SIGMA**2).tolist(),
        "least_certain": {"direction": "translation along z of the robot body", "sigma": 0.003},
        "placements": 12,
        "observations": 34,
        "points": 5678,
        "rejected_share": 0.05,
        "residual": {"rms": 0.0123, "unit": "px" if sensor == "left" else "m"},
        "undetermined": [],
        "recording_advice": "Tilt the board.",
        "next_view": NEXT_VIEW_JSON,
        "rejected_by_region": [
            REJECTED_REGION_JSON
            | {"kind": "pattern_corner" if sensor == "left" else "target_surface"}
        ],
        "fit_by_kind": {},
        "leave_one_out": LEAVE_ONE_OUT_JSON,
        "corrections": [],
        "common_range_sigma_m": None,
        "sigma_by_placements": {
            "placements": [3, 6, 12],
            "sigma_m": [None, 0.004, 0.003],
            "sigma_rad": [3e-3, 2e-3, 1e-3],
        },
        "time_offset_s": None,
        "time_offset_note": "",
        "clock_drift": None,
        "intrinsics": None,
        "intrinsics_note": "",
    }


def make_influence_json(placement, influence, nees):
    """What one placement does to both sensors."""
    sensors = {n: {"influence": influence, "nees": nees, "n_directions": 6} for n in SENSOR_CONFIGS}
    return {"session": "s1", "target": "board", "placement": placement, "sensors": sensors}


def make_calibration_json():
    """A calibration.json of two solved sensors."""
    return {
        "schema_version": 1,
        "rig": "robo",
        "verdict": "pass",
        "reasons": [],
        "sensors": {n: make_sensor_result(n) for n in SENSOR_CONFIGS},
        "joint_covariance": {
            "order": ["left", "top"],
            "matrix": np.diag(np.tile(POSE_SIGMA**2, 2)).tolist(),
        },
        "pairs": [],
        "suspected_errors": [],
        "mocap_offsets_s": {},
        "mocap_scales": {},
        "influences": [make_influence_json(0, 1.4, 5.0), make_influence_json(1, None, 7.0)],
        "repeatability": [],
        "split_halves": SPLIT_HALVES_JSON,
        "targets": {"board": None, "pipe": None},
        "board_shapes": {},
        "sessions": {"s1": None},
        "noise": {
            "sensors": {"left": {"pattern_corner": 0.04}, "top": {"target_surface": 0.012}},
            "mocap_factor": 1.25,
            "mocap_scatter": None,
        },
        "provenance": {"sessions": ["s1"], "packages": {"numpy": "2.4.6"}},
    }


def remove_sensor_pose(calibration, sensor, status):
    """The calibration with one sensor that could not be solved."""
    none = dict.fromkeys(
        ("T_robot_sensor", "covariance", "least_certain", "leave_one_out", "sigma_by_placements")
    )
    none["next_view"] = None
    counts = dict.fromkeys(("placements", "observations", "points"), 0)
    calibration["sensors"][sensor] |= {
        "status": status.to_dict(),
        "verdict": "fail",
        "rejected_share": 0.0,
    }
    calibration["sensors"][sensor] |= none | counts | {"residual": {"rms": None, "unit": "px"}}
    left = [n for n, s in sorted(calibration["sensors"].items()) if s["T_robot_sensor"]]
    block = np.diag(np.tile(POSE_SIGMA**2, len(left))).tolist()
    calibration["joint_covariance"] = {"order": left, "matrix": block} if left else None
    calibration["noise"]["sensors"].pop(sensor, None)
    return calibration


class ReportInputs:
    """The inputs of one report in a folder; each may be replaced before it is rendered."""

    def __init__(self, folder):
        self.folder = folder
        rng = np.random.default_rng(0)
        self.calibration, self.findings, self.mocap_notes = make_calibration_json(), [], []
        self.audits, self.frames = {"s1": make_log_audit()}, {"s1": make_frame_columns()}
        self.placements = {"s1": (make_placement_columns(), OK, {"board": OK, "pipe": OK})}
        self.guesses, self.views, self.keypoints, parts = {}, {}, {}, []
        for sensor in SENSOR_CONFIGS:
            views = make_view_columns(sensor, rng)
            keypoints, residuals = make_measurement_columns(sensor, views, rng)
            parts += residuals
            self.guesses["s1", sensor] = make_guess_json(sensor)
            self.views["s1", sensor] = views, OK
            kept = np.flatnonzero(views["kept"])
            outcomes = {int(v): OK for v in kept}
            self.keypoints["s1", sensor] = join_columns(keypoints, KEYPOINTS_SCHEMA), OK, outcomes
        self.residuals = join_columns(parts, RESIDUALS_SCHEMA)
        rounds = {"round": [0], "cost": [12.5], "ipopt_iterations": [4], "n_inliers": [999]}
        self.iterations = rounds | {"step_m": [1e-9], "step_rad": [1e-9], "n_reassigned": [0]}
        self.options = {
            "report": {"title": "", "max_overlays": 4},
            "rig": "robo",
            "body": "mcs/robot",
            "sensors": SENSOR_CONFIGS,
            "targets": {"board": BOARD_CONFIG, "pipe": PIPE_CONFIG},
            "sessions": {"s1": sorted(SENSOR_CONFIGS)},
            "settings": {k: v for k, v in default_config_blocks().items() if k != "export"},
        }

    def remove_sensor_views(self, sensor, status, session="s1"):
        """A sensor that saw nothing in a session."""
        schema = run_data.VIEW_SCHEMAS[SENSOR_CONFIGS[sensor]["kind"]]
        self.views[session, sensor] = empty_columns(schema), status
        self.keypoints[session, sensor] = empty_columns(KEYPOINTS_SCHEMA), status, {}
        rows = (self.residuals["sensor"] != sensor) | (self.residuals["session"] != session)
        self.residuals = select_rows(self.residuals, rows)

    def write_inputs(self):
        """Write all; returns the arguments of report.py."""
        arguments = {
            k: [] for k in ("audits", "frames", "placements", "guesses", "views", "keypoints")
        }
        for session, sensors in sorted(self.options["sessions"].items()):
            arguments["audits"].append(
                self.write_json_input(f"{session}-log", self.audits[session])
            )
            path = self.write_table_input(f"{session}-frames", FRAMES_SCHEMA, self.frames[session])
            arguments["frames"].append(path)
            columns, status, of_targets = self.placements[session]
            statuses = {k: v.to_dict() for k, v in of_targets.items()}
            notes = {"targets": statuses, "mocap_noise": {}, "mocap_notes": self.mocap_notes}
            path = self.write_table_input(
                f"{session}-placements", PLACEMENTS_SCHEMA, columns, status, notes
            )
            arguments["placements"].append(path)
            for sensor in sorted(sensors):
                for key, path in self.write_sensor_inputs(session, sensor).items():
                    arguments[key].append(path)
        levels = {n: s["verdict"] for n, s in self.calibration["sensors"].items()}
        result = validate_and_complete(
            "calibration", copy.deepcopy(self.calibration), "calibration"
        )
        judged = {k: result[k] for k in ("verdict", "reasons")}
        judged |= {"findings": self.findings, "sensors": levels, "limits": VERDICT_LIMITS}
        arguments |= {
            "calibration": [self.write_json_input("calibration", result)],
            "verdict": [
                self.write_json_input(
                    "verdict", validate_and_complete("verdict", judged, "verdict")
                )
            ],
            "residuals": [self.write_table_input("residuals", RESIDUALS_SCHEMA, self.residuals)],
            "iterations": [
                self.write_table_input("iterations", ITERATIONS_SCHEMA, self.iterations)
            ],
            "templates": [p for p in REPORT_TEMPLATES if p.suffix in (".j2", ".css", ".js")],
            "html": [self.folder / "report.html"],
            "pdf": [self.folder / "report.pdf"],
            "figures": [self.folder / f"{name}.svg" for name in FIGURE_COLUMNS],
            "options": [json.dumps(self.options)],
        }
        return [str(v) for key, values in arguments.items() for v in (f"--{key}", *values)]

    def write_sensor_inputs(self, session, sensor):
        """Paths of what one sensor left in one session."""
        at = session, sensor
        schema = run_data.VIEW_SCHEMAS[SENSOR_CONFIGS[sensor]["kind"]]
        columns, status, outcomes = self.keypoints[at]
        told = [{"view": v, "status": s.to_dict()} for v, s in outcomes.items()]
        notes = {"outcomes": told, "T_robot_sensor": None, "guess": self.guesses[at]}
        name = f"{session}-{sensor}"
        return {
            "guesses": self.write_json_input(f"{name}-guess", self.guesses[at]),
            "views": self.write_table_input(f"{name}-views", schema, *self.views[at]),
            "keypoints": self.write_table_input(
                f"{name}-keypoints", KEYPOINTS_SCHEMA, columns, status, notes
            ),
        }

    def write_json_input(self, name, content):
        """Path of a JSON file."""
        write_json(self.folder / f"{name}.json", content)
        return self.folder / f"{name}.json"

    def write_table_input(self, name, schema, columns, status=OK, notes=None):
        """Path of a table."""
        write_table(self.folder / f"{name}.parquet", schema, columns, status, notes)
        return self.folder / f"{name}.parquet"

    def render_report(self):
        """The page as it stands; printing it would take most of the time."""
        with patch.object(report, "encode_pdf", return_value=b"%PDF"):
            report.main(self.write_inputs())
        return (self.folder / "report.html").read_text()


def remove_plotly(page):
    """The page without the library that draws the 3-D view, which is not ours to read."""
    return re.sub(r"<script>/\*\*\n\* plotly.*?</script>", "", page, flags=re.S)


def extract_section(page, name):
    """One section of the page."""
    return page.split(f'<section id="{name}">')[1].split("</section>")[0]


def extract_page_text(page):
    """The page's text without tags, in single blanks."""
    page = re.sub(r"<(style|svg|script).*?</\1>", " ", page, flags=re.S)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", page))


def disable_figures(monkeypatch):
    """Name figures but do not draw them."""

    def drawing(fig, name, label, caption, column_span=1):
        svg = f'<svg viewBox="0 0 1 1" aria-label="{label}"></svg>'
        return Drawing(svg, None, caption, "", column_span)

    monkeypatch.setattr(
        figure_encoding, "create_panels", lambda n, *_, **__: (MagicMock(), [MagicMock()] * len(n))
    )
    monkeypatch.setattr(figure_encoding, "finish_drawing", drawing)
    monkeypatch.setattr(rig_figure, "_plot_sensors", MagicMock())
    monkeypatch.setattr(rig_figure, "_plot_sigma_bars", MagicMock())


def write_good_report(folder):
    """The folder with all that the report of a good run writes."""
    report.main(ReportInputs(folder).write_inputs())
    return folder
