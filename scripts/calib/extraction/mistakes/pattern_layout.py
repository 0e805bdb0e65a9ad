"""A pattern with rows and columns exchanged, or with the other colour first."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from calib.extraction.mistakes.stated_setup import ConfigCorrection, StatedSetup
from calib.io.config_change import target_change
from calib.targets.board import Board
from calib.targets.patterns.charuco import Charuco
from calib.targets.patterns.checkerboard import Checkerboard
from calib.targets.patterns.pattern_registry import TargetPattern

OTHER_COLOR = {"black": "white", "white": "black"}


def correct_pattern_layout(stated: StatedSetup) -> Iterator[ConfigCorrection]:
    """Yield the setups with one pattern read otherwise (see Mistake)."""
    for name, target in sorted(stated.targets.items()):
        if isinstance(target.pattern, Checkerboard):
            yield from _correct_colors(stated, name, target.pattern)
            yield from _correct_checkerboard(stated, name, target.pattern)
        elif isinstance(target.pattern, Charuco):
            yield from _correct_charuco(stated, name, target.pattern)


def with_pattern(stated: StatedSetup, name: str, pattern: TargetPattern) -> StatedSetup:
    """Return the setup with another pattern on a board."""
    board = stated.targets[name]
    assert isinstance(board, Board)  # only boards have patterns
    return replace(stated, targets=stated.targets | {name: replace(board, pattern=pattern)})


def _correct_colors(
    stated: StatedSetup, name: str, pattern: Checkerboard
) -> Iterator[ConfigCorrection]:
    color = pattern.first_square_color
    if color is None:
        return
    other = OTHER_COLOR[color]
    yield ConfigCorrection(
        with_pattern(stated, name, replace(pattern, first_square_color=other)),
        f"{stated.sensor} sees the pattern of {name} the other way round than configured",
        f"Set first_square of {name} to {other}. If the pattern should begin with {color}, it was "
        "printed or mounted mirrored: print it again without mirroring.",
        target_change(name, "pattern.first_square", other),
    )


def _correct_checkerboard(
    stated: StatedSetup, name: str, pattern: Checkerboard
) -> Iterator[ConfigCorrection]:
    """Yield the pattern with rows and columns exchanged: its first corner too, or not."""
    if pattern.n_columns == pattern.n_rows:
        return
    x, y = pattern.first_corner
    middle = pattern.corners()[:, :2].mean(0)
    swapped = replace(pattern, n_columns=pattern.n_rows, n_rows=pattern.n_columns)
    centred = middle - (swapped.corners()[:, :2].mean(0) - [x, y])
    for first in ((y, x), (x, y), tuple(np.round(centred, 4).tolist())):
        yield describe_checkerboard(stated, name, pattern, replace(swapped, first_corner=first))


def describe_checkerboard(
    stated: StatedSetup, name: str, before: Checkerboard, pattern: Checkerboard
) -> ConfigCorrection:
    """Return the correction to another number of inner corners, with what to write."""
    counts = [f"{p.n_columns} x {p.n_rows}" for p in (pattern, before)]
    x, y = pattern.first_corner
    corner, has_other_corner = (
        f" and first_corner_m to [{x:g}, {y:g}]",
        (x, y) != before.first_corner,
    )
    written = [pattern.n_columns, pattern.n_rows]
    return ConfigCorrection(
        with_pattern(stated, name, pattern),
        f"the images of {stated.sensor} show the pattern of {name} with {counts[0]} inner corners "
        f"along x and y, the config states {counts[1]}",
        f"Set pattern.inner_corners of {name} to [{pattern.n_columns}, {pattern.n_rows}]"
        f"{corner if has_other_corner else ''}.",
        None if has_other_corner else target_change(name, "pattern.inner_corners", written),
    )


def _correct_charuco(
    stated: StatedSetup, name: str, pattern: Charuco
) -> Iterator[ConfigCorrection]:
    for squares in (pattern.n_squares, pattern.n_squares[::-1]):
        for is_legacy in (pattern.is_legacy, not pattern.is_legacy):
            other = replace(pattern, n_squares=squares, is_legacy=is_legacy)
            if other != pattern:
                yield describe_charuco(stated, name, pattern, other)


def describe_charuco(
    stated: StatedSetup, name: str, before: Charuco, pattern: Charuco
) -> ConfigCorrection:
    """Return the correction to another ChArUco board, with what to write."""
    before_values, values = (
        {"squares": list(p.n_squares), "dictionary": p.dictionary, "legacy": p.is_legacy}
        for p in (before, pattern)
    )
    keys = [k for k in values if values[k] != before_values[k]]
    stated_words, true_words = (
        ", ".join(f"{k} {_format_value(v[k])}" for k in keys) for v in (before_values, values)
    )
    written = [f"pattern.{k} of {name} to {_format_value(values[k])}" for k in keys]
    return ConfigCorrection(
        with_pattern(stated, name, pattern),
        f"the images of {stated.sensor} show the ChArUco board of {name} with {true_words}, the "
        f"config states {stated_words}",
        f"Set {' and '.join(written)}.",
        target_change(name, f"pattern.{keys[0]}", values[keys[0]]) if len(keys) == 1 else None,
    )


def _format_value(value: Any) -> str:
    """Return a value as YAML has it."""
    return str(value).lower() if isinstance(value, bool) else str(value)
