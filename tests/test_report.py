"""The report: what it must say, of good runs and of failed ones, on hand-made inputs."""

import copy
import json
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock, patch
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml

import report
from calib import config, geometry, images, rig, stage, tables, targets, verdict
from calib.report import (
    extrinsics,
    overlays,
    paper,
    plots,
    residuals,
    rig_figure,
    run,
    summary,
    terminal,
    text,
)
from calib.status import OK, InputError, failed

ROOT = Path(__file__).parents[1]
TEMPLATE = ROOT / "workflow" / "report" / "report.html.j2"
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
HELD_OUT = {"placements": 2, "directions": 12, "rms_m": 0.002, "rms_rad": 0.01, "ratio": 1.1}
POSES = {
    "left": geometry.from_rpy([0.1, 0.02, 0.3], np.radians([-90, 0, -90])),
    "top": geometry.from_rpy([0.2, -0.05, 0.6], np.radians([0, 0, 30])),
}
GUESS_OFF = geometry.from_rpy([0.03, 0.0, 0.04], np.radians([0, 0, 2]))
SIGMA = np.array([0.001, 0.002, 0.003, 1e-4, 2e-4, 3e-4])
NOT_FOUND = failed("no checkerboard in the region", "none", "4 × 3 inner corners")
UNSEEN = failed("left has no view of a target", "40 not still", "1 or more", "Record its view.")
# Two placements of the board before the robot, one of the pipe.
PLACES = (("board", [2.0, 0.1, 0.3]), ("board", [2.5, -0.2, 0.4]), ("pipe", [2.0, 0.4, 0.5]))
FACING = geometry.from_rpy([0, 0, 0], np.radians([90, 0, -90]))[:3, :3]


def placements():
    """Columns of three still intervals, 2 s each."""
    n = len(PLACES)
    pose = [geometry.pose(FACING if name == "board" else None, xyz) for name, xyz in PLACES]
    return {
        "placement": np.arange(n),
        "target": [name for name, _ in PLACES],
        "kind": ["still"] * n,
        "start": np.arange(n) * 4 * 10**9,
        "end": np.arange(n) * 4 * 10**9 + 2 * 10**9,
        "xyz": [xyz for _, xyz in PLACES],
        "quat": geometry.to_quat(np.array(pose)),
        "samples": np.full(n, 200),
        "effective_samples": np.full(n, 150.0),
        "pose_factor": np.full(n, 0.1),
        "covariance": np.zeros((n, 36)),
    }


def in_sensor(sensor, placement):
    """T_sensor_target (4, 4) by the truth."""
    name, xyz = PLACES[placement]
    T_robot_target = geometry.pose(FACING if name == "board" else None, xyz)
    return geometry.inverse(POSES[sensor]) @ T_robot_target


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
        png = [images.to_png(image)] * len(shown) + [b""]
        return columns | {"u0": np.zeros(n), "v0": np.zeros(n), "png": png}
    clouds = [geometry.transform(in_sensor(sensor, k), cloud(k, rng)) for k in shown]
    xyz = [c.astype(np.float32).reshape(-1) for c in clouds] + [np.zeros(0, np.float32)]
    ring = [np.arange(300) % 16 for _ in shown] + [np.zeros(0, np.int32)]
    dt = [np.zeros(300, np.int64) for _ in shown] + [np.zeros(0, np.int64)]
    return columns | {"xyz": xyz, "ring": ring, "dt": dt}


def measurements(sensor, views, rng):
    """(keypoints, residuals) columns of the kept views, consistent with each other."""
    camera = rig.camera(CAMERA)
    keypoints, residuals = [], []
    for i in np.flatnonzero(views["kept"]):
        T = in_sensor(sensor, views["placement"][i])
        if sensor == "left":
            p = targets.from_config(BOARD).pattern.corners()
            uv = camera.project(geometry.transform(T, p))[0] + rng.normal(0, 0.05, (len(p), 2))
            value, sigma, kind = rng.normal(0, 0.05, (len(p), 2)), 0.05, "corner"
            measured, xyz = np.column_stack([uv, np.zeros(len(p))]), np.full((len(p), 3), np.nan)
        else:
            xyz = np.reshape(views["xyz"][i], (-1, 3)).astype(float)
            value = np.column_stack([rng.normal(0, 0.01, len(xyz)), np.zeros(len(xyz))])
            uv, sigma, kind = np.full((len(xyz), 2), np.nan), 0.01, "surface"
            measured = geometry.transform(geometry.inverse(T), xyz)
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
        residuals.append(
            shared | more | {"session": np.full(n, "s1"), "sensor": np.full(n, sensor)}
        )
    return keypoints, residuals


