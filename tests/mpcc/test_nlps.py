"""What is compiled: members as unknowns, relaxations by their formulas, NLPs and their residuals."""

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC, RELAXATIONS, Duals, solve
from rmesh_nlp.mpcc.lifting import lift, warm_start
from rmesh_nlp.mpcc.nlps import relaxed_nlp
from rmesh_nlp.mpcc.result import excess, residuals
from support.derivatives import assert_derivatives_are_casadis
from support.scripted_run import ON_G, XY, XYW, run_of, w, x, y

p = ca.SX.sym("p")
NONE, INF = np.zeros(0), np.inf


def test_only_members_that_are_no_unknowns_get_slacks():
    """Pairs (x, 2 y) and (y + w, w): slacks 3 and 4 for 2 y and y + w."""
    lifted = lift(
        MPCC(XYW, x, x + w, ca.vertcat(x, y + w), ca.vertcat(2 * y, w), lbg=-1, ubg=2, lbx=[-5, -6, -7])
    )
    assert lifted.pairs.tolist() == [[0, 3], [4, 2]]
    assert list(lifted.rows) == [0, 2, 3]  # g, then G_1 and H_0 of (g, G, H)
    assert list(lifted.member) == [True, False, True, True, True]
    nlp = lifted.nlp
    assert (list(nlp.lbx), list(nlp.ubx)) == ([0, -6, 0, 0, 0], [np.inf] * 5)
    assert (list(nlp.lbg), list(nlp.ubg)) == ([-1, 0, 0], [2, 0, 0])
    z = np.array([1.0, 2.0, 4.0, 10.0, 20.0])
    gradient, rows, jacobian = lifted.linearise(z, np.array([3.0]))  # weight 3
    assert (list(gradient), list(rows)) == ([3, 0, 0, 0, 0], [5, 6 - 10, 4 - 20])
    assert jacobian.toarray().tolist() == [[1, 0, 1, 0, 0], [0, 1, 1, -1, 0], [0, 2, 0, 0, -1]]
    assert z[lifted.pairs].tolist() == [[1, 10], [20, 4]]
    assert lifted.smaller(z).tolist() == [[True, False], [False, True]]
    assert lifted.smaller(np.ones(5)).tolist() == [[True, True], [False, False]]  # of equals the first
    assert list(lifted.start(np.array([1.0, 2.0, 4.0]), NONE)) == [1, 2, 4, 6, 4]
    assert list(lifted.start(np.array([1.0, -2.0, 0.0]), NONE)) == [1, -2, 0, 0, 0]  # as far as signs allow


def test_member_keeps_its_place_only_if_it_is_the_unknown_and_may_be_zero():
    others = x * (1 + 1e-9), x + 1e-9, 0 * x, ca.SX(0), x + y, x**2, -x, ca.fabs(x), ca.fmax(x, 0)
    members = ca.vertcat(x, 1.0 * x, *others)
    lifted = lift(MPCC(XYW, x, None, members, ca.SX.ones(11) * w))
    assert lifted.pairs[0].tolist() == [0, 0, *range(3, 12)]
    for lower, upper, keeps in ((0, 0, True), (-1, 1, True), (1, 2, False), (-2, -1, False)):
        lifted = lift(MPCC(XYW, x, None, x, w, lbx=[lower, 0, 0], ubx=[upper, 9, 9]))
        assert (lifted.pairs[0, 0] == 0) == keeps
        assert lifted.nlp.lbx[0] == (max(lower, 0) if keeps else lower)


def test_known_multipliers_are_put_on_rows_bounds_and_members():
    """Pair (x, 2 y): that of x joins its bound, that of 2 y its slack and its row; NaN counts as zero."""
    lifted = lift(MPCC(XYW, x, w, x, 2 * y))
    known = Duals(np.array([1.0, np.nan, 3.0]), np.array([5.0]), np.array([7.0]), np.array([11.0]))
    of_unknowns, of_rows = warm_start(lifted, 2.0, known)
    assert list(of_unknowns) == [2 * (1 + 7), 0, 6, 2 * 11]
    assert list(of_rows) == [10, 22]
    twice = lift(MPCC(XYW, x, None, ca.vertcat(x, x), ca.vertcat(y, w)))
    known = Duals(np.zeros(3), NONE, np.array([1.0, 2.0]), np.zeros(2))
    assert list(warm_start(twice, 1.0, known)[0]) == [3, 0, 0]


A, B, T = np.array([0.3, 2.0]), np.array([0.5, 0.1]), 0.04
S = 0.2  # sqrt(T)
PHI = 2 * S / (1 - 2 / np.pi)  # Steffensen and Ulbrich's s


def at(name, a=A, b=B, t=T):
    """Rows and penalty at numbers."""
    symbols = ca.SX.sym("a", np.size(a)), ca.SX.sym("b", np.size(a)), ca.SX.sym("t")
    found = RELAXATIONS[name](*symbols)
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
    assert at("kanzow-schwartz", [0.1, 0.0], [0.0, 0.0])[0][:1] == pytest.approx([-(0.1**2 + 0.2**2) / 2])
    assert at("l1-penalty") == (pytest.approx([]), pytest.approx((0.15 + 0.2) / S))


