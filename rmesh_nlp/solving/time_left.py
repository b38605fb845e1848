"""Guesses of how long a descent will go on, for those who wait."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

MEMORY = 12
"""Steps that a guess is made from."""

LONGEST = 86400.0
"""A guess of more seconds than this is none."""


class Falling:
    """Follows a quantity that falls in time about like a geometric sequence.

    Parameters
    ----------
    target : float
        Value at which the descent ends.
    """

    def __init__(self, target: float) -> None:
        self._target = math.log10(target)
        self._last: deque[tuple[float, float]] = deque(maxlen=MEMORY)

    def __call__(self, seconds: float, value: float) -> None:
        """Note a value; one that is not positive and finite is passed over."""
        if math.isfinite(value) and value > 0:
            self._last.append((seconds, math.log10(value)))

    @property
    def seconds_left(self) -> float | None:
        """A guess: it falls on as it did over the last steps; None where it does not, or few are known."""
        if len(self._last) < MEMORY // 2:
            return None
        seconds, logs = np.array(self._last).T
        if np.ptp(seconds) == 0:
            return None
        rate = np.polyfit(seconds - seconds[0], logs, 1)[0]
        left = (logs[-1] - self._target) / -rate if rate < 0 else math.inf
        return float(max(left, 0.0)) if left < LONGEST else None