def joined(parts, schema):
    """Columns of several parts."""
    return tables.concatenate(parts, schema)


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


def guess_of(sensor):
    """The first guess, off by centimetres and degrees."""
    T = rig.pose_json(POSES[sensor] @ GUESS_OFF)
    sigma = [0.05] * 3 + [0.09] * 3
    known = {"T_robot_sensor": T, "sigma": sigma, "source": "config", "time_offset_s": None}
    return known | {"status": OK.to_dict(), "frame": f"{sensor}_frame"}


def sensor_result(sensor):
    """A solved sensor of calibration.json."""
    guess = guess_of(sensor)
    return {
        "kind": SENSORS[sensor]["kind"],
        "frame": f"{sensor}_frame",
        "status": OK.to_dict(),
        "verdict": "pass",
        "guess": {k: guess[k] for k in ("T_robot_sensor", "sigma", "source")},
        "T_robot_sensor": rig.pose_json(POSES[sensor]),
        "covariance": np.diag(SIGMA**2).tolist(),
        "weakest": {"direction": "translation along z of the robot body", "sigma": 0.003},
        "placements": 12,
        "observations": 34,
        "points": 5678,
        "rejected": 0.05,
        "residual": {"rms": 0.0123, "unit": "px" if sensor == "left" else "m"},
        "undetermined": [],
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
        self.audits = {"s1": audit()}
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
            self.keypoints["s1", sensor] = joined(keypoints, tables.KEYPOINTS), OK, outcomes
        self.residuals = joined(parts, tables.RESIDUALS)
        rounds = {"round": [0], "cost": [12.5], "ipopt_iterations": [4], "members": [999]}
        self.iterations = rounds | {"step_m": [1e-9], "step_rad": [1e-9], "changed": [0]}
        self.options = {
            "report": {"title": "", "max_overlays": 4},
            "rig": "robo",
            "body": "mcs/robot",
            "sensors": SENSORS,
            "targets": {"board": BOARD, "pipe": PIPE},
            "sessions": {"s1": sorted(SENSORS)},
        }

    def blind(self, sensor, status, session="s1"):
        """A sensor that saw nothing in a session."""
        schema = run.VIEWS[SENSORS[sensor]["kind"]]
        self.views[session, sensor] = tables.empty(schema), status
        self.keypoints[session, sensor] = tables.empty(tables.KEYPOINTS), status, {}
        rows = (self.residuals["sensor"] != sensor) | (self.residuals["session"] != session)
        self.residuals = tables.select(self.residuals, rows)

    def write(self):
        """Write all; returns the arguments of report.py."""
        arguments = {k: [] for k in ("audits", "placements", "guesses", "views", "keypoints")}
        for session, sensors in sorted(self.options["sessions"].items()):
            arguments["audits"].append(self.json(f"{session}-log", self.audits[session]))
            columns, status, of_targets = self.placements[session]
            notes = {k: v.to_dict() for k, v in of_targets.items()}
            path = self.table(f"{session}-placements", tables.PLACEMENTS, columns, status, notes)
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
            "residuals": [self.table("residuals", tables.RESIDUALS, self.residuals)],
            "iterations": [self.table("iterations", tables.ITERATIONS, self.iterations)],
            "template": [TEMPLATE],
            "html": [self.folder / "report.html"],
            "pdf": [self.folder / "report.pdf"],
            "figures": [self.folder / f"{name}.svg" for name in report.COLUMNS],
            "options": [json.dumps(self.options)],
        }
        return [str(v) for key, values in arguments.items() for v in (f"--{key}", *values)]

    def write_stream(self, session, sensor):
        """Paths of what one sensor left in one session."""
        at = session, sensor
        schema = run.VIEWS[SENSORS[sensor]["kind"]]
        columns, status, outcomes = self.keypoints[at]
        told = [{"view": v, "status": s.to_dict()} for v, s in outcomes.items()]
        notes = {"outcomes": told, "T_robot_sensor": None, "guess": self.guesses[at]}
        name = f"{session}-{sensor}"
        return {
            "guesses": self.json(f"{name}-guess", self.guesses[at]),
            "views": self.table(f"{name}-views", schema, *self.views[at]),
            "keypoints": self.table(f"{name}-keypoints", tables.KEYPOINTS, columns, status, notes),
        }

    def json(self, name, content):
        """Path of a JSON file."""
        stage.write_json(self.folder / f"{name}.json", content)
        return self.folder / f"{name}.json"

    def table(self, name, schema, columns, status=OK, notes=None):
        """Path of a table."""
        tables.write(self.folder / f"{name}.parquet", schema, columns, status, notes)
        return self.folder / f"{name}.parquet"

    def render(self):
        """The page as it stands; printing it would take most of the time."""
        with patch.object(paper, "to_pdf", return_value=b"%PDF"):
            report.main(self.write())
        return (self.folder / "report.html").read_text()


