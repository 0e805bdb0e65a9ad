"""Arrow schemas of all Parquet files: columns, types and units."""

import pyarrow as pa

TEXT_TYPE = pa.dictionary(pa.int32(), pa.string())


def _vector_type(n):
    return pa.list_(pa.float64(), n)


def _make_column(name, type_, **meta):
    return pa.field(name, type_, nullable=False, metadata=meta or None)


def _make_schema(name, version, *columns):
    return pa.schema(columns, metadata={"table": name, "version": str(version)})


MOCAP_SCHEMA = _make_schema(
    "mocap",
    1,
    _make_column("body", TEXT_TYPE),
    _make_column("stamp_ns", pa.int64(), unit="ns", meaning="stamp of the message"),
    _make_column("log_time_ns", pa.int64(), unit="ns", meaning="when the log took it"),
    _make_column("xyz", _vector_type(3), unit="m", frame="map"),
    _make_column("quat", _vector_type(4), meaning="xyzw of T_map_body"),
    _make_column("fault", TEXT_TYPE, meaning="empty when the pose can be used"),
)

FRAMES_SCHEMA = _make_schema(
    "frames",
    1,
    _make_column("sensor", TEXT_TYPE),
    _make_column("stamp_ns", pa.int64(), unit="ns", meaning="stamp of the message"),
    _make_column("log_time_ns", pa.int64(), unit="ns", meaning="when the log took it"),
    _make_column("size", pa.int64(), unit="byte"),
    _make_column("file_index", pa.int32(), meaning="index into the files of the log"),
    _make_column(
        "index_at_log_time", pa.int32(), meaning="among the topic's messages of that file and log_t"
    ),
)

PLACEMENTS_SCHEMA = _make_schema(
    "placements",
    2,
    _make_column("placement", pa.int32(), meaning="number in the session"),
    _make_column("target", TEXT_TYPE),
    _make_column("kind", TEXT_TYPE, meaning="still or moving"),
    _make_column("start_ns", pa.int64(), unit="ns"),
    _make_column("end_ns", pa.int64(), unit="ns"),
    _make_column(
        "xyz", _vector_type(3), unit="m", frame="robot", meaning="of the mean T_robot_body"
    ),
    _make_column("quat", _vector_type(4), meaning="xyzw of the mean T_robot_body"),
    _make_column("samples", pa.int32(), meaning="MCS poses averaged"),
    _make_column("effective_samples", pa.float64(), meaning="independent ones among them"),
    _make_column(
        "mean_pose_sigma_factor", pa.float64(), meaning="σ of an averaged pose over pose_sigma"
    ),
    _make_column(
        "covariance", _vector_type(36), unit="m, rad", meaning="white part, right perturbation"
    ),
    _make_column(
        "residual_drift",
        _vector_type(6),
        unit="m/s, rad/s",
        meaning="what is left of motion, body's axes",
    ),
)

_VIEW_COLUMNS = (
    _make_column("view", pa.int32()),
    _make_column("stamp_ns", pa.int64(), unit="ns", meaning="stamp of the message"),
    _make_column("target", TEXT_TYPE),
    _make_column("placement", pa.int32()),
    _make_column("kept", pa.bool_()),
    _make_column("reason", TEXT_TYPE, meaning="why not kept"),
)

LIDAR_VIEWS_SCHEMA = _make_schema(
    "views-lidar",
    1,
    *_VIEW_COLUMNS,
    _make_column(
        "xyz", pa.list_(pa.float32()), unit="m", frame="lidar", meaning="flattened (n, 3)"
    ),
    _make_column("ring", pa.list_(pa.int32()), meaning="beam, -1 where unknown"),
    _make_column(
        "point_time_ns", pa.list_(pa.int64()), unit="ns", meaning="time of the point after t"
    ),
)

CAMERA_VIEWS_SCHEMA = _make_schema(
    "views-camera",
    1,
    *_VIEW_COLUMNS,
    _make_column("u0", pa.int32(), unit="px", meaning="column of the region's first pixel"),
    _make_column("v0", pa.int32(), unit="px", meaning="row of the region's first pixel"),
    _make_column("png", pa.binary(), meaning="the region, lossless"),
)

_KEYPOINT_COLUMNS = (
    _make_column("view", pa.int32()),
    _make_column(
        "stamp_ns", pa.int64(), unit="ns", meaning="stamp, of the point where it has its own"
    ),
    _make_column("target", TEXT_TYPE),
    _make_column("placement", pa.int32()),
    _make_column(
        "kind", TEXT_TYPE, meaning="one of calib.estimation.residuals.residual_registry.KINDS"
    ),
    _make_column(
        "feature_index", pa.int32(), meaning="corner of the detected grid, ring, or side of a limb"
    ),
    _make_column(
        "xyz", _vector_type(3), unit="m", frame="lidar", meaning="point; unit ray of an edge; NaN"
    ),
    _make_column("uv", _vector_type(2), unit="px", meaning="NaN for a lidar"),
    _make_column("sigma", pa.float64(), unit="px, m or rad", meaning="by kind"),
    _make_column(
        "whitening",
        _vector_type(3),
        meaning="a, b, c: ((a, b), (0, c)) makes errors of (u, v) σ; NaN",
    ),
)

KEYPOINTS_SCHEMA = _make_schema("keypoints", 2, *_KEYPOINT_COLUMNS)

PAIRS_SCHEMA = _make_schema(
    "pairs",
    2,
    _make_column("sensor", TEXT_TYPE),
    *_KEYPOINT_COLUMNS,
    _make_column(
        "candidate_feature", pa.int32(), meaning="corner, edge or template point; -1 not paired"
    ),
)

RESIDUALS_SCHEMA = _make_schema(
    "residuals",
    2,
    _make_column("session", TEXT_TYPE),
    _make_column("sensor", TEXT_TYPE),
    _make_column("target", TEXT_TYPE),
    _make_column("placement", pa.int32()),
    _make_column(
        "view", pa.int32(), meaning="of views.parquet; of moving_views.parquet where moving"
    ),
    _make_column("is_moving", pa.bool_(), meaning="a view of a target in motion"),
    _make_column("speed_mps", pa.float64(), unit="m/s", meaning="of its middle against the robot"),
    _make_column("kind", TEXT_TYPE),
    _make_column("value", _vector_type(2), unit="px, m or rad", meaning="(u, v), or (distance, 0)"),
    _make_column("sigma", pa.float64(), unit="px, m or rad"),
    _make_column("weight", pa.float64(), meaning="of the robust loss; 0 where not a member"),
    _make_column("measured", _vector_type(3), unit="px or m", frame="image or target"),
    _make_column("range_m", pa.float64(), unit="m"),
    _make_column("cos_incidence", pa.float64(), meaning="of the angle of incidence"),
    _make_column("feature_index", pa.int32(), meaning="corner, ring, or side of a limb"),
)

ITERATIONS_SCHEMA = _make_schema(
    "iterations",
    1,
    _make_column("round", pa.int32()),
    _make_column("cost", pa.float64()),
    _make_column("ipopt_iterations", pa.int32()),
    _make_column("n_inliers", pa.int64()),
    _make_column("step_m", pa.float64(), unit="m", meaning="largest of all sensors"),
    _make_column("step_rad", pa.float64(), unit="rad", meaning="largest of all sensors"),
    _make_column(
        "n_reassigned", pa.int64(), meaning="measurements that came, went or were re-labelled"
    ),
)
