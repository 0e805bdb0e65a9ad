"""Arrow schemas of all Parquet files: columns, types and units."""

import pyarrow as pa

TEXT = pa.dictionary(pa.int32(), pa.string())


def _vector(n):
    return pa.list_(pa.float64(), n)


def _column(name, type_, **meta):
    return pa.field(name, type_, nullable=False, metadata=meta or None)


def _schema(name, version, *columns):
    return pa.schema(columns, metadata={"table": name, "version": str(version)})


MOCAP = _schema(
    "mocap",
    1,
    _column("body", TEXT),
    _column("t", pa.int64(), unit="ns", meaning="stamp of the message"),
    _column("log_t", pa.int64(), unit="ns", meaning="when the log took it"),
    _column("xyz", _vector(3), unit="m", frame="map"),
    _column("quat", _vector(4), meaning="xyzw of T_map_body"),
    _column("fault", TEXT, meaning="empty when the pose can be used"),
)

FRAMES = _schema(
    "frames",
    1,
    _column("sensor", TEXT),
    _column("t", pa.int64(), unit="ns", meaning="stamp of the message"),
    _column("log_t", pa.int64(), unit="ns", meaning="when the log took it"),
    _column("size", pa.int64(), unit="byte"),
    _column("file", pa.int32(), meaning="index into the files of the log"),
    _column("ordinal", pa.int32(), meaning="among the topic's messages of that file and log_t"),
)

PLACEMENTS = _schema(
    "placements",
    2,
    _column("placement", pa.int32(), meaning="number in the session"),
    _column("target", TEXT),
    _column("kind", TEXT, meaning="still or moving"),
    _column("start", pa.int64(), unit="ns"),
    _column("end", pa.int64(), unit="ns"),
    _column("xyz", _vector(3), unit="m", frame="robot", meaning="of the mean T_robot_body"),
    _column("quat", _vector(4), meaning="xyzw of the mean T_robot_body"),
    _column("samples", pa.int32(), meaning="MCS poses averaged"),
    _column("effective_samples", pa.float64(), meaning="independent ones among them"),
    _column("pose_factor", pa.float64(), meaning="σ of an averaged pose over pose_sigma"),
    _column("covariance", _vector(36), unit="m, rad", meaning="white part, right perturbation"),
    _column("creep", _vector(6), unit="m/s, rad/s", meaning="what is left of motion, body's axes"),
)

_VIEW = (
    _column("view", pa.int32()),
    _column("t", pa.int64(), unit="ns", meaning="stamp of the message"),
    _column("target", TEXT),
    _column("placement", pa.int32()),
    _column("kept", pa.bool_()),
    _column("reason", TEXT, meaning="why not kept"),
)

VIEWS_LIDAR = _schema(
    "views-lidar",
    1,
    *_VIEW,
    _column("xyz", pa.list_(pa.float32()), unit="m", frame="lidar", meaning="flattened (n, 3)"),
    _column("ring", pa.list_(pa.int32()), meaning="beam, -1 where unknown"),
    _column("dt", pa.list_(pa.int64()), unit="ns", meaning="time of the point after t"),
)

VIEWS_CAMERA = _schema(
    "views-camera",
    1,
    *_VIEW,
    _column("u0", pa.int32(), unit="px", meaning="column of the region's first pixel"),
    _column("v0", pa.int32(), unit="px", meaning="row of the region's first pixel"),
    _column("png", pa.binary(), meaning="the region, lossless"),
)

_KEYPOINT = (
    _column("view", pa.int32()),
    _column("t", pa.int64(), unit="ns", meaning="stamp, of the point where it has its own"),
    _column("target", TEXT),
    _column("placement", pa.int32()),
    _column("kind", TEXT, meaning="one of calib.estimation.residuals.residual_registry.KINDS"),
    _column("index", pa.int32(), meaning="corner of the detected grid, ring, or side of a limb"),
    _column("xyz", _vector(3), unit="m", frame="lidar", meaning="point; unit ray of an edge; NaN"),
    _column("uv", _vector(2), unit="px", meaning="NaN for a lidar"),
    _column("sigma", pa.float64(), unit="px, m or rad", meaning="by kind"),
    _column(
        "whiten", _vector(3), meaning="a, b, c: ((a, b), (0, c)) makes errors of (u, v) σ; NaN"
    ),
)

KEYPOINTS = _schema("keypoints", 2, *_KEYPOINT)

PAIRS = _schema(
    "pairs",
    2,
    _column("sensor", TEXT),
    *_KEYPOINT,
    _column("feature", pa.int32(), meaning="corner, edge or template point; -1 not paired"),
)

RESIDUALS = _schema(
    "residuals",
    2,
    _column("session", TEXT),
    _column("sensor", TEXT),
    _column("target", TEXT),
    _column("placement", pa.int32()),
    _column("view", pa.int32(), meaning="of views.parquet; of motion.parquet where moving"),
    _column("moving", pa.bool_(), meaning="a view of a target in motion"),
    _column("speed", pa.float64(), unit="m/s", meaning="of its middle against the robot"),
    _column("kind", TEXT),
    _column("value", _vector(2), unit="px, m or rad", meaning="(u, v), or (distance, 0)"),
    _column("sigma", pa.float64(), unit="px, m or rad"),
    _column("weight", pa.float64(), meaning="of the robust loss; 0 where not a member"),
    _column("measured", _vector(3), unit="px or m", frame="image or target"),
    _column("range", pa.float64(), unit="m"),
    _column("cosine", pa.float64(), meaning="of the angle of incidence"),
    _column("index", pa.int32(), meaning="corner, ring, or side of a limb"),
)

ITERATIONS = _schema(
    "iterations",
    1,
    _column("round", pa.int32()),
    _column("cost", pa.float64()),
    _column("ipopt_iterations", pa.int32()),
    _column("members", pa.int64()),
    _column("step_m", pa.float64(), unit="m", meaning="largest of all sensors"),
    _column("step_rad", pa.float64(), unit="rad", meaning="largest of all sensors"),
    _column("changed", pa.int64(), meaning="measurements that came, went or were re-labelled"),
)