def nonlinear(kind):
    """One member is an unknown with bounds of its own, the others are expressions."""
    x, p = kind.sym("x", 3), kind.sym("p", 1)
    G, H = ca.vertcat(x[0] * x[1], x[2]), ca.vertcat(x[1] + p, ca.exp(x[0]) * x[2])
    return MPCC(x, ca.sumsqr(x - 1) * x[2], x[0] ** 3 - x[1], G, H, p=p, lbg=0, ubg=0, lbx=-5, ubx=[4, 5, 6])


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
@pytest.mark.parametrize("name", [None, *RELAXATIONS])
def test_derivatives_of_every_compiled_nlp_are_casadis(kind, name):
    lifted = lift(nonlinear(kind))
    nlp = lifted.nlp if name is None else relaxed_nlp(lifted, name)[0]
    assert_derivatives_are_casadis(nlp, seed=3)


THREE = MPCC(XY, x, x + y, ca.vertcat(x, y), ca.vertcat(y, x), lbx=-1, ubx=4, lbg=0, ubg=1)


@pytest.mark.parametrize(
    ("point", "g", "G", "H", "violation"),
    [
        ((1, 1), 0.5, (1, 1), (1, 1), 0),
        ((1, -1.5), 0.5, (1, 1), (1, 1), 0.5),
        ((5, 1), 0.5, (1, 1), (1, 1), 1),
        ((1, 1), 1.25, (1, 1), (1, 1), 0.25),
        ((1, 1), -0.25, (1, 1), (1, 1), 0.25),
        ((1, 1), 0.5, (1, -2), (1, -3), 3),
        ((1, 1), np.nan, (1, 1), (1, 1), INF),
    ],
)
def test_violation_is_the_largest_of_any_bound_or_sign(point, g, G, H, violation):
    found = residuals(THREE, np.array(point, float), np.array([g, *G, *H]), 1.0)
    assert found["constraint_violation"] == violation


def test_complementarity_is_the_smaller_member_and_product_the_product():
    found = residuals(THREE, np.ones(2), np.array([0.5, 0.1, -3.0, 4.0, 0.2]), 1.0)
    assert (found["complementarity"], found["product"]) == (pytest.approx(0.2), pytest.approx(0.6))
    found = residuals(MPCC(x, x, None, None, None), np.zeros(1), NONE, 1.0)
    assert set(found.values()) == {0}
    assert excess(NONE, 0.0, 1.0) == 0.0


@pytest.mark.parametrize(
    ("point", "units"),
    [
        ([1.0, 0.0, 0.0], 0),
        ([1.0, 3e-8, 0.0], 3),  # min(x, y), tolerance 1e-8
        ([2e-8, 3.0, 0.0], 2),
        ([-4e-8, 0.0, 0.0], 4),
        ([1.0, -5e-8, 0.0], 5),
        ([1.0, 0.0, 2 + 6e-7], 30),  # 10 w <= 20 by 6e-6, in units of its term 20: 3e-7
        ([1.0, 0.0, -3 - 7e-8], 7),  # w >= -3
    ],
)
def test_excess_is_in_units_of_the_tolerance_and_of_the_terms_of_a_row(point, units):
    own = run_of(MPCC(XYW, x, 10 * w, x, y, ubg=20, lbx=[-INF, -INF, -3]))
    assert own.excess(np.array(point)) == pytest.approx(units, rel=1e-3, abs=1e-6)
    sized = run_of(MPCC(XYW, x, None, 1e6 * (x - w), y))  # zero only up to rounding of its terms
    at_3 = sized.lifted.start(np.array([3.0 + 1e-6, 1.0, 3.0]), np.zeros(0))
    assert sized.excess(at_3) == pytest.approx(100 / 3, rel=0.01)
    assert run_of(MPCC(XYW, ca.log(x - 1), None, x, y)).excess(np.array([0.0, 1.0, 0.0])) == INF
    loose = run_of(MPCC(XY, x, x, x, y, ubg=1), feasibility=1e-2, complementarity=1e-4)
    assert loose.excess(np.array([1.02, 0.0])) == pytest.approx(2 / 1.02)
    assert loose.excess(np.array([1.0, 3e-4])) == pytest.approx(3)


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_more_equations_than_free_unknowns_are_solved_all_the_same(scale):
    """One equation three times on one free unknown, from the relaxed multipliers too."""
    g = ca.vertcat(y - 1, 2 * y - 2, 3 * y - 3)
    own = run_of(MPCC(XY, scale * (x + y), g, x, y, lbg=0, ubg=0))
    result = own.branch(np.array([0.0, 0.5]), ON_G, warm=(np.zeros(2), np.zeros(3)))
    assert result.x == pytest.approx([0, 1], abs=1e-7)
    assert (result.x.size, result.lam_x.size, result.f) == (2, 2, pytest.approx(scale))
    assert solve(MPCC(XY, x, g, x, y, lbg=0, ubg=0), 0.5).success