@pytest.fixture
def files(tmp_path):
    """Inputs of a good run."""
    return Files(tmp_path)


@pytest.fixture
def undrawn(monkeypatch):
    """Figures are named but not drawn, which takes most of the time."""

    def drawing(fig, name, label, caption, span=1):
        svg = f'<svg viewBox="0 0 1 1" aria-label="{label}"></svg>'
        return plots.Drawing(svg, None, caption, "", span)

    monkeypatch.setattr(plots, "panels", lambda n, *_, **__: (MagicMock(), [MagicMock()] * len(n)))
    monkeypatch.setattr(plots, "drawing", drawing)
    monkeypatch.setattr(rig_figure, "_seen", MagicMock())
    monkeypatch.setattr(rig_figure, "_bars", MagicMock())


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    """The folder with all that the report of a good run writes."""
    files = Files(tmp_path_factory.mktemp("good"))
    report.main(files.write())
    return files.folder


@pytest.fixture(scope="module")
def page(printed):
    """The page of a good run."""
    return (printed / "report.html").read_text()


def words(page):
    """The page's text without tags, in single blanks."""
    page = re.sub(r"<(style|svg).*?</\1>", " ", page, flags=re.S)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", page))


def test_sections_come_in_order(page):
    found = re.findall(r"<h2>(\d) ", page)
    assert found == list("12345678")


@pytest.mark.parametrize(
    "said",
    [
        "PASS 2 of 2 sensors calibrated from 1 session",
        "warn above 5, fail above 20",
        "roll, ° −90.0000 −90.0000 0.0057 0.0000",
        "x, mm 226.0 200.0 1.3 −26.0",
        "Rejected: 5 % , 299 of 5 977 candidates",
        "4 of 100 cells of the image",
        "4 of 36 sectors of azimuth, elevation −18 to 2.3°",
        "placements 12",
        "observations 34",
        "rejected 5 %",
        "residual rms 12.3 mm",
        "residual rms 0.0123 px",
        "change from the first guess 50 mm, 2°",
        "least certain: translation along z of the robot body, σ 3 mm",
        "the point (1, 0, 0) m of top lies at (1.0660, 0.4500, 0.6000) m in the robot frame",
        "T_left_top",
        "Not estimated: time offset of left, intrinsics of left, time offset of top, "
        "alignment of board in its MCS body, alignment of pipe in its MCS body.",
        "3 × repeated",
        "not kept: 1 not still",
        "widened by a factor of 1.25",
        "left corner 0.05 0.04 px 0.8",
        "s1, view 0: board, placement 0",
        "s1.mcap 123456 00ffab",
        "numpy 2.4.6",
        "T_robot_left, from frame left_frame into mcs/robot",
    ],
)
def test_says(page, said):
    assert said in words(page)


def test_is_complete_in_itself(page):
    assert "<script" not in page
    assert "http" not in page
    references = re.findall(r"""(?:src|href)\s*=\s*["']([^"']*)""", page)
    assert references
    assert all(r.startswith(("#", "data:image/")) for r in references)
    assert all(u.startswith("#") for u in re.findall(r"url\(([^)]*)\)", page))
    assert "@import" not in page


def test_ids_that_figures_refer_to_are_their_own(page):
    ids = re.findall(r'\sid="([^"]*)"', page)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'href="#([^"]*)"', page)) <= set(ids)


def test_follows_light_and_dark(page):
    assert "prefers-color-scheme: dark" in page
    assert "@media print" in page
    # No figure has a colour of the light page of its own.
    drawn = "".join(re.findall("<svg.*?</svg>", page, flags=re.S))
    assert "var(--ink)" in drawn
    assert not re.search("|".join(plots.THEME), drawn)


