"""The inputs of a report, made by hand: a camera, a lidar, a board and a pipe."""

import copy
import json
import re
from pathlib import Path
from unittest.mock import MagicMock, patch

import numpy as np

import report
from calib.geometry import se3
from calib.io import config, parquet_tables, pose_block, stage_cli, table_schemas
from calib.io.status import OK, failed
from calib.report.data import run_data
from calib.report.figures import rig_figure, svg_plots
from calib.report.page import pdf_page
from calib.sensors import sensor_models
from calib.sensors.camera.images import image_messages
from calib.targets import target_shapes

ROOT = Path(__file__).parents[1]
TEMPLATES = sorted((ROOT / "workflow" / "report").rglob("*.*"))
BOARD = {
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
PIPE = {
    "body": "mcs/pipe",
    "shape": "cylinder",
    "length_m": 0.8,
    "radius_m": 0.1,
    "T_body_target": {"xyz_m": [0, 0, 0], "rpy_deg": [0, 0, 0]},
}
CAMERA = {
    "kind": "camera",
    "topic": "/image",
    "model": "radtan",
    "size_px": [320, 240],
    "params": [200, 200, 160, 120, 0, 0, 0, 0],
}
LIDAR = {"kind": "lidar", "topic": "/points", "azimuth_step_deg": 0.2}
SENSORS = {"left": CAMERA, "top": LIDAR}
LIMITS = {
    "warn_sigma_m": 0.005,
    "fail_sigma_m": 0.02,
    "warn_sigma_deg": 0.25,
    "fail_sigma_deg": 1.0,
    "warn_rejected": 0.2,
    "fail_rejected": 0.5,
    "warn_placements": 5,
    "fail_placements": 3,
    "warn_heldout": 2.0,
    "fail_heldout": 4.0,
}
LEFT_OUT = {
    "target": "board",
    "kind": "surface",
    "where": "before the surface",
    "count": 7,
    "of": 70,
}
NEXT_VIEW = {
    "target": "board",
    "T_sensor_target": pose_block.pose_json(se3.pose(None, [0.0, 0.0, 2.0])),
    "words": "2.0 m away, its face turned 40° left as the sensor sees it",
    "direction": "translation along z of the robot body",
    "unit": "m",
    "sigma": 0.003,
    "sigma_one": 0.0024,
    "sigma_four": 0.0016,
}
HELD_OUT = {"placements": 2, "directions": 12, "rms_m": 0.002, "rms_rad": 0.01, "ratio": 1.1}
POSES = {
    "left": se3.from_rpy([0.1, 0.02, 0.3], np.radians([-90, 0, -90])),
    "top": se3.from_rpy([0.2, -0.05, 0.6], np.radians([0, 0, 30])),
}
GUESS_OFF = se3.from_rpy([0.03, 0.0, 0.04], np.radians([0, 0, 2]))
SIGMA = np.array([0.001, 0.002, 0.003, 1e-4, 2e-4, 3e-4])
NOT_FOUND = failed("no checkerboard in the region", "none", "4 × 3 inner corners")
UNSEEN = failed("left has no view of a target", "40 not still", "1 or more", "Record its view.")
# Two placements of the board before the robot, one of the pipe.
PLACES = (("board", [2.0, 0.1, 0.3]), ("board", [2.5, -0.2, 0.4]), ("pipe", [2.0, 0.4, 0.5]))
FACING = se3.from_rpy([0, 0, 0], np.radians([90, 0, -90]))[:3, :3]


def placements():
    """Columns of three still intervals, 2 s each."""
    n = len(PLACES)
    pose = [se3.pose(FACING if name == "board" else None, xyz) for name, xyz in PLACES]
    return {
        "placement": np.arange(n),
        "target": [name for name, _ in PLACES],
        "kind": ["still"] * n,
        "start": np.arange(n) * 4 * 10**9,
        "end": np.arange(n) * 4 * 10**9 + 2 * 10**9,
        "xyz": [xyz for _, xyz in PLACES],
        "quat": se3.to_quat(np.array(pose)),
        "samples": np.full(n, 200),
        "effective_samples": np.full(n, 150.0),
        "pose_factor": np.full(n, 0.1),
        "creep": np.zeros((n, 6)),
        "covariance": np.zeros((n, 36)),
    }


def in_sensor(sensor, placement):
    """T_sensor_target (4, 4) by the truth."""
    name, xyz = PLACES[placement]
    T_robot_target = se3.pose(FACING if name == "board" else None, xyz)
    return se3.inverse(POSES[sensor]) @ T_robot_target


def cloud(placement, rng):
    """Returns (300, 3), target frame, on the face of a target."""
    if PLACES[placement][0] == "board":
        return rng.uniform([-0.4, -0.3, 0], [0.4, 0.3, 1e-9], (300, 3))
    angle, x = rng.uniform(-1, 1, 300), rng.uniform(-0.4, 0.4, 300)
    return np.column_stack([x, -0.1 * np.cos(angle), 0.1 * np.sin(angle)])


def view_columns(sensor, rng):
    """Columns of views.parquet: each placement kept once, and one frame that is not still."""
    camera = sensor == "left"
    shown = [k for k in range(len(PLACES)) if not camera or PLACES[k][0] == "board"]
    n = len(shown) + 1
    columns = {
        "view": np.arange(n),
        "t": np.array([10**9 + 4 * 10**9 * k for k in shown] + [3 * 10**9]),
        "target": [PLACES[k][0] for k in shown] + ["board"],
        "placement": np.array([*shown, -1]),
        "kept": np.array([True] * len(shown) + [False]),
        "reason": [""] * len(shown) + ["not still"],
    }
    if camera:
        image = rng.integers(0, 255, (240, 320, 3), np.uint8)
        png = [image_messages.to_png(image)] * len(shown) + [b""]
        return columns | {"u0": np.zeros(n), "v0": np.zeros(n), "png": png}
    clouds = [se3.transform(in_sensor(sensor, k), cloud(k, rng)) for k in shown]
    xyz = [c.astype(np.float32).reshape(-1) for c in clouds] + [np.zeros(0, np.float32)]
    ring = [np.arange(300) % 16 for _ in shown] + [np.zeros(0, np.int32)]
    dt = [np.zeros(300, np.int64) for _ in shown] + [np.zeros(0, np.int64)]
    return columns | {"xyz": xyz, "ring": ring, "dt": dt}


def measurements(sensor, views, rng):
    """(keypoints, residuals) columns of the kept views, consistent with each other."""
    camera = sensor_models.camera(CAMERA)
    keypoints, residuals = [], []
    for i in np.flatnonzero(views["kept"]):
        T = in_sensor(sensor, views["placement"][i])
        if sensor == "left":
            p = target_shapes.from_config(BOARD).pattern.corners()
            uv = camera.project(se3.transform(T, p))[0] + rng.normal(0, 0.05, (len(p), 2))
            value, sigma, kind = rng.normal(0, 0.05, (len(p), 2)), 0.05, "corner"
            measured, xyz = np.column_stack([uv, np.zeros(len(p))]), np.full((len(p), 3), np.nan)
        else:
            xyz = np.reshape(views["xyz"][i], (-1, 3)).astype(float)
            value = np.column_stack([rng.normal(0, 0.01, len(xyz)), np.zeros(len(xyz))])
            uv, sigma, kind = np.full((len(xyz), 2), np.nan), 0.01, "surface"
            measured = se3.transform(se3.inverse(T), xyz)
        n = len(value)
        shared = {
            "view": np.full(n, views["view"][i]),
            "target": np.full(n, views["target"][i]),
            "placement": np.full(n, views["placement"][i]),
            "kind": np.full(n, kind),
            "index": np.arange(n) % 16,
            "sigma": np.full(n, sigma),
            "whiten": np.tile([1.0, 0.0, 1.0], (n, 1)),
        }
        keypoints.append(shared | {"t": np.full(n, views["t"][i]), "xyz": xyz, "uv": uv})
        more = {"value": value, "measured": measured, "weight": (np.arange(n) % 10 > 0) * 0.9}
        more |= {"range": np.full(n, 2.0) + rng.uniform(0, 1, n), "cosine": rng.uniform(0.5, 1, n)}
        more |= {"session": np.full(n, "s1"), "sensor": np.full(n, sensor)}
        still = {"moving": np.zeros(n, bool), "speed": np.zeros(n)}
        residuals.append(shared | more | still)
        moving = {"moving": np.ones(n, bool), "speed": np.linspace(0.1, 0.7, n)}
        residuals.append(shared | more | moving)
    return keypoints, residuals


def frames():
    """Columns of the messages of both sensors: 10 Hz, 20 ms late in the log."""
    t = np.tile(np.arange(40) * 10**8, 2)
    place = {"file": np.zeros(80), "ordinal": np.zeros(80), "size": np.full(80, 1000)}
    return {"sensor": np.repeat(sorted(SENSORS), 40), "t": t, "log_t": t + 20 * 10**6} | place


def joined(parts, schema):
    """Columns of several parts."""
    return parquet_tables.concatenate(parts, schema)


def audit():
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
        "sensors": {n: sensor | {"frame": f"{n}_frame"} for n in SENSORS},
        "static": [],
    }


