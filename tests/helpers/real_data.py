"""Recorded data beside the checkout, which tests may use where it is there."""

from pathlib import Path

import pytest

SHARED_DATA_FOLDER = Path(__file__).parents[3] / "shared" / "data"


def find_shared_data(name):
    """Path of recorded data by its name below shared/data; skips the test where it is absent."""
    path = SHARED_DATA_FOLDER / name
    if not path.exists():
        pytest.skip(f"recorded data {name} is not beside this checkout, in ../shared/data")
    return path
