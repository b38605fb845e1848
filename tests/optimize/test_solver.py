"""The one call of CasADi's solvers: wrong options are named, Ctrl-C stops them, units do not matter."""

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.optimize.nlp import NLP
from rmesh_nlp.optimize.solver import Solver


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
