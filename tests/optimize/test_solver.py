"""The one call of CasADi's solvers: wrong options are named, Ctrl-C stops them, units do not matter."""

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.optimize.nlp import NLP, Derivatives
from rmesh_nlp.optimize.solver import Solver
from rmesh_nlp.optimize.units import Units


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"max_iterr": 3}, "Ipopt has no option 'max_iterr', did you mean 'max_iter'?"),
        ({"tol": 1e-8, "max_iter": "three"}, "Ipopt refuses max_iter = 'three'"),
        ({"mu_strategy": "adaptiv"}, "Ipopt refuses mu_strategy = 'adaptiv'"),
        (
            {"linear_solver": "pardiso"},
            "Ipopt refuses its options: has it the linear solver 'pardiso' here?",
        ),
    ],
)
def test_a_wrong_option_of_ipopt_is_named(option, message, capfd) -> None:
    x, none = ca.MX.sym("x"), np.zeros(0)
    nlp = NLP(x, ca.MX(0, 1), x**2, ca.MX(0, 1), np.array([-1.0]), np.array([1.0]), none, none)
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the message is compared as a whole
        Solver(nlp, options=option)([0.5])
    assert str(caught.value) == message
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize(("upper", "x", "lam_x", "lam_g"), [(9.0, 1.0, 0.0, 2.0), (0.5, 0.5, 5.0, 0.0)])
def test_results_in_other_units_are_those_of_the_nlp(upper, x, lam_x, lam_g) -> None:
    # (x - 3)^2 with 2 x <= 2 and x <= upper
    unknown, p, lam_f, lam = ca.MX.sym("x"), ca.MX(0, 1), ca.MX.sym("lam_f"), ca.MX.sym("lam")
    f, g = (unknown - 3) ** 2, 2 * unknown
    derivatives = Derivatives(
        ca.Function("f", [unknown, p], [f, ca.gradient(f, unknown)]),
        ca.Function("g", [unknown, p], [g, ca.jacobian(g, unknown)]),
        ca.Function("h", [unknown, p, lam_f, lam], [2 * lam_f]),
    )
    ends = (np.array([end]) for end in (-9.0, upper, -np.inf, 2.0))
    units = Units(np.array([10.0]), np.array([0.25]))
    solver = Solver(units.program(NLP(unknown, p, f, g, *ends, derivatives)))
    found = units.result(solver(np.array([0.0])))
    measured = np.concatenate([found.x, found.g, found.lam_x, found.lam_g, [found.f]])
    np.testing.assert_allclose(measured, [x, 2 * x, lam_x, lam_g, (x - 3) ** 2], atol=1e-6)
