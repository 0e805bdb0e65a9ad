"""Faults as data: the status of what failed, and the errors that end a job or drop a message."""

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from typing import Any
from unicodedata import category

from calib.io.config_change import ConfigChange

MAX_ERROR_CHARS = 200


class InputError(Exception):
    """Unreadable input or a wrong config; its message tells the user what to do.

    The only exception that ends a job without a trace.
    """


class MessageError(InputError):
    """A message of a log that cannot be read. The other messages are still used."""


@dataclass(frozen=True)
class Status:
    """Whether a step succeeded; if not: why, what was found and expected, and what to do.

    change: what the remedy changes in the config, None if that needs a person.
    """

    ok: bool = True
    reason: str = ""
    found: str = ""
    expected: str = ""
    remedy: str = ""
    change: ConfigChange | None = field(default=None, hash=False)

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as written into JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, block: dict[str, Any]) -> "Status":
        """Read the fields written by `to_dict`."""
        return cls(**block)

    def __str__(self) -> str:
        if self.ok:
            return "ok"
        parts = [self.reason]
        parts += [f"{k} {v}" for k, v in (("found", self.found), ("expected", self.expected)) if v]
        return "; ".join(parts) + (f". {self.remedy}" if self.remedy else "")


OK = Status()


def failure_status(
    reason: str,
    found: object = "",
    expected: object = "",
    remedy: str = "",
    change: ConfigChange | None = None,
) -> Status:
    """Return a status that is not ok."""
    return Status(False, reason, str(found), str(expected), remedy, change)


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return "Did you mean X?" with the known name nearest to `name`, or "" if none is near."""
    nearest = difflib.get_close_matches(name, list(known), n=1)
    return f"Did you mean {nearest[0]}?" if nearest else ""


@contextmanager
def guard_message_fields(type_name: str) -> Iterator[None]:
    """Raise MessageError if a message lacks the fields that ROS defines for its type.

    A log brings its own definitions; they may be damaged or of another version.
    """
    try:
        yield
    except (AttributeError, TypeError, ValueError) as error:
        raise MessageError(
            f"{type_name}: its definition differs from that of ROS ({summarize_error(error)})"
        ) from error


def escape_control_characters(text: str) -> str:
    """Return the text with control and format characters written out, for terminals and logs.

    Names from a log or a config may hold any character.
    """
    return "".join(c if c == "\n" or not _is_special(c) else _escape_character(c) for c in text)


def _is_special(character: str) -> bool:
    """Whether a character is a control or format character, or ends a line as \\n does."""
    return category(character)[0] == "C" or category(character) in ("Zl", "Zp")


def _escape_character(character: str) -> str:
    return character.encode("unicode_escape", "surrogatepass").decode()


def summarize_error(error: BaseException) -> str:
    """Return the type and message of a library's error in one line of limited length."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"[:MAX_ERROR_CHARS]
