"""Build ROS 2 messages: headers, transforms, point clouds, images."""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from calib.geometry.se3 import pose_to_quat
from calib.geometry.units import NS_PER_S

TF_TYPE = "tf2_msgs/msg/TFMessage"
CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
LASER_SCAN_TYPE = "sensor_msgs/msg/LaserScan"
LIVOX_TYPE = "livox_ros_driver2/msg/CustomMsg"
LIVOX_POINT_TYPE = "livox_ros_driver2/msg/CustomPoint"
IMAGE_TYPE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE_TYPE = "sensor_msgs/msg/CompressedImage"
NUMPY_TO_POINT_FIELD = {"int8": 1, "uint8": 2, "uint16": 4, "uint32": 6, "float32": 7, "float64": 8}
ROS2_TYPES = get_typestore(Stores.ROS2_HUMBLE)
ROS2_TYPES.register(
    get_types_from_msg(
        "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\n"
        "uint8[3] rsvd\nCustomPoint[] points",
        LIVOX_TYPE,
    )
    | get_types_from_msg(
        "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\n"
        "uint8 line",
        LIVOX_POINT_TYPE,
    )
)


class RosMessage(NamedTuple):
    """A message to be written, as rosbags builds it, with its log time (ns) and topic."""

    log_time_ns: int
    topic: str
    type_name: str
    message: Any  # rosbags creates the classes at runtime


class FrameTransform(NamedTuple):
    """The pose (4, 4) of a child frame in its parent frame: p_parent = T_parent_child p_child."""

    parent: str
    child: str
    T_parent_child: np.ndarray


def make_ros_message(type_name: str, /, **fields: Any) -> Any:
    """Make a message of a type from its fields."""
    return ROS2_TYPES.types[type_name](**fields)


def make_ros_header(stamp_ns: int, frame: str) -> Any:
    """Make a std_msgs/Header."""
    stamp = make_ros_message(
        "builtin_interfaces/msg/Time",
        sec=int(stamp_ns // NS_PER_S),
        nanosec=int(stamp_ns % NS_PER_S),
    )
    return make_ros_message("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def make_tf_message(stamp_ns: int, parent: str, T_parent_child: Mapping[str, np.ndarray]) -> Any:
    """Make a TFMessage of poses (4, 4) in one parent frame, by child frame."""
    return make_transforms_message(
        stamp_ns, [FrameTransform(parent, child, T) for child, T in T_parent_child.items()]
    )


def make_transforms_message(stamp_ns: int, transforms: Iterable[FrameTransform]) -> Any:
    """Make a TFMessage whose transforms all have one stamp."""
    stamped = [
        make_ros_message(
            "geometry_msgs/msg/TransformStamped",
            header=make_ros_header(stamp_ns, transform.parent),
            child_frame_id=transform.child,
            transform=_make_transform(transform.T_parent_child),
        )
        for transform in transforms
    ]
    return make_ros_message(TF_TYPE, transforms=stamped)


def _make_transform(T: np.ndarray) -> Any:
    xyz = dict(zip("xyz", T[:3, 3].tolist(), strict=True))
    return make_ros_message(
        "geometry_msgs/msg/Transform",
        translation=make_ros_message("geometry_msgs/msg/Vector3", **xyz),
        rotation=make_ros_quaternion(T),
    )


def make_ros_quaternion(T: np.ndarray) -> Any:
    """Make the geometry_msgs/Quaternion of the rotation of a pose (4, 4)."""
    quat = dict(zip("xyzw", pose_to_quat(T).tolist(), strict=True))
    return make_ros_message("geometry_msgs/msg/Quaternion", **quat)


def make_pointcloud2(
    stamp_ns: int,
    frame: str,
    points: np.ndarray,
    ros_datatypes: Mapping[str, int] = NUMPY_TO_POINT_FIELD,
) -> Any:
    """Make a PointCloud2 of structured points (height, width).

    ros_datatypes maps NumPy names of types to numbers of sensor_msgs/PointField.
    """
    layout, (height, width) = points.dtype, points.shape
    assert layout.names and layout.fields, "the points are not structured"
    fields = [
        make_ros_message(
            "sensor_msgs/msg/PointField",
            name=name,
            offset=layout.fields[name][1],
            datatype=ros_datatypes[layout[name].name],
            count=1,
        )
        for name in layout.names
    ]
    return make_ros_message(
        CLOUD_TYPE,
        header=make_ros_header(stamp_ns, frame),
        height=height,
        width=width,
        fields=fields,
        is_bigendian=False,
        point_step=layout.itemsize,
        row_step=width * layout.itemsize,
        data=points.reshape(-1).view("u1"),
        is_dense=True,
    )


def make_raw_image(stamp_ns: int, frame: str, encoding: str, data: np.ndarray) -> Any:
    """Make an Image of rows (height, width[, channels]) that are in its encoding already."""
    data = np.ascontiguousarray(data)
    return make_ros_message(
        IMAGE_TYPE,
        header=make_ros_header(stamp_ns, frame),
        height=data.shape[0],
        width=data.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=data[0].nbytes,
        data=data.reshape(-1).view(np.uint8),
    )


def make_compressed_image(
    stamp_ns: int, frame: str, format_text: str, file_bytes: np.ndarray
) -> Any:
    """Make a CompressedImage of the bytes (n,) uint8 of an image file."""
    return make_ros_message(
        COMPRESSED_IMAGE_TYPE,
        header=make_ros_header(stamp_ns, frame),
        format=format_text,
        data=file_bytes,
    )
