"""What the pipeline made of one simulated session, and the simulator's own account of it."""

import json
from argparse import Namespace
from dataclasses import dataclass

import numpy as np

import simulate
from calib.geometry import se3
from calib.io import config, parquet_tables, pose_block, table_schemas
from calib.sensors import sensor_models
from calib.targets import target_shapes
from calib.views.windows import cone
from simulation import config_and_truth, record_session
from simulation.sensors import camera_exposure, render_image, scan_patterns

NOISE = ("range_noise_m", "image_noise", "mcs_noise_m", "mcs_noise_deg")
SCHEMAS = {"camera": table_schemas.VIEWS_CAMERA, "lidar": table_schemas.VIEWS_LIDAR}


@dataclass(frozen=True)
class Recording:
    """One sensor and one target in one session, with noise that is yet to be drawn.

    session: of the simulator (record.Session), its arguments with that noise; options: what the
    stages read of a config that states the noise; placements, views: columns of the tables;
    content: by placement, what a sensor without noise meets there (`window` or `picture`).
    """

    session: record_session.Session
    sensor: str
    target: str
    options: dict
    placements: dict
    views: dict
    guess: dict
    content: dict

    @property
    def T_robot_sensor(self):
        """The true pose (4, 4); nothing but the judgement of a result may ask for it."""
        return self.session.rig.sensors[self.sensor]

    @property
    def model(self):
        return sensor_models.model(self.options["sensor"])


def recording(results, log, settings, row, noise):
    """The Recording of the folder of a session's results and of that of its simulated log.

    settings: the config of the run, complete; row: of the benchmark, for sensor and target; noise:
    arguments of simulate.py that make the noise to be drawn.
    """
    arguments = json.loads((log / "truth.json").read_text())["arguments"]
    loud = {key: getattr(simulate.parse(["-", *noise]), key) for key in NOISE}
    args = Namespace(**(arguments | loud))
    placements, _, _ = parquet_tables.read(results / "placements.parquet", table_schemas.PLACEMENTS)
    kind = "camera" if row.of_images else "lidar"
    views, _, _ = parquet_tables.read(results / row.sensor / "views.parquet", SCHEMAS[kind])
    guess = json.loads((results / row.sensor / "guess.json").read_text())
    return filled(args, row.sensor, row.target, settings, placements, views, guess)


def filled(args, sensor, target, settings, placements, views, guess):
    """The Recording of arguments of simulate.py, the noise among them, and of what the pipeline
    made of such a log: columns of placements and views, content of guess.json."""
    (session,), guesses = simulate.draw(args)
    described = config.complete(
        "rig", config_and_truth.rig_config(session.rig, guesses, args), "rig"
    )
    written = config.complete("target", config_and_truth.target_config(target, args), "target")
    (name,) = set(placements["target"].tolist())
    block = described["sensors"][sensor]
    options = {
        "name": sensor,
        "sensor": block,
        "sensors": {sensor: block},
        "targets": {name: written},
        "mocap": described["mocap"],
        **{k: settings[k] for k in ("crop", "extract", "associate", "solve")},
    }
    whole = Recording(session, sensor, target, options, placements, views, guess, {})
    meet = picture if block["kind"] == "camera" else window
    for k in sorted(set(views["placement"][views["kept"]].tolist())):
        whole.content[k] = meet(whole, k)
    return whole


def rows_of(recording, placement):
    """Rows of the kept views of a placement."""
    views = recording.views
    return np.flatnonzero(views["kept"] & (views["placement"] == placement))


def span(recording, placement):
    """Start and end of a placement, ns."""
    row = np.flatnonzero(recording.placements["placement"] == placement)[0]
    return tuple(int(recording.placements[k][row]) for k in ("start", "end"))


def window(recording, placement):
    """Beams (n, 3) of a turn around where the guess expects the target, the time of each after the
    first, ns, and its ring."""
    options, table = recording.options, recording.placements
    row = np.flatnonzero(table["placement"] == placement)[0]
    T_robot_body = se3.from_xyz_quat(table["xyz"][row], table["quat"][row])
    (config_of,) = options["targets"].values()
    T_sensor_robot = se3.inverse(np.array(recording.guess["T_robot_sensor"]["matrix"]))
    T = T_sensor_robot @ T_robot_body @ pose_block.pose(config_of["T_body_target"])
    spec = recording.session.rig.specs[recording.sensor]
    firing = spec.scans.firing(np.deg2rad(spec.sector_deg), 0)
    margin = options["crop"]["margin_sigma"] * np.array(recording.guess["sigma"])
    flat = firing.beams.reshape(-1, 3)
    inside = cone(flat, target_shapes.from_config(config_of), T, margin)
    column, ring = np.divmod(np.flatnonzero(inside), firing.beams.shape[1])
    return scan_patterns.Firing(flat[inside][:, None], firing.after[column]), ring.astype(np.int32)


def picture(recording, placement):
    """Unrounded image (height, width, 3) of a placement without noise."""
    session, args = recording.session, recording.session.args
    view = render_image.view(session.rig.cameras[recording.sensor])
    shutter = camera_exposure.Shutter(
        lambda t, points: record_session.image_at(session, recording.sensor, view, t, points),
        *(session.times, args.exposure_s, args.blur_px),
    )
    t = recording.views["t"][rows_of(recording, placement)[0]]
    return shutter.open(int(t)).astype(np.float32)