def test_same_inputs_same_bytes(printed, files):
    report.main(files.write())
    for name in ("report.html", "report.pdf", *(f"{figure}.svg" for figure in report.COLUMNS)):
        assert (files.folder / name).read_bytes() == (printed / name).read_bytes(), name


def test_every_figure_has_a_caption(page):
    assert page.count("<figure") == page.count("<figcaption>") > 10
    assert page.count('role="img"') == page.count("<svg")


def test_sensor_without_a_pose_says_what_to_do_and_shows_no_guess(files, undrawn):
    files.calibration = without_pose(files.calibration, "left", UNSEEN)
    files.calibration |= {"verdict": "fail", "reasons": ["left: no view <of> a target"]}
    files.blind("left", UNSEEN)
    page = files.render()
    said = words(page)
    assert "No pose." in said
    for part in (UNSEEN.reason, UNSEEN.found, UNSEEN.expected, UNSEEN.remedy):
        assert part in said
    assert "left: no view &lt;of&gt; a target" in page
    guess = files.guesses["s1", "left"]["T_robot_sensor"]["xyz_m"]
    assert text.fixed(1e3 * guess[0], 1) not in said
    assert "No residual: nothing of this sensor reached the solve." in said
    # The other sensor keeps its numbers.
    assert "x, mm 226.0 200.0" in said


def test_nothing_at_all(files):
    status = failed(
        "MCS body mcs/robot is not in the log", "bodies none", "mcs/robot", "Check `body`."
    )
    for name in SENSORS:
        files.calibration = without_pose(files.calibration, name, status)
        files.blind(name, status)
        files.guesses["s1", name] |= {
            "T_robot_sensor": None,
            "status": status.to_dict(),
            "frame": "",
        }
        files.calibration["sensors"][name]["guess"]["T_robot_sensor"] = None
    files.calibration |= {"verdict": "fail", "reasons": ["nothing"]}
    files.placements["s1"] = tables.empty(tables.PLACEMENTS), status, {"board": status}
    files.iterations = tables.empty(tables.ITERATIONS)
    nothing = {"status": status.to_dict(), "poses": 0}
    files.audits["s1"] |= {"bodies": {"mcs/robot": nothing}, "topics": {}}
    silent = {"status": status.to_dict(), "frame": "", "messages": 0, "rate_hz": 0.0}
    files.audits["s1"]["sensors"] = dict.fromkeys(SENSORS, silent)
    said = words(files.render())
    assert "FAIL 0 of 2 sensors calibrated" in said
    assert "Check `body`." in said
    assert "No round was run." in said
    assert "Nothing was measured" in said


def test_no_session_and_no_sensor(files, undrawn):
    files.options |= {"sessions": {}, "sensors": {}, "targets": {}}
    files.calibration |= {"sensors": {}, "joint_covariance": None, "targets": {}, "sessions": {}}
    files.calibration["noise"]["sensors"] = {}
    files.residuals = tables.empty(tables.RESIDUALS)
    assert "0 of 0 sensors" in words(files.render())


def test_views_without_a_find_are_shown_and_explained(files, undrawn):
    columns, _, outcomes = files.keypoints["s1", "left"]
    keep = np.asarray(columns["view"]) != 1
    outcomes = outcomes | {1: NOT_FOUND}
    files.keypoints["s1", "left"] = tables.select(columns, keep), OK, outcomes
    gone = (files.residuals["sensor"] == "left") & (files.residuals["view"] == 1)
    files.residuals = tables.select(files.residuals, ~gone)
    said = words(files.render())
    assert "not found: 1 no checkerboard in the region" in said
    assert "s1, view 1: board, placement 1; nothing found" in said
    assert "4 × 3 inner corners" in said


def test_measurements_without_a_member_are_left_out_not_plotted(files, undrawn):
    rows = files.residuals["sensor"] == "left"
    files.residuals["weight"] = np.where(rows, 0.0, files.residuals["weight"])
    said = words(files.render())
    assert "No measurement is a member" in said
    assert "not used: 2 no measurement was a member of the solution" in said


def test_sessions_may_use_different_sensors(files, undrawn):
    files.options["sessions"] = {"s1": ["left", "top"], "s0": ["top"]}
    for kept in (files.audits, files.placements):
        kept["s0"] = kept["s1"]
    for kept in (files.guesses, files.views, files.keypoints):
        kept["s0", "top"] = kept["s1", "top"]
    rows = tables.select(files.residuals, files.residuals["sensor"] == "top")
    rows["session"] = np.full(len(rows["view"]), "s0")
    files.residuals = tables.concatenate([files.residuals, rows], tables.RESIDUALS)
    page = files.render()
    assert "A line parts the sessions" in page
    assert "Session s0" in page
    assert "s0, view" in page


