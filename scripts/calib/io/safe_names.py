"""Names that logs and folders bring: only letters that ROS allows are written anywhere.

A name with other letters gets a safe name: its allowed letters and a hash of the whole name. The
same name gets the same safe name everywhere, so that configs, logs and URDFs still match; two names
get two. Only the audit of a log shows the name as it was, escaped.
"""

import hashlib
import re
from functools import lru_cache
from pathlib import Path
from typing import Any
from unicodedata import category

SAFE_NAME_PATTERN = re.compile(r"[A-Za-z0-9_/][A-Za-z0-9_/.-]{0,254}")
OTHER_LETTERS_PATTERN = re.compile(r"[^A-Za-z0-9_/.-]+")
MAX_KEPT_CHARS = 64  # of a name that is replaced
N_HASH_DIGITS = 16
MAX_SHOWN_CHARS = 100
MAX_SHOWN_PATH_CHARS = 4096  # paths are as long as this on Linux
MAX_SHOWN_NAMES = 20  # of one log
FORMAT_CHARACTERS = frozenset("<>&$`|\\")  # with a meaning in HTML, Markdown, shells or ROS launch


@lru_cache(maxsize=4096)
def safe_name(name: str) -> str:
    """Return the name itself if all its letters are allowed, else its safe name."""
    if not name or SAFE_NAME_PATTERN.fullmatch(name):
        return name
    kept = OTHER_LETTERS_PATTERN.sub("_", name).lstrip(".-")[:MAX_KEPT_CHARS] or "_"
    digest = hashlib.sha256(name.encode(errors="surrogatepass")).hexdigest()
    return f"{kept}_{digest[:N_HASH_DIGITS]}"


def plain_text(text: str, max_chars: int = MAX_SHOWN_CHARS) -> str:
    """Return a text as one line for messages, with what a page or a terminal would obey escaped."""
    line = "".join(_escape_special(c) for c in text[:max_chars])
    return line if len(text) <= max_chars else f"{line}..."


def plain_path(path: str | Path) -> str:
    """Return a path as plain_text, whole."""
    return plain_text(str(path), MAX_SHOWN_PATH_CHARS)


def _escape_special(character: str) -> str:
    is_special = category(character)[0] in "CZ" or character in FORMAT_CHARACTERS
    if character == " " or not is_special:
        return character
    code = ord(character)
    return f"\\x{code:02x}" if code < 1 << 8 else f"\\u{code:04x}"


class NameGate:
    """The gate of one log: every name passes it once; replaced: {safe name: name in the log}."""

    def __init__(self) -> None:
        self.replaced: dict[str, str] = {}

    def admit(self, name: str) -> str:
        """Return the safe name of a name, and note it if it is another one."""
        safe = safe_name(name)
        if safe != name:
            self.replaced.setdefault(safe, name)
        return safe

    def describe_replaced(self) -> list[str]:
        """Return a line per name that is not written as the log has it."""
        names = sorted(self.replaced.items())
        lines = [
            f'"{plain_text(name)}" has letters that ROS does not allow; it is written as {safe}'
            for safe, name in names[:MAX_SHOWN_NAMES]
        ]
        n_more = len(names) - MAX_SHOWN_NAMES
        return lines + ([f"{n_more} more names of this kind are not listed"] if n_more > 0 else [])


def replace_rig_names(rig: dict[str, Any]) -> None:
    """Replace, in place, the names of a rig that ROS does not allow, as decode does in the log."""
    mocap, export = rig["mocap"], rig["export"]
    topics = mocap["topics"]
    mocap["topics"] = (
        {safe_name(topic): body and safe_name(body) for topic, body in topics.items()}
        if isinstance(topics, dict)
        else [safe_name(topic) for topic in topics]
    )
    named = [(rig, "body"), (mocap, "map"), (export.get("parent", {}), "frame")]
    for sensor in rig["sensors"].values():
        named += [(sensor, "topic"), (sensor, "camera_info")]
        named.append((sensor.get("point_time", {}), "field"))
    named += [(export["body_frames"], name) for name in export["body_frames"]]
    for block, key in named:
        if key in block:
            block[key] = safe_name(block[key])
