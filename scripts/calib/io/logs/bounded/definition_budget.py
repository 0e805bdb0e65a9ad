"""Bounds of a log's message definitions, checked before rosbags parses and compiles them.

A definition of a few kB can stand for any number of values, and its parser may take any time for
it. Within these bounds both are linear in the length of its text.
"""

import re
from collections.abc import Mapping
from typing import Any, NamedTuple

from rosbags.interfaces import Nodetype

from calib.io.logs.bounded.decompression import TooLargeError

MAX_DEFINITION_CHARS = 1 << 17  # the longest of ROS have about 70 000
MAX_FIELDS = 4000  # statements of one definition with all types that it holds
MAX_TYPES = 256
MAX_ARRAY_LENGTH = 1 << 24  # elements
MAX_EXPANDED_VALUES = 2000  # of one message; a list and an array of numbers count as one value
MAX_NESTED_TYPES = 32
MAX_IDL_OPERATORS = 8  # in constant expressions
MAX_IDL_EXPRESSIONS = 1000  # values of constants and annotations, and array lengths
MAX_IDL_TYPEDEFS = 128
# The IDL parser tries each alternative again at each level.
MAX_IDL_NESTING = {"{": 8, "(": 1, "<": 2, "[": 1}
MAX_SHIFT_BITS = 64

_MSG_COMMENT_LINE = re.compile(r"^[ \t]*(#[^\n]*)?\n", re.MULTILINE)
_IDL_STRING_OR_COMMENT = re.compile(
    r"""(?P<string>"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*')|//[^\n]*|/\*(?s:.*?)\*/"""
)
_IDL_ANNOTATION = re.compile(r"@\s*[\w:]+\s*\(")
_IDL_BINARY_OPERATOR = re.compile(r"<<|[*/%|^&~]|(?<=[\w)])\s*(?<![\d.][eE])[+-]")
_IDL_SHIFT = re.compile(r"<<\s*(\d{1,3}\b)?")
_IDL_BRACKETS = re.compile(r"<<|>>|[][{}()<>]")
_CLOSING_BRACKETS = {"}": "{", ")": "(", ">": "<", "]": "["}


class TypeSize(NamedTuple):
    """Number of values of a message with all its members, and depth of nested types."""

    n_values: int
    depth: int


def require_bounded_count(count: int, limit: int, unit: str) -> None:
    """Raise TooLargeError if a count is above its limit."""
    if count > limit:
        raise TooLargeError(f"{count} {unit}, expected at most {limit}")


def strip_definition(definition_format: str, text: str) -> str:
    """Return a definition without comments; raises TooLargeError if it takes long to parse."""
    require_bounded_count(len(text), MAX_DEFINITION_CHARS, "characters")
    if definition_format == "ros2idl":
        stripped = _IDL_STRING_OR_COMMENT.sub(lambda m: m["string"] or " ", text)
        _require_bounded_idl(_IDL_STRING_OR_COMMENT.sub("0", stripped))
        return stripped
    stripped = _MSG_COMMENT_LINE.sub("", text)
    require_bounded_count(stripped.count("\n"), MAX_FIELDS, "fields")
    return stripped


def _require_bounded_idl(text: str) -> None:
    """Raise TooLargeError if the statements of an IDL text, without strings, are out of bounds."""
    require_bounded_count(len(re.findall("[;,]", text)), MAX_FIELDS, "fields")
    require_bounded_count(len(re.findall(r"\btypedef\b", text)), MAX_IDL_TYPEDEFS, "typedefs")
    require_bounded_count(len(re.findall(r"[=[]", text)), MAX_IDL_EXPRESSIONS, "expressions")
    operators = _IDL_BINARY_OPERATOR.findall(text)
    require_bounded_count(len(operators), MAX_IDL_OPERATORS, "operators in constants")
    for shift in _IDL_SHIFT.finditer(text):
        if shift[1] is None or int(shift[1]) > MAX_SHIFT_BITS:
            raise TooLargeError(f"a constant is shifted by more than {MAX_SHIFT_BITS} bits")
    _require_bounded_nesting(_IDL_ANNOTATION.sub("@ ", text))


def _require_bounded_nesting(text: str) -> None:
    """Raise TooLargeError if brackets are nested too deeply; text: without annotations' "("."""
    depth = dict.fromkeys(MAX_IDL_NESTING, 0)
    for bracket in _IDL_BRACKETS.findall(text):
        if bracket == "<<":
            continue
        for character in bracket:
            opened = _CLOSING_BRACKETS.get(character, character)
            # The ")" of an annotation closes nothing that was counted.
            depth[opened] = max(0, depth[opened] + (1 if opened == character else -1))
            require_bounded_count(depth[opened], MAX_IDL_NESTING[opened], f"nested {opened}")


def require_bounded_types(types: Mapping[str, Any], known: Mapping[str, Any]) -> None:
    """Raise TooLargeError if messages of parsed types may hold more values than allowed.

    types, known: {name: (constants, fields)} as of rosbags; known: types that they may refer to.
    """
    require_bounded_count(len(types), MAX_TYPES, "types")
    n_fields = sum(len(constants) + len(fields) for constants, fields in types.values())
    require_bounded_count(n_fields, MAX_FIELDS, "fields")
    sizes: dict[str, TypeSize] = {}
    for name in types:
        _measure_type(name, {**known, **types}, sizes, 1)


def _measure_type(
    name: str, types: Mapping[str, Any], sizes: dict[str, TypeSize], depth: int
) -> TypeSize:
    """Return the size of a type, and add it and those of its members to sizes."""
    require_bounded_count(depth, MAX_NESTED_TYPES, "types nested in each other")
    if name in sizes:
        return sizes[name]
    n_values, max_inner_depth = 1, 0
    for _, (kind, inner) in types[name][1] if name in types else ():
        length = 1
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            is_array = kind == Nodetype.ARRAY
            (kind, inner), declared = inner
            length = _require_array_length(declared) if is_array else 1
        is_number = kind == Nodetype.BASE and inner[0] not in ("string", "wstring")
        member = TypeSize(1, 0)
        if kind == Nodetype.NAME:
            member = _measure_type(inner, types, sizes, depth + 1)
        n_values += member.n_values * (1 if is_number else length)
        max_inner_depth = max(max_inner_depth, member.depth)
        require_bounded_count(n_values, MAX_EXPANDED_VALUES, f"values in a message of {name}")
    require_bounded_count(depth + max_inner_depth, MAX_NESTED_TYPES, "types nested in each other")
    sizes[name] = TypeSize(n_values, 1 + max_inner_depth)
    return sizes[name]


def _require_array_length(length: int) -> int:
    """Return the length of an array; raises TooLargeError if it is out of bounds."""
    if not 1 <= length <= MAX_ARRAY_LENGTH:
        raise TooLargeError(f"an array of {length}, expected 1 to {MAX_ARRAY_LENGTH} elements")
    return length
