"""The same small recording in every container, with every type of motion capture.

A recording is rows (log time in ns, topic, type, message of ROS 2).
"""

import shutil
import sqlite3

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from calib.decoding.body_tracks import build_mocap_columns
from calib.decoding.decoded_log import build_frame_columns, decode_log, infer_stream_clocks
from calib.geometry.se3 import make_pose, pose_to_quat, se3_exp
from calib.io.logs.open_log import open_log
from calib.io.logs.ros_messages import CLOUD_TYPE, IMAGE_TYPE, TF_TYPE, make_tf_message
from decode import DecodedTables, build_log_audit
from simulation.ros_log import convert_to_ros1, write_rosbags_log

NS_PER_MS = 1_000_000
CONTAINER_START_NS = 1_700_000_000_000_000_000
MAP_FRAME, ROBOT_BODY, BOARD_BODY = "world", "robot", "board"
MARKER_DEFINITION = "int64 index\ngeometry_msgs/Point translation"
BODY_DEFINITION = "string rigid_body_name\nmocap4r2_msgs/Marker[] markers\ngeometry_msgs/Pose pose"
CUSTOM_DEFINITIONS = {
    "mocap4r2_msgs/msg/Marker": MARKER_DEFINITION,
    "mocap4r2_msgs/msg/RigidBody": BODY_DEFINITION,
    "mocap4r2_msgs/msg/RigidBodies": "std_msgs/Header header\nuint32 frame_number\n"
    "mocap4r2_msgs/RigidBody[] rigidbodies",
    "motion_capture_tracking_interfaces/msg/NamedPose": "string name\ngeometry_msgs/Pose pose",
    "motion_capture_tracking_interfaces/msg/NamedPoseArray": "std_msgs/Header header\n"
    "motion_capture_tracking_interfaces/NamedPose[] poses",
    "vicon_receiver/msg/Position": "float32 x_trans\nfloat32 y_trans\nfloat32 z_trans\n"
    "float32 x_rot\nfloat32 y_rot\nfloat32 z_rot\nfloat32 w\nstring segment_name\n"
    "string subject_name\nint32 frame_number\nstring translation_type",
    "velodyne_msgs/msg/VelodynePacket": "builtin_interfaces/Time stamp\nuint8[1206] data",
    "velodyne_msgs/msg/VelodyneScan": "std_msgs/Header header\n"
    "velodyne_msgs/VelodynePacket[] packets",
    "foxglove_msgs/msg/PackedElementField": "string name\nuint32 offset\nuint8 type",
    "foxglove_msgs/msg/PointCloud": "builtin_interfaces/Time timestamp\nstring frame_id\n"
    "geometry_msgs/Pose pose\nuint32 point_stride\nfoxglove_msgs/PackedElementField[] fields\n"
    "uint8[] data",
    "foxglove_msgs/msg/RawImage": "builtin_interfaces/Time timestamp\nstring frame_id\n"
    "uint32 width\nuint32 height\nstring encoding\nuint32 step\nuint8[] data",
    "foxglove_msgs/msg/CompressedImage": "builtin_interfaces/Time timestamp\nstring frame_id\n"
    "uint8[] data\nstring format",
    "livox_ros_driver2/msg/CustomPoint": "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\n"
    "uint8 reflectivity\nuint8 tag\nuint8 line",
    "livox_ros_driver2/msg/CustomMsg": "std_msgs/Header header\nuint64 timebase\n"
    "uint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\nlivox_ros_driver2/CustomPoint[] points",
    "foxglove_msgs/msg/CompressedVideo": "builtin_interfaces/Time timestamp\nstring frame_id\n"
    "uint8[] data\nstring format",
}


def _make_type_store(ros_store):
    store = get_typestore(ros_store)
    types = {}
    for name, text in CUSTOM_DEFINITIONS.items():
        if ros_store == Stores.ROS1_NOETIC:
            text = text.replace("builtin_interfaces/Time", "time")
        types |= get_types_from_msg(text, name)
    store.register(types)
    return store


