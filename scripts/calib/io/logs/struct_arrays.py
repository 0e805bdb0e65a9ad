"""Messages that end in a long list of small structures, read as one array of them.

rosbags makes an object of each, which for the points of one Livox scan takes 30 ms.
"""

import struct

import numpy as np

NUMPY_BY_ROS_TYPE = {"uint32": "u4", "float32": "f4", "uint8": "u1"}
_LIVOX_POINT_FIELDS = [("offset_time", "uint32")] + [(k, "float32") for k in "xyz"]
_LIVOX_POINT_FIELDS += [(k, "uint8") for k in ("reflectivity", "tag", "line")]
# Type of message: fields of what its last field lists. The first is as large as any: structures
# then follow each other at one distance.
STRUCT_LIST_FIELDS = {
    f"{package}/msg/CustomMsg": _LIVOX_POINT_FIELDS
    for package in ("livox_ros_driver", "livox_ros_driver2")
}
CDR_ALIGNMENT_BYTES = (
    4  # bytes to which CDR aligns the count of a list, and structures that begin with four
)


def read_struct_list(data, type_name, serialisation, store):
    """The message of a type in LISTS that the bytes say, its last field an array (n,) of named
    fields. Raises ValueError or an error of rosbags where they say none."""
    head, count_at, order, data = _read_head(memoryview(data), type_name, serialisation, store)
    (n,) = struct.unpack_from(f"{order}I", data, count_at)
    layout = _struct_dtype(type_name, store, order, aligned=serialisation == "cdr")
    # CDR leaves out the gap after the last structure.
    body = bytes(data[count_at + 4 :]) + bytes(CDR_ALIGNMENT_BYTES)
    if not 0 <= len(body) - n * layout.itemsize < 2 * CDR_ALIGNMENT_BYTES:
        raise ValueError(f"a list of {n} in {len(body) - CDR_ALIGNMENT_BYTES} bytes")
    fields = {k: getattr(head, k) for k, _ in store.fielddefs[type_name][1][:-1]}
    last = {store.fielddefs[type_name][1][-1][0]: np.frombuffer(body, layout, n)}
    return store.types[type_name](**fields, **last)


def _read_head(data, type_name, serialisation, store):
    """(all fields but the last, where the count of the list stands, byte order, bytes from the
    first field on)."""
    head = f"{type_name}WithoutList"
    if head not in store.fielddefs:
        constants, fields = store.fielddefs[type_name]
        store.register({head: (constants, fields[:-1])})
    kind = store.get_msgdef(head)
    if serialisation == "ros1":
        found, end = kind.deserialize_ros1(data, 0, kind.cls, store)
        return found, end, "<", data
    little = {b"\0\0": False, b"\0\1": True}[bytes(data[:2])]
    read = kind.deserialize_cdr_le if little else kind.deserialize_cdr_be
    found, end = read(data[4:], 0, kind.cls, store)
    return found, end + -end % CDR_ALIGNMENT_BYTES, "<" if little else ">", data[4:]


def _struct_dtype(type_name, store, byte_order, aligned):
    """dtype of the structures; raises ValueError where the log defines others."""
    listed = store.fielddefs[type_name][1][-1][1][1][0][1]
    defined = [(field, kind[1][0]) for field, kind in store.fielddefs[listed][1]]
    if defined != STRUCT_LIST_FIELDS[type_name]:
        raise ValueError(f"{listed} has other fields than its driver gives it")
    dtype = np.dtype(
        [
            (field, byte_order + NUMPY_BY_ROS_TYPE[kind])
            for field, kind in STRUCT_LIST_FIELDS[type_name]
        ]
    )
    size = dtype.itemsize + (-dtype.itemsize % CDR_ALIGNMENT_BYTES if aligned else 0)
    offsets = [dtype.fields[field][1] for field in dtype.names]
    formats = [dtype.fields[field][0] for field in dtype.names]
    return np.dtype(
        {"names": dtype.names, "formats": formats, "offsets": offsets, "itemsize": size}
    )
