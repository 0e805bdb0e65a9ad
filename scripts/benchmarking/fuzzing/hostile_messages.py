"""Messages that are correctly serialised, but with meaningless values in their fields."""

import copy
from dataclasses import is_dataclass
from typing import Any

import numpy as np

from benchmarking.fuzzing.small_recordings import FUZZ_START_NS, make_fuzz_messages
from calib.io.logs.ros_messages import ROS2_TYPES, RosMessage

HOSTILE_NUMBERS = {
    "int": (0, 1, -1, 127, 255, 32767, 65535, 2**31 - 1, -(2**31), 2**32 - 1, 2**63 - 1),
    "float": (0.0, -0.0, 1.0, -1.0, 1e-300, 1e30, 1e308, np.nan, np.inf, -np.inf),
}
HOSTILE_TEXTS = (
    "", " ", "/", "..", "../../../x", "C:\\x", "x" * 5000, "\x1b[31mred\x1b[2J", "two\nlines",
    "error: not so", "<script>alert(1)</script>", "{{ 1 }}", "$\\frac$", "%s%n", "\u202egnp",
    "bgr8", "bayer_rggb8", "nv12", "mono16", "jpeg", "png", "plumb_bob", "world", "robot",
)  # fmt: skip


def make_hostile_messages(
    sensor_names: tuple[str, ...], rng: np.random.Generator
) -> list[RosMessage]:
    """Return the messages of a recording, with hostile values in the fields of some of them."""
    out = copy.deepcopy(make_fuzz_messages(sensor_names))
    for number in rng.choice(len(out), int(rng.integers(1, 5)), replace=False):
        log_t, topic, name, message = out[number]
        for _ in range(rng.integers(1, 4)):
            _damage_field(message, rng)
        # Sometimes in all messages of the topic, because the pipeline skips a single bad message.
        if rng.random() < 0.3:
            out = [RosMessage(*r[:3], message) if r[1] == topic else r for r in out]
        else:
            out[number] = RosMessage(_draw_log_time(log_t, rng), topic, name, message)
    return sorted(out, key=lambda r: r[0])


def _draw_log_time(log_time_ns: int, rng: np.random.Generator) -> int:
    if rng.random() < 0.8:
        return log_time_ns
    return int(rng.choice([0, 1, FUZZ_START_NS + 10**15, 2**62, 2**63 - 1]))


def _damage_field(message: Any, rng: np.random.Generator) -> None:
    """Put a hostile value into one field of a message, at any depth."""
    fields = ROS2_TYPES.fielddefs[message.__msgtype__][1]
    name, definition = fields[rng.integers(len(fields))]
    value = getattr(message, name)
    if is_dataclass(value):
        return _damage_field(value, rng)
    if isinstance(value, list) and value and is_dataclass(value[0]) and rng.random() < 0.7:
        return _damage_field(value[rng.integers(len(value))], rng)
    setattr(message, name, _draw_hostile_value(value, definition, rng))
    return None


def _draw_hostile_value(value: Any, field_definition: Any, rng: np.random.Generator) -> Any:
    """Return a hostile value of the same type.

    field_definition: the description of the field by rosbags.
    """
    if isinstance(value, bool):
        return not value
    if isinstance(value, str):
        return str(rng.choice(HOSTILE_TEXTS))
    if isinstance(value, list):
        return [value[:0], value[:1], value * 3][rng.integers(3)]
    if isinstance(value, np.ndarray):
        return _draw_hostile_array(value, rng, has_fixed_length=field_definition[0].name == "ARRAY")
    return _draw_hostile_number(field_definition[1][0], rng)


def _draw_hostile_array(
    value: np.ndarray, rng: np.random.Generator, has_fixed_length: bool
) -> np.ndarray:
    """Return a hostile array of the same type, and of the same length if that is fixed."""
    with np.errstate(over="ignore", invalid="ignore"):
        odd = np.array(rng.choice(HOSTILE_NUMBERS["float"], max(1, len(value)))).astype(value.dtype)
    if has_fixed_length or rng.random() < 0.4:
        return odd[: len(value)]
    return [value[:0], value[: len(value) // 2], np.concatenate([value, value])][rng.integers(3)]


def _draw_hostile_number(ros_type: str, rng: np.random.Generator) -> Any:
    """Return a hostile number in the range of a ROS type."""
    if ros_type.startswith("float"):
        value = HOSTILE_NUMBERS["float"][rng.integers(len(HOSTILE_NUMBERS["float"]))]
        return float(np.float32(np.clip(value, -3e38, 3e38))) if ros_type == "float32" else value
    limits = np.iinfo(ros_type.replace("byte", "uint8").replace("char", "int8"))
    value = HOSTILE_NUMBERS["int"][rng.integers(len(HOSTILE_NUMBERS["int"]))]
    return int(np.clip(value, limits.min, limits.max))
