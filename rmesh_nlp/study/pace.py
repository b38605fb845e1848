"""How a solve is going: its gain, its residual, and about how long it will take."""

from __future__ import annotations

import math

from rmesh_nlp.solving.clock import Falling
from rmesh_nlp.solving.parts import Step

TOLERANCE = 1e-6
"""Residual at which formulations stop by default."""


class Pace:
    """Follows the steps of one solve.

    The time left is a guess: that of the formulation, if it has one, else the residual falls on in time as it
    did over the last steps, on a logarithmic scale. Where neither is known the time limit is said.

    Parameters
    ----------
    limit : float, optional
        Seconds after which the formulation stops.
    """

    def __init__(self, limit: float | None = None) -> None:
        self._first: float | None = None
        self._falling = Falling(TOLERANCE)
        self._step: Step | None = None
        self._limit = limit

    def __call__(self, step: Step) -> None:
        """Note a step."""
        self._step = step
        if self._first is None and math.isfinite(step.energy):
            self._first = step.energy
        residual = self.residual
        if residual is not None:
            self._falling(step.seconds, residual)

    @property
    def residual(self) -> float | None:
        """The larger of the two residuals of the last step, as the solver scales them."""
        if self._step is None:
            return None
        known = [r for r in (self._step.primal_residual, self._step.dual_residual) if math.isfinite(r)]
        return max(known, default=None)

    @property
    def gain(self) -> float | None:
        """Energy of the mesh as given, or else of the first step, less that of the last step."""
        if self._step is None or self._first is None or not math.isfinite(self._step.energy):
            return None
        given = self._step.energy_given
        return (given if math.isfinite(given) else self._first) - self._step.energy

    @property
    def seconds_left(self) -> float | None:
        """A guess, not beyond the time limit; None where there is none."""
        if self._step is None:
            return None
        guess: float | None = self._step.seconds_left
        if guess is None or not math.isfinite(guess):
            guess = self._falling.seconds_left
        longest = self._longest
        return guess if guess is None or longest is None else min(guess, longest)

    @property
    def _longest(self) -> float | None:
        if self._step is None or self._limit is None:
            return None
        return max(self._limit - self._step.seconds, 0.0)

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
        left, longest = self.seconds_left, self._longest
        if left is not None:
            parts.append(f"perhaps {_words(left)} left")
        elif longest is not None:
            parts.append(f"at most {_words(longest)} left")
        return ", ".join(parts)


def _words(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"
