"""Message types: from the definitions in a log, else those that ROS ships; and how to read them."""

import re
from dataclasses import dataclass, field
from functools import cache, cached_property

from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from calib.io.logs import decompression, struct_arrays
from calib.io.status import InputError, MessageError, in_a_line

NAME = re.compile(r"[A-Za-z]\w*/(msg|srv|action)/[A-Za-z]\w*", re.ASCII)
HEADER = "std_msgs/msg/Header"
LONGEST = 1 << 20  # characters of a definition
LATEST = 1 << 32  # s or ns of a stamp
SHIPPED = {"cdr": Stores.LATEST, "ros1": Stores.ROS1_NOETIC}  # by serialisation
PARSERS = {
    "ros2msg": get_types_from_msg,
    "ros1msg": get_types_from_msg,
    "ros2idl": lambda text, _: get_types_from_idl(text),
}


def full_name(name):
    """package/msg/Type, also of a type named package/Type."""
    parts = name.split("/")
    return "/".join([parts[0], "msg", parts[-1]]) if len(parts) == 2 else name


@dataclass
class Types:
    """The types of one log; where: what to call the log in messages."""

    where: str
    definitions: dict = field(default_factory=dict)
    stores: dict = field(default_factory=dict)
    known: dict = field(default_factory=dict)
    failed: dict = field(default_factory=dict)

    def define(self, name, form, text):
        """Take in a definition; form: ros2msg, ros1msg or ros2idl, else it is of no use."""
        if form in PARSERS and text:
            self.definitions.setdefault(name, (form, text))

    def codec(self, name, serialisation):
        """The Codec of messages of a type, serialised as cdr or ros1."""
        return Codec(name, serialisation, self)

    def store(self, name, serialisation):
        """A type store that has the type; raises InputError where nothing tells how to read it."""
        if (name, serialisation) in self.failed:
            raise self.failed[name, serialisation]
        try:
            return self._store(name, serialisation)
        except InputError as error:
            self.failed[name, serialisation] = error
            raise

    def _store(self, name, serialisation):
        if serialisation not in SHIPPED:
            raise InputError(
                f"{self.where}: {name} is serialised as {serialisation or 'nothing named'}; "
                f"this version reads {' and '.join(SHIPPED)}: convert it with `ros2 bag convert`"
            )
        # A definition is read when it is needed: those of service events are none of messages.
        if name in self.definitions:
            store = self.stores.setdefault(serialisation, get_typestore(Stores.EMPTY))
            self._register(store, self.known.setdefault(serialisation, set()), name)
            return store
        shipped = _shipped(serialisation)
        if name not in shipped.fielddefs:
            raise InputError(
                f"{self.where}: holds {name} without its definition, and ROS ships no such type; "
                "record it with `ros2 bag record --storage mcap`"
            )
        return shipped

    def _register(self, store, known, name):
        if name in known:
            return
        form, text = self.definitions[name]
        try:
            # Names become code: nothing but a name may pass.
            if not NAME.fullmatch(name) or len(text) > LONGEST:
                raise ValueError("no name of a type, or longer than any")
            types = PARSERS[form](text, name)
            if not all(NAME.fullmatch(k) for k in types) or name not in types:
                raise ValueError("defines other types")
            store.register({k: v for k, v in types.items() if k not in known})
        except Exception as error:  # whatever the parser makes of foreign text
            raise InputError(
                f"{self.where}: the definition of {name} cannot be read ({in_a_line(error)})"
            ) from error
        known.update(types)


@cache
def _shipped(serialisation):
    return get_typestore(SHIPPED[serialisation])


@dataclass(frozen=True, eq=False)
class Codec:
    """How the messages of one type are read."""

    type: str
    serialisation: str
    types: Types

    @cached_property
    def _store(self):
        return self.types.store(self.type, self.serialisation)

    @cached_property
    def _read(self):
        store = self._store
        return store.deserialize_cdr if self.serialisation == "cdr" else store.deserialize_ros1

    def content(self, data):
        """The message that the bytes say; raises InputError where they say none."""
        read, store = self._read, self._store
        try:
            data = decompression.message(data)
            store.max_sequence_length = max(1, len(data))
            if self.type in struct_arrays.LISTS:
                return struct_arrays.content(data, self.type, self.serialisation, store)
            return read(data, self.type)
        except Exception as error:  # whatever rosbags makes of foreign bytes
            raise self._unreadable(error) from error

    def header(self, data):
        """The header that the bytes begin with; raises InputError where they do not."""
        store = self._store
        try:
            header = self._first_of(data, store) if self._begins(store) else None
            header = header or self.content(data).header
            stamp = header.stamp
            if not (isinstance(header.frame_id, str) and 0 <= stamp.nanosec < LATEST > stamp.sec):
                raise ValueError("no such header")
            return header
        except Exception as error:
            raise self._unreadable(error) from error

    def _begins(self, store):
        """Whether the first field of the type is a header."""
        fields = store.fielddefs[self.type][1]
        return bool(fields) and fields[0][1][1] == HEADER

    def _first_of(self, data, store):
        kind, data = store.get_msgdef(HEADER), memoryview(decompression.message(data))
        if self.serialisation == "ros1":
            return kind.deserialize_ros1(data, 0, kind.cls, store)[0]
        little = {b"\0\0": False, b"\0\1": True}[bytes(data[:2])]
        read = kind.deserialize_cdr_le if little else kind.deserialize_cdr_be
        return read(data[4:], 0, kind.cls, store)[0]

    def _unreadable(self, error):
        return MessageError(
            f"{self.types.where}: a message of {self.type} cannot be read ({in_a_line(error)})"
        )
