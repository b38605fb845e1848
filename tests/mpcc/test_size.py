"""What large problems rest on: dense rows, multipliers by least squares, limits."""

import threading
import time

import casadi as ca
import numpy as np
import pytest
import scipy.sparse as sp

from rmesh_nlp.mpcc import MPCC, solve
from rmesh_nlp.mpcc.factors import factorised
from rmesh_nlp.mpcc.lifting import lift
from rmesh_nlp.mpcc.lpec import linearise
from rmesh_nlp.mpcc.multipliers import by_least_squares
from rmesh_nlp.mpcc.options import LARGE
from rmesh_nlp.mpcc.stationarity import stationarity
from rmesh_nlp.optimize.budget import Budget, Limits, StoppedError
from rmesh_nlp.optimize.status import Status


def test_what_takes_too_long_is_left_and_what_fails_fails():
    assert Budget(Limits(60.0)).within(lambda: 3) == 3
    with pytest.raises(StoppedError) as stop:
        Budget(Limits(0.01)).within(lambda: time.sleep(0.5))
    assert stop.value.status is Status.TIME_LIMIT
    with pytest.raises(ZeroDivisionError):
        Budget(Limits(60.0)).within(lambda: 1 / 0)


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


def corners(slopes_G, slopes_H, g=None):
    """Pairs x_i _|_ y_i that are biactive at 0; their multipliers are minus the slopes."""
    n = len(slopes_G)
    v = ca.SX.sym("v", 2 * n)
    f = ca.dot(ca.DM(slopes_G), v[:n]) + ca.dot(ca.DM(slopes_H), v[n:])
    lifted = lift(MPCC(v, f, None if g is None else g(v), v[:n], v[n:], ubg=0))
    return lifted, linearise(lifted, np.zeros(2 * n), np.ones(1), 1e-8, 1e-8)


@pytest.mark.parametrize(
    ("slopes_G", "slopes_H", "label"),
    [
        ([1, 2, 0], [1, 0, 3], "S"),
        ([1, -2, 0], [1, 0, 3], "M"),
        ([1, -2, 0], [1, -1, 3], "C"),
        ([1, -2, 0], [1, 1, 3], "W"),
    ],
)
def test_unique_multipliers_decide_the_label_and_name_a_branch_that_descends(slopes_G, slopes_H, label):
    lifted, lin = corners(slopes_G, slopes_H)
    found = stationarity(lifted, lin, 1e-6, by_signs=True)
    assert (found.label, found.b_stationary) == (label, label == "S")
    if label != "S":
        free = lifted.pairs[~found.direction.zero]
        assert np.min(lin.gradient[free]) < 0


def test_multipliers_that_are_not_unique_prove_s_by_least_squares_with_signs():
    """x1 + x2 <= 0 holds with its multiplier what the corner's own may not: least squares alone share it."""
    lifted, lin = corners([-1, -1], [1, 1], lambda v: v[0] + v[1])
    found = by_least_squares(lifted, lin, 1e-6)
    assert (found.s_stationary, found.unique) == (True, False)
    assert np.all(found.multipliers.pairs <= 1e-6)
    assert found.multipliers.rows[0] >= 1


@pytest.mark.slow
def test_large_obstacle_control_is_exact_and_labelled_from_one_trajectory():
    m = 34
    n, h = m * m, 1 / (m + 1)
    line = sp.diags([-np.ones(m - 1), np.full(m, 2.0), -np.ones(m - 1)], [-1, 0, 1])
    laplace = ca.DM(sp.csc_matrix(sp.kronsum(line, line)) / h**2)
    s = np.arange(1, m + 1) * h
    wanted = 0.5 * np.outer(np.sin(2 * np.pi * s), np.sin(2 * np.pi * s)).ravel() - 0.02
    x = ca.SX.sym("x", 3 * n)
    u, f, force = x[:n], x[n : 2 * n], x[2 * n :]
    cost = h**2 * (ca.sumsqr(u - wanted) + 1e-3 * ca.sumsqr(f))
    result = solve(MPCC(x, cost, ca.mtimes(laplace, u) - f - force, force, u, lbg=0, ubg=0), 0.0)
    assert n >= LARGE
    assert (result.status, result.stationarity) == (Status.CONVERGED, "S")
    assert result.complementarity == 0.0
    assert result.n_biactive > 100
    assert "second" not in result.columns()["phase"]
