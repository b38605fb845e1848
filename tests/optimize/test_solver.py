"""Options of the one call of CasADi's solvers: wrong ones are named when they are given."""

import pytest

from formulations.joint import Joint
from rmesh_nlp.errors import BadInputError


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"max_iterr": 3}, "has no 'max_iterr', did you mean 'max_iter'?"),
        ({"tol": 1e-8, "max_iter": "three"}, "refuses max_iter = 'three' here"),
        ({"mu_strategy": "adaptiv"}, "refuses mu_strategy = 'adaptiv' here"),
        ({"linear_solver": "pardiso"}, "refuses linear_solver = 'pardiso' here"),
    ],
)
def test_a_wrong_option_of_ipopt_is_named(option, message, capfd) -> None:
    with pytest.raises(BadInputError) as caught:
        Joint(ipopt=option)
    assert str(caught.value) == f"ipopt must be options of Ipopt, which {message}"
    assert capfd.readouterr().out == ""
