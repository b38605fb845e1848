"""Phase I: feasible complementary points, and local minima of the violation."""

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC
from rmesh_nlp.mpcc.phase_one import phase_one
from rmesh_nlp.optimize.status import Status
from support.scripted_run import XY, run_of, x, y

S = Status
v = ca.SX.sym("v", 3)
SUM = MPCC(v, ca.sum1(v), ca.dot(ca.DM([3, 5, 9]), v), v, 1 - v, lbg=14, ubg=14)
"""Each v is 0 or 1: only (0, 1, 1) is feasible."""


def end_of(mpcc, start, **how):
    run = run_of(mpcc)
    end = phase_one(run, run.lifted.start(np.array(start, dtype=float), np.zeros(0)), **how)
    return run, end


@pytest.mark.parametrize("radius", [1e-3, 1.0, np.inf])
def test_region_grows_until_a_feasible_point_is_within_reach(radius):
    run, end = end_of(MPCC(XY, x, x + 2 * y, x, y, lbg=10), [0.2, 0.0], radius=radius)
    assert end.status is S.CONVERGED
    assert run.exact(end.z)
    assert np.max(end.z) >= 5 - 1e-7


@pytest.mark.parametrize("start", [(0.5, 0.5, 0.5), (1, 0, 0), (0, 0, 0)])
def test_branch_is_found_over_all_combinations(start):
    run, end = end_of(SUM, start)
    assert end.status is S.CONVERGED
    assert end.z[:3] == pytest.approx([0, 1, 1], abs=1e-7)
    assert run.exact(end.z)


def test_region_shrinks_where_the_linearisation_is_poor():
    """cos(4 x) = 1/2 with x in [0.1, 3]: the first steps go too far."""
    _, end = end_of(MPCC(XY, -x, ca.cos(4 * x) + y, x, y, lbg=0.5, ubg=0.5, lbx=[0.1, 0], ubx=3), [0.11, 0])
    assert end.status is S.CONVERGED
    assert np.cos(4 * end.z[0]) == pytest.approx(0.5, abs=1e-7)


def test_of_feasible_branches_the_one_with_the_lower_objective_is_taken():
    mpcc = MPCC(XY, x + 3 * y, x + y, x, y, lbg=1)
    assert end_of(mpcc, [0.4, 0.5])[1].z == pytest.approx([1, 0], abs=1e-6)


@pytest.mark.parametrize("only_violation", [True, False])
def test_local_minimum_of_the_violation_is_certified(only_violation):
    run, end = end_of(MPCC(XY, x, XY, x, y, lbg=0.5), [0.3, 0.4], only_violation=only_violation)
    assert end.status is S.INFEASIBLE
    assert np.min(end.z[run.lifted.pairs]) == 0


def test_point_outside_its_bounds_is_put_into_them():
    run = run_of(MPCC(XY, x, ca.exp(x) + y, x, y, ubg=0.5))
    assert phase_one(run, np.array([-0.1, -0.2])).status is S.INFEASIBLE
    run = run_of(MPCC(XY, x, ca.exp(x) + y, x, y, ubg=1.5))
    assert phase_one(run, np.array([-0.1, -0.2])).status is S.CONVERGED


@pytest.mark.parametrize("start", [[np.nan, 0.0], [np.inf, 0.0]])
def test_point_that_is_not_finite_proves_nothing(start):
    run = run_of(MPCC(XY, x, x + y, x, y, lbg=1))
    assert phase_one(run, np.array(start)).status is S.STALLED