@pytest.mark.parametrize("most", [0, 1, 2])
def test_overlays_are_limited(files, undrawn, most):
    files.options["report"]["max_overlays"] = most
    page = files.render()
    assert page.count('class="photo"') == most
    assert page.count(" over the target but not used") == most


def test_unknown_rings_are_not_plotted(files, undrawn):
    files.residuals["index"] = np.full(len(files.residuals["view"]), -1)
    page = files.render()
    assert "Residuals of top by range" in page
    assert "Residuals of top by ring" not in page


def test_estimated_unknowns_are_told(files, undrawn):
    files.calibration["sensors"]["left"]["time_offset_s"] = {"value": 0.025, "sigma": 0.0002}
    files.calibration["sensors"]["left"]["clock"] = "from 25 views of targets in motion"
    files.calibration["sensors"]["top"]["clock"] = "not observable: no relative motion"
    files.calibration["targets"]["board"] = {
        "T_body_target": rig.pose_json(geometry.from_rpy([0.006, 0, 0], [0, 0, np.radians(1)])),
        "covariance": np.diag(SIGMA**2).tolist(),
        "shift": [0.006, 0, 0, 0, 0, np.radians(1)],
        "prior": (SIGMA * [2, 4, 4, 4, 4, 1.05]).tolist(),
    }
    T = rig.pose_json(geometry.from_rpy([0.03, 0, 0], [0, 0, 0]))
    markers = {"T_robot_markers": T, "covariance": np.diag(SIGMA**2).tolist()}
    files.calibration["sessions"]["s1"] = markers
    said = words(files.render())
    assert "robot markers in s1, in R x 30.0 ± 1.0 mm" in said
    assert "time offset of left 25.000 ± 0.2 ms, from 25 views of targets in motion" in said
    assert "time offset of top not observable: no relative motion" in said
    assert "alignment of board in its MCS body x 6.0 ± 1.0 mm" in said
    assert "yaw 1.0000 ± 0.0172 °; σ is 0.25 to 0.95 of its prior" in said
    assert "nothing tells the turn about z of the target; tilt it to more sides" in said


def test_every_session_stands_beside_the_others(files, undrawn):
    row = {"session": "s1", "sensor": "left", "others": 1, "chance": 1e-9}
    shift, sigma = [0.003, 0, 0.004, 0, 0, 0.01], [0.0001] * 3 + [0.001] * 3
    files.calibration["repeatability"] = [row | {"shift": shift, "sigma": sigma}]
    assert "s1 left 5 0.17 0.57 0.099" in words(files.render())


def test_title(files, undrawn):
    files.options["report"]["title"] = "Husky & trailer"
    assert "<h1>Husky &amp; trailer</h1>" in files.render()


def test_table_of_another_sensor_kind_is_refused(files):
    arguments = files.write()
    at = arguments.index("--views")
    arguments[at + 1], arguments[at + 2] = arguments[at + 2], arguments[at + 1]
    with pytest.raises(InputError, match="views"):
        report.main(arguments)


def test_levels_agree_with_the_judge():
    limits = config.complete("config", {"sessions": {"s": {"rig": "r", "log": "x"}}}, "x")["judge"]
    told = {"tilt": {}, "fit": {}, "advice": "", "correction": None}
    for sigma in (0.001, 0.006, 0.03):
        sensor = sensor_result("top") | {"covariance": (np.eye(6) * sigma**2).tolist()} | told
        sensor |= {"rejected": 0.3, "placements": 2, "held_out": HELD_OUT | {"ratio": 3.0}}
        cells = {
            key: summary._level(value, limits, key, large)
            for _, _, key, _, value, large in summary.checks(sensor)
        }
        found = verdict.of_sensor("top", sensor, limits)
        found += verdict.of_sigma("top", sensor, limits, misfit=True)
        assert {k: v for k, v in cells.items() if v != "pass"} == {
            f["check"]: f["level"] for f in found
        }


