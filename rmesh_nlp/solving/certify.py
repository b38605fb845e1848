"""How far a solution is from the exact one, before and after the relocation: bounds, not estimates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rmesh_nlp.assessment.admissible import Admissible, admissible
from rmesh_nlp.certificate import NotCertifiableError
from rmesh_nlp.certificate.bracket import BENT, UNKNOWN, Bracket, refined_bracket
from rmesh_nlp.certificate.equilibration import Guess
from rmesh_nlp.certificate.forces import force_bounds
from rmesh_nlp.certificate.skeleton import same_domain
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import Motion
from rmesh_nlp.solving.assessment import Assessment
from rmesh_nlp.solving.parts import Certificate
from rmesh_nlp.solving.solution import Solution
from rmesh_nlp.solving.state import State

POLYGON = (
    "a body with curves is certified as the polygon of its mesh, whose error is larger than that of "
    "displacements of order 2: take order = 1"
)


def certify(solution: Solution, *, refinements: int | None = None) -> Certificate:
    """Bound the least energy and the error of a solution in the energy norm.

    The contact problem is solved once more on the given mesh, for the bound before the relocation. The
    better of the two lower bounds serves both meshes if relocation left the domain as it was. Of a design the
    bounds before are those of the first one.

    Parameters
    ----------
    solution : Solution
    refinements : int, optional
        How often the mesh is refined for the field that proves the lower bound; more make the bounds
        closer and cost four times as much each. By default once on small meshes, see
        :func:`rmesh_nlp.certificate.bracket.refined_bracket`.

    Raises
    ------
    NotCertifiableError
        If the problem is of a kind for which no certificate is known.
    ValueError
        If the solution has no displacement, because its mesh is invalid.
    """
    return bounded(solution.assessment, refinements)


def bounded(assessment: Assessment, refinements: int | None = None) -> Certificate:
    """The certificate of the two states of an assessment."""
    given, final = assessment.given, assessment.final
    if given.continuous is None or final.continuous is None:
        raise ValueError(f"there is nothing to certify: the solution is {assessment.status.value}")
    problem, first = final.problem, given.problem
    if problem.order == 2 and problem.motion.curves:
        raise NotCertifiableError(POLYGON)
    nodes = np.asarray(final.mesh.p)
    is_new = not np.array_equal(first.mesh.t, problem.mesh.t)
    exact = _on_polygon(final, final.continuous)
    after = _bracket(final, exact, refinements)
    if not is_new and np.array_equal(nodes, given.mesh.p):
        return _certificate(exact, after, after, after.why)
    before = _bracket(given, _on_polygon(given, given.continuous), refinements)
    is_same = not final.design  # else the bounds are those of two problems
    if is_same and same_domain(problem, nodes) and not (is_new and problem.motion.curves):
        best = max((before, after), key=lambda bracket: (not bracket.lower_faults, bracket.lower))
        before, after = (
            replace(bracket, lower=best.lower, lower_faults=best.lower_faults) for bracket in (before, after)
        )
    if is_new:  # the elements of a file are those of the last mesh
        before = replace(before, local=np.full(problem.mesh.t.shape[1], np.nan))
    return _certificate(
        exact, before, after, (*after.why, *(f"given mesh: {reason}" for reason in before.why))
    )


def _on_polygon(state: State, continuous: Admissible) -> Admissible:
    """The admissible displacement; a body with curves is certified as the polygon of its mesh."""
    if not state.problem.motion.curves:
        return continuous
    return admissible(replace(state.problem, mesh=state.mesh, motion=Motion(None)))


def _bracket(state: State, continuous: Admissible, refinements: int | None) -> Bracket:
    """Both bounds on one mesh, the upper one that of the displacement that is admissible."""
    u = DisplacementSpace(state.problem).coefficients(state.displacement)
    guess = Guess(u, state.pressure, state.tangential_stress)
    return with_upper(
        refined_bracket(state.problem, np.asarray(state.mesh.p), guess, refinements), continuous
    )


def with_upper(bracket: Bracket, continuous: Admissible) -> Bracket:
    """The bracket with the energy of an admissible displacement as its upper bound."""
    if continuous.status is not Status.CONVERGED:
        return bracket
    faults = tuple(fault for fault in bracket.upper_faults if fault in (BENT, UNKNOWN))
    return replace(bracket, upper=continuous.energy + continuous.doubt, upper_faults=faults)


def _certificate(exact: Admissible, before: Bracket, after: Bracket, why: tuple[str, ...]) -> Certificate:
    # half the square of the error in the energy norm is at most the gap between the bounds
    gaps = [max(bracket.upper - bracket.lower, 0.0) for bracket in (before, after)]
    errors = [float(np.sqrt(2 * gap)) for gap in gaps]
    return Certificate(
        lower=after.lower,
        upper=after.upper,
        error_bound_initial=errors[0],
        error_bound=errors[1],
        relative_initial=errors[0] / max(before.norm, 1e-300),
        relative=errors[1] / max(after.norm, 1e-300),
        guaranteed_lower=not after.lower_faults,
        guaranteed_upper=not after.upper_faults,
        guaranteed_initial=not before.why,
        why="; ".join(dict.fromkeys(why)),
        local=after.local,
        local_initial=before.local,
        field=after.field,
        residual=max(after.residual, before.residual),
        forces=force_bounds(exact, after.lower),
    )


def certified(assessment: Assessment) -> tuple[Certificate | None, str | None]:
    """The certificate, or a remark that says why there is none."""
    try:
        return bounded(assessment), None
    except (ValueError, RuntimeError, np.linalg.LinAlgError) as error:
        return None, f"no certificate: {' '.join(str(error).split())}"
