"""The exact finish: which branches it visits, what it accepts, and how it says where it ended."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.mpcc import stationarity as module
from rmesh_nlp.mpcc.finish import finish, is_below, labelled, pivot
from support.scripted_run import XY, run_of, x, y


def test_only_the_last_point_of_a_descent_is_labelled(monkeypatch):
    """Along two pairs from (0, 0.5, 0, 0.5) to (1, 0, 1, 0)."""
    v, asked = ca.SX.sym("v", 4), []
    own = module._weaker
    monkeypatch.setattr(module, "_weaker", lambda *a: asked.append(1) or own(*a))
    f = (v[0] - 1) ** 2 + (v[1] + 1) ** 2 + (v[2] - 1) ** 2 + (v[3] + 1) ** 2
    run = run_of(rm.MPCC(v, f, None, v[[0, 2]], v[[1, 3]]))
    end = finish(run, np.array([0.0, 0.5, 0.0, 0.5]), search=False)
    assert (end.solved, end.stationarity.label, not asked) == (True, "S", True)
    assert end.z == pytest.approx([1, 0, 1, 0], abs=1e-8)
    run = run_of(rm.MPCC(XY, (x - 1) ** 2 + (y + 1) ** 2, None, x, y), max_pivots=1)
    point = labelled(run, np.zeros(2), 2.0, rm.Status.CONVERGED, is_last=False)
    assert point.stationarity.direction is not None
    left = pivot(run, replace(point, pivots=1))  # no pivot is left
    assert (left.status, left.stationarity.label, bool(asked)) == (rm.Status.ITERATION_LIMIT, "W", True)


def test_branch_that_is_hardly_lower_counts_where_it_is_stationary():
    """f falls by 4e-10 from the origin to (0, 2e-6)."""
    run = run_of(rm.MPCC(XY, (x + 1) ** 2 + 100 * (y - 2e-6) ** 2, None, x, y))
    end = finish(run, np.array([0.1, 0.0]), search=False)
    assert (end.solved, end.pivots) == (True, 1)
    assert [is_below(f, 4.0) for f in (4.0 - 1e-9, 4.0 - 1e-8)] == [False, True]  # by more than rounding


def test_branch_that_is_higher_is_not_taken(monkeypatch):
    """A solve that climbs, to a stationary point of a branch, is no descent."""
    run = run_of(rm.MPCC(XY, (x - 1) ** 2 + (y + 1) ** 2, None, x, y))
    point = labelled(run, np.zeros(2), 2.0, rm.Status.CONVERGED, is_last=False)
    solved = run.branch(point.z, point.stationarity.direction.zero)
    monkeypatch.setattr(type(run), "branch", lambda *a, **k: replace(solved, f=3.0))
    left = pivot(run, point)
    assert (left.pivots, left.f) == (0, 2.0)


def test_branch_along_which_the_objective_falls_without_end_has_no_label():
    end = finish(run_of(rm.MPCC(XY, -x, None, x, y)), np.array([1.0, 0.0]), search=False)
    assert (end.status, end.solved, end.stationarity.label) == (rm.Status.UNBOUNDED, False, "")


def test_feasible_branch_is_found_when_the_sides_are_unclear():
    """x = y - 1e-3: at x = y the sides are a coin toss and one of them is infeasible."""
    run = run_of(rm.MPCC(XY, (x - y) ** 2 + x, y - x - 1e-3, x, y, lbg=0, ubg=0))
    z = np.array([2e-3, 1e-3])  # fixes y, which is infeasible
    assert not finish(run, z, search=False).solved
    end = finish(run, z, search=True)
    assert (end.solved, end.z) == (True, pytest.approx([0, 1e-3], abs=1e-9))


def test_pairs_with_a_wrong_sign_change_sides_until_all_signs_are_right():
    """Newton steps move the contact boundary of an obstacle problem."""
    n = 9
    u, force = ca.SX.sym("u", n), ca.SX.sym("force", n)
    padded = ca.vertcat(0, u, 0)
    balance = (2 * padded[1:-1] - padded[:-2] - padded[2:]) * (n + 1) ** 2 + 1 - force
    run = run_of(rm.MPCC(ca.vertcat(u, force), 0, balance, force, u + 0.05, lbg=0, ubg=0))
    z = run.lifted.start(np.concatenate([np.zeros(n), np.ones(n)]), np.zeros(0))
    end = finish(run, z, search=True)
    assert end.solved
    assert [step.phase for step in run.steps] == ["newton"]
    assert 1 < run.steps[0].iterations < n
    touching = end.z[n : 2 * n] > 1e-6
    assert 0 < np.count_nonzero(touching) < n
    assert np.all(end.z[n : 2 * n] > -1e-8)
    assert np.all(end.z[:n] > -0.05 - 1e-8)


@pytest.mark.parametrize(("lam_rows", "solved"), [([0.0], True), ([1.0], False)])
def test_early_end_is_solved_only_if_its_own_multipliers_prove_it(lam_rows, solved):
    """At (0, 1) of `two_minima` without active rows; a linear program would find the label."""
    run = run_of(rm.MPCC(XY, (x - 2) ** 2 + (y - 1) ** 2, x + y, x, y, ubg=1.0))
    end = labelled(run, np.array([0.0, 1.0]), 4.0, rm.Status.CONVERGED, np.array(lam_rows), search=False)
    assert end.solved is solved
    assert finish(run, np.array([0.0, 1.0]), search=False).solved