ROS2_TYPES, ROS1_TYPES = _make_type_store(Stores.ROS2_HUMBLE), _make_type_store(Stores.ROS1_NOETIC)
ROS1_TYPES.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF_TYPE))


def make_ros2_message(name, /, **fields):
    """A message of ROS 2."""
    return ROS2_TYPES.types[name](**fields)


# --- what is recorded


def make_body_tracks(n=20, hz=100):
    """Stamps (n,), ns, and poses (n, 4, 4) by body: both move, and turn, smoothly."""
    t = CONTAINER_START_NS + np.arange(n) * (1_000_000_000 // hz)
    s = (np.arange(n) / hz)[:, None]
    robot = make_pose(t=[0.5, -0.2, 0.1]) @ se3_exp(s * [0.3, 0.1, 0, 0, 0, 0.4])
    board = make_pose(t=[2.0, 0.5, 1.0]) @ se3_exp(s * [0.1, 0.2, -0.1, 0.3, 0, 0.1])
    return t, {ROBOT_BODY: robot, BOARD_BODY: board}


def make_stamped_header(t, frame=MAP_FRAME):
    """A header stamped t, ns."""
    stamp = make_ros2_message(
        "builtin_interfaces/msg/Time", sec=int(t // 10**9), nanosec=int(t % 10**9)
    )
    return make_ros2_message("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def make_ros_pose(T):
    """A geometry_msgs/Pose."""
    x, y, z, w = pose_to_quat(T).tolist()
    position = make_ros2_message(
        "geometry_msgs/msg/Point", **dict(zip("xyz", T[:3, 3].tolist(), strict=True))
    )
    turn = make_ros2_message("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
    return make_ros2_message("geometry_msgs/msg/Pose", position=position, orientation=turn)


def make_tf_rows(t, poses):
    """All bodies in one TFMessage."""
    return [("/tf", TF_TYPE, make_tf_message(t, MAP_FRAME, poses))]


def make_rows_per_body(message_type, make_message):
    """A function that gives a message of one type for each body, on a topic of its own."""
    return lambda t, poses: [
        (f"/mocap/{b}", message_type, make_message(t, b, T)) for b, T in poses.items()
    ]


def _transform_message(t, body, T):
    return make_tf_message(t, MAP_FRAME, {body: T}).transforms[0]


def _pose_stamped_message(t, body, T):
    return make_ros2_message(
        "geometry_msgs/msg/PoseStamped", header=make_stamped_header(t), pose=make_ros_pose(T)
    )


def _pose_with_covariance(T):
    return make_ros2_message(
        "geometry_msgs/msg/PoseWithCovariance", pose=make_ros_pose(T), covariance=np.zeros(36)
    )


def _pose_covariance_stamped(t, body, T):
    name = "geometry_msgs/msg/PoseWithCovarianceStamped"
    return make_ros2_message(name, header=make_stamped_header(t), pose=_pose_with_covariance(T))


def _odometry_message(t, body, T):
    zero = make_ros2_message("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    twist = make_ros2_message("geometry_msgs/msg/Twist", linear=zero, angular=zero)
    twist = make_ros2_message(
        "geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)
    )
    name = "nav_msgs/msg/Odometry"
    return make_ros2_message(
        name,
        header=make_stamped_header(t),
        child_frame_id=body,
        pose=_pose_with_covariance(T),
        twist=twist,
    )


def _vicon_position_message(t, body, T):
    x, y, z, w = pose_to_quat(T).tolist()
    mm = dict(zip(("x_trans", "y_trans", "z_trans"), (1000 * T[:3, 3]).tolist(), strict=True))
    names = {"segment_name": body, "subject_name": body, "translation_type": "Global"}
    turn = {"x_rot": x, "y_rot": y, "z_rot": z, "w": w}
    return make_ros2_message("vicon_receiver/msg/Position", **mm, **turn, **names, frame_number=1)


def make_rigid_bodies_rows(t, poses):
    """All bodies in one message of mocap4r2."""
    body, name = "mocap4r2_msgs/msg/RigidBody", "mocap4r2_msgs/msg/RigidBodies"
    found = [
        make_ros2_message(body, rigid_body_name=b, markers=[], pose=make_ros_pose(T))
        for b, T in poses.items()
    ]
    return [
        (
            "/bodies",
            name,
            make_ros2_message(
                name, header=make_stamped_header(t), frame_number=1, rigidbodies=found
            ),
        )
    ]


def make_named_poses_rows(t, poses):
    """All bodies in one message of motion_capture_tracking."""
    package = "motion_capture_tracking_interfaces/msg/"
    found = [
        make_ros2_message(package + "NamedPose", name=b, pose=make_ros_pose(T))
        for b, T in poses.items()
    ]
    name = package + "NamedPoseArray"
    return [("/poses", name, make_ros2_message(name, header=make_stamped_header(t), poses=found))]


# messages at t, ns, of poses by body; `mocap.topics`; names of robot and board as the log has them
BODIES_BY_TOPIC = {f"/mocap/{b}": b for b in (ROBOT_BODY, BOARD_BODY)}
MOCAP_TYPES = {
    "TFMessage": (make_tf_rows, ["/tf"], (ROBOT_BODY, BOARD_BODY)),
    "TransformStamped": (
        make_rows_per_body("geometry_msgs/msg/TransformStamped", _transform_message),
        list(BODIES_BY_TOPIC),
        (ROBOT_BODY, BOARD_BODY),
    ),
    "PoseStamped": (
        make_rows_per_body("geometry_msgs/msg/PoseStamped", _pose_stamped_message),
        BODIES_BY_TOPIC,
        (ROBOT_BODY, BOARD_BODY),
    ),
    "PoseStamped, bodies by topic": (
        make_rows_per_body("geometry_msgs/msg/PoseStamped", _pose_stamped_message),
        list(BODIES_BY_TOPIC),
        tuple(BODIES_BY_TOPIC),
    ),
    "PoseWithCovarianceStamped": (
        make_rows_per_body("geometry_msgs/msg/PoseWithCovarianceStamped", _pose_covariance_stamped),
        BODIES_BY_TOPIC,
        (ROBOT_BODY, BOARD_BODY),
    ),
    "Odometry": (
        make_rows_per_body("nav_msgs/msg/Odometry", _odometry_message),
        list(BODIES_BY_TOPIC),
        (ROBOT_BODY, BOARD_BODY),
    ),
    "RigidBodies": (make_rigid_bodies_rows, {"/bodies": None}, (ROBOT_BODY, BOARD_BODY)),
    "NamedPoseArray": (make_named_poses_rows, ["/poses"], (ROBOT_BODY, BOARD_BODY)),
    "Position": (
        make_rows_per_body("vicon_receiver/msg/Position", _vicon_position_message),
        list(BODIES_BY_TOPIC),
        ("robot/robot", "board/board"),
    ),
}


def make_small_image(t):
    """A small Image."""
    pixels = np.arange(24, dtype=np.uint8)
    fields = {"height": 2, "width": 4, "encoding": "bgr8", "is_bigendian": 0, "step": 12}
    return make_ros2_message(
        IMAGE_TYPE, header=make_stamped_header(t, "camera"), **fields, data=pixels
    )


def make_small_cloud(t):
    """A small PointCloud2."""
    fields = [
        make_ros2_message("sensor_msgs/msg/PointField", name=k, offset=4 * i, datatype=7, count=1)
        for i, k in enumerate("xyz")
    ]
    data = np.arange(15, dtype=np.float32).view(np.uint8)
    shape = {"height": 1, "width": 5, "point_step": 12, "row_step": 60}
    flags = {"is_bigendian": False, "is_dense": True}
    return make_ros2_message(
        CLOUD_TYPE,
        header=make_stamped_header(t, "lidar"),
        fields=fields,
        data=data,
        **shape,
        **flags,
    )


def make_container_rows(mocap_type, n=20):
    """Rows of a recording with motion capture of a kind of TYPES, a camera and a lidar."""
    say, _, _ = MOCAP_TYPES[mocap_type]
    t, poses = make_body_tracks(n)
    rows = []
    for i, now in enumerate(t.tolist()):
        said = say(now, {body: T[i] for body, T in poses.items()})
        rows += [(now + 2 * NS_PER_MS + k, *message) for k, message in enumerate(said)]
        if i % 3 == 0:
            rows.append((now + 5 * NS_PER_MS, "/image", IMAGE_TYPE, make_small_image(now)))
            rows.append((now + 6 * NS_PER_MS, "/points", CLOUD_TYPE, make_small_cloud(now)))
    return rows


def container_decode_options(mocap_type):
    """What decode is given for it."""
    _, topics, names = MOCAP_TYPES[mocap_type]
    sensors = {
        "camera": {"kind": "camera", "topic": "/image"},
        "lidar": {"kind": "lidar", "topic": "/points"},
    }
    mocap = {
        "topics": topics,
        "map": MAP_FRAME,
        "max_gap_s": 0.05,
        "unit": "auto",
        "quaternions": "auto",
    }
    span = {"from_s": None, "to_s": None}
    return {"sensors": sensors, "mocap": mocap, "bodies": sorted(names), "fingerprint": [], **span}


# --- containers


def serialize_cdr(name, message):
    return bytes(ROS2_TYPES.serialize_cdr(message, name))


def write_test_mcap(
    path, rows, serialise=serialize_cdr, message_encoding=("cdr", "ros2msg", 2), **options
):
    """One MCAP file."""
    options = {"chunk_size": 2000, "compression": CompressionType.ZSTD} | options
    with open(path, "wb") as stream:
        writer = Writer(stream, **options)
        writer.start(profile="ros2", library="test")
        schemas, channels = {}, {}
        for log_t, topic, name, message in rows:
            if name not in schemas:
                store = ROS2_TYPES if message_encoding[2] == 2 else ROS1_TYPES
                text = store.generate_msgdef(name, ros_version=message_encoding[2])[0].encode()
                schemas[name] = writer.register_schema(name, message_encoding[1], text)
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, message_encoding[0], schemas[name])
            writer.add_message(channels[topic], log_t, serialise(name, message), log_t)
        writer.finish()
    return path


def serialize_ros1(name, message):
    """A message serialised as in ROS 1."""
    return bytes(ROS1_TYPES.serialize_ros1(convert_to_ros1(message, ROS1_TYPES), name))


def write_ros1_mcap(path, rows):
    """An MCAP of messages of ROS 1."""
    return write_test_mcap(path, rows, serialize_ros1, ("ros1", "ros1msg", 1))


def write_rosbag2(folder, rows, plugin, compression=CompressionMode.NONE):
    """A folder as `ros2 bag record` makes it."""
    writer = Rosbag2Writer(folder, version=9, storage_plugin=plugin)
    if compression != CompressionMode.NONE:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    write_rosbags_log(writer, rows, ROS2_TYPES, serialize_cdr)
    return folder


def write_ros1_bag(path, rows, compression=None):
    """A bag of ROS 1."""
    writer = BagWriter(path)
    writer.chunk_threshold = 2000
    if compression:
        writer.set_compression(compression)
    write_rosbags_log(writer, rows, ROS1_TYPES, serialize_ros1)
    return path


def drop_message_definitions(folder):
    """The SQLite file of a rosbag2 folder as Humble and older write it, alone."""
    (path,) = folder.glob("*.db3")
    connection = sqlite3.connect(path)
    connection.executescript(
        "DROP TABLE message_definitions; UPDATE schema SET schema_version = 3;"
    )
    connection.close()
    return path


def write_split_mcap(folder, rows):
    """Two MCAP files in a folder, which its metadata names."""
    folder.mkdir()
    half = len(rows) // 2
    write_test_mcap(folder / "bag_0.mcap", rows[:half])
    write_test_mcap(folder / "bag_1.mcap", rows[half:])
    names = "".join(f"    - bag_{i}.mcap\n" for i in range(2))
    text = f"rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n{names}"
    (folder / "metadata.yaml").write_text(text)
    return folder


def write_two_recorders(folder, rows):
    """A list of two MCAP files: motion capture and sensors, recorded at once by two recorders."""
    sensors = [r for r in rows if r[1] in ("/image", "/points")]
    mocap = [r for r in rows if r not in sensors]
    folder.mkdir()
    return [
        write_test_mcap(folder / "mocap.mcap", mocap),
        write_test_mcap(folder / "sensors.mcap", sensors),
    ]


def extract_sqlite_file(folder):
    """The SQLite file of a rosbag2 folder, alone."""
    (path,) = folder.glob("*.db3")
    return shutil.copy(path, folder.with_suffix(".db3"))


SQLITE_PLUGIN, MCAP_PLUGIN = StoragePlugin.SQLITE3, StoragePlugin.MCAP
MESSAGE_COMPRESSION, FILE_COMPRESSION = CompressionMode.MESSAGE, CompressionMode.FILE
Ros1Compression = BagWriter.CompressionFormat
LOG_CONTAINERS = {
    "mcap, zstd": lambda p, rows: write_test_mcap(p / "a.mcap", rows),
    "mcap, lz4": lambda p, rows: write_test_mcap(
        p / "a.mcap", rows, compression=CompressionType.LZ4
    ),
    "mcap, none": lambda p, rows: write_test_mcap(
        p / "a.mcap", rows, compression=CompressionType.NONE
    ),
    "mcap, no chunks": lambda p, rows: write_test_mcap(p / "a.mcap", rows, use_chunking=False),
    "mcap, no statistics": lambda p, rows: write_test_mcap(
        p / "a.mcap", rows, use_statistics=False
    ),
    "mcap, ros1": lambda p, rows: write_ros1_mcap(p / "a.mcap", rows),
    "split": lambda p, rows: write_split_mcap(p / "bag", rows),
    "recorded apart": lambda p, rows: write_two_recorders(p / "bag", rows),
    "rosbag2, mcap": lambda p, rows: write_rosbag2(p / "bag", rows, MCAP_PLUGIN),
    "rosbag2, mcap, file": lambda p, rows: write_rosbag2(
        p / "bag", rows, MCAP_PLUGIN, FILE_COMPRESSION
    ),
    "rosbag2, mcap, message": lambda p, rows: write_rosbag2(
        p / "bag", rows, MCAP_PLUGIN, MESSAGE_COMPRESSION
    ),
    "rosbag2, sqlite3": lambda p, rows: write_rosbag2(p / "bag", rows, SQLITE_PLUGIN),
    "rosbag2, sqlite3, file": lambda p, rows: write_rosbag2(
        p / "bag", rows, SQLITE_PLUGIN, FILE_COMPRESSION
    ),
    "rosbag2, sqlite3, message": lambda p, rows: write_rosbag2(
        p / "bag", rows, SQLITE_PLUGIN, MESSAGE_COMPRESSION
    ),
    "sqlite3": lambda p, rows: extract_sqlite_file(write_rosbag2(p / "bag", rows, SQLITE_PLUGIN)),
    "sqlite3, no definitions": lambda p, rows: drop_message_definitions(
        write_rosbag2(p / "bag", rows, SQLITE_PLUGIN)
    ),
    "bag": lambda p, rows: write_ros1_bag(p / "a.bag", rows),
    "bag, bz2": lambda p, rows: write_ros1_bag(p / "a.bag", rows, Ros1Compression.BZ2),
    "bag, lz4": lambda p, rows: write_ros1_bag(p / "a.bag", rows, Ros1Compression.LZ4),
}


def write_in_container(container, folder, rows):
    """The recording in a container, as `log` in config.yaml names it."""
    found = LOG_CONTAINERS[container](folder, rows)
    return [str(p) for p in found] if isinstance(found, list) else str(found)


def decode_tables(log, options):
    """(columns of mocap.parquet, of frames.parquet, log.json) of a log."""
    log = open_log(log)
    recording = decode_log(log, options)
    clocks = infer_stream_clocks(recording)
    poses, words = build_mocap_columns(recording, clocks, options["mocap"])
    frames = build_frame_columns(recording.frame_rows, clocks)
    tables = DecodedTables(poses, frames, words)
    audit = build_log_audit(options, log, recording, clocks, tables)
    return poses, frames, audit
