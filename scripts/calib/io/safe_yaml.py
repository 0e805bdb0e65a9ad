"""YAML loader for config files: plain values only, bounded size, no duplicate keys."""

from pathlib import Path
from typing import Any

import yaml

from calib.io.status import MAX_ERROR_CHARS, InputError

MAX_YAML_BYTES = 1 << 20  # size of a file; configs take about 1 kB
MAX_YAML_VALUES = 100_000  # with aliases expanded


def load_yaml(path: str | Path) -> Any:
    """Return the YAML file at `path` as plain Python values.

    Raises InputError if the file is missing, unreadable or not YAML, has a key twice, or expands to
    more than MAX_YAML_VALUES values.
    """
    try:
        text = _read_text(Path(path))
        loader = yaml.SafeLoader(text)
        node = loader.get_single_node()
        if node is None:
            return None
        _count_values(node, path, {}, {})
        return loader.construct_document(node)
    except yaml.MarkedYAMLError as error:
        line = f", line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise InputError(f"{path}: not valid YAML: {error.problem}{line}") from None
    except RecursionError:
        raise InputError(f"{path}: not valid YAML: nested too deeply") from None
    except InputError:
        raise
    except Exception as error:  # of any type, for a wrong date or a number that is too long
        cause = " ".join(str(error).split())[:MAX_ERROR_CHARS]
        raise InputError(f"{path}: not valid YAML: {cause}") from None


def _read_text(path: Path) -> str:
    try:
        if path.stat().st_size > MAX_YAML_BYTES:
            raise InputError(f"{path}: larger than {MAX_YAML_BYTES} bytes; not a config file")
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file. Create it; README.md shows an example.") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None


def _count_values(
    node: yaml.Node, path: str | Path, counts: dict[int, int], ancestors: dict[int, yaml.Node]
) -> int:
    """Return how many values a node stands for, with aliases expanded.

    counts: results by id(node), filled here; ancestors: nodes around this one. Raises InputError
    for too many values, an alias that refers to itself, or a key that appears twice.
    """
    if id(node) in ancestors:
        raise InputError(f"{path}, line {node.start_mark.line + 1}: an alias refers to itself")
    if id(node) in counts:
        return counts[id(node)]
    inner = []
    if isinstance(node, yaml.MappingNode):
        _require_unique_keys(node, path)
        inner = [part for pair in node.value for part in pair]
    elif isinstance(node, yaml.SequenceNode):
        inner = node.value
    ancestors[id(node)] = node
    counts[id(node)] = 1 + sum(_count_values(part, path, counts, ancestors) for part in inner)
    del ancestors[id(node)]
    if counts[id(node)] > MAX_YAML_VALUES:
        raise InputError(
            f"{path}: expands to more than {MAX_YAML_VALUES} values; not a config file"
        )
    return counts[id(node)]


def _require_unique_keys(mapping: yaml.MappingNode, path: str | Path) -> None:
    """Raise InputError if a key appears twice; YAML would silently use the last."""
    line_by_key: dict[tuple[str, str], int] = {}
    for key, _ in mapping.value:
        if not isinstance(key, yaml.ScalarNode) or key.tag == "tag:yaml.org,2002:merge":
            continue
        line = key.start_mark.line + 1
        if (key.tag, key.value) in line_by_key:
            raise InputError(
                f"{path}: key {key.value!r} appears in line {line_by_key[key.tag, key.value]} and "
                f"again in line {line}. Keep one of them."
            )
        line_by_key[key.tag, key.value] = line