@pytest.mark.parametrize("large_is_bad", [True, False])
def test_a_value_that_is_no_number_fails_for_judge_and_report_alike(large_is_bad):
    key = "sigma_m" if large_is_bad else "placements"
    assert verdict.level(np.nan, LIMITS, key, large_is_bad) == "fail"
    assert summary._level(np.nan, LIMITS, key, large_is_bad) == "fail"


def test_sigmas_are_those_of_the_numbers_beside_them():
    for T in (*POSES.values(), geometry.from_rpy([1, 2, 3], [0.4, -0.7, 2.1])):
        step = 1e-6
        moved = [T @ geometry.se3_exp(step * axis) for axis in np.eye(6)]
        J = np.array([extrinsics.difference(there, T) for there in moved]).T / step
        told = extrinsics.sigmas(T, np.diag(SIGMA**2))
        np.testing.assert_allclose(np.sqrt((J * SIGMA) ** 2 @ np.ones(6)), told, rtol=1e-4)


@pytest.mark.filterwarnings("ignore:Gimbal lock")
def test_angles_without_a_meaning_of_their_own_have_no_sigma():
    T = geometry.from_rpy([1, 2, 3], [0.3, np.pi / 2, 0.1])
    sigma = extrinsics.sigmas(T, np.diag(SIGMA**2))
    assert np.isfinite(sigma[:3]).all() and np.isnan(sigma[3:]).all()
    assert [r["sigma"] for r in extrinsics.rows(T, np.diag(SIGMA**2), None, None)][3:] == ["–"] * 3


def test_angles_differ_by_less_than_half_a_turn():
    one, other = (geometry.from_rpy([0, 0, 0], np.radians([0, 0, yaw])) for yaw in (179, -179))
    assert extrinsics.difference(other, one)[5] == pytest.approx(2)


def test_the_error_of_draws_from_the_covariance_is_one_sigma():
    rng = np.random.default_rng(2)
    P, T = np.diag(SIGMA**2), POSES["left"]
    xi = SIGMA * rng.standard_normal((300, 6))
    nees = [extrinsics.error(T @ geometry.se3_exp(x), P, T)[2] for x in xi]
    assert np.mean(nees) == pytest.approx(1, abs=0.15)
    inside = np.mean([extrinsics.NEES_95[0] < v < extrinsics.NEES_95[1] for v in nees])
    assert inside == pytest.approx(0.95, abs=0.03)


def test_truth_is_shown_beside_the_results(files):
    files.options["report"]["max_overlays"] = 1
    off = geometry.se3_exp([0.002, 0, 0, 0, 0, 0])
    files.options["truth"] = {n: {"matrix": (T @ off).tolist()} for n, T in POSES.items()}
    said = words(files.render())
    # 2 mm along an axis of σ 1 mm: NEES 4.
    assert "error against the truth 2 mm, 0° (0.82 σ, NEES/6 0.67)" in said
    assert "The truth was given, to this report alone." in said
    assert "dashed outline: by the truth" in said


def test_truth_may_be_known_of_one_sensor_alone(files, undrawn):
    files.options["truth"] = {"top": {"matrix": POSES["top"].tolist()}}
    said = words(files.render())
    assert said.count("error against the truth 0 mm, 0°") == 1


def test_a_truth_of_a_sensor_that_the_rig_does_not_use_is_told(files, undrawn):
    files.options["truth"] = {"tpo": {"matrix": POSES["top"].tolist()}}
    said = words(files.render())
    assert "A truth was given of tpo, which rig robo does not use" in said
    assert "error against the truth" not in said


def test_without_truth_nothing_is_said_of_it(page):
    assert "truth" not in words(page)


def test_the_pdf_is_small_and_knows_no_clock(printed):
    pdf = (printed / "report.pdf").read_bytes()
    assert pdf.startswith(b"%PDF") and b"CreationDate" not in pdf
    assert 50_000 < len(pdf) < 5_000_000


@pytest.mark.parametrize("name", report.COLUMNS)
def test_figures_are_files_that_open_without_a_page(printed, name):
    root = ElementTree.parse(printed / f"{name}.svg").getroot()
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert "var(" not in (printed / f"{name}.svg").read_text()
    assert root.findall("{http://www.w3.org/2000/svg}svg")


