"""A pattern with rows and columns exchanged, or with the other colour first."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from calib.extraction.mistakes.stated_setup import ConfigCorrection, StatedSetup
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
    corner = f" and first_corner_m to [{x:g}, {y:g}]"
    return ConfigCorrection(
        with_pattern(stated, name, pattern),
        f"the images of {stated.sensor} show the pattern of {name} with {counts[0]} inner corners "
        f"along x and y, the config states {counts[1]}",
        f"Set pattern.inner_corners of {name} to [{pattern.n_columns}, {pattern.n_rows}]"
        f"{corner if pattern.first_corner != before.first_corner else ''}.",
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
    keys = {
        "squares": [str(list(p.n_squares)) for p in (before, pattern)],
        "dictionary": [p.dictionary for p in (before, pattern)],
        "legacy": [str(p.is_legacy).lower() for p in (before, pattern)],
    }
    changed = {k: v for k, v in keys.items() if v[0] != v[1]}
    stated_words, true_words = (
        ", ".join(f"{k} {v[i]}" for k, v in changed.items()) for i in (0, 1)
    )
    return ConfigCorrection(
        with_pattern(stated, name, pattern),
        f"the images of {stated.sensor} show the ChArUco board of {name} with {true_words}, the "
        f"config states {stated_words}",
        "Set " + " and ".join(f"pattern.{k} of {name} to {v[1]}" for k, v in changed.items()) + ".",
    )
