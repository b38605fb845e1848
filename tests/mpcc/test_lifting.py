"""Members of pairs as plain unknowns: slacks where needed, rows, starts, weight, known multipliers."""

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC, Duals
from rmesh_nlp.mpcc.lifting import automatic_derivatives, lift, warm_start
from support.scripted_run import XYW, w, x, y

p = ca.SX.sym("p")
NONE = np.zeros(0)


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
    f, gradient, rows, jacobian = lifted.linearise(z, np.array([3.0]))  # weight 3
    assert (f, list(gradient), list(rows)) == (3.0, [3, 0, 0, 0, 0], [5, 6 - 10, 4 - 20])
    assert jacobian.toarray().tolist() == [[1, 0, 1, 0, 0], [0, 1, 1, -1, 0], [0, 2, 0, 0, -1]]
    assert z[lifted.pairs].tolist() == [[1, 10], [20, 4]]
    assert lifted.smaller(z).tolist() == [[True, False], [False, True]]
    assert lifted.smaller(np.ones(5)).tolist() == [[True, True], [False, False]]  # of equals the first


def test_member_keeps_its_place_only_if_it_is_the_unknown_and_may_be_zero():
    members = ca.vertcat(x, 1.0 * x, x * (1 + 1e-9), x + 1e-9, 0 * x, ca.SX(0), x + y, x**2, -x)
    ones = ca.SX.ones(9) * w
    lifted = lift(MPCC(XYW, x, None, members, ones))
    assert lifted.pairs[0].tolist() == [0, 0, *range(3, 10)]
    for lower, upper, keeps in ((0, 0, True), (-1, 1, True), (1, 2, False), (-2, -1, False)):
        lifted = lift(MPCC(XYW, x, None, x, w, lbx=[lower, 0, 0], ubx=[upper, 9, 9]))
        assert (lifted.pairs[0, 0] == 0) == keeps
        assert lifted.nlp.lbx[0] == (max(lower, 0) if keeps else lower)


def test_start_extends_by_slacks_that_meet_their_rows_as_far_as_signs_allow():
    lifted = lift(MPCC(XYW, x, x, ca.vertcat(2 * y, w - 1), ca.vertcat(x * p, 1 / w), p=p))
    assert list(lifted.start(np.array([1.0, 2.0, 4.0]), np.array([5.0]))) == [1, 2, 4, 4, 3, 5, 0.25]
    assert list(lifted.start(np.array([1.0, -2.0, 0.0]), np.array([5.0]))) == [1, -2, 0, 0, 0, 5, 0]


@pytest.mark.parametrize(
    ("f", "weight"), [(1e-4 * x, 1e4), (3 * x, 1.0), (ca.SX(7), 1.0), (0.5 * x - 0.25 * w, 2.0)]
)
def test_weight_brings_small_slopes_up_to_one(f, weight):
    assert lift(MPCC(XYW, f, None, x, w)).weight(np.zeros(3), NONE) == pytest.approx(weight)


def test_weight_looks_beside_a_start_where_the_slope_vanishes():
    lifted = lift(MPCC(XYW, 1e-3 * ca.sumsqr(XYW), None, x, w))
    weight = lifted.weight(np.zeros(3), NONE)
    assert 1e3 <= weight < 1e5  # a slope of at most 1e-3 within 0.5 of the start
    bad = lift(MPCC(XYW, 1e-2 * ca.sqrt(x), None, x, w))
    assert np.isfinite(bad.weight(np.full(3, -1.0), NONE))


def test_known_multipliers_are_put_on_rows_bounds_and_members():
    """Pair (x, 2 y): that of x joins its bound, that of 2 y its slack and its row; NaN counts as zero."""
    lifted = lift(MPCC(XYW, x, w, x, 2 * y))
    known = Duals(np.array([1.0, np.nan, 3.0]), np.array([5.0]), np.array([7.0]), np.array([11.0]))
    warm = warm_start(lifted, np.ones(4), 2.0, known)
    assert list(warm.lam_x) == [2 * (1 + 7), 0, 6, 2 * 11]
    assert list(warm.lam_g) == [10, 22]
    assert warm.converged
    twice = lift(MPCC(XYW, x, None, ca.vertcat(x, x), ca.vertcat(y, w)))
    known = Duals(np.zeros(3), NONE, np.array([1.0, 2.0]), np.zeros(2))
    assert list(warm_start(twice, np.ones(3), 1.0, known).lam_x) == [3, 0, 0]


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_constant_derivatives_are_numbers(kind):
    Q, v = np.random.default_rng(0).normal(size=(12, 12)), kind.sym("v", 12)
    f = ca.bilin(ca.DM(Q), v, v) + v[0]
    derivatives = automatic_derivatives(v, kind(0, 1), f, ca.mtimes(ca.DM(Q[:5]), v) - 1)
    upper = derivatives.hess_lag(np.ones(12), np.zeros((0, 1)), 2.0, np.ones(5))
    np.testing.assert_allclose(np.array(upper), np.triu(2 * (Q + Q.T)), rtol=1e-12)
    np.testing.assert_allclose(np.array(derivatives.jac_g(np.ones(12), np.zeros((0, 1)))[1]), Q[:5])
    assert derivatives.hess_lag.n_instructions() < 500
