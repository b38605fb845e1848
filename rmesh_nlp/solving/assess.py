"""One assessment of where a formulation ended, measured on the problem itself."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rmesh_nlp.assessment.coulomb import growth
from rmesh_nlp.assessment.measures import residuals
from rmesh_nlp.contact.setup_warnings import curve_warnings
from rmesh_nlp.meshes.geometry import have_same_mesh
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import signed_areas
from rmesh_nlp.solving.assessment import Assessment
from rmesh_nlp.solving.first_order import FirstOrder, first_order
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.state import State, measured


def assess(
    first: Outer,
    outcome: Outcome,
    *,
    stopped: Status | None = None,
    relocates: bool = True,
    audit: bool = True,
) -> Assessment:
    """Measure where a formulation ended and what it began with, and compare them.

    Parameters
    ----------
    first : Outer
        The outer problem that was given, on whose mesh everything is compared.
    outcome : Outcome
        Its outer problem may have other edges, another rule or another weight.
    stopped : Status, optional
        What ended the solve from outside, in the place of the solver's own word.
    relocates : bool
        Whether the formulation moves nodes at all.
    audit : bool
        Whether the energies of the continuous problem are measured.
    """
    last, said = outcome.outer, stopped or outcome.status
    is_same_mesh = have_same_mesh(first.problem.mesh, last.problem.mesh)
    begin = last if is_same_mesh else first
    # the final mesh before the given one: the models remember their last point
    final = measured(last, outcome.q, audit=audit)
    given = final
    if np.any(outcome.q) or begin is not last:
        given = measured(begin, np.zeros(begin.n), audit=audit)
    conditions, own = FirstOrder(), final.residuals
    if final.point is not None:
        conditions = first_order(last, final.point, outcome.label, said, relocates)
        if outcome.own is not None:
            own = residuals(final.point.system, outcome.own)
    grown = growth(given.coulomb_residual, final.coulomb_residual)
    return Assessment(
        given=given,
        final=final,
        first_order=conditions,
        solver_status=said,
        own_residuals=own,
        objective=last.objective,
        is_same_mesh=is_same_mesh,
        tolerance=last.tolerance,
        lacks=outcome.lacks,
        designed=last.problem if final.design else None,
        domain_area_change=_domain_area_change(first, final),
        warnings=(*_doubts(first, given, final), *final.warnings, *(() if grown is None else (grown,))),
    )


def _doubts(first: Outer, given: State, final: State) -> Iterator[str]:
    """Signs of a wrong set-up: all of the given mesh, of the final one those that are new.

    Another design has figures of its own; on a mesh that was moved only the kind counts.
    """
    yield from (sign.message for sign in (*curve_warnings(first.problem), *given.doubts))
    before = given.doubts if final.design else [sign.kind for sign in given.doubts]
    for sign in final.doubts:
        if (sign if final.design else sign.kind) not in before:
            yield f"at the end: {sign.message}"


def _domain_area_change(first: Outer, final: State) -> float | None:
    """Relative change of the area of the body, where nodes slide along curves."""
    if not final.problem.motion.curves:
        return None
    before = signed_areas(first.problem.mesh.p, first.problem.triangles).sum()
    return float(signed_areas(final.mesh.p, final.problem.triangles).sum() / before - 1)
