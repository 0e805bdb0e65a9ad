"""YAML as people write it: plain values, bounded, no key twice."""

from pathlib import Path

import yaml

from calib.io.status import InputError

MAX_YAML_BYTES = 1 << 20  # of a file; configs take some 1 kB
MAX_YAML_VALUES = 100_000  # with all that its aliases stand for


def load_yaml(path):
    """The YAML file at path as Python values; no other object is ever made.

    Raises InputError for a file that is not there or cannot be read, or is no YAML, or has a key
    twice, or unfolds to more than anybody writes.
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
        at = f", line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise InputError(f"{path}: not valid YAML: {error.problem}{at}") from None
    except RecursionError:
        raise InputError(f"{path}: not valid YAML: nested too deeply") from None
    except InputError:
        raise
    except Exception as error:  # whatever the library makes of a wrong date or a number too long
        words = " ".join(str(error).split())[:200]
        raise InputError(f"{path}: not valid YAML: {words}") from None


def _read_text(path):
    try:
        if path.stat().st_size > MAX_YAML_BYTES:
            raise InputError(f"{path}: larger than {MAX_YAML_BYTES} bytes; this is no config")
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; write it, README shows an example") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None


def _count_values(node, path, counts, ancestors):
    """How many values a node stands for, aliases unfolded; raises InputError where they are too
    many or without end, or a mapping has a key twice. ancestors: nodes that this one lies in."""
    if id(node) in ancestors:
        raise InputError(f"{path}, line {node.start_mark.line + 1}: an alias of what it lies in")
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
            f"{path}: unfolds to more than {MAX_YAML_VALUES} values; this is no config"
        )
    return counts[id(node)]


def _require_unique_keys(mapping, path):
    """Raises InputError where a key stands twice: only the last would count."""
    seen = {}
    for key, _ in mapping.value:
        if not isinstance(key, yaml.ScalarNode) or key.tag == "tag:yaml.org,2002:merge":
            continue
        line = key.start_mark.line + 1
        if (key.tag, key.value) in seen:
            raise InputError(
                f"{path}: key {key.value!r} stands in line {seen[key.tag, key.value]} and again in "
                f"line {line}; keep one"
            )
        seen[key.tag, key.value] = line
