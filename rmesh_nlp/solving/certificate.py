"""Two-sided bounds of the least energy, and of the error of a solution."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rmesh_nlp.assessment.error_reduction import by_certificate
from rmesh_nlp.display import figure
from rmesh_nlp.evaluation import Array


@dataclass(frozen=True)
class Certificate:
    """Two-sided bounds of the least energy, and of the error of a solution.

    Attributes
    ----------
    lower, upper : float
        ``lower <= min J <= upper``, J the energy without any discretisation; ``upper`` is that of an
        admissible displacement on the mesh of the solution, with the doubt of its quadrature, whose error is
        bounded. On curved bodies both are of the polygon, and ``upper`` is the energy of the solution.
    error_bound_initial, error_bound : float
        Bounds of the error in the energy norm (twice the strain energy, its root) on the given
        mesh and on the relocated one.
    relative_initial, relative : float
        The same over the energy norm of the computed displacement.
    guaranteed_lower, guaranteed_upper : bool
        Whether the bounds are bounds; else they are estimates, and so is that of the error.
    guaranteed_initial : bool
        Whether the bound of the error on the given mesh is one.
    why : str
        What stands in the way of a guarantee; empty if nothing does.
    local, local_initial : (elements,) arrays
        What each element adds to ``upper - lower`` on either mesh.
    field : (2 or 3, elements) array
        The flux or the stress xx, yy, xy in equilibrium, mean of each element, on the relocated mesh.
    residual : float
        Largest violation of static admissibility, relative to the largest force.
    """

    lower: float
    upper: float
    error_bound_initial: float
    error_bound: float
    relative_initial: float
    relative: float
    guaranteed_lower: bool
    guaranteed_upper: bool
    guaranteed_initial: bool
    why: str
    local: Array
    local_initial: Array
    field: Array
    residual: float

    def record(self) -> dict[str, Any]:
        """The entries of a record."""
        return {
            "energy_lower_bound": self.lower,
            "energy_upper_bound": self.upper,
            "error_bound_initial": self.error_bound_initial,
            "error_bound": self.error_bound,
            "relative_error_bound_initial": self.relative_initial,
            "relative_error_bound": self.relative,
            "guaranteed_lower": self.guaranteed_lower,
            "guaranteed_upper": self.guaranteed_upper,
            "guaranteed_initial": self.guaranteed_initial,
            "certificate_remark": self.why,
        }

    @property
    def is_disproved(self) -> bool:
        """Whether the energy lies below a proven bound: then the displacement is not admissible."""
        return self.guaranteed_lower and self.upper < self.lower

    def of_reduction(self, found: Mapping[str, Any]) -> Mapping[str, Any]:
        """The record of an error reduction with these bounds, where they are guaranteed."""
        proved = self.guaranteed_lower and self.guaranteed_upper and self.guaranteed_initial
        before, after = (bound**2 / 2 for bound in (self.error_bound_initial, self.error_bound))
        return by_certificate(found, before, after, proved)

    @property
    def sentence(self) -> str:
        """The result in words."""
        if self.is_disproved:
            return (
                f"no error bound: the energy {figure(self.upper)} lies below the proven bound "
                f"{figure(self.lower)}, so the displacement is not admissible"
            )
        guaranteed = self.guaranteed_lower and self.guaranteed_upper and self.guaranteed_initial
        word = "at most" if guaranteed else "estimated at"
        before, after = _percent(self.relative_initial), _percent(self.relative)
        return f"error in the energy norm {word} {before} before, {after} after"


def _percent(part: float) -> str:
    return f"{100 * part:.3g} %"
