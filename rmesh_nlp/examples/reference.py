"""Reference solutions: a contact solve on a fine grid, as a smooth function of position."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Expression
from rmesh_nlp.examples.paper import EXAMPLES
from rmesh_nlp.problem import ContactProblem, ExactSolution

DECIMALS = 10
"""Coordinates that agree to so many decimals lie on one grid line."""


GRIDS = {"6.2": (48, 18), "6.3": (96, 48)}
"""Grids of the reference solutions of the paper's examples that have no exact one.

6.2 moves the bottom row of its uniform grid up to y = 0.05, so its rows may not be thinner.
"""


def with_reference(problem: ContactProblem) -> ContactProblem:
    """An example of the paper with a reference solution, if it has no exact one.

    Raises
    ------
    ValueError
        If there is no reference for this problem.
    """
    if problem.exact is not None:
        return problem
    if problem.name not in GRIDS:
        raise BadInputError(f"there is no reference solution for {problem.name!r}")
    return replace(problem, exact=reference_solution(EXAMPLES[problem.name](GRIDS[problem.name])))


def reference_solution(fine: ContactProblem) -> ExactSolution:
    """Solve a problem on its own fine mesh and interpolate the displacement by cubic splines.

    A piecewise-linear reference has kinks where its elements meet, which an optimiser of node
    positions would feel; a tensor-product spline is smooth and derivable twice.

    Parameters
    ----------
    fine : ContactProblem
        On a mesh whose nodes form a rectangular grid.

    Raises
    ------
    ValueError
        If the nodes do not form a rectangular grid.
    """
    p = np.round(fine.mesh.p, DECIMALS)
    x, y = np.unique(p[0]), np.unique(p[1])
    if x.size * y.size != p.shape[1]:
        raise BadInputError(
            f"a reference solution needs nodes on a rectangular grid: {p.shape[1]} nodes lie on "
            f"{x.size} x {y.size} grid lines"
        )
    model = ContactSolver(fine)
    solution = model.solve(fine.mesh.p)
    place = np.searchsorted(x, p[0]), np.searchsorted(y, p[1])
    splines, at_nodes = [], model.displacement.values(solution.u)
    for component in at_nodes[:, : model.discretisation.space.n_vertices]:
        values = np.empty((x.size, y.size))
        values[place] = component
        splines.append(ca.interpolant("reference", "bspline", [x, y], values.ravel(order="F")))

    def value(at_x: Expression, at_y: Expression) -> Expression:
        point = ca.vertcat(at_x, at_y)
        return ca.vertcat(*[spline(point) for spline in splines])

    return ExactSolution(value, solution.energy, ca.MX)