OFFSET = {"value": 0.0, "sigma": 0.05, "source": "config"}


def guess_of(sensor):
    """The first guess, off by centimetres and degrees."""
    T = pose_block.pose_json(POSES[sensor] @ GUESS_OFF)
    sigma = [0.05] * 3 + [0.09] * 3
    known = {"T_robot_sensor": T, "sigma": sigma, "source": "config", "time_offset_s": OFFSET}
    return known | {"status": OK.to_dict(), "frame": f"{sensor}_frame"}


def sensor_result(sensor):
    """A solved sensor of calibration.json."""
    guess = guess_of(sensor)
    return {
        "kind": SENSORS[sensor]["kind"],
        "frame": f"{sensor}_frame",
        "status": OK.to_dict(),
        "verdict": "pass",
        "guess": {k: guess[k] for k in ("T_robot_sensor", "sigma", "source", "time_offset_s")},
        "T_robot_sensor": pose_block.pose_json(POSES[sensor]),
        "covariance": np.diag(SIGMA**2).tolist(),
        "weakest": {"direction": "translation along z of the robot body", "sigma": 0.003},
        "placements": 12,
        "observations": 34,
        "points": 5678,
        "rejected": 0.05,
        "residual": {"rms": 0.0123, "unit": "px" if sensor == "left" else "m"},
        "undetermined": [],
        "advice": "Tilt the board.",
        "next_view": NEXT_VIEW,
        "left_out": [LEFT_OUT | {"kind": "corner" if sensor == "left" else "surface"}],
        "fit": {},
        "held_out": HELD_OUT,
        "corrections": [],
        "predicted": {
            "placements": [3, 6, 12],
            "sigma_m": [None, 0.004, 0.003],
            "sigma_rad": [3e-3, 2e-3, 1e-3],
        },
        "time_offset_s": None,
        "clock": "",
        "time_wander": None,
        "intrinsics": None,
        "lens": "",
    }


