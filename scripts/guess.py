"""Where to look: the first guess of T_robot_sensor, its uncertainty and its source.

Reads   log.json
Writes  guess.json
Decides nothing yet from the data: the rig's own T_robot_sensor comes first, then the log's
/tf_static from the robot body's frame to the frame of the sensor's messages.
"""

import numpy as np

from calib import frames, rig, stage
from calib.stage import logger
from calib.status import OK, InputError, Status, failed


def from_static(audit, body, frame):
    """T_body_frame (4, 4) along the static transforms of the log, or None."""
    edges = {(e["parent"], e["child"]): rig.pose(e["T"]) for e in audit["static"]}
    return frames.chain(edges, body, frame)


def find(options, audit):
    """The guess as (T (4, 4) or None, source, status)."""
    name, sensor = options["name"], options["sensor"]
    heard = audit["sensors"][name]
    status = Status.from_dict(heard["status"])
    if not status.ok:
        return None, "none", status
    if "T_robot_sensor" in sensor:
        return rig.pose(sensor["T_robot_sensor"]), "config", OK
    try:
        T = from_static(audit, options["body"], heard["frame"])
    except InputError as error:
        remedy = f"Mend what publishes it, or write sensors.{name}.T_robot_sensor."
        return None, "none", failed("a static transform of the log is no pose", error, "", remedy)
    if T is not None:
        return T, "tf_static", OK
    status = failed(
        f"no first guess for {name}",
        f"no T_robot_sensor, no static transform from {options['body']} to {heard['frame']}",
        "one of them",
        f"Measure it roughly (5 cm, 5 deg) and write sensors.{name}.T_robot_sensor.",
    )
    return None, "none", status


def main(argv=None):
    args = stage.parser(
        __doc__, audit="input log.json", output="output", options="slice of the config"
    ).parse_args(argv)
    options = args.options
    audit = stage.read_json(args.audit)
    T, source, status = find(options, audit)
    sigma = rig.pose_sigma(options["sensor"].get("guess_sigma", options["guess"]["sigma"]))
    stage.write_json(
        args.output,
        {
            "status": status.to_dict(),
            "T_robot_sensor": None if T is None else rig.pose_json(T),
            "sigma": np.asarray(sigma).tolist(),
            "source": source,
            "frame": audit["sensors"][options["name"]]["frame"],
            "time_offset_s": None,
        },
    )
    logger.info("%s: first guess from %s", options["name"], source if status.ok else status)


if __name__ == "__main__":
    stage.run(main)
