"""Newton's method on a branch and the projection onto it, by hand and against Ipopt."""

import threading

import casadi as ca
import numpy as np
import pytest
import scipy.sparse as sp

from rmesh_nlp.mpcc import MPCC
from rmesh_nlp.mpcc.factors import factorised
from rmesh_nlp.mpcc.lifting import automatic_derivatives
from rmesh_nlp.mpcc.polish import polish
from rmesh_nlp.optimize.budget import Budget, Limits
from rmesh_nlp.optimize.nlp import Derivatives
from support.scripted_run import CORNER, ON_G, XY, XYW, run_of, two_minima, w, x, y

INF = np.inf


def overdetermined():
    """Three equations that agree with each other leave one point per branch of ``0 <= x _|_ y >= 0``.

    On the branch x = 0: y + w = 1, y - w = 1/2, so y = 3/4, w = 1/4, and the third equation is redundant.
    """
    g = ca.vertcat(x + y + w - 1, y - w - 0.5 + x, 2 * y - 1.5 + 2 * x)
    return MPCC(XYW, (x - 1) ** 2 + y**2, g, x, y, lbg=0, ubg=0)


def test_newton_ends_at_the_kkt_point_of_a_branch():
    """min (y-2)^2 + (w+1)^2 + y w on x = 0 with w >= -1/2 and y <= 3/2 as a row: both are active.

    2 (y - 2) + w + lam = 0, so lam = 3/2 of the row; 2 (w + 1) + y + lam = 0, so lam_w = -5/2; x gets -3.
    """
    f = (y - 2) ** 2 + (w + 1) ** 2 + y * w + 3 * x + 0.1 * x**4
    run = run_of(MPCC(XYW, f, 2 * y, x, y, ubg=3, lbx=[-INF, -INF, -0.5]))
    near = np.array([1e-3, 1.49, -0.48])
    found = polish(run, near, ON_G, np.array([0.7]), np.array([-3.0, 0.0, -2.4]))
    assert found[0] == pytest.approx([0, 1.5, -0.5], abs=1e-12)
    assert found[1] == pytest.approx(0.25 + 0.25 - 0.75)
    without = polish(run, np.array([1e-3, 1.51, -0.52]), ON_G, np.zeros(1), np.zeros(3))  # both are violated
    assert without[0] == pytest.approx(found[0], abs=1e-9)


@pytest.mark.parametrize("size", [1.0, 1e4])
@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize(("offset", "moves"), [(2.5e-8, False), (1e-6, True)])
def test_wrong_signs_are_measured_in_units_of_the_objective(size, side, offset, moves):
    """The minimum is ``offset`` inside a bound that is held at first; a multiplier of 1e-7 counts as none."""
    f = size * ((w - 2 - side * offset) ** 2 + x + (y - 1) ** 2)
    bounds = {"lbx": [-INF, -INF, 2]} if side > 0 else {"ubx": [INF, INF, 2]}
    run = run_of(MPCC(XYW, f, None, x, y, **bounds))
    found = polish(run, np.array([0, 1, 2.0]), ON_G, np.zeros(0), size * np.array([-1, 0, -1.0 * side]))
    assert found[0][2] == pytest.approx(2 + side * offset * moves, abs=1e-10)


def test_of_two_members_at_the_corner_the_one_with_the_larger_multiplier_leaves():
    """Their multipliers at the corner are 1 and 1/2."""
    run = run_of(MPCC(XY, (x - 0.5) ** 2 + (y - 0.25) ** 2, None, x, y))
    found = polish(run, np.array([1e-3, 1e-3]), CORNER, np.zeros(0), np.zeros(2))
    assert found[0] == pytest.approx([0.5, 0], abs=1e-9)


def test_without_a_hessian_or_with_a_singular_point_there_is_no_newton():
    own = automatic_derivatives(XY, ca.SX(0, 1), x + y**2, ca.vertcat(x, y))
    first_order = Derivatives(own.grad_f, own.jac_g, None)
    run = run_of(MPCC(XY, x + y**2, None, x, y, derivatives=first_order))
    assert polish(run, np.array([0, 0.1]), ON_G, np.zeros(0), np.zeros(2)) is None
    run = run_of(MPCC(XY, x + ca.log(y - 1), None, x, y))
    assert polish(run, np.array([0, 0.1]), ON_G, np.zeros(0), np.zeros(2)) is None  # NaN


def test_more_equations_than_unknowns_are_met_by_newton():
    run = run_of(overdetermined())
    near, exact = np.array([1e-4, 0.7501, 0.2498]), [0.0, 0.75, 0.25]
    assert polish(run, near, ON_G, np.zeros(3), np.zeros(3))[0] == pytest.approx(exact, abs=1e-9)


def towards_x():
    """Minimum (1/2, 0): on the branch x = 0 the member y is driven to 0, and f falls along x from there."""
    return MPCC(XY, (x - 0.5) ** 2 + (y + 1) ** 2, None, x, y)


def test_pair_at_its_corner_changes_sides_where_the_objective_falls():
    run = run_of(towards_x())
    found = polish(run, np.array([0.0, 0.1]), ON_G, np.zeros(0), np.zeros(2))
    assert found[0] == pytest.approx([0.5, 0], abs=1e-7)
    far = run_of(two_minima())  # f falls up to (2, 0): no correction but another point
    assert polish(far, np.array([1e-3, 1e-3]), CORNER, np.zeros(0), np.zeros(2)) is None


def test_dense_rows_are_bordered_and_the_solution_is_that_of_the_whole_matrix():
    random, n = np.random.default_rng(0), 2500
    border = sp.csc_matrix(random.normal(size=(n, 2)))
    line = sp.diags([-np.ones(n - 1), np.full(n, 3.0), -np.ones(n - 1)], [-1, 0, 1])
    system = sp.bmat([[line, border], [border.T, None]], format="csc")
    right = random.normal(size=n + 2)
    assert np.max(np.abs(system @ factorised(system, lambda solve: solve(right)) - right)) <= 1e-10


def test_factors_stay_in_the_thread_that_made_them():
    """SuperLU does not give back memory in another one."""
    eye = sp.identity(3, format="csc")
    solved, at = factorised(
        eye, lambda solve: (solve(np.ones(3)), threading.get_ident()), Budget(Limits(60.0))
    )
    assert list(solved) == [1, 1, 1]
    assert at != threading.get_ident()
