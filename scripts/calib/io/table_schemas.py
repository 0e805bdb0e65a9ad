"""Arrow schemas of all Parquet files: columns, types, units and meanings."""

import pyarrow as pa

TEXT_TYPE = pa.dictionary(pa.int32(), pa.string())


def _vector_type(n: int) -> pa.DataType:
    return pa.list_(pa.float64(), n)


def _make_column(name: str, type_: pa.DataType, **metadata: str) -> pa.Field:
    return pa.field(name, type_, nullable=False, metadata=metadata or None)


def _make_schema(name: str, version: int, *columns: pa.Field) -> pa.Schema:
    return pa.schema(columns, metadata={"table": name, "version": str(version)})


MOCAP_SCHEMA = _make_schema(
    "mocap",
    1,
    _make_column("body", TEXT_TYPE),
    _make_column("stamp_ns", pa.int64(), unit="ns", meaning="stamp of the message"),
    _make_column("log_time_ns", pa.int64(), unit="ns", meaning="when the log recorded the message"),
    _make_column("xyz", _vector_type(3), unit="m", frame="map"),
    _make_column("quat", _vector_type(4), meaning="xyzw of T_map_body"),
    _make_column("fault", TEXT_TYPE, meaning="name of the fault; empty if the pose can be used"),
)

FRAMES_SCHEMA = _make_schema(
    "frames",
    1,
    _make_column("sensor", TEXT_TYPE),
    _make_column("stamp_ns", pa.int64(), unit="ns", meaning="stamp of the message"),
    _make_column("log_time_ns", pa.int64(), unit="ns", meaning="when the log recorded the message"),
    _make_column("size", pa.int64(), unit="byte"),
    _make_column("file_index", pa.int32(), meaning="index into the files of the log"),
    _make_column(
        "index_at_log_time",
        pa.int32(),
        meaning="among the topic's messages of that file and log time",
    ),
)

PLACEMENTS_SCHEMA = _make_schema(
    "placements",
    3,
    _make_column("placement", pa.int32(), meaning="number in the session"),
    _make_column("target", TEXT_TYPE),
    _make_column("kind", TEXT_TYPE, meaning="still or moving"),
    _make_column("start_ns", pa.int64(), unit="ns"),
    _make_column("end_ns", pa.int64(), unit="ns"),
    _make_column("xyz", _vector_type(3), unit="m", frame="robot", meaning="mean T_robot_body"),
    _make_column("quat", _vector_type(4), meaning="xyzw of mean T_robot_body"),
    _make_column("samples", pa.int32(), meaning="number of averaged MCS poses"),
    _make_column(
        "effective_samples", pa.float64(), meaning="number of independent poses among them"
    ),
    _make_column(
        "mean_pose_sigma_factor", pa.float64(), meaning="σ of the averaged pose / pose_sigma"
    ),
    _make_column(
        "covariance", _vector_type(36), unit="m, rad", meaning="white noise, right perturbation"
    ),
    _make_column(
        "residual_drift",
        _vector_type(6),
        unit="m/s, rad/s",
        meaning="residual motion, axes of the body",
    ),
    *(
        _make_column(f"{name}_slow_{quantity}", _vector_type(6), unit=unit, meaning=meaning)
        for name in ("robot", "body")
        for quantity, unit, meaning in (
            ("sigma", "m, rad", "σ that slow noise leaves in the mean pose, 0 where not used"),
            ("time_s", "s", "time constant of the slow noise"),
        )
    ),
)

_VIEW_COLUMNS = (
    _make_column("view", pa.int32()),
    _make_column("stamp_ns", pa.int64(), unit="ns", meaning="stamp of the message"),
    _make_column("target", TEXT_TYPE),
    _make_column("placement", pa.int32()),
    _make_column("kept", pa.bool_()),
    _make_column("reason", TEXT_TYPE, meaning="why it is not kept"),
)

LIDAR_VIEWS_SCHEMA = _make_schema(
    "views-lidar",
    2,
    *_VIEW_COLUMNS,
    _make_column(
        "xyz", pa.list_(pa.float32()), unit="m", frame="lidar", meaning="flattened (n, 3)"
    ),
    _make_column("ring", pa.list_(pa.int32()), meaning="beam; -1 if unknown"),
    _make_column(
        "point_time_ns",
        pa.list_(pa.int64()),
        unit="ns",
        meaning="time of the point after the stamp",
    ),
    _make_column(
        "intensity", pa.list_(pa.float32()), meaning="as the cloud has it; NaN if it has none"
    ),
)