def influence(placement, moved, nees):
    """What one placement does to both sensors."""
    sensors = {n: {"influence": moved, "nees": nees, "directions": 6} for n in SENSORS}
    return {"session": "s1", "target": "board", "placement": placement, "sensors": sensors}


def calibration():
    """A calibration.json of two solved sensors."""
    return {
        "schema_version": 1,
        "rig": "robo",
        "verdict": "pass",
        "reasons": [],
        "sensors": {n: sensor_result(n) for n in SENSORS},
        "joint_covariance": {
            "order": ["left", "top"],
            "matrix": np.diag(np.tile(SIGMA**2, 2)).tolist(),
        },
        "pairs": [],
        "suspicions": [],
        "mocap_offsets_s": {},
        "influences": [influence(0, 1.4, 5.0), influence(1, None, 7.0)],
        "repeatability": [],
        "targets": {"board": None, "pipe": None},
        "sessions": {"s1": None},
        "noise": {
            "sensors": {"left": {"corner": 0.04}, "top": {"surface": 0.012}},
            "mocap_factor": 1.25,
        },
        "provenance": {"sessions": ["s1"], "packages": {"numpy": "2.4.6"}},
    }


def without_pose(result, name, status):
    """The calibration with one sensor that could not be solved."""
    none = dict.fromkeys(("T_robot_sensor", "covariance", "weakest", "held_out", "predicted"))
    none["next_view"] = None
    counts = dict.fromkeys(("placements", "observations", "points"), 0)
    result["sensors"][name] |= {"status": status.to_dict(), "verdict": "fail", "rejected": 0.0}
    result["sensors"][name] |= none | counts | {"residual": {"rms": None, "unit": "px"}}
    left = [n for n, s in sorted(result["sensors"].items()) if s["T_robot_sensor"]]
    block = np.diag(np.tile(SIGMA**2, len(left))).tolist()
    result["joint_covariance"] = {"order": left, "matrix": block} if left else None
    result["noise"]["sensors"].pop(name, None)
    return result


