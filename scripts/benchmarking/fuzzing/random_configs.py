"""Random damage to good configs, as people, editors and converters may cause it."""

import copy
from typing import Any

import numpy as np
import yaml

from benchmarking.fuzzing.byte_damage import BYTE_DAMAGES
from benchmarking.fuzzing.hostile_messages import HOSTILE_NUMBERS, HOSTILE_TEXTS

VALID_POSE = {"xyz_m": [0.2, 0, 0.6], "rpy_deg": [0, 0, 2]}
VALID_SIGMA = {"xyz_m": 0.05, "rpy_deg": 5}
VALID_FILES = {
    "config.yaml": {
        "sessions": {
            "morning": {"rig": "cart", "log": "logs/morning.mcap"},
            "evening": {"rig": "cart", "log": ["logs/a.mcap", "logs/b.mcap"], "sensors": ["left"],
                        "targets": ["board"], "from_s": 1, "to_s": 90.5, "remounted": True},
        },
        "gate": {"window_s": 0.3},
        "guess": {"sigma": VALID_SIGMA},
        "solve": {"estimate": {"time_offset": "auto", "intrinsics": False}, "max_rounds": 50},
        "report": {"title": "A cart"},
    },
    "rigs/cart.yaml": {
        "body": "cart",
        "mocap": {"topics": ["/tf"], "map": "world", "pose_sigma": VALID_SIGMA, "max_gap_s": 0.05},
        "sensors": {
            "top": {"kind": "lidar", "topic": "/points", "T_robot_sensor": VALID_POSE,
                    "guess_sigma": VALID_SIGMA, "azimuth_deg": [-90, 90], "range_m": [0.5, 60],
                    "point_time": {"field": "stamp_ns", "unit": "ns", "origin": "stamp"}},
            "left": {"kind": "camera", "topic": "/image", "model": "radtan",
                     "size_px": [640, 480],
                     "params": [500, 500, 320, 240, 0.1, 0.01, 0.001, 0.002],
                     "T_robot_sensor": {"xyz_m": [0, 0, 1], "quat_xyzw": [0, 0, 0, 1]}},
            "right": {"kind": "camera", "topic": "/right", "camera_info": "/right/info"},
        },
        "export": {"parent": {"frame": "base", "T_parent_robot": VALID_POSE},
                   "body_frames": {"left": "left_link"}},
    },
    "targets/board.yaml": {
        "body": "board", "shape": "board", "thickness_m": 0.005,
        "outline_m": [[0.7, 0], [0, 0.7], [-0.7, 0], [0, -0.7]],
        "pattern": {"kind": "checkerboard", "inner_corners": [6, 5], "square_m": 0.08,
                    "first_corner_m": [-0.2, -0.16], "first_square": "black"},
        "T_body_target": {"matrix": np.eye(4).tolist()}, "alignment_sigma": VALID_SIGMA,
    },
    "targets/charuco.yaml": {
        "body": "sheet", "shape": "board", "mount": "unknown",
        "outline_m": [[-0.3, -0.4], [0.3, -0.4], [0.3, 0.4], [-0.3, 0.4]],
        "pattern": {"kind": "charuco", "squares": [5, 7], "square_m": 0.1, "marker_m": 0.07,
                    "dictionary": "DICT_6X6_250"},
    },
    "targets/cylinder.yaml": {
        "body": "can", "shape": "cylinder", "length_m": 0.8, "radius_m": 0.1,
        "color": {"hue_deg": [90, 150], "saturation": [0.3, 1], "value": [0.15, 1]},
        "method": "points", "points": {"spacing_m": 0.05},
    },
}  # fmt: skip
PYTHON_OBJECT_YAML = "!!python/object/apply:os.system ['exit 3']"
ALIAS_BOMB = "a0: &a0 [x, x]\n" + "".join(
    f"a{i}: &a{i} [" + ", ".join([f"*a{i - 1}"] * 9) + "]\n" for i in range(1, 40)
)
MERGE_BOMB = "a0: &a0 {k: 1}\n" + "".join(
    f"a{i}: &a{i} {{<<: [*a{i - 1}, *a{i - 1}]}}\n" for i in range(1, 40)
)
HOSTILE_YAML = (
    ALIAS_BOMB, MERGE_BOMB, PYTHON_OBJECT_YAML, "a: &a [*a]", "[" * 3000, "{a: " * 500,
    "- " * 5000, "? [a]\n: 1", "a: 1\na: 2", "\0", "%YAML 9.9\n---\n", "--- a\n--- b",
    "!!binary x", "!!set {a, b}", "1: 2\ntrue: 3", "", "~", "a: 1e999", "2026-13-45",
    "x: !!int '9" + "9" * 5000 + "'",
)  # fmt: skip