@pytest.mark.parametrize(
    ("sensor", "kind", "signed", "unit"),
    [
        ("left", "limb", True, "px"),
        ("left", "silhouette", True, "px"),
        ("top", "point", False, "mm"),
        ("top", "vertex", False, "mm"),
        ("top", "edge", True, "°"),
    ],
)
def test_every_kind_of_measurement_is_shown(files, undrawn, sensor, kind, signed, unit):
    rows = files.residuals["sensor"] == sensor
    files.residuals["kind"] = np.where(rows, kind, files.residuals["kind"])
    if kind == "limb":
        files.residuals["value"][rows, 1] = 0
    if not signed:
        files.residuals["value"][rows] = np.abs(files.residuals["value"][rows])
        files.residuals["cosine"][rows] = 0.0
    files.calibration["noise"]["sensors"][sensor] = {kind: 0.01}
    page = files.render()
    assert f"Residuals of {sensor} {kind} over sigma" in page
    assert f">{kind}<small>{residuals.MEANING[kind]}" in page
    assert residuals.unit(kind)[0] == unit
    assert ("which are never" in words(page) or "never negative" in words(page)) != signed


def test_what_did_not_pass_comes_with_what_to_do(files, undrawn):
    """Each remedy once, with the sensors that it is for."""
    one = {"check": "rejected", "level": "warn", "value": 0.3, "limit": 0.2, "text": "much"}
    one |= {"remedy": "look at the overlays"}
    files.findings = [one | {"sensor": n, "sensors": [n]} for n in ("left", "top")]
    said = words(files.render())
    assert "What to do left, top : look at the overlays" in said
    assert said.count("look at the overlays") == 1


def test_suspicions_are_told_with_rivals_effect_and_remedy(files, undrawn):
    rival = {"name": "frame", "of": "board", "text": "it is off", "remedy": "so", "gain": 9.0}
    files.calibration["suspicions"] = [
        {
            "name": "squares",
            "of": "board",
            "text": "the squares are larger",
            "remedy": "measure them",
            "estimate": [0.02],
            "sigma": [0.001],
            "gain": 30.0,
            "chance": 1e-14,
            "explained": {"left/corner": 0.4, "mocap": 0.01},
            "shift": {"left": {"m": 0.0123, "rad": 0.001, "sigmas": 9.0}},
            "rivals": [rival],
        }
    ]
    said = words(files.render())
    assert "the squares are larger or it is off To do: measure them." in said
    assert "left 12 mm, 0.057° (9 σ) 40 % of left/corner" in said


def test_placements_left_out_and_measurements_left_out_are_counted(files, undrawn):
    said = words(files.render())
    assert "left 2 2 0.57 1.1 1 (board) cannot be spared; 0 (board) 1.4 σ" in said
    assert "board corner 70 7 (10 %) before the surface" in said
    assert "σ against the number of placements" in said


def told(result, truth=None, reasons=()):
    """The lines on the terminal."""
    judged = {"verdict": result["verdict"], "reasons": list(reasons)}
    return terminal.lines(result, judged, truth or {})


def test_the_terminal_shows_poses_sigmas_and_errors_in_columns():
    truth = {n: {"matrix": (T @ geometry.se3_exp(SIGMA)).tolist()} for n, T in POSES.items()}
    head, left, top = told(calibration(), truth)
    assert head == "robo: PASS"
    assert re.fullmatch(
        r"left  100  20 300 mm ± 3, −90.000 0.000 −90.000 ° ± 0.017 error 3.7 mm 0.021° \(1 σ\)",
        left,
    )
    assert left.index("mm ±") == top.index("mm ±") and left.index("error") == top.index("error")


def test_the_terminal_says_why_a_sensor_has_no_pose():
    result = without_pose(calibration(), "left", UNSEEN)
    assert told(result)[1] == "left  no pose: left has no view of a target"


def test_the_terminal_takes_ten_lines_of_110_at_most_for_four_sensors():
    result = calibration()
    for name in ("front_camera", "rear_camera"):
        result["sensors"][name] = copy.deepcopy(result["sensors"]["left"])
        matrix = np.array(POSES["left"]) @ geometry.from_rpy([-12.3, -4.5, 6.7], [1, 0.5, 2])
        result["sensors"][name]["T_robot_sensor"] = rig.pose_json(matrix)
    truth = {n: {"matrix": np.eye(4).tolist()} for n in result["sensors"]}
    for lines in (told(result, truth), told(result, {}, [f"reason {i}" for i in range(12)])):
        assert len(lines) <= 9
        assert max(map(len, lines)) <= 110
    assert "and 9 reasons more, in the report" in lines


