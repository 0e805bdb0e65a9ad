"""Scalars that YAML 1.1 reads otherwise than people write them: 1e-3 as text, 1 and no as none."""

import datetime
import re
from typing import Any

# A number with an exponent but without a dot, or without a sign of the exponent, is text in YAML.
NUMBER_TEXT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
NUMBER_TYPES = ("number", "integer")


def read_number_text(value: Any, schema: dict[str, Any]) -> Any:
    """Return the number that a text is, where the schema expects a number; else the value."""
    if schema.get("type") not in NUMBER_TYPES or not isinstance(value, str):
        return value
    if not NUMBER_TEXT.fullmatch(value):
        return value
    number = float(value)
    return int(number) if schema["type"] == "integer" and number.is_integer() else number


def quoting_advice(value: Any) -> str:
    """Return what to write in place of a value that should be text, "" for other values."""
    if isinstance(value, bool):
        return 'YAML reads yes, no, on and off as true and false. Write it in quotes, as in "on".'
    if isinstance(value, int | float):
        return f'YAML reads it as a number. Write it in quotes: "{value}".'
    if isinstance(value, datetime.date):
        return f'YAML reads it as a date. Write it in quotes: "{value}".'
    return ""
