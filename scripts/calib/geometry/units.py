"""Factors between units, each defined once."""

import math

NS_PER_S = 1_000_000_000
MM_PER_M = 1e3
DEG_PER_RAD = math.degrees(1.0)
MS_PER_S = 1e3
SHARE_TO_PERCENT = 100.0
MAD_TO_SIGMA = 1.4826  # σ of a normal distribution over its median absolute deviation
