"""An initial guess with its uncertainty, or the reason why there is none."""

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from calib.io.status import OK, Status

Value = TypeVar("Value", np.ndarray, float)

NO_SOURCE = "none"
SOURCE_DATA = "found in the data"


@dataclass(frozen=True)
class InitialGuess(Generic[Value]):
    """A pose or a time offset that is stated or searched.

    value: pose (4, 4), or offset, s; None if there is none. sigma: of a pose (6,), m and rad, or of
    an offset, s. basis: which data agree on it, in words. status: why a search found nothing.
    source: config, tf_static, the name of a file, SOURCE_DATA or NO_SOURCE.
    """

    value: Value | None = None
    sigma: Value | None = None
    basis: str = ""
    status: Status = OK
    source: str = NO_SOURCE


PoseGuess = InitialGuess[np.ndarray]
OffsetGuess = InitialGuess[float]
