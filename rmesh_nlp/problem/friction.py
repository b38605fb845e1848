"""Friction: how large a tangential stress contact bears."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rmesh_nlp.display import describe
from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem.coefficients import Coefficient, is_nonzero, on_points


@dataclass(frozen=True)
class Friction:
    """The bound ``g + F max(p, 0)`` of the tangential stress under the contact pressure p; false if it is 0.

    Parameters
    ----------
    given : float or function of position
        Tresca's g >= 0, in units of stress.
    slope : float or function of position
        Coulomb's F >= 0, the bound's derivative by the pressure.
    """

    given: Coefficient
    slope: Coefficient

    def __bool__(self) -> bool:
        return self.has_given or not self.has_energy

    @property
    def has_given(self) -> bool:
        """Whether a part of the bound does not depend on the pressure."""
        return is_nonzero(self.given)

    @property
    def has_energy(self) -> bool:
        """Whether the displacement minimises an energy: where the bound does not depend on the pressure."""
        return not is_nonzero(self.slope)

    def bound(self, points: Array, pressure: Array) -> Array:
        """The bound (...) at ``points`` (2, ...) under contact pressures (...)."""
        slope = on_points(self.slope, points, "Coulomb's coefficient")
        return on_points(self.given, points, "the friction bound") + slope * np.maximum(pressure, 0.0)

    def in_words(self) -> str:
        """Both parts of the bound, or that there is none."""
        bounds = [f"friction bound {describe(self.given)}"] if self.has_given else []
        bounds += [] if self.has_energy else [f"Coulomb's coefficient {describe(self.slope)}"]
        return " and ".join(bounds) or "no friction"
