"""Where a sensor sits by what the rig or the log states of it."""

from calib.geometry import frame_graph
from calib.initial_guess.pose_guess import Found
from calib.io import pose_block
from calib.io.status import InputError, failed


def from_static(static, body, frame):
    """T_body_frame (4, 4) along static transforms, those of log.json or of a URDF, or None."""
    edges = {(e["parent"], e["child"]): pose_block.pose(e["T"]) for e in static}
    return frame_graph.chain(edges, body, frame)


def stated(name, sensor, options, audit):
    """(source, Found) of a pose that the rig or the log states, or of none: no pose, status ok."""
    heard = audit["sensors"][name]
    sigma = pose_block.pose_sigma(sensor.get("guess_sigma", options["guess"]["sigma"]))
    given = options.get("given", {}).get(name, {})
    for source, known in (("config", sensor), (given.get("source"), given)):
        if "T_robot_sensor" in known:
            return source, Found(pose_block.pose(known["T_robot_sensor"]), sigma)
    if given.get("static"):
        T = from_static(given["static"], options["body"], heard["frame"].lstrip("/"))
        if T is not None:
            return given["source"], Found(T, sigma)
    try:
        T = from_static(audit["static"], options["body"], heard["frame"])
    except InputError as error:
        remedy = f"Mend what publishes it, or write sensors.{name}.T_robot_sensor."
        status = failed("a static transform of the log is no pose", error, "", remedy)
        return "none", Found(status=status)
    return ("none", Found()) if T is None else ("tf_static", Found(T, sigma))