CAMERA_VIEWS_SCHEMA = _make_schema(
    "views-camera",
    1,
    *_VIEW_COLUMNS,
    _make_column("u0", pa.int32(), unit="px", meaning="image column of the region's first pixel"),
    _make_column("v0", pa.int32(), unit="px", meaning="image row of the region's first pixel"),
    _make_column("png", pa.binary(), meaning="image region, lossless"),
)

_KEYPOINT_COLUMNS = (
    _make_column("view", pa.int32()),
    _make_column(
        "stamp_ns",
        pa.int64(),
        unit="ns",
        meaning="stamp of the point if it has one, else of the message",
    ),
    _make_column("target", TEXT_TYPE),
    _make_column("placement", pa.int32()),
    _make_column(
        "kind", TEXT_TYPE, meaning="one of calib.estimation.residuals.residual_registry.KINDS"
    ),
    _make_column(
        "feature_index",
        pa.int32(),
        meaning="corner of the detected grid, ring, or side of a cylinder",
    ),
    _make_column(
        "xyz",
        _vector_type(3),
        unit="m",
        frame="lidar",
        meaning="point, or unit ray of an outline crossing; NaN for a camera",
    ),
    _make_column("uv", _vector_type(2), unit="px", meaning="NaN for a lidar"),
    _make_column("sigma", pa.float64(), unit="px, m or rad", meaning="unit by kind"),
    _make_column(
        "whitening",
        _vector_type(3),
        meaning="a, b, c: ((a, b), (0, c)) (du, dv) has errors of one sigma; NaN for a lidar",
    ),
    _make_column("intensity", pa.float64(), meaning="of a return; NaN if unknown"),
)

KEYPOINTS_SCHEMA = _make_schema("keypoints", 3, *_KEYPOINT_COLUMNS)

PAIRS_SCHEMA = _make_schema(
    "pairs",
    4,
    _make_column("sensor", TEXT_TYPE),
    *_KEYPOINT_COLUMNS,
    _make_column(
        "candidate_feature",
        pa.int32(),
        meaning="corner, edge or template point; -1 if not assigned",
    ),
    _make_column(
        "residual",
        _vector_type(2),
        unit="px, m or rad",
        meaning="at the initial guess: (u, v), or (distance, 0)",
    ),
    _make_column(
        "standardized_residual",
        pa.float64(),
        meaning="length of the residual in σ, at the noise from which solve starts",
    ),
    _make_column("is_inlier", pa.bool_(), meaning="in the gate there, and used"),
)

RESIDUALS_SCHEMA = _make_schema(
    "residuals",
    2,
    _make_column("session", TEXT_TYPE),
    _make_column("sensor", TEXT_TYPE),
    _make_column("target", TEXT_TYPE),
    _make_column("placement", pa.int32()),
    _make_column(
        "view", pa.int32(), meaning="in views.parquet, or in moving_views.parquet if moving"
    ),
    _make_column("is_moving", pa.bool_(), meaning="view of a moving target"),
    _make_column(
        "speed_mps",
        pa.float64(),
        unit="m/s",
        meaning="of the target's centre relative to the robot",
    ),
    _make_column("kind", TEXT_TYPE),
    _make_column(
        "value", _vector_type(2), unit="px, m or rad", meaning="residual: (u, v), or (distance, 0)"
    ),
    _make_column("sigma", pa.float64(), unit="px, m or rad"),
    _make_column("weight", pa.float64(), meaning="of the robust loss; 0 if not an inlier"),
    _make_column("measured", _vector_type(3), unit="px or m", frame="image or target"),
    _make_column("range_m", pa.float64(), unit="m"),
    _make_column("cos_incidence", pa.float64(), meaning="cosine of the angle of incidence"),
    _make_column("feature_index", pa.int32(), meaning="corner, ring, or side of a cylinder"),
)

ITERATIONS_SCHEMA = _make_schema(
    "iterations",
    1,
    _make_column("round", pa.int32()),
    _make_column("cost", pa.float64()),
    _make_column("ipopt_iterations", pa.int32()),
    _make_column("n_inliers", pa.int64()),
    _make_column("step_m", pa.float64(), unit="m", meaning="largest step of all sensors"),
    _make_column("step_rad", pa.float64(), unit="rad", meaning="largest step of all sensors"),
    _make_column(
        "n_reassigned",
        pa.int64(),
        meaning="measurements added, removed or assigned to another feature",
    ),
)
