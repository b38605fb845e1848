"""Theorem 4.1: I1 + I2 equals L - J(u) where everything is integrated accurately."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.assembly import Assembled
from rmesh_nlp.fem.fields import constant_field
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.problem import ContactProblem, ExactSolution, Laplace


def evaluate(problem: ContactProblem, text: str, nodes: np.ndarray, u: np.ndarray) -> float:
    """Value of an objective at node positions and displacement unknowns."""
    model = ContactSolver(problem)
    x = ca.MX.sym("x", 1)
    groups = parse_objective(text).groups(
        problem,
        constant_field(nodes),
        constant_field(model.displacement.values(u)),
        constant_field(np.zeros((1, nodes.shape[1]))),
    )
    return float(ca.Function("f", [x], [Assembled(groups, x, ca.MX(0, 1), 0).f])(0))


def test_errors_of_a_linear_function_are_those_by_hand() -> None:
    # u_h = 0 against u = x on the unit square: |u|^2 = 1/3, |grad u|^2 = 1
    problem = replace(
        EXAMPLES["6.1"](4), law=Laplace(), exact=ExactSolution(lambda x, y: x, energy=float("nan"))
    )
    u = np.zeros(ContactSolver(problem).n_u)
    p = problem.mesh.p
    assert evaluate(problem, "error-l2", p, u) == pytest.approx(1 / 3)
    assert evaluate(problem, "error-h1", p, u) == pytest.approx(1.0)
    assert evaluate(problem, "error-energy", p, u) == pytest.approx(0.5)
    assert evaluate(problem, "error-energy + 2*error-l2", p, u) == pytest.approx(0.5 + 2 / 3)


def test_contact_error_uses_the_outward_normal() -> None:
    # du/dn = 1 on x = 1 for u = x; a constant gap of 1/2 makes I2 = 1/2
    base = EXAMPLES["6.1"](4)
    problem = replace(
        base,
        law=Laplace(),
        obstacle=replace(base.obstacle, offset=0.5),
        exact=ExactSolution(lambda x, y: x, energy=float("nan")),
    )
    u = np.zeros(ContactSolver(problem).n_u)
    assert evaluate(problem, "contact", problem.mesh.p, u) == pytest.approx(0.5)


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
        evaluate(EXAMPLES["6.2"]((4, 2)), "error-l2", EXAMPLES["6.2"]((4, 2)).mesh.p, np.zeros(24))
