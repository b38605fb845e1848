"""How a solve is going: its gain, its residual, and about how long it will take."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from rmesh_nlp.solution.solution import Step

TOLERANCE = 1e-6
"""Residual at which strategies stop by default."""

MEMORY = 12
"""Steps that the guess of the time left is made from."""

LONGEST = 86400.0
"""A guess of more seconds than this is none."""


class Pace:
    """Follows the steps of one solve.

    The time left is a guess: the residual falls on in time as it did over the last steps, on a
    logarithmic scale.
    """

    def __init__(self) -> None:
        self._first: float | None = None
        self._last: deque[tuple[float, float]] = deque(maxlen=MEMORY)
        self._step: Step | None = None

    def __call__(self, step: Step) -> None:
        """Note a step."""
        self._step = step
        if self._first is None and math.isfinite(step.energy):
            self._first = step.energy
        residual = self.residual
        if residual is not None and residual > 0:
            self._last.append((step.seconds, math.log10(residual)))

    @property
    def residual(self) -> float | None:
        """The larger of the two residuals of the last step, as the solver scales them."""
        if self._step is None:
            return None
        known = [r for r in (self._step.primal_residual, self._step.dual_residual) if math.isfinite(r)]
        return max(known, default=None)

    @property
    def gain(self) -> float | None:
        """Energy of the first step less that of the last."""
        if self._step is None or self._first is None or not math.isfinite(self._step.energy):
            return None
        return self._first - self._step.energy

    @property
    def seconds_left(self) -> float | None:
        """A guess; None where the residual does not fall."""
        if len(self._last) < MEMORY // 2:
            return None
        seconds, logs = np.array(self._last).T
        if np.ptp(seconds) == 0:
            return None
        rate = np.polyfit(seconds - seconds[0], logs, 1)[0]
        left = (logs[-1] - math.log10(TOLERANCE)) / -rate if rate < 0 else math.inf
        return float(max(left, 0.0)) if left < LONGEST else None

    def text(self) -> str:
        """One line about the last step."""
        if self._step is None:
            return ""
        parts = [f"iteration {self._step.iteration}"]
        if math.isfinite(self._step.energy):
            parts.append(f"J = {self._step.energy:.6g}")
        if self.gain is not None:
            parts.append(f"gain {self.gain:.3g}")
        if self.residual is not None:
            parts.append(f"residual {self.residual:.1e}")
        left = self.seconds_left
        if left is not None:
            parts.append(f"perhaps {left:.0f} s left" if left < 120 else f"perhaps {left / 60:.0f} min left")
        return ", ".join(parts)
