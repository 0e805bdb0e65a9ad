"""Messages that end in a long list of small structures, read as one array.

rosbags makes an object of each structure, which takes 30 ms for the points of one Livox scan.
"""

import struct
from typing import Any, NamedTuple

import numpy as np
from rosbags.typesys.store import Typestore

NUMPY_BY_ROS_TYPE = {"uint32": "u4", "float32": "f4", "uint8": "u1"}
_LIVOX_POINT_FIELDS = [("offset_time", "uint32")] + [(k, "float32") for k in "xyz"]
_LIVOX_POINT_FIELDS += [(k, "uint8") for k in ("reflectivity", "tag", "line")]
# Type of message: fields of the structures in its last field. The first field is the largest, so
# that structures follow each other at equal distances.
STRUCT_LIST_FIELDS = {
    f"{package}/msg/CustomMsg": _LIVOX_POINT_FIELDS
    for package in ("livox_ros_driver", "livox_ros_driver2")
}
CDR_ALIGNMENT_BYTES = 4  # of the count of a list, and of structures that begin with four bytes


class _MessageHead(NamedTuple):
    """All fields but the last; the offset of the list's count in data; byte order "<" or ">"."""

    fields: Any
    count_offset: int
    byte_order: str
    data: memoryview  # from the first field on


def read_struct_list(data: bytes, type_name: str, serialisation: str, store: Typestore) -> Any:
    """Return a message of a type in STRUCT_LIST_FIELDS, its last field a structured array (n,).

    Raises ValueError or an error of rosbags if the bytes do not fit the type.
    """
    head = _read_head(memoryview(data), type_name, serialisation, store)
    (n,) = struct.unpack_from(f"{head.byte_order}I", head.data, head.count_offset)
    layout = _struct_dtype(type_name, store, head.byte_order, aligned=serialisation == "cdr")
    # CDR leaves out the gap after the last structure.
    body = bytes(head.data[head.count_offset + 4 :]) + bytes(CDR_ALIGNMENT_BYTES)
    if not 0 <= len(body) - n * layout.itemsize < 2 * CDR_ALIGNMENT_BYTES:
        raise ValueError(f"a list of {n} in {len(body) - CDR_ALIGNMENT_BYTES} bytes")
    fields = {k: getattr(head.fields, k) for k, _ in store.fielddefs[type_name][1][:-1]}
    last = {store.fielddefs[type_name][1][-1][0]: np.frombuffer(body, layout, n)}
    return store.types[type_name](**fields, **last)


def _read_head(
    data: memoryview, type_name: str, serialisation: str, store: Typestore
) -> _MessageHead:
    """Read all fields but the last, the list."""
    head_type = f"{type_name}WithoutList"
    if head_type not in store.fielddefs:
        constants, fields = store.fielddefs[type_name]
        store.register({head_type: (constants, fields[:-1])})
    definition = store.get_msgdef(head_type)
    if serialisation == "ros1":
        values, end = definition.deserialize_ros1(data, 0, definition.cls, store)
        return _MessageHead(values, end, "<", data)
    is_little_endian = {b"\0\0": False, b"\0\1": True}[bytes(data[:2])]
    read = definition.deserialize_cdr_le if is_little_endian else definition.deserialize_cdr_be
    values, end = read(data[4:], 0, definition.cls, store)
    count_offset = end + -end % CDR_ALIGNMENT_BYTES
    return _MessageHead(values, count_offset, "<" if is_little_endian else ">", data[4:])


def _struct_dtype(type_name: str, store: Typestore, byte_order: str, aligned: bool) -> np.dtype:
    """Return the dtype of the structures; raises ValueError if the log defines other fields."""
    # rosbags describes it as (name, (kind, ((kind, name of the struct type), length))).
    last_field: Any = store.fielddefs[type_name][1][-1]
    struct_type = last_field[1][1][0][1]
    defined = [(field, kind[1][0]) for field, kind in store.fielddefs[struct_type][1]]
    if defined != STRUCT_LIST_FIELDS[type_name]:
        raise ValueError(f"{struct_type} has other fields than those of its driver")
    names, kinds = zip(*STRUCT_LIST_FIELDS[type_name], strict=True)
    formats = [byte_order + NUMPY_BY_ROS_TYPE[kind] for kind in kinds]
    ends = np.cumsum([np.dtype(f).itemsize for f in formats]).tolist()
    gap = -ends[-1] % CDR_ALIGNMENT_BYTES if aligned else 0
    return np.dtype(
        {
            "names": list(names),
            "formats": formats,
            "offsets": [0, *ends[:-1]],
            "itemsize": ends[-1] + gap,
        }
    )
