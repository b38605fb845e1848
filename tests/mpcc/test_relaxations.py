"""Relaxations by their formulas, and the relaxed NLPs made of them."""

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC, RELAXATIONS, Options
from rmesh_nlp.mpcc.lifting import lift
from rmesh_nlp.mpcc.nlps import CompiledNLPs, relaxed_nlp, unlifted_nlp
from rmesh_nlp.mpcc.relaxations import relaxation

A, B, T = np.array([0.3, 2.0]), np.array([0.5, 0.1]), 0.04
S = 0.2  # sqrt(T)
PHI = 2 * S / (1 - 2 / np.pi)  # Steffensen and Ulbrich's s


def at(name, a=A, b=B, t=T):
    """Rows and penalty at numbers."""
    symbols = ca.SX.sym("a", np.size(a)), ca.SX.sym("b", np.size(a)), ca.SX.sym("t")
    found = relaxation(name)(*symbols)
    rows, penalty = ca.Function("f", list(symbols), [found.rows, found.penalty])(a, b, t)
    return np.array(rows).ravel(), float(penalty)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("scholtes", [0.15 - T, 0.2 - T]),
        ("lin-fukushima", [0.15 - T, 0.2 - T, -(0.15 + S * 0.8), -(0.2 + S * 2.1)]),
        (
            "steffensen-ulbrich",  # |a - b| = 0.2 lies inside of s = 1.1, 1.9 outside
            [0.8 - PHI * (2 / np.pi * np.sin(-np.pi / 2 * S / PHI + 1.5 * np.pi) + 1), 2.1 - 1.9],
        ),
        ("kanzow-schwartz", [0.1 * 0.3, 1.8 * -0.1]),
        ("fischer-burmeister", [0.8 - np.sqrt(0.34 + 2 * T), 2.1 - np.sqrt(4.01 + 2 * T)]),
    ],
)
def test_rows_are_those_of_the_formula(name, expected):
    rows, penalty = at(name)
    assert rows == pytest.approx(expected, rel=1e-12)
    assert penalty == 0


def test_kanzow_schwartz_below_the_corner_and_the_penalty_by_hand():
    assert at("kanzow-schwartz", [0.1, 0.0], [0.0, 0.0])[0][:1] == pytest.approx([-(0.1**2 + 0.2**2) / 2])
    assert at("l1-penalty") == (pytest.approx([]), pytest.approx((0.15 + 0.2) / S))
    with pytest.raises(ValueError, match="unknown relaxation 'none'; there are scholtes, lin-fukushima"):
        relaxation("none")


@pytest.mark.parametrize("name", RELAXATIONS)
def test_solution_of_max_x_on_the_diagonal_is_the_corner(name):
    """-x + x y / sqrt(t) on x = y has its minimum at sqrt(t) / 2."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    nlps = CompiledNLPs(MPCC(ca.vertcat(x, y), -x, x - y, x, y, lbg=0, ubg=0), Options())
    for t in (1.0, 1e-2, 1e-4):
        result = nlps.relaxed(name, np.array([0.1, 0.1]) * np.sqrt(t), np.ones(1), t)
        expected = np.sqrt(t) * (0.5 if name == "l1-penalty" else 1.0)
        assert result.x == pytest.approx([expected] * 2, rel=1e-4)


def nonlinear(kind):
    """One member is an unknown with bounds of its own, the others are expressions."""
    x, p = kind.sym("x", 3), kind.sym("p", 1)
    G, H = ca.vertcat(x[0] * x[1], x[2]), ca.vertcat(x[1] + p, ca.exp(x[0]) * x[2])
    return MPCC(x, ca.sumsqr(x - 1) * x[2], x[0] ** 3 - x[1], G, H, p=p, lbg=0, ubg=0, lbx=-5, ubx=[4, 5, 6])


def assert_derivatives_are_casadis(nlp, seed):
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", nlp.n_g)
    rows = [nlp.f, ca.gradient(nlp.f, nlp.x), nlp.g, ca.jacobian(nlp.g, nlp.x)]
    hessian = ca.triu(ca.hessian(lam_f * nlp.f + ca.dot(lam_g, nlp.g), nlp.x)[0])
    given = ca.Function("given", [nlp.x, nlp.p, lam_f, lam_g], [*rows, hessian])
    at = np.random.default_rng(seed)
    point, parameters = at.uniform(0.2, 1.5, nlp.n_x), at.uniform(0.2, 1.5, nlp.p.shape[0])
    lam = at.normal(size=nlp.n_g)
    own = nlp.derivatives
    ours = [*own.grad_f(point, parameters), *own.jac_g(point, parameters)]
    ours += [own.hess_lag(point, parameters, 0.7, lam)]
    for mine, casadi in zip(ours, given(point, parameters, 0.7, lam), strict=True):
        np.testing.assert_allclose(np.array(ca.DM(mine)), np.array(ca.DM(casadi)), rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
@pytest.mark.parametrize("name", [None, "unlifted", *RELAXATIONS])
def test_derivatives_of_every_compiled_nlp_are_casadis(kind, name):
    lifted = lift(nonlinear(kind))
    if name is None:
        nlp = lifted.nlp
    else:
        nlp = unlifted_nlp(lifted.source, lifted.base) if name == "unlifted" else relaxed_nlp(lifted, name)[0]
    assert_derivatives_are_casadis(nlp, 3)
