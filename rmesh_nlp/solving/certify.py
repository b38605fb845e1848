"""How far a solution is from the exact one, before and after the relocation: bounds, not estimates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rmesh_nlp.assessment.admissible import Admissible
from rmesh_nlp.assessment.error_reduction import by_certificate
from rmesh_nlp.certificate.admissibility import GIVEN
from rmesh_nlp.certificate.bracket import Bracket
from rmesh_nlp.certificate.domain import same_domain
from rmesh_nlp.certificate.field import Guess
from rmesh_nlp.certificate.refined import refined_bracket
from rmesh_nlp.contact.model import ContactModel
from rmesh_nlp.display import figure
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.contact_terms import nodal_weights
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.solving.solution import Solution


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


def certify(solution: Solution, *, refinements: int | None = None) -> Certificate:
    """Bound the least energy and the error of a solution in the energy norm.

    The contact problem is solved once more on the given mesh, for the bound before the relocation. The
    better of the two lower bounds serves both meshes if relocation left the domain as it was.

    Parameters
    ----------
    solution : Solution
    refinements : int, optional
        How often the mesh is refined for the field that proves the lower bound; more make the bounds
        closer and cost four times as much each. By default once on small meshes, see
        :func:`rmesh_nlp.certificate.refined.refined_bracket`.

    Raises
    ------
    NotCertifiableError
        If the problem is of a kind for which no certificate is known.
    ValueError
        If the solution has no displacement, because its mesh is invalid.
    """
    if not np.all(np.isfinite(solution.displacement)):
        raise ValueError(f"there is nothing to certify: the solution is {solution.status.value}")
    problem, nodes = solution.problem, np.asarray(solution.mesh.p)
    guess = Guess(solution.displacement, solution.pressure, solution.tangential_stress)
    after = refined_bracket(problem, nodes, guess, refinements)
    before = after
    moved = bool(np.any(nodes != problem.mesh.p))
    if solution.assessed is not None and not problem.motion.curves:
        after = _with_upper(after, solution.assessed[1])
        if not moved:
            before = after
    if moved:
        given = np.asarray(problem.mesh.p)
        before = refined_bracket(problem, given, contact_solution(ContactModel(problem), given), refinements)
        if solution.assessed is not None and not problem.motion.curves and solution.given is None:
            before = _with_upper(before, solution.assessed[0])
    if not moved:
        return _certificate(after, after, after.why)
    if same_domain(problem, nodes):
        best = max((before, after), key=lambda one: (one.guaranteed_lower, one.lower))
        before, after = _with_lower(before, best), _with_lower(after, best)
    why = (*after.why, *(f"given mesh: {reason}" for reason in before.why))
    return _certificate(before, after, why)


def contact_solution(model: ContactModel, nodes: Array) -> Guess:
    """The contact solution on a mesh with its nodes at ``nodes`` (2, nodes)."""
    problem, found = model.problem, model.solve(nodes)
    pressure, friction = np.zeros((2, nodes.shape[1]))
    weights = nodal_weights(problem, nodes)
    pressure[model.contact_nodes] = found.normal_force / weights
    if found.tangential_force.size:
        friction[model.contact_nodes] = found.tangential_force / weights
    return Guess(model.displacement.values(found.u), pressure, friction)


def _with_upper(one: Bracket, found: Admissible) -> Bracket:
    """The bracket with the energy of an admissible displacement as its upper bound."""
    if found.status is not Status.CONVERGED:
        return one
    kept = tuple(reason for reason in one.why if not reason.startswith("upper") or GIVEN in reason)
    known = not any(reason.startswith("upper") for reason in kept)
    return replace(one, upper=found.energy + found.doubt, guaranteed_upper=known, why=kept)


def _with_lower(one: Bracket, best: Bracket) -> Bracket:
    """The bracket with the lower bound of another one of the same problem."""
    if one is best:
        return one
    kept = tuple(reason for reason in one.why if not reason.startswith("lower"))
    added = tuple(reason for reason in best.why if reason.startswith("lower"))
    return replace(one, lower=best.lower, guaranteed_lower=best.guaranteed_lower, why=(*added, *kept))


def _certificate(before: Bracket, after: Bracket, why: tuple[str, ...]) -> Certificate:
    errors = [error_bound(one) for one in (before, after)]
    return Certificate(
        lower=after.lower,
        upper=after.upper,
        error_bound_initial=errors[0],
        error_bound=errors[1],
        relative_initial=errors[0] / max(before.norm, 1e-300),
        relative=errors[1] / max(after.norm, 1e-300),
        guaranteed_lower=after.guaranteed_lower,
        guaranteed_upper=after.guaranteed_upper,
        guaranteed_initial=before.guaranteed_lower and before.guaranteed_upper,
        why="; ".join(dict.fromkeys(why)),
        local=after.local,
        local_initial=before.local,
        field=after.field,
        residual=max(after.residual, before.residual),
    )


def error_bound(one: Bracket) -> float:
    """Bound of the error in the energy norm: half its square is at most the gap between the bounds."""
    return float(np.sqrt(2 * max(one.upper - one.lower, 0.0)))


def certified(solution: Solution) -> tuple[dict[str, Any], Certificate | None]:
    """The entries of a record, and the certificate; without one the remark in the record says why."""
    try:
        certificate = certify(solution)
    except (ValueError, RuntimeError, np.linalg.LinAlgError) as error:
        return {"certificate_remark": f"no certificate: {' '.join(str(error).split())}"}, None
    return certificate.record(), certificate


def _percent(part: float) -> str:
    return f"{100 * part:.3g} %"
