"""Theorem 4.1 of the paper, term by term: L(X) - J(u) = I1 + I2 + I3.

I1 is the energy-norm error, ``1/2 a(u_h - u, u_h - u)``, I2 the work of the exact contact stress on the
discrete gap, I3 the difference of the friction terms. All are non-negative, so lowering the energy lowers
their sum. They are integrated by an accurate rule, on the contact solution by that rule.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.assembly import element_values
from rmesh_nlp.fem.fields import Field, constant_field
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.findings import ACCURATE
from rmesh_nlp.solving.solution import Solution


@dataclass(frozen=True)
class ErrorTerms:
    """The terms on one mesh, in the unit of the energy.

    Attributes
    ----------
    I1, I2 : float
    I3 : float
        0 without friction.
    above_exact : float
        Audited energy less the exact one: by the theorem the sum of the three.
    """

    I1: float
    I2: float
    I3: float
    above_exact: float

    @property
    def total(self) -> float:
        """``I1 + I2 + I3``."""
        return self.I1 + self.I2 + self.I3

    def entries(self) -> dict[str, float | None]:
        """Entries of a record."""
        return {"I1": self.I1, "I2": self.I2, "I3": self.I3, "energy_above_exact": self.above_exact}


def error_terms(solution: Solution) -> ErrorTerms | None:
    """The terms of Theorem 4.1 on the relocated mesh; None where no exact solution is known."""
    return error_terms_on(solution.problem, np.asarray(solution.mesh.p))


def error_terms_on(problem: ContactProblem, nodes: Array) -> ErrorTerms | None:
    """The same on any node positions (2, nodes) of a problem's mesh."""
    exact = problem.exact
    if exact is None or not np.isfinite(exact.energy):
        return None
    accurate = replace(problem, quadrature=ACCURATE)
    model = ContactSolver(accurate)
    state = model.solve(nodes)
    fields = (
        constant_field(nodes),
        constant_field(model.displacement.values(state.u)),
        constant_field(_slips(model, state.u)),
    )
    names = ["error-energy", "contact", *(["friction"] if problem.frictional else [])]
    values = [_value(accurate, name, fields) for name in names]
    return ErrorTerms(values[0], values[1], sum(values[2:]), state.energy - exact.energy)


def _slips(model: ContactSolver, u: Array) -> Array:
    """Sizes of the slips (obstacles, nodes), zero off the contact boundaries."""
    problem = model.problem
    field = np.zeros((max(len(problem.obstacles), 1), problem.mesh.p.shape[1]))
    if problem.frictional:
        slip = np.abs(model.tangents @ u)
        for part in problem.contact_sets:
            field[part.number, part.nodes] = slip[part.rows]
    return field


def _value(problem: ContactProblem, name: str, fields: tuple[Field, Field, Field]) -> float:
    groups = parse_objective(name).groups(problem, *fields)
    return float(sum(np.sum(part) for part in element_values(groups)(np.zeros(0))))
