"""Checks by theory: a Taylor test of gradients, and Theorem 4.1 of the paper term by term."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.display import Rows, Shown
from rmesh_nlp.errors import BadInputError, expect
from rmesh_nlp.evaluation import Array, magnitude
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.meshes.geometry import relocated_mesh
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.state import ACCURATE, objective_value

LEAST_ORDER = 1.9
"""What counts as second order; 1.9 is also what cashocs and dolfin-adjoint ask for."""

FIRST_STEP, HALVINGS = 1e-2, 5
"""Lengths of the steps, in units of the move limits in which nodes move."""


@dataclass(frozen=True)
class TaylorTest(Shown):
    """How the remainder of the linearised objective falls.

    Attributes
    ----------
    objective : str
        Its text.
    value : float
        The objective at the point.
    slope : float
        The directional derivative that the gradient gives.
    steps, remainders : (n,) arrays
    orders : (n - 1,) array
        ``log2`` of the ratio of successive remainders; NaN where both are rounding.
    """

    objective: str
    value: float
    slope: float
    steps: Array
    remainders: Array
    orders: Array

    @property
    def order(self) -> float:
        """The order of the smallest steps that rounding does not hide; infinite for a linear objective."""
        orders = self.orders[np.isfinite(self.orders)]
        return float(orders[-1]) if orders.size else float("inf")

    @property
    def passed(self) -> bool:
        """Whether the remainder is of second order."""
        return self.order >= LEAST_ORDER

    def __bool__(self) -> bool:
        return self.passed

    def summary(self) -> Rows:
        """Steps, remainders and orders as rows for people."""
        orders = ["", *(f"order {order:.2f}" for order in self.orders)]
        return [
            ("directional derivative", f"{self.slope:.6g}"),
            *(
                (f"remainder at h = {step:.3g}", f"{remainder:.2e} {order}")
                for step, remainder, order in zip(self.steps, self.remainders, orders, strict=True)
            ),
            ("gradient", f"{'right' if self.passed else 'WRONG'}: order {self.order:.2f}"),
        ]

    @property
    def title(self) -> str:
        """What it is, for people."""
        return f"Taylor test of {self.objective!r}"


def verify_gradient(
    problem: ContactProblem, objective: str | Objective = "energy", *, seed: int = 0
) -> TaylorTest:
    """Test the gradient that ``nested`` uses at a random admissible mesh, in a random direction.

    The gradient of the energy is that of (5.7), (5.11). Other objectives are differentiated with
    the contact set held: where that set changes between two steps, or strict complementarity
    fails, the order is below 2 although the gradient is right. Another seed tells.

    Parameters
    ----------
    problem : ContactProblem
        Whose gradient is tested.
    objective : str or Objective
        As in ``solve``.
    seed : int
        Of the point and the direction.

    Raises
    ------
    ValueError
        If the objective is unknown or does not suit the problem, or no node may move.
    """
    expect("problem", problem, ContactProblem)
    outer = Outer.of(problem, objective)
    function, n = outer.function, outer.n
    if n == 0:
        raise BadInputError(f"no node of {problem.name!r} may move: there is no gradient to test")
    rng = np.random.default_rng(seed)
    q, direction = (1 - FIRST_STEP) * outer.variables(seed=int(rng.integers(2**31))), rng.uniform(-1, 1, n)
    while not outer.is_valid(q + FIRST_STEP * direction):
        direction /= 2
    point = function(q)
    slope = float(point.gradient @ direction)
    steps = np.array([FIRST_STEP * 0.5**k for k in range(HALVINGS)])
    values = np.array([function(q + step * direction).value for step in steps])
    remainders = np.abs(values - point.value - steps * slope)
    # less is rounding and says nothing of the gradient
    size = max(abs(point.value), magnitude(values))
    is_resolved = remainders > 500 * np.finfo(float).eps * size
    with np.errstate(divide="ignore", invalid="ignore"):
        orders = np.log2(remainders[:-1] / remainders[1:])
    orders[~(is_resolved[:-1] & is_resolved[1:])] = np.nan
    return TaylorTest(str(outer.objective), point.value, slope, steps, remainders, orders)


def error_terms(problem: ContactProblem, nodes: Array) -> dict[str, float]:
    """The terms of Theorem 4.1 at node positions (2, nodes), in the unit of the energy: entries of a record.

    ``energy_above_exact``, the audited energy less the exact one, is by the theorem the sum of ``I1``, ``I2``
    and ``I3``, which is 0 without friction. Empty where no exact solution is known.
    """
    exact = problem.exact
    if exact is None or not np.isfinite(exact.energy):
        return {}
    moved = replace(problem, mesh=relocated_mesh(problem.mesh, nodes), quadrature=ACCURATE)
    solver = ContactSolver(moved)
    q = np.zeros(solver.discretisation.n_q)

    def term(name: str) -> float:
        return objective_value(solver, parse_objective(name), q, solver.given)

    friction = term("friction") if problem.frictional else 0.0
    terms = {"I1": term("error-energy"), "I2": term("contact"), "I3": friction}
    return {**terms, "energy_above_exact": solver.given.energy - exact.energy}
