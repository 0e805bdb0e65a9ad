"""How a fault of the data travels: as data, never as an exception."""

from contextlib import contextmanager
from dataclasses import asdict, dataclass
from unicodedata import category


class InputError(Exception):
    """Unreadable input or a wrong config: the one thing that ends a job, in words for its user."""


class MessageError(InputError):
    """One message that cannot be read, in words with the remedy: the others may be well."""


@dataclass(frozen=True)
class Status:
    """Whether a thing could be done; if not why, what was found, what was expected, what to do."""

    ok: bool = True
    reason: str = ""
    found: str = ""
    expected: str = ""
    remedy: str = ""

    def to_dict(self):
        return asdict(self)

    @classmethod
    def from_dict(cls, d):
        return cls(**d)

    def __str__(self):
        if self.ok:
            return "ok"
        parts = [self.reason]
        parts += [f"{k} {v}" for k, v in (("found", self.found), ("expected", self.expected)) if v]
        return "; ".join(parts) + (f". {self.remedy}" if self.remedy else "")


OK = Status()


def failure_status(reason, found="", expected="", remedy=""):
    """A status that is not ok."""
    return Status(False, reason, str(found), str(expected), remedy)


@contextmanager
def guard_message_fields(type_name):
    """Raises MessageError where a message of the type so named lacks what its type should have: a
    log brings its own definitions, and they may be damaged or of another version."""
    try:
        yield
    except (AttributeError, TypeError, ValueError) as error:
        raise MessageError(
            f"{type_name} is not defined as ROS does it ({summarize_error(error)})"
        ) from error


def escape_control_characters(text):
    """A text without what a terminal would obey: control and format characters are written out.

    Names from a log or a config may hold any.
    """
    return "".join(c if category(c)[0] != "C" or c == "\n" else _escape_character(c) for c in text)


def _escape_character(character):
    return character.encode("unicode_escape", "surrogatepass").decode()


def summarize_error(error):
    """What a library said of foreign bytes, short and without line breaks."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"[:200]
