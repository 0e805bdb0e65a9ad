"""Fresh noise on a recorded session, through the stages' own functions again.

A draw takes every sample of the MCS anew, turns the pattern of the scans by a share of its step at
every placement, so that the crossings of an outline lie elsewhere between two beams, and puts fresh
noise on every range or pixel. Then come the stages' own functions: mean poses, extraction from the
guess, the joint estimate. None of them is given the truth, which only serves to judge the result.
"""

import numpy as np

import extract
import gate
from benchmarking.accuracy import cramer_rao_bound, simulated_session
from benchmarking.accuracy.draw_statistics import Draw
from calib.estimation import problem_assembly, solver
from calib.extraction import extractor_registry
from calib.geometry import se3
from calib.io import pose_block
from calib.mocap import body_trajectory
from calib.sensors.camera.images import image_messages
from simulation import record_session
from simulation.sensors import camera_exposure, mocap_errors, scan_scene

TOLERANCE = {"tolerance_m": 1e-7, "tolerance_rad": 1e-7}  # a hundredth of the smallest σ at most


def draw(recording, seed):
    """The Draw of one seed; its pose is None where nothing was found."""
    rng = np.random.default_rng([recording.session.args.seed, seed])
    table = placements_of(recording, rng)
    setup, start = setup_of(recording, table, views_of(recording, rng))
    if not setup.groups:
        return Draw(None, None)
    stops = problem_assembly.limits(setup, recording.options["solve"] | TOLERANCE)
    result = solver.estimate(setup, start, **stops)
    T = result.state.T_robot_sensor[recording.sensor]
    spread = result.solution.covariance[:6, :6]
    error = se3.se3_log(se3.inverse(T) @ recording.T_robot_sensor)
    return Draw(error, spread)


def setup_of(recording, table, views):
    """The Setup, and the poses to start from, that the stages make of the columns of
    placements.parquet and views.parquet."""
    options, name = recording.options, recording.sensor
    job = extract.job_of(options, recording.model, table, recording.guess)
    keypoints, _, T = extractor_registry.SENSORS[options["sensor"]["kind"]](job, views)
    n = len(keypoints["view"])
    pairs = keypoints | {"sensor": np.full(n, name, dtype="U64"), "feature": np.full(n, -1)}
    return problem_assembly.setup_of(
        {"": (pairs, {name: {"T_robot_sensor": T}}, job.places)}, {}, options
    )


def limits(recording):
    """(with, without) outlines: the covariances (6, 6) of the reference for draws of a recording.

    Of one draw's data: the information hardly depends on their noise.
    """
    rng = np.random.default_rng(recording.session.args.seed)
    setup, _ = setup_of(recording, placements_of(recording, rng), views_of(recording, rng))
    true = {recording.sensor: recording.T_robot_sensor}
    found = cramer_rao_bound.evaluate(setup, true, recording.session.args.range_noise_m)
    return found.covariance[recording.sensor], found.inside[recording.sensor]


def placements_of(recording, rng):
    """Columns of placements.parquet with every sample of the MCS anew."""
    session = recording.session
    start, end = record_session.span(session.times)
    t = np.arange(start, end + 1, mocap_errors.PERIOD_NS)
    gap = round(recording.options["mocap"]["max_gap_s"] * body_trajectory.NS)
    poses = (mocap_errors.measured(session, rng, name, t) for name in ("robot", recording.target))
    relative = body_trajectory.relative(*(body_trajectory.Trajectory(t, T, gap) for T in poses))
    sigma = pose_block.pose_sigma(recording.options["mocap"]["pose_sigma"])
    table = {k: np.array(v) for k, v in recording.placements.items()}
    for i in np.flatnonzero(table["kind"] == "still"):
        found = gate.averaged(relative, (table["start"][i], table["end"][i]), sigma)
        for key, value in found.items():
            table[key][i] = value
    return table


def views_of(recording, rng):
    """Columns of views.parquet with fresh noise on every kept view."""
    views = {k: list(v) if isinstance(v, list) else v for k, v in recording.views.items()}
    anew = _image if recording.options["sensor"]["kind"] == "camera" else _scan
    for k in sorted(recording.content):
        fresh = anew(recording, k, rng)
        for i in simulated_session.rows_of(recording, k):
            for key, value in fresh(i).items():
                views[key][i] = value
    return views


def _scan(recording, placement, rng):
    """Function of a row of views: its columns in a scan with noise; the phase is one for all."""
    session = recording.session
    firing, ring = recording.content[placement]
    step = recording.model.azimuth_step
    turn = se3.so3_exp([0.0, 0.0, step * rng.uniform(-0.5, 0.5)])
    firing = firing._replace(beams=firing.beams @ turn.T)
    when = np.array([simulated_session.span(recording, placement)[0]])
    T = {k: np.reshape(v, (-1, 4, 4))[0] for k, v in session.surfaces(when).items()}
    T_world_lidar = session.T_world("robot", when)[0] @ recording.T_robot_sensor
    echoes = scan_scene.scan(session.scene, T, T_world_lidar, firing)
    seen = echoes.returned[:, 0]
    beams, distance = firing.beams[seen, 0], echoes.distance[seen, 0]
    rest = {"ring": ring[seen], "dt": firing.after[seen]}

    def fresh(row):
        ranges = distance + session.args.range_noise_m * rng.standard_normal(len(distance))
        return rest | {"xyz": (beams * ranges[:, None]).astype(np.float32).reshape(-1)}

    return fresh


def _image(recording, placement, rng):
    """Function of a row of views: its columns in an image with noise."""
    views, whole = recording.views, recording.content[placement]
    encoding = recording.session.rig.specs[recording.sensor].encoding
    noise = recording.session.args.image_noise

    def fresh(row):
        height, width = image_messages.from_png(views["png"][row]).shape[:2]
        u, v = views["u0"][row], views["v0"][row]
        region = whole[v : v + height, u : u + width]
        return {"png": image_messages.to_png(camera_exposure.expose(region, encoding, noise, rng))}

    return fresh