class Files:
    """The inputs of one report in a folder; each may be replaced before it is rendered."""

    def __init__(self, folder):
        self.folder = folder
        rng = np.random.default_rng(0)
        self.calibration, self.findings = calibration(), []
        self.audits, self.frames = {"s1": audit()}, {"s1": frames()}
        self.placements = {"s1": (placements(), OK, {"board": OK, "pipe": OK})}
        self.guesses, self.views, self.keypoints, parts = {}, {}, {}, []
        for sensor in SENSORS:
            views = view_columns(sensor, rng)
            keypoints, residuals = measurements(sensor, views, rng)
            parts += residuals
            self.guesses["s1", sensor] = guess_of(sensor)
            self.views["s1", sensor] = views, OK
            kept = np.flatnonzero(views["kept"])
            outcomes = {int(v): OK for v in kept}
            self.keypoints["s1", sensor] = joined(keypoints, table_schemas.KEYPOINTS), OK, outcomes
        self.residuals = joined(parts, table_schemas.RESIDUALS)
        rounds = {"round": [0], "cost": [12.5], "ipopt_iterations": [4], "members": [999]}
        self.iterations = rounds | {"step_m": [1e-9], "step_rad": [1e-9], "changed": [0]}
        self.options = {
            "report": {"title": "", "max_overlays": 4},
            "rig": "robo",
            "body": "mcs/robot",
            "sensors": SENSORS,
            "targets": {"board": BOARD, "pipe": PIPE},
            "sessions": {"s1": sorted(SENSORS)},
            "settings": {k: v for k, v in config.defaults().items() if k != "export"},
        }

    def blind(self, sensor, status, session="s1"):
        """A sensor that saw nothing in a session."""
        schema = run_data.VIEWS[SENSORS[sensor]["kind"]]
        self.views[session, sensor] = parquet_tables.empty(schema), status
        self.keypoints[session, sensor] = parquet_tables.empty(table_schemas.KEYPOINTS), status, {}
        rows = (self.residuals["sensor"] != sensor) | (self.residuals["session"] != session)
        self.residuals = parquet_tables.select(self.residuals, rows)

    def write(self):
        """Write all; returns the arguments of report.py."""
        arguments = {
            k: [] for k in ("audits", "frames", "placements", "guesses", "views", "keypoints")
        }
        for session, sensors in sorted(self.options["sessions"].items()):
            arguments["audits"].append(self.json(f"{session}-log", self.audits[session]))
            path = self.table(f"{session}-frames", table_schemas.FRAMES, self.frames[session])
            arguments["frames"].append(path)
            columns, status, of_targets = self.placements[session]
            notes = {k: v.to_dict() for k, v in of_targets.items()}
            path = self.table(
                f"{session}-placements", table_schemas.PLACEMENTS, columns, status, notes
            )
            arguments["placements"].append(path)
            for sensor in sorted(sensors):
                for key, path in self.write_stream(session, sensor).items():
                    arguments[key].append(path)
        levels = {n: s["verdict"] for n, s in self.calibration["sensors"].items()}
        result = config.complete("calibration", copy.deepcopy(self.calibration), "calibration")
        judged = {k: result[k] for k in ("verdict", "reasons")}
        judged |= {"findings": self.findings, "sensors": levels, "limits": LIMITS}
        arguments |= {
            "calibration": [self.json("calibration", result)],
            "verdict": [self.json("verdict", config.complete("verdict", judged, "verdict"))],
            "residuals": [self.table("residuals", table_schemas.RESIDUALS, self.residuals)],
            "iterations": [self.table("iterations", table_schemas.ITERATIONS, self.iterations)],
            "templates": [p for p in TEMPLATES if p.suffix in (".j2", ".css", ".js")],
            "html": [self.folder / "report.html"],
            "pdf": [self.folder / "report.pdf"],
            "figures": [self.folder / f"{name}.svg" for name in report.COLUMNS],
            "options": [json.dumps(self.options)],
        }
        return [str(v) for key, values in arguments.items() for v in (f"--{key}", *values)]

    def write_stream(self, session, sensor):
        """Paths of what one sensor left in one session."""
        at = session, sensor
        schema = run_data.VIEWS[SENSORS[sensor]["kind"]]
        columns, status, outcomes = self.keypoints[at]
        told = [{"view": v, "status": s.to_dict()} for v, s in outcomes.items()]
        notes = {"outcomes": told, "T_robot_sensor": None, "guess": self.guesses[at]}
        name = f"{session}-{sensor}"
        return {
            "guesses": self.json(f"{name}-guess", self.guesses[at]),
            "views": self.table(f"{name}-views", schema, *self.views[at]),
            "keypoints": self.table(
                f"{name}-keypoints", table_schemas.KEYPOINTS, columns, status, notes
            ),
        }

    def json(self, name, content):
        """Path of a JSON file."""
        stage_cli.write_json(self.folder / f"{name}.json", content)
        return self.folder / f"{name}.json"

    def table(self, name, schema, columns, status=OK, notes=None):
        """Path of a table."""
        parquet_tables.write(self.folder / f"{name}.parquet", schema, columns, status, notes)
        return self.folder / f"{name}.parquet"

    def render(self):
        """The page as it stands; printing it would take most of the time."""
        with patch.object(pdf_page, "to_pdf", return_value=b"%PDF"):
            report.main(self.write())
        return (self.folder / "report.html").read_text()


def own(page):
    """The page without the library that draws the 3-D view, which is not ours to read."""
    return re.sub(r"<script>/\*\*\n\* plotly.*?</script>", "", page, flags=re.S)


def section(page, name):
    """One section of the page."""
    return page.split(f'<section id="{name}">')[1].split("</section>")[0]


def words(page):
    """The page's text without tags, in single blanks."""
    page = re.sub(r"<(style|svg|script).*?</\1>", " ", page, flags=re.S)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", page))


def undraw(monkeypatch):
    """Name figures but do not draw them."""

    def drawing(fig, name, label, caption, span=1):
        svg = f'<svg viewBox="0 0 1 1" aria-label="{label}"></svg>'
        return svg_plots.Drawing(svg, None, caption, "", span)

    monkeypatch.setattr(
        svg_plots, "panels", lambda n, *_, **__: (MagicMock(), [MagicMock()] * len(n))
    )
    monkeypatch.setattr(svg_plots, "drawing", drawing)
    monkeypatch.setattr(rig_figure, "_seen", MagicMock())
    monkeypatch.setattr(rig_figure, "_bars", MagicMock())


def printed(folder):
    """The folder with all that the report of a good run writes."""
    report.main(Files(folder).write())
    return folder
