"""Values of objectives, by the fields that they are integrals and sums of."""

import numpy as np

import rmesh_nlp as rm
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.models.kkt_model import kkt_unknowns


def values_at(outer: rm.Outer, objectives: list[Objective | str], q: Array | None = None) -> list[float]:
    """At the contact solution for the outer variables ``q``, by default on the given mesh."""
    point, parts = outer.energy(np.zeros(outer.n) if q is None else q), outer.discretisation
    x = kkt_unknowns(point, parts.friction_rows)
    return [float(parse_objective(one).on(parts.fields()).evaluate()(x)) for one in objectives]


def value_on(problem: rm.ContactProblem, objective: Objective | str) -> float:
    """At the contact solution on the given mesh."""
    return values_at(rm.Outer.of(problem), [objective])[0]


def even_sum(outer: rm.Outer, objectives: list[Objective | str]) -> Objective:
    """A sum whose parts are of one size on the given mesh, so that none hides what is wrong with another."""
    sizes = values_at(outer, objectives)
    parts = [
        parse_objective(one) * (1 / abs(size) if size else 1.0)
        for one, size in zip(objectives, sizes, strict=True)
    ]
    return sum(parts[1:], parts[0])
