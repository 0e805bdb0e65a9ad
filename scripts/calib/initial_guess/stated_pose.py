"""Where a sensor sits by what the rig or the log states of it."""

from calib.geometry.frame_graph import lookup_transform
from calib.initial_guess.pose_guess import PoseGuess
from calib.io.pose_block import pose_from_config, pose_sigma_from_config
from calib.io.status import InputError, failure_status


def pose_from_static_transforms(static_transforms, body, frame):
    """T_body_frame (4, 4) along static transforms, those of log.json or of a URDF, or None."""
    edges = {(e["parent"], e["child"]): pose_from_config(e["T"]) for e in static_transforms}
    return lookup_transform(edges, body, frame)


def read_pose_guess(sensor_name, sensor, options, audit):
    """(source, Found) of a pose that the rig or the log states, or of none: no pose, status ok."""
    heard = audit["sensors"][sensor_name]
    sigma = pose_sigma_from_config(sensor.get("guess_sigma", options["guess"]["sigma"]))
    given = options.get("given", {}).get(sensor_name, {})
    for source, known in (("config", sensor), (given.get("source"), given)):
        if "T_robot_sensor" in known:
            return source, PoseGuess(pose_from_config(known["T_robot_sensor"]), sigma)
    if given.get("static"):
        T = pose_from_static_transforms(
            given["static"], options["body"], heard["frame"].lstrip("/")
        )
        if T is not None:
            return given["source"], PoseGuess(T, sigma)
    try:
        T = pose_from_static_transforms(audit["static"], options["body"], heard["frame"])
    except InputError as error:
        remedy = f"Mend what publishes it, or write sensors.{sensor_name}.T_robot_sensor."
        status = failure_status("a static transform of the log is no pose", error, "", remedy)
        return "none", PoseGuess(status=status)
    return ("none", PoseGuess()) if T is None else ("tf_static", PoseGuess(T, sigma))