@pytest.fixture
def common(tmp_path, monkeypatch):
    """Function of what a rig says beyond its sensors: the names of common.smk for that rig."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    for folder in ("config/rigs", "config/targets", "logs"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "logs/s1.mcap").write_bytes(b"log")
    (tmp_path / "config/targets/board.yaml").write_text(yaml.safe_dump(BOARD))

    def load(**truth):
        mocap = {"topics": ["/tf"], "map": "mcs/world"}
        content = {"body": "mcs/robot", "mocap": mocap, "sensors": SENSORS} | truth
        (tmp_path / "config/rigs/robo.yaml").write_text(yaml.safe_dump(content))
        path = ROOT / "workflow" / "common.smk"
        names = {"workflow": SimpleNamespace(basedir=ROOT), "shell": MagicMock()}
        names["config"] = {"sessions": {"s1": {"rig": "robo", "log": "logs/s1.mcap"}}}
        exec(compile(path.read_text(), path, "exec"), names)
        return names

    return load


def slices(names):
    """{stage: the options that its jobs are given, as text}."""
    w = SimpleNamespace(rig="robo", session="s1", sensor="left")
    found = {k: f(w) for k, f in names.items() if k.endswith("_options") and k != "sensor_options"}
    return {k.removesuffix("_options"): v for k, v in found.items()}


def test_the_truth_changes_what_the_report_is_given_and_nothing_else(common):
    truth = {"left": {"xyz_m": [0.1, 0.02, 0.3], "rpy_deg": [-90, 0, -90]}}
    without, given = slices(common()), slices(common(truth=truth))
    assert {stage for stage in given if given[stage] != without[stage]} == {"report"}
    assert {stage for stage, text in given.items() if "truth" in text} == {"report"}
    assert json.loads(given["report"])["truth"] == truth
    assert len(given) >= 9


def test_a_wrong_truth_is_refused(common):
    with pytest.raises(Exception, match="truth.left"):
        common(truth={"left": {"xyz_m": [0.1, 0.02, 0.3]}})


def test_the_last_words_are_verdict_poses_and_where_the_report_is(
    common, tmp_path, capsys, monkeypatch
):
    """The path is one to open from where the command was given."""
    monkeypatch.setenv("PWD", str(tmp_path.parent))
    names = common(truth={"left": {"matrix": POSES["left"].tolist()}})
    (tmp_path / "results/robo").mkdir(parents=True)
    stage.write_json("results/robo/calibration.json", calibration())
    stage.write_json("results/robo/verdict.json", {"verdict": "warn", "reasons": ["top: why"]})
    names["last_words"]()
    lines = capsys.readouterr().err.splitlines()
    assert lines[:2] == ["robo: WARN", "  top: why"]
    assert lines[2].startswith("  left  100") and "error 0 mm 0°" in lines[2]
    assert lines[-1] == f"  report: {tmp_path.name}/results/robo/report.html"


def test_payloads_reads_only_what_is_wanted(files):
    files.write()
    path = files.folder / "s1-left-views.parquet"
    rows = run.payloads(path, [1])
    assert list(rows) == [1]
    assert images.from_png(rows[1]["png"]).shape == (240, 320, 3)
    columns, status, _ = tables.read(path, tables.VIEWS_CAMERA, run.LIGHT)
    assert status.ok
    assert set(columns) == set(run.LIGHT)


def test_worst_views_come_first_and_every_target_is_among_them(files):
    worse = (files.residuals["sensor"] == "top") & (files.residuals["placement"] == 1)
    files.residuals["value"][worse] *= 5
    least = (files.residuals["sensor"] == "top") & (files.residuals["placement"] == 2)
    files.residuals["value"][least] *= 0.1
    args = report.arguments(files.write())
    chosen = overlays.choose(report.read_run(args), "top", 2)
    assert [view for _, view, _ in chosen] == [1, 2]


@pytest.mark.parametrize(
    ("x", "shown"),
    [(1234.5, "1230"), (-0.0123456, "−0.0123"), (4.9e-6, "4.90e−6"), (None, "–"), (np.nan, "–")],
)
def test_numbers(x, shown):
    assert text.number(x) == shown


def test_fixed_has_no_negative_zero():
    assert text.fixed(-0.001, 2) == "0.00"
    assert [text.places(s) for s in (12.0, 0.15, 0.0021, 0.0)] == [0, 2, 4, 2]
    assert [text.nice(x) for x in (1.0, 3.0, 70.0, 0.03)] == [1, 2, 50, 0.02]
