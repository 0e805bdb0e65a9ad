"""Message types by the definitions in a log, or else in ROS, and their decoders."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any, NamedTuple

from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from calib.io.logs.bounded.decompression import decompress_message
from calib.io.logs.bounded.definition_budget import require_bounded_types, strip_definition
from calib.io.logs.struct_arrays import STRUCT_LIST_FIELDS, read_struct_list
from calib.io.status import InputError, MessageError, summarize_error

TYPE_NAME_PATTERN = re.compile(r"[A-Za-z]\w*/(msg|srv|action)/[A-Za-z]\w*", re.ASCII)
HEADER_TYPE = "std_msgs/msg/Header"
STAMP_FIELD_LIMIT = 1 << 32  # the fields of a stamp, s and ns, have 32 bits
ROS_STORE_BY_SERIALISATION = {"cdr": Stores.LATEST, "ros1": Stores.ROS1_NOETIC}
DEFINITION_PARSERS = {
    "ros2msg": get_types_from_msg,
    "ros1msg": get_types_from_msg,
    "ros2idl": lambda text, _: get_types_from_idl(text),
}


def full_type_name(name: str) -> str:
    """Return package/msg/Type, also for a type named package/Type."""
    parts = name.split("/")
    return "/".join([parts[0], "msg", parts[-1]]) if len(parts) == 2 else name


class MessageDefinition(NamedTuple):
    """Text that defines a type, and its format, a key of DEFINITION_PARSERS."""

    format: str
    text: str


@dataclass
class MessageTypes:
    """Message types of one log.

    log_name: of the log, in messages; definitions: {type: definition}; stores, registered_names:
    by serialisation; errors: {(type, serialisation): why it cannot be read}.
    """

    log_name: str
    definitions: dict[str, MessageDefinition] = field(default_factory=dict)
    stores: dict[str, Typestore] = field(default_factory=dict)
    registered_names: dict[str, set[str]] = field(default_factory=dict)
    errors: dict[tuple[str, str], InputError] = field(default_factory=dict)

    def add_definition(self, name: str, definition_format: str | None, text: str) -> None:
        """Add a definition; formats other than ros2msg, ros1msg and ros2idl are ignored."""
        if definition_format in DEFINITION_PARSERS and text:
            self.definitions.setdefault(name, MessageDefinition(definition_format, text))

    def make_codec(self, name: str, serialisation: str) -> "MessageCodec":
        """Return the codec of a type; serialisation: cdr or ros1."""
        return MessageCodec(name, serialisation, self)

    def find_type_store(self, name: str, serialisation: str) -> Typestore:
        """Return a type store with the type; raises InputError if it has no readable definition."""
        if (name, serialisation) in self.errors:
            raise self.errors[name, serialisation]
        try:
            return self._build_type_store(name, serialisation)
        except InputError as error:
            self.errors[name, serialisation] = error
            raise

    def _build_type_store(self, name: str, serialisation: str) -> Typestore:
        if serialisation not in ROS_STORE_BY_SERIALISATION:
            raise InputError(
                f"{self.log_name}: {name} is serialised as {serialisation or 'no named format'}; "
                f"expected {' or '.join(ROS_STORE_BY_SERIALISATION)}. Convert the log with "
                "`ros2 bag convert`."
            )
        # Definitions are read only when needed: those of service events are not valid ones.
        if name in self.definitions:
            store = self.stores.setdefault(serialisation, get_typestore(Stores.EMPTY))
            self._register_type(store, self.registered_names.setdefault(serialisation, set()), name)
            return store
        shipped = _load_ros_store(serialisation)
        if name not in shipped.fielddefs:
            raise InputError(
                f"{self.log_name}: holds no definition of {name}, and ROS does not ship this type. "
                "Record it with `ros2 bag record --storage mcap`."
            )
        return shipped

    def _register_type(self, store: Typestore, registered_names: set[str], name: str) -> None:
        if name in registered_names:
            return
        definition = self.definitions[name]
        try:
            # rosbags generates code from names, so only plain names may pass.
            if not TYPE_NAME_PATTERN.fullmatch(name):
                raise ValueError("not the name of a type")
            text = strip_definition(definition.format, definition.text)
            types = DEFINITION_PARSERS[definition.format](text, name)
            if not all(TYPE_NAME_PATTERN.fullmatch(k) for k in types) or name not in types:
                raise ValueError("it defines other types")
            require_bounded_types(types, store.fielddefs)
            store.register({k: v for k, v in types.items() if k not in registered_names})
        except Exception as error:  # the parser raises any type for foreign text
            raise InputError(
                f"{self.log_name}: the definition of {name} cannot be read "
                f"({summarize_error(error)})"
            ) from error
        registered_names.update(types)


@cache
def _load_ros_store(serialisation: str) -> Typestore:
    return get_typestore(ROS_STORE_BY_SERIALISATION[serialisation])


@dataclass(frozen=True, eq=False)
class MessageCodec:
    """Decoder of the messages of one type."""

    type: str
    serialisation: str
    types: MessageTypes

    @cached_property
    def _store(self) -> Typestore:
        return self.types.find_type_store(self.type, self.serialisation)

    @cached_property
    def _deserialize(self) -> Callable[[bytes, str], Any]:
        store = self._store
        return store.deserialize_cdr if self.serialisation == "cdr" else store.deserialize_ros1

    def decode(self, data: bytes) -> Any:
        """Return the decoded message; raises InputError if the bytes do not fit its definition."""
        read, store = self._deserialize, self._store
        try:
            data = decompress_message(data)
            store.max_sequence_length = max(1, len(data))
            if self.type in STRUCT_LIST_FIELDS:
                return read_struct_list(data, self.type, self.serialisation, store)
            return read(data, self.type)
        except MemoryError:
            raise
        except Exception as error:  # rosbags raises any type for foreign bytes
            raise self._decode_error(error) from error

    def decode_header(self, data: bytes) -> Any:
        """Return the header at the start of the bytes; raises InputError if there is none."""
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
                raise ValueError("not a header")
            return header
        except MemoryError:
            raise
        except Exception as error:
            raise self._decode_error(error) from error

    def _has_leading_header(self, store: Typestore) -> bool:
        """Return whether the first field of the type is a header."""
        fields = store.fielddefs[self.type][1]
        return bool(fields) and fields[0][1][1] == HEADER_TYPE

    def _decode_leading_header(self, data: bytes, store: Typestore) -> Any:
        definition = store.get_msgdef(HEADER_TYPE)
        view = memoryview(decompress_message(data))
        if self.serialisation == "ros1":
            return definition.deserialize_ros1(view, 0, definition.cls, store)[0]
        is_little_endian = {b"\0\0": False, b"\0\1": True}[bytes(view[:2])]
        read = definition.deserialize_cdr_le if is_little_endian else definition.deserialize_cdr_be
        return read(view[4:], 0, definition.cls, store)[0]

    def _decode_error(self, error: Exception) -> MessageError:
        return MessageError(
            f"{self.types.log_name}: a message of {self.type} cannot be read "
            f"({summarize_error(error)})"
        )
