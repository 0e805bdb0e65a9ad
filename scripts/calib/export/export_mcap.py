"""MCAP files of the exports: /tf_static and messages, the same bytes for the same messages."""

import io
from collections.abc import Iterable, Mapping

from calib.io.logs.mcap_writer import LATCHED_QOS, McapOptions, write_mcap
from calib.io.logs.ros_messages import (
    TF_TYPE,
    FrameTransform,
    RosMessage,
    make_transforms_message,
)

TF_STATIC_TOPIC = "/tf_static"
EXPORT_LOG_OPTIONS = McapOptions(
    library="calibration export", qos_by_topic={TF_STATIC_TOPIC: LATCHED_QOS}
)


def make_static_tf_message(stamp_ns: int, transforms: Iterable[FrameTransform]) -> RosMessage:
    """Make the message of /tf_static with all transforms."""
    message = make_transforms_message(stamp_ns, transforms)
    return RosMessage(stamp_ns, TF_STATIC_TOPIC, TF_TYPE, message)


def encode_mcap(messages: Iterable[RosMessage], about: Mapping[str, str]) -> bytes:
    """Encode messages, sorted by time and topic; about becomes the metadata `calibration`."""
    stream = io.BytesIO()
    in_order = sorted(messages, key=lambda m: (m.log_time_ns, m.topic))
    write_mcap(stream, in_order, EXPORT_LOG_OPTIONS, metadata={"calibration": about})
    return stream.getvalue()
