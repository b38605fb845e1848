"""The door of the MPCC solver: what it refuses and what it says."""

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC, Options, multistart, solve
from rmesh_nlp.optimize.nlp import Derivatives

x, y, stray = ca.SX.sym("x"), ca.SX.sym("y"), ca.SX.sym("stray")
XY = ca.vertcat(x, y)


def corner(**changes):
    fields = {"x": XY, "f": x + y, "g": x - y, "G": x, "H": y, "lbg": -1, "ubg": 1}
    return MPCC(**{**fields, **changes})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"lbx": [0.0]}, "lbx has length 1, expected 2"),
        ({"ubg": [1.0, 2.0]}, "ubg has length 2, expected 1"),
        ({"lbx": [np.nan, 0.0]}, r"lbx\[0\] is nan, not a number"),
        ({"lbx": [0.0, 2.0], "ubx": [1.0, 1.0]}, r"lbx\[1\] = 2.0 and ubx\[1\] = 1.0"),
        ({"lbg": np.inf, "ubg": np.inf}, r"lbg\[0\]"),
        ({"lbx": "low"}, "lbx must be numeric"),
        ({"x": np.zeros(2)}, "x must be a column of CasADi SX or MX symbols"),
        ({"x": ca.vertcat(x, 2 * y)}, "x must be a column of CasADi SX or MX symbols"),
        ({"f": XY}, "f must be a scalar"),
        ({"f": x + stray}, "free symbols.*stray"),
        ({"H": XY}, "G has length 1 and H has length 2"),
        ({"p": 2 * stray}, "p must be a column of symbols"),
        ({"p": x}, "distinct symbols"),
        ({"f": ca.MX.sym("m")}, "f must be a column of SX"),
    ],
)
def test_a_malformed_problem_is_refused_with_its_fault(changes, words):
    with pytest.raises(ValueError, match=words):
        corner(**changes)


@pytest.mark.parametrize(
    ("x0", "words"),
    [
        ([0.0], "x0 has length 1"),
        ([0.0, np.nan], r"x0\[1\] is nan, not a finite"),
        ([0.0, np.inf], r"x0\[1\] is inf"),
    ],
)
def test_a_bad_start_is_refused(x0, words):
    with pytest.raises(ValueError, match=words):
        solve(corner(f=x + y, lbx=[0, 0]), x0)


def test_bad_parameters_and_options_are_refused():
    with pytest.raises(ValueError, match="p has length 0, expected 1"):
        solve(corner(f=x * stray, p=stray), [0, 0])
    with pytest.raises(ValueError, match="unknown relaxation 'none'; there are scholtes"):
        solve(corner(), [0, 0], relaxation="none")
    with pytest.raises(ValueError, match=r"factor must be below 1, got 2\.0"):
        Options(factor=2.0)
    with pytest.raises(ValueError, match=r"t0 must be positive and finite, got 0\.0"):
        Options(t0=0.0)
    with pytest.raises(ValueError, match="n = 0 starts"):
        multistart(corner(), [0, 0], n=0)


def test_derivatives_of_another_oracle_are_refused():
    column = ca.vertcat(x - y, x)  # H is missing
    wrong = Derivatives(
        ca.Function("d", [XY, ca.SX(0, 1)], [x + y, ca.densify(ca.gradient(x + y, XY))]),
        ca.Function("j", [XY, ca.SX(0, 1)], [column, ca.jacobian(column, XY)]),
        None,
    )
    with pytest.raises(ValueError, match=r"shape \(2, 2\), vertcat\(g, G, H\) needs \(3, 2\)"):
        corner(derivatives=wrong)


def test_lists_scalars_and_omitted_parts_are_accepted():
    mpcc = MPCC([x, y], (x - 1) ** 2 + y**2, None, [x], [y], lbx=-5, ubx=[5, 5])
    assert mpcc.n_g == 0
    assert list(mpcc.ubx) == [5, 5]
    assert solve(mpcc, 0.3).x == pytest.approx([1, 0], abs=1e-7)
