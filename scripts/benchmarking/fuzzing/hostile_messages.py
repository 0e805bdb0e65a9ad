"""Logs whose bytes are as they should be, and whose messages say what no driver means."""

import copy
from dataclasses import is_dataclass

import numpy as np

from benchmarking.fuzzing.small_recordings import BEGIN, STORE, rows

NUMBERS = {
    "int": (0, 1, -1, 127, 255, 32767, 65535, 2**31 - 1, -(2**31), 2**32 - 1, 2**63 - 1),
    "float": (0.0, -0.0, 1.0, -1.0, 1e-300, 1e30, 1e308, np.nan, np.inf, -np.inf),
}
TEXTS = (
    "", " ", "/", "..", "../../../x", "C:\\x", "x" * 5000, "\x1b[31mred\x1b[2J", "two\nlines",
    "error: not so", "<script>alert(1)</script>", "{{ 1 }}", "$\\frac$", "%s%n", "\u202egnp",
    "bgr8", "bayer_rggb8", "nv12", "mono16", "jpeg", "png", "plumb_bob", "world", "robot",
)  # fmt: skip


def messages(names, rng):
    """Rows of a recording of sensors, with hostile values in the fields of some messages."""
    out = copy.deepcopy(rows(names))
    for number in rng.choice(len(out), int(rng.integers(1, 5)), replace=False):
        log_t, topic, name, message = out[number]
        for _ in range(rng.integers(1, 4)):
            _spoil(message, rng)
        # The same in all of its kind: one message alone is left out, and no more is seen of it.
        if rng.random() < 0.3:
            out = [r[:3] + (message,) if r[1] == topic else r for r in out]
        else:
            out[number] = (_time(log_t, rng), topic, name, message)
    return sorted(out, key=lambda r: r[0])


def _time(log_t, rng):
    if rng.random() < 0.8:
        return log_t
    return int(rng.choice([0, 1, BEGIN + 10**15, 2**62, 2**63 - 1]))


def _spoil(message, rng):
    """Put a hostile value into one field of a message, at any depth."""
    known = STORE.fielddefs[message.__msgtype__][1]
    name, about = known[rng.integers(len(known))]
    value = getattr(message, name)
    if is_dataclass(value):
        return _spoil(value, rng)
    if isinstance(value, list) and value and is_dataclass(value[0]) and rng.random() < 0.7:
        return _spoil(value[rng.integers(len(value))], rng)
    setattr(message, name, _other(value, about, rng))
    return None


def _other(value, about, rng):
    """A value of the same type as this; about: how rosbags describes the field."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, str):
        return str(rng.choice(TEXTS))
    if isinstance(value, list):
        return [value[:0], value[:1], value * 3][rng.integers(3)]
    if isinstance(value, np.ndarray):
        return _array(value, rng, sized=about[0].name == "ARRAY")
    return _number(about[1][0], rng)


def _array(value, rng, sized):
    """An array of the same type, and of the same length where that is fixed."""
    with np.errstate(over="ignore", invalid="ignore"):
        odd = np.array(rng.choice(NUMBERS["float"], max(1, len(value)))).astype(value.dtype)
    if sized or rng.random() < 0.4:
        return odd[: len(value)]
    return [value[:0], value[: len(value) // 2], np.concatenate([value, value])][rng.integers(3)]


def _number(kind, rng):
    """A number that fits a type of ROS."""
    if kind.startswith("float"):
        value = NUMBERS["float"][rng.integers(len(NUMBERS["float"]))]
        return float(np.float32(np.clip(value, -3e38, 3e38))) if kind == "float32" else value
    limits = np.iinfo(kind.replace("byte", "uint8").replace("char", "int8"))
    value = NUMBERS["int"][rng.integers(len(NUMBERS["int"]))]
    return int(np.clip(value, limits.min, limits.max))
