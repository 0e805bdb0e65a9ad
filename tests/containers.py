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

from calib.geometry import se3
from simulation import ros_log

MS = 1_000_000
BEGIN = 1_700_000_000_000_000_000
MAP, ROBOT, BOARD = "world", "robot", "board"
MARKER = "int64 index\ngeometry_msgs/Point translation"
BODY = "string rigid_body_name\nmocap4r2_msgs/Marker[] markers\ngeometry_msgs/Pose pose"
OWN = {
    "mocap4r2_msgs/msg/Marker": MARKER,
    "mocap4r2_msgs/msg/RigidBody": BODY,
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


def _store(kind):
    store = get_typestore(kind)
    types = {}
    for name, text in OWN.items():
        if kind == Stores.ROS1_NOETIC:
            text = text.replace("builtin_interfaces/Time", "time")
        types |= get_types_from_msg(text, name)
    store.register(types)
    return store


STORE, STORE1 = _store(Stores.ROS2_HUMBLE), _store(Stores.ROS1_NOETIC)
STORE1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", ros_log.TF))


def make(name, /, **fields):
    """A message of ROS 2."""
    return STORE.types[name](**fields)


# --- what is recorded


def track(n=20, hz=100):
    """Stamps (n,), ns, and poses (n, 4, 4) by body: both move, and turn, smoothly."""
    t = BEGIN + np.arange(n) * (1_000_000_000 // hz)
    s = (np.arange(n) / hz)[:, None]
    robot = se3.pose(t=[0.5, -0.2, 0.1]) @ se3.se3_exp(s * [0.3, 0.1, 0, 0, 0, 0.4])
    board = se3.pose(t=[2.0, 0.5, 1.0]) @ se3.se3_exp(s * [0.1, 0.2, -0.1, 0.3, 0, 0.1])
    return t, {ROBOT: robot, BOARD: board}


def header(t, frame=MAP):
    """A header stamped t, ns."""
    stamp = make("builtin_interfaces/msg/Time", sec=int(t // 10**9), nanosec=int(t % 10**9))
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def pose(T):
    """A geometry_msgs/Pose."""
    x, y, z, w = se3.to_quat(T).tolist()
    position = make("geometry_msgs/msg/Point", **dict(zip("xyz", T[:3, 3].tolist(), strict=True)))
    turn = make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
    return make("geometry_msgs/msg/Pose", position=position, orientation=turn)


def transforms(t, poses):
    """All bodies in one TFMessage."""
    return [("/tf", ros_log.TF, ros_log.transforms(t, MAP, poses))]


def each(name, of):
    """A function that gives a message of one type for each body, on a topic of its own."""
    return lambda t, poses: [(f"/mocap/{b}", name, of(t, b, T)) for b, T in poses.items()]


def _transform(t, body, T):
    return ros_log.transforms(t, MAP, {body: T}).transforms[0]


def _stamped(t, body, T):
    return make("geometry_msgs/msg/PoseStamped", header=header(t), pose=pose(T))


def _spread(T):
    return make("geometry_msgs/msg/PoseWithCovariance", pose=pose(T), covariance=np.zeros(36))


def _with_covariance(t, body, T):
    name = "geometry_msgs/msg/PoseWithCovarianceStamped"
    return make(name, header=header(t), pose=_spread(T))


def _odometry(t, body, T):
    zero = make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    twist = make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
    twist = make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36))
    name = "nav_msgs/msg/Odometry"
    return make(name, header=header(t), child_frame_id=body, pose=_spread(T), twist=twist)


def _position(t, body, T):
    x, y, z, w = se3.to_quat(T).tolist()
    mm = dict(zip(("x_trans", "y_trans", "z_trans"), (1000 * T[:3, 3]).tolist(), strict=True))
    names = {"segment_name": body, "subject_name": body, "translation_type": "Global"}
    turn = {"x_rot": x, "y_rot": y, "z_rot": z, "w": w}
    return make("vicon_receiver/msg/Position", **mm, **turn, **names, frame_number=1)


def rigid_bodies(t, poses):
    """All bodies in one message of mocap4r2."""
    body, name = "mocap4r2_msgs/msg/RigidBody", "mocap4r2_msgs/msg/RigidBodies"
    found = [make(body, rigid_body_name=b, markers=[], pose=pose(T)) for b, T in poses.items()]
    return [("/bodies", name, make(name, header=header(t), frame_number=1, rigidbodies=found))]


def named_poses(t, poses):
    """All bodies in one message of motion_capture_tracking."""
    package = "motion_capture_tracking_interfaces/msg/"
    found = [make(package + "NamedPose", name=b, pose=pose(T)) for b, T in poses.items()]
    name = package + "NamedPoseArray"
    return [("/poses", name, make(name, header=header(t), poses=found))]


# messages at t, ns, of poses by body; `mocap.topics`; names of robot and board as the log has them
NAMED = {f"/mocap/{b}": b for b in (ROBOT, BOARD)}
TYPES = {
    "TFMessage": (transforms, ["/tf"], (ROBOT, BOARD)),
    "TransformStamped": (
        each("geometry_msgs/msg/TransformStamped", _transform), list(NAMED), (ROBOT, BOARD),
    ),
    "PoseStamped": (each("geometry_msgs/msg/PoseStamped", _stamped), NAMED, (ROBOT, BOARD)),
    "PoseStamped, bodies by topic": (
        each("geometry_msgs/msg/PoseStamped", _stamped), list(NAMED), tuple(NAMED),
    ),
    "PoseWithCovarianceStamped": (
        each("geometry_msgs/msg/PoseWithCovarianceStamped", _with_covariance),
        NAMED, (ROBOT, BOARD),
    ),
    "Odometry": (each("nav_msgs/msg/Odometry", _odometry), list(NAMED), (ROBOT, BOARD)),
    "RigidBodies": (rigid_bodies, {"/bodies": None}, (ROBOT, BOARD)),
    "NamedPoseArray": (named_poses, ["/poses"], (ROBOT, BOARD)),
    "Position": (
        each("vicon_receiver/msg/Position", _position), list(NAMED), ("robot/robot", "board/board"),
    ),
}  # fmt: skip


def image(t):
    """A small Image."""
    pixels = np.arange(24, dtype=np.uint8)
    fields = {"height": 2, "width": 4, "encoding": "bgr8", "is_bigendian": 0, "step": 12}
    return make(ros_log.IMAGE, header=header(t, "camera"), **fields, data=pixels)


def cloud(t):
    """A small PointCloud2."""
    fields = [
        make("sensor_msgs/msg/PointField", name=k, offset=4 * i, datatype=7, count=1)
        for i, k in enumerate("xyz")
    ]
    data = np.arange(15, dtype=np.float32).view(np.uint8)
    shape = {"height": 1, "width": 5, "point_step": 12, "row_step": 60}
    flags = {"is_bigendian": False, "is_dense": True}
    return make(
        ros_log.CLOUD, header=header(t, "lidar"), fields=fields, data=data, **shape, **flags
    )


def recording(kind, n=20):
    """Rows of a recording with motion capture of a kind of TYPES, a camera and a lidar."""
    say, _, _ = TYPES[kind]
    t, poses = track(n)
    rows = []
    for i, now in enumerate(t.tolist()):
        said = say(now, {body: T[i] for body, T in poses.items()})
        rows += [(now + 2 * MS + k, *message) for k, message in enumerate(said)]
        if i % 3 == 0:
            rows.append((now + 5 * MS, "/image", ros_log.IMAGE, image(now)))
            rows.append((now + 6 * MS, "/points", ros_log.CLOUD, cloud(now)))
    return rows


def options(kind):
    """What decode is given for it."""
    _, topics, names = TYPES[kind]
    sensors = {
        "camera": {"kind": "camera", "topic": "/image"},
        "lidar": {"kind": "lidar", "topic": "/points"},
    }
    mocap = {"topics": topics, "map": MAP, "max_gap_s": 0.05}
    span = {"from_s": None, "to_s": None}
    return {"sensors": sensors, "mocap": mocap, "bodies": sorted(names), "fingerprint": [], **span}


# --- containers


def cdr(name, message):
    return bytes(STORE.serialize_cdr(message, name))


def mcap(path, rows, serialise=cdr, form=("cdr", "ros2msg", 2), **options):
    """One MCAP file."""
    options = {"chunk_size": 2000, "compression": CompressionType.ZSTD} | options
    with open(path, "wb") as stream:
        writer = Writer(stream, **options)
        writer.start(profile="ros2", library="test")
        schemas, channels = {}, {}
        for log_t, topic, name, message in rows:
            if name not in schemas:
                store = STORE if form[2] == 2 else STORE1
                text = store.generate_msgdef(name, ros_version=form[2])[0].encode()
                schemas[name] = writer.register_schema(name, form[1], text)
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, form[0], schemas[name])
            writer.add_message(channels[topic], log_t, serialise(name, message), log_t)
        writer.finish()
    return path


def ros1(name, message):
    """A message serialised as in ROS 1."""
    return bytes(STORE1.serialize_ros1(ros_log.of_ros1(message, STORE1), name))


def ros1_mcap(path, rows):
    """An MCAP of messages of ROS 1."""
    return mcap(path, rows, ros1, ("ros1", "ros1msg", 1))


def rosbag2(folder, rows, plugin, compression=CompressionMode.NONE):
    """A folder as `ros2 bag record` makes it."""
    writer = Rosbag2Writer(folder, version=9, storage_plugin=plugin)
    if compression != CompressionMode.NONE:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    ros_log.record(writer, rows, STORE, cdr)
    return folder


def bag(path, rows, compression=None):
    """A bag of ROS 1."""
    writer = BagWriter(path)
    writer.chunk_threshold = 2000
    if compression:
        writer.set_compression(compression)
    ros_log.record(writer, rows, STORE1, ros1)
    return path


def without_definitions(folder):
    """The SQLite file of a rosbag2 folder as Humble and older write it, alone."""
    (path,) = folder.glob("*.db3")
    connection = sqlite3.connect(path)
    connection.executescript(
        "DROP TABLE message_definitions; UPDATE schema SET schema_version = 3;"
    )
    connection.close()
    return path


def split(folder, rows):
    """Two MCAP files in a folder, which its metadata names."""
    folder.mkdir()
    half = len(rows) // 2
    mcap(folder / "bag_0.mcap", rows[:half])
    mcap(folder / "bag_1.mcap", rows[half:])
    names = "".join(f"    - bag_{i}.mcap\n" for i in range(2))
    text = f"rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n{names}"
    (folder / "metadata.yaml").write_text(text)
    return folder


def apart(folder, rows):
    """A list of two MCAP files: motion capture and sensors, recorded at once by two recorders."""
    sensors = [r for r in rows if r[1] in ("/image", "/points")]
    mocap = [r for r in rows if r not in sensors]
    folder.mkdir()
    return [mcap(folder / "mocap.mcap", mocap), mcap(folder / "sensors.mcap", sensors)]


def alone(folder):
    """The SQLite file of a rosbag2 folder, alone."""
    (path,) = folder.glob("*.db3")
    return shutil.copy(path, folder.with_suffix(".db3"))


SQLITE, MCAP = StoragePlugin.SQLITE3, StoragePlugin.MCAP
MESSAGE, FILE = CompressionMode.MESSAGE, CompressionMode.FILE
Format = BagWriter.CompressionFormat
CONTAINERS = {
    "mcap, zstd": lambda p, rows: mcap(p / "a.mcap", rows),
    "mcap, lz4": lambda p, rows: mcap(p / "a.mcap", rows, compression=CompressionType.LZ4),
    "mcap, none": lambda p, rows: mcap(p / "a.mcap", rows, compression=CompressionType.NONE),
    "mcap, no chunks": lambda p, rows: mcap(p / "a.mcap", rows, use_chunking=False),
    "mcap, no statistics": lambda p, rows: mcap(p / "a.mcap", rows, use_statistics=False),
    "mcap, ros1": lambda p, rows: ros1_mcap(p / "a.mcap", rows),
    "split": lambda p, rows: split(p / "bag", rows),
    "recorded apart": lambda p, rows: apart(p / "bag", rows),
    "rosbag2, mcap": lambda p, rows: rosbag2(p / "bag", rows, MCAP),
    "rosbag2, mcap, file": lambda p, rows: rosbag2(p / "bag", rows, MCAP, FILE),
    "rosbag2, mcap, message": lambda p, rows: rosbag2(p / "bag", rows, MCAP, MESSAGE),
    "rosbag2, sqlite3": lambda p, rows: rosbag2(p / "bag", rows, SQLITE),
    "rosbag2, sqlite3, file": lambda p, rows: rosbag2(p / "bag", rows, SQLITE, FILE),
    "rosbag2, sqlite3, message": lambda p, rows: rosbag2(p / "bag", rows, SQLITE, MESSAGE),
    "sqlite3": lambda p, rows: alone(rosbag2(p / "bag", rows, SQLITE)),
    "sqlite3, no definitions": lambda p, rows: without_definitions(
        rosbag2(p / "bag", rows, SQLITE)
    ),
    "bag": lambda p, rows: bag(p / "a.bag", rows),
    "bag, bz2": lambda p, rows: bag(p / "a.bag", rows, Format.BZ2),
    "bag, lz4": lambda p, rows: bag(p / "a.bag", rows, Format.LZ4),
}


def write(container, folder, rows):
    """The recording in a container, as `log` in config.yaml names it."""
    found = CONTAINERS[container](folder, rows)
    return [str(p) for p in found] if isinstance(found, list) else str(found)
