"""When a target is still relative to the robot, and when it moves.

Reads   mocap.parquet, log.json
Writes  placements.parquet: maximal still intervals per target, trimmed at both ends, with the mean
        T_robot_body over the interval and its covariance; and the intervals between, marked moving
Decides by linear and angular speed over a window, from the MCS alone.
"""

import numpy as np

from calib.geometry import se3
from calib.io import parquet_tables, pose_block, stage_cli, table_schemas
from calib.io.stage_cli import logger
from calib.io.status import OK, Status, failed
from calib.mocap import body_trajectory, stillness


def averaged(relative, span, sigma):
    """Mean pose of a span (start, end), ns, and how far it can be trusted, as columns."""
    rows = (relative.t >= span[0]) & (relative.t <= span[1])
    mean, xi = se3.mean(relative.T[rows])
    prior = white_covariance(mean, sigma)
    scatter = max(1.0, np.sqrt(np.mean(np.sum(xi * np.linalg.solve(prior, xi.T).T, 1)) / 6))
    independent = stillness.effective_samples(xi)
    factor = scatter / np.sqrt(independent)
    return {
        "xyz": mean[:3, 3],
        "quat": se3.to_quat(mean),
        "samples": int(rows.sum()),
        "effective_samples": independent,
        "pose_factor": factor,
        "covariance": (factor**2 * prior).reshape(-1),
        "creep": stillness.creep(relative.t[rows], xi),
    }


def white_covariance(T_robot_body, sigma):
    """(6, 6) of one T_robot_body when both bodies' poses err by sigma (6,)."""
    A = se3.adjoint(se3.inverse(T_robot_body))
    return np.diag(sigma**2) + A @ np.diag(sigma**2) @ A.T


def at_middle(relative, span):
    """The pose nearest the middle of a moving span, as columns: not averaged, not to be trusted."""
    T = relative.T[np.abs(relative.t - (span[0] + (span[1] - span[0]) // 2)).argmin()]
    return {
        "xyz": T[:3, 3],
        "quat": se3.to_quat(T),
        "samples": 1,
        "effective_samples": 1.0,
        "pose_factor": 1.0,
        "covariance": np.zeros(36),
        "creep": np.zeros(6),
    }


def between(spans, t):
    """(k, 2) what lies between spans, from the first to the last of the times t."""
    if len(t) == 0:
        return np.zeros((0, 2), np.int64)
    edges = np.concatenate([[t[0]], spans.reshape(-1), [t[-1]]]).reshape(-1, 2)
    return edges[edges[:, 1] > edges[:, 0]]


def rows_of(target, relative, options, sigma):
    """Rows of one target, in order of time."""
    still = stillness.still_intervals(
        relative,
        options["window_s"],
        options["max_linear_mps"],
        np.radians(options["max_angular_dps"]),
        options["trim_s"],
        options["min_duration_s"],
    )
    rows = [("still", s, averaged(relative, s, sigma)) for s in still]
    rows += [("moving", s, at_middle(relative, s)) for s in between(still, relative.t)]
    head = [{"target": target, "kind": k, "start": s[0], "end": s[1]} for k, s, _ in rows]
    merged = [h | r[2] for h, r in zip(head, rows, strict=True)]
    return sorted(merged, key=lambda r: r["start"])


def main(argv=None):
    args = stage_cli.parser(
        __doc__, mocap="input", audit="input", output="output", options="slice of the config"
    ).parse_args(argv)
    options = args.options
    columns, _, _ = parquet_tables.read(args.mocap, table_schemas.MOCAP)
    audit = stage_cli.read_json(args.audit)["bodies"]
    sigma = pose_block.pose_sigma(options["mocap"]["pose_sigma"])
    gap = options["mocap"]["max_gap_s"]
    robot = body_trajectory.trajectory(columns, options["body"], gap)
    rows, notes = [], {}
    for target, body in sorted(options["targets"].items()):
        relative = body_trajectory.relative(robot, body_trajectory.trajectory(columns, body, gap))
        found = rows_of(target, relative, options["gate"], sigma)
        still = [r for r in found if r["kind"] == "still"]
        rows += found
        notes[target] = target_status(audit, options["body"], body, still).to_dict()
        logger.info("%s: %d still intervals of %d", target, len(still), len(found))
    status = Status.from_dict(audit[options["body"]]["status"])
    # The number of an interval is its row: the still ones come first, as people count them.
    rows.sort(key=lambda r: r["kind"] != "still")
    table = {k: [r[k] for r in rows] for k in table_schemas.PLACEMENTS.names if k != "placement"}
    table["placement"] = np.arange(len(rows))
    parquet_tables.write(args.output, table_schemas.PLACEMENTS, table, status, notes)


def target_status(audit, robot, body, still):
    """Why a target has no still interval, or ok."""
    for name in (robot, body):
        status = Status.from_dict(audit[name]["status"])
        if not status.ok:
            return status
    if not still:
        return failed(
            f"{body} is never still relative to {robot}",
            "0 still intervals",
            "1 or more",
            "Hold the target still for a second, or raise gate.max_linear_mps.",
        )
    return OK


if __name__ == "__main__":
    stage_cli.run(main)
