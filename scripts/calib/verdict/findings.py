"""Findings: one entry of a verdict for each limit that is exceeded, with what to do."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypedDict

from calib.io.config_change import ConfigChange

VERDICT_LEVELS = ("pass", "warn", "fail")
Limits = dict[str, float]  # the judge block of the config


class Finding(TypedDict):
    """One entry of `findings` in verdict.json.

    check: name of the limit, without warn_ or fail_. sensors: names of those whose verdict depends
    on it; sensor: the one, if it is only one. ratio: how many times value is beyond limit, at
    least 1. value, limit and ratio are None if the check has no number; ratio also if limit is 0.
    change: what the remedy changes in the config, None if that needs a person.
    """

    check: str
    sensor: str | None
    sensors: list[str]
    level: str
    value: float | None
    limit: float | None
    ratio: float | None
    text: str
    remedy: str
    change: ConfigChange | None


@dataclass(frozen=True)
class LimitCheck:
    """A value with a limit `warn_<key>`, and one `fail_<key>` if it can make a result unusable.

    text: description with {} for the value. display_factor: from the unit of the limit to `unit`.
    is_upper_limit: whether large values are bad.
    """

    key: str
    text: str
    remedy: str = ""
    unit: str = ""
    display_factor: float = 1.0
    is_upper_limit: bool = True

    def format(self, value: float) -> str:
        """Return a value as text, with its unit."""
        return f"{value * self.display_factor:.3g}{self.unit}"


def worst_level(levels: Iterable[str]) -> str:
    """Return the most severe level, pass if there is none."""
    return max(levels, key=VERDICT_LEVELS.index, default="pass")


def level_by_limits(value: float, limits: Limits, key: str, is_upper_limit: bool = True) -> str:
    """Return pass, warn or fail by the limits warn_<key> and fail_<key>, if there is one.

    A NaN exceeds every limit.
    """
    for level in ("fail", "warn"):
        limit = limits.get(f"{level}_{key}")
        if limit is not None and not (value <= limit if is_upper_limit else value >= limit):
            return level
    return "pass"


def make_finding(
    check: str,
    sensors: Sequence[str],
    level: str,
    *,
    text: str,
    remedy: str,
    change: ConfigChange | None = None,
) -> Finding:
    """Return a finding without a number."""
    return Finding(
        check=check,
        sensor=sensors[0] if len(sensors) == 1 else None,
        sensors=list(sensors),
        level=level,
        value=None,
        limit=None,
        ratio=None,
        text=text,
        remedy=remedy,
        change=change,
    )


def with_limit(
    finding: Finding, value: float, limit: float, is_upper_limit: bool = True
) -> Finding:
    """Return the finding with its value and the limit that it exceeds."""
    out = finding.copy()
    out["value"], out["limit"] = value, limit
    if limit:
        out["ratio"] = value / limit if is_upper_limit else limit / max(value, 1e-9)
    return out


def check_limit(
    check: LimitCheck,
    value: float,
    limits: Limits,
    *,
    sensor: str = "",
    remedy: str = "",
    change: ConfigChange | None = None,
) -> list[Finding]:
    """Return [finding] if the value exceeds its warn or fail limit, else [].

    sensor: name, "" for a finding on the whole rig. remedy: replaces that of the check.
    """
    level = level_by_limits(value, limits, check.key, check.is_upper_limit)
    if level == "pass":
        return []
    limit = limits[f"{level}_{check.key}"]
    side = "above" if check.is_upper_limit else "below"
    text = f"{check.text.format(check.format(value))}, {level} {side} {check.format(limit)}"
    finding = make_finding(
        check.key,
        [sensor] if sensor else [],
        level,
        text=f"{sensor}: {text}" if sensor else text,
        remedy=remedy or check.remedy,
        change=change,
    )
    return [with_limit(finding, value, limit, check.is_upper_limit)]
