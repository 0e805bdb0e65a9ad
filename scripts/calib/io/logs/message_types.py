"""Message types: from the definitions in a log, else those that ROS ships; and how to read them."""

import re
from dataclasses import dataclass, field
from functools import cache, cached_property

from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from calib.io.logs.decompression import decompress_message
from calib.io.logs.struct_arrays import STRUCT_LIST_FIELDS, read_struct_list
from calib.io.status import InputError, MessageError, summarize_error

TYPE_NAME_PATTERN = re.compile(r"[A-Za-z]\w*/(msg|srv|action)/[A-Za-z]\w*", re.ASCII)
HEADER_TYPE = "std_msgs/msg/Header"
MAX_DEFINITION_CHARS = 1 << 20  # characters of a definition
STAMP_FIELD_LIMIT = 1 << 32  # s or ns of a stamp
ROS_STORE_BY_SERIALISATION = {"cdr": Stores.LATEST, "ros1": Stores.ROS1_NOETIC}  # by serialisation
DEFINITION_PARSERS = {
    "ros2msg": get_types_from_msg,
    "ros1msg": get_types_from_msg,
    "ros2idl": lambda text, _: get_types_from_idl(text),
}


def full_type_name(name):
    """package/msg/Type, also of a type named package/Type."""
    parts = name.split("/")
    return "/".join([parts[0], "msg", parts[-1]]) if len(parts) == 2 else name


@dataclass
class MessageTypes:
    """The types of one log; where: what to call the log in messages."""

    log_name: str
    definitions: dict = field(default_factory=dict)
    stores: dict = field(default_factory=dict)
    registered_names: dict = field(default_factory=dict)
    errors: dict = field(default_factory=dict)

    def add_definition(self, name, definition_format, text):
        """Take in a definition; definition_format: ros2msg, ros1msg or ros2idl, else it is of no use."""
        if definition_format in DEFINITION_PARSERS and text:
            self.definitions.setdefault(name, (definition_format, text))

    def make_codec(self, name, serialisation):
        """The Codec of messages of a type, serialised as cdr or ros1."""
        return MessageCodec(name, serialisation, self)

    def find_type_store(self, name, serialisation):
        """A type store that has the type; raises InputError where nothing tells how to read it."""
        if (name, serialisation) in self.errors:
            raise self.errors[name, serialisation]
        try:
            return self._build_type_store(name, serialisation)
        except InputError as error:
            self.errors[name, serialisation] = error
            raise

    def _build_type_store(self, name, serialisation):
        if serialisation not in ROS_STORE_BY_SERIALISATION:
            raise InputError(
                f"{self.log_name}: {name} is serialised as {serialisation or 'nothing named'}; "
                f"this version reads {' and '.join(ROS_STORE_BY_SERIALISATION)}: convert it with `ros2 bag convert`"
            )
        # A definition is read when it is needed: those of service events are none of messages.
        if name in self.definitions:
            store = self.stores.setdefault(serialisation, get_typestore(Stores.EMPTY))
            self._register_type(store, self.registered_names.setdefault(serialisation, set()), name)
            return store
        shipped = _load_ros_store(serialisation)
        if name not in shipped.fielddefs:
            raise InputError(
                f"{self.log_name}: holds {name} without its definition, and ROS ships no such type; "
                "record it with `ros2 bag record --storage mcap`"
            )
        return shipped

    def _register_type(self, store, registered_names, name):
        if name in registered_names:
            return
        form, text = self.definitions[name]
        try:
            # Names become code: nothing but a name may pass.
            if not TYPE_NAME_PATTERN.fullmatch(name) or len(text) > MAX_DEFINITION_CHARS:
                raise ValueError("no name of a type, or longer than any")
            types = DEFINITION_PARSERS[form](text, name)
            if not all(TYPE_NAME_PATTERN.fullmatch(k) for k in types) or name not in types:
                raise ValueError("defines other types")
            store.register({k: v for k, v in types.items() if k not in registered_names})
        except Exception as error:  # whatever the parser makes of foreign text
            raise InputError(
                f"{self.log_name}: the definition of {name} cannot be read ({summarize_error(error)})"
            ) from error
        registered_names.update(types)


@cache
def _load_ros_store(serialisation):
    return get_typestore(ROS_STORE_BY_SERIALISATION[serialisation])


@dataclass(frozen=True, eq=False)
class MessageCodec:
    """How the messages of one type are read."""

    type: str
    serialisation: str
    types: MessageTypes

    @cached_property
    def _store(self):
        return self.types.find_type_store(self.type, self.serialisation)

    @cached_property
    def _deserialize(self):
        store = self._store
        return store.deserialize_cdr if self.serialisation == "cdr" else store.deserialize_ros1

    def decode(self, data):
        """The message that the bytes say; raises InputError where they say none."""
        read, store = self._deserialize, self._store
        try:
            data = decompress_message(data)
            store.max_sequence_length = max(1, len(data))
            if self.type in STRUCT_LIST_FIELDS:
                return read_struct_list(data, self.type, self.serialisation, store)
            return read(data, self.type)
        except Exception as error:  # whatever rosbags makes of foreign bytes
            raise self._decode_error(error) from error

    def decode_header(self, data):
        """The header that the bytes begin with; raises InputError where they do not."""
        store = self._store
        try:
            header = (
                self._decode_leading_header(data, store)
                if self._has_leading_header(store)
                else None
            )
            header = header or self.decode(data).header
            stamp = header.stamp
            if not (
                isinstance(header.frame_id, str)
                and 0 <= stamp.nanosec < STAMP_FIELD_LIMIT > stamp.sec
            ):
                raise ValueError("no such header")
            return header
        except Exception as error:
            raise self._decode_error(error) from error

    def _has_leading_header(self, store):
        """Whether the first field of the type is a header."""
        fields = store.fielddefs[self.type][1]
        return bool(fields) and fields[0][1][1] == HEADER_TYPE

    def _decode_leading_header(self, data, store):
        kind, data = store.get_msgdef(HEADER_TYPE), memoryview(decompress_message(data))
        if self.serialisation == "ros1":
            return kind.deserialize_ros1(data, 0, kind.cls, store)[0]
        little = {b"\0\0": False, b"\0\1": True}[bytes(data[:2])]
        read = kind.deserialize_cdr_le if little else kind.deserialize_cdr_be
        return read(data[4:], 0, kind.cls, store)[0]

    def _decode_error(self, error):
        return MessageError(
            f"{self.types.log_name}: a message of {self.type} cannot be read ({summarize_error(error)})"
        )
