"""Errors against an exact solution as objectives, by hand, and texts that are no objective."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.assembly import Assembled
from rmesh_nlp.fem.fields import constant_field
from rmesh_nlp.fem.objective import Fields
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.problem import ContactProblem, ExactSolution, Laplace


def at_rest(problem: ContactProblem, text: str) -> float:
    """Value of an objective without displacement on the mesh as given."""
    x, p = ca.MX.sym("x", 1), problem.mesh.p
    still = ContactSolver(problem)
    u = constant_field(still.displacement.values(np.zeros(still.n_u)))
    slip = constant_field(np.zeros((1, p.shape[1])))
    groups = parse_objective(text).on(Fields(problem, constant_field(p), u, slip)).groups
    return float(ca.Function("f", [x], [Assembled(groups, x, ca.MX(0, 1), 0).f])(0))


@pytest.mark.parametrize(
    ("text", "gap", "value"),
    [
        ("error-l2", 0.0, 1 / 3),  # the integral of x^2
        ("error-h1", 0.0, 1.0),
        ("error-energy", 0.0, 0.5),
        ("error-energy + 2*error-l2", 0.0, 0.5 + 2 / 3),
        ("contact", 0.5, 0.5),  # a constant gap along x = 1, where the outward normal derivative is 1
    ],
)
def test_u_against_the_exact_solution_x_on_the_unit_square(text: str, gap: float, value: float) -> None:
    base = EXAMPLES["6.1"](4)
    exact = ExactSolution(lambda x, y: x, energy=float("nan"))
    obstacle = replace(base.obstacle, offset=gap)
    assert at_rest(replace(base, law=Laplace(), obstacle=obstacle, exact=exact), text) == pytest.approx(value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("error-l3", "unknown objective 'error-l3'"),
        ("energy + ", "unknown objective ''"),
        ("x*energy", "the weight 'x'"),
        ("-1*quality", "the weight '-1'"),
        ("nan*quality", "the weight 'nan'"),
    ],
)
def test_bad_objectives_are_named(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        parse_objective(text)


def test_weights_may_be_written_with_exponents() -> None:
    assert parse_objective("1e-3*quality + 1e+2*energy").text == "0.001*quality + 100*energy"


def test_errors_need_an_exact_solution() -> None:
    with pytest.raises(ValueError, match=r"'error-l2' needs an exact or reference solution, and '6\.2'"):
        at_rest(EXAMPLES["6.2"]((4, 2)), "error-l2")
