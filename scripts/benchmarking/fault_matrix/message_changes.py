"""Faults that a recording has: functions of its messages, in the order of their log times."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from calib.geometry.se3 import make_pose, pose_from_xyz_quat, pose_to_quat, so3_exp
from calib.geometry.units import NS_PER_S
from calib.io.logs.ros_messages import TF_TYPE, RosMessage

MessageChange = Callable[[list[RosMessage]], Iterable[RosMessage]]
IMAGE_SUFFIX = "image_raw"


def change_transforms(change: Callable[[Any, float], None], body: str = "") -> MessageChange:
    """Return a fault that changes every pose of a body (default all of them).

    change: of a transform of /tf, at that share of the recording.
    """

    def apply(messages: list[RosMessage]) -> Iterator[RosMessage]:
        first, last = messages[0].log_time_ns, messages[-1].log_time_ns
        for message in messages:
            if message.type_name == TF_TYPE:
                share = (message.log_time_ns - first) / (last - first)
                for item in message.message.transforms:
                    if body in ("", item.child_frame_id):
                        change(item, share)
            yield message

    return apply


def knock_body(body: str, shift_m: float, turn_deg: float) -> MessageChange:
    """Return a fault: from the middle of the recording on, the markers of a body sit elsewhere."""
    T_knock = make_pose(so3_exp(np.deg2rad(turn_deg) * np.array([0.6, 0.64, 0.48])))
    T_knock[:3, 3] = shift_m * np.array([0.48, -0.6, 0.64])

    def move(item: Any, share: float) -> None:
        if share > 0.5:
            set_transform(item, read_transform(item) @ T_knock)

    return change_transforms(move, body)


def read_transform(item: Any) -> np.ndarray:
    """Return the pose (4, 4) of a transform message."""
    p, q = item.transform.translation, item.transform.rotation
    return pose_from_xyz_quat(np.array([p.x, p.y, p.z]), np.array([q.x, q.y, q.z, q.w]))


def set_transform(item: Any, T: np.ndarray) -> None:
    """Write a pose (4, 4) into a transform message."""
    p, q = item.transform.translation, item.transform.rotation
    p.x, p.y, p.z = T[:3, 3].tolist()
    q.x, q.y, q.z, q.w = pose_to_quat(T).tolist()


def reorder_quaternion(item: Any, share: float) -> None:
    """Write w first into a transform message, as some drivers do."""
    q = item.transform.rotation
    q.x, q.y, q.z, q.w = q.w, q.x, q.y, q.z


def scale_to_millimetres(item: Any, share: float) -> None:
    """Write millimetres into a transform message."""
    p = item.transform.translation
    p.x, p.y, p.z = 1e3 * p.x, 1e3 * p.y, 1e3 * p.z


def swap_bodies(first: str, second: str) -> MessageChange:
    """Return a fault: two bodies have each other's name."""
    other = {first: second, second: first}

    def rename(item: Any, share: float) -> None:
        item.child_frame_id = other.get(item.child_frame_id, item.child_frame_id)

    return change_transforms(rename)


def step_clock(step_s: float) -> MessageChange:
    """Return a fault: the robot's clock is stepped in the middle, motion capture's is not."""
    step_ns = round(step_s * NS_PER_S)

    def apply(messages: list[RosMessage]) -> Iterator[RosMessage]:
        middle_ns = (messages[0].log_time_ns + messages[-1].log_time_ns) // 2
        for message in messages:
            if message.log_time_ns <= middle_ns:
                yield message
                continue
            if message.type_name != TF_TYPE:
                stamp = message.message.header.stamp
                stamp_ns = stamp.sec * NS_PER_S + stamp.nanosec + step_ns
                stamp.sec, stamp.nanosec = divmod(stamp_ns, NS_PER_S)
            yield message._replace(log_time_ns=message.log_time_ns + step_ns)

    return apply


def mirror_pictures(messages: list[RosMessage]) -> Iterator[RosMessage]:
    """Mirror every picture left to right."""
    for message in messages:
        if message.topic.endswith(IMAGE_SUFFIX):
            image = message.message
            pixels = np.asarray(image.data).reshape(image.height, image.width, -1)
            image.data = np.ascontiguousarray(pixels[:, ::-1]).ravel()
        yield message