def draw_config_files(rng: np.random.Generator) -> dict[str, bytes]:
    """Return the bytes of config files by path; one or two of them are damaged."""
    texts = {path: copy.deepcopy(content) for path, content in VALID_FILES.items()}
    out, damaged_paths = {}, rng.choice(list(texts), int(rng.integers(1, 3)), replace=False)
    for path, content in texts.items():
        if path in damaged_paths:
            damage = FILE_DAMAGES[rng.choice(len(FILE_DAMAGES), p=FILE_DAMAGE_PROBABILITIES)]
            out[path] = damage(content, rng)
        else:
            out[path] = _to_yaml(content)
    return out


def _to_yaml(content: Any) -> bytes:
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True).encode(errors="replace")


def _change_values(content: Any, rng: np.random.Generator) -> bytes:
    """Change or remove some values or keys."""
    for _ in range(rng.integers(1, 4)):
        parent, key = _draw_location(content, rng)
        if isinstance(parent, dict) and rng.random() < 0.15:
            parent[_draw_any_value(rng, 0) if rng.random() < 0.5 else "unknown"] = parent.pop(key)
        elif rng.random() < 0.2:
            del parent[key]
        elif rng.random() < 0.6:
            parent[key] = _draw_similar_value(parent[key], rng)
        else:
            parent[key] = _draw_any_value(rng, 2)
        if not content:
            break
    return _to_yaml(content)


def _draw_location(content: Any, rng: np.random.Generator) -> tuple[Any, Any]:
    """Return (container, key) of a random value at any depth."""
    locations, todo = [], [content]
    while todo:
        parent = todo.pop()
        keys = parent if isinstance(parent, dict) else range(len(parent))
        locations += [(parent, key) for key in keys]
        todo += [
            parent[key] for key in keys if isinstance(parent[key], dict | list) and parent[key]
        ]
    return locations[rng.integers(len(locations))]


def _draw_similar_value(value: Any, rng: np.random.Generator) -> Any:
    """Return another value of the same kind, or a list or mapping with an item less or more."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return rng.choice([value * 2, -value, 0, 1e-12, 1e12, value + 0.5]).item()
    if isinstance(value, str):
        return HOSTILE_TEXTS[rng.integers(len(HOSTILE_TEXTS))]
    if isinstance(value, list):
        return [value[:-1], value + value[:1], value[::-1]][rng.integers(3)]
    return dict(list(value.items())[:-1]) if value else value


def _draw_any_value(rng: np.random.Generator, depth: int) -> Any:
    """Return any value that YAML can write; hashable at depth 0."""
    drawn = rng.integers(8 if depth else 5)
    if drawn >= 6:
        return [_draw_any_value(rng, depth - 1) for _ in range(rng.integers(5))]
    if drawn == 5:
        return {
            str(_draw_any_value(rng, 0)): _draw_any_value(rng, depth - 1)
            for _ in range(rng.integers(4))
        }
    flat = (None, bool(rng.integers(2)), HOSTILE_TEXTS[rng.integers(len(HOSTILE_TEXTS))])
    numbers = [HOSTILE_NUMBERS[k][rng.integers(len(HOSTILE_NUMBERS[k]))] for k in ("int", "float")]
    return (*flat, *numbers)[drawn]


def _damage_file_bytes(content: Any, rng: np.random.Generator) -> bytes:
    """Damage the bytes of the file."""
    return bytes(BYTE_DAMAGES[rng.integers(len(BYTE_DAMAGES))](bytearray(_to_yaml(content)), rng))


def _insert_hostile_yaml(content: Any, rng: np.random.Generator) -> bytes:
    """Replace the content with, or append, YAML that is difficult to read."""
    trick = HOSTILE_YAML[rng.integers(len(HOSTILE_YAML))].encode()
    return trick if rng.random() < 0.5 else _to_yaml(content) + b"\nmore:\n" + b"  " + trick


def _draw_random_bytes(content: Any, rng: np.random.Generator) -> bytes:
    """Return random bytes, printable or not."""
    drawn = rng.integers(*((32, 127) if rng.random() < 0.5 else (0, 256)), rng.integers(300))
    return bytes(drawn.astype(np.uint8))


FILE_DAMAGES, FILE_DAMAGE_PROBABILITIES = (
    (_change_values, _damage_file_bytes, _insert_hostile_yaml, _draw_random_bytes),
    (0.6, 0.25, 0.1, 0.05),
)
