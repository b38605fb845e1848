"""Active sets of a point, descent over its branches, branches near an inexact one, and phase I."""

import ctypes
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC, lpec
from rmesh_nlp.mpcc.lifting import lift
from rmesh_nlp.mpcc.lpec import descent, nearest_branch
from rmesh_nlp.mpcc.rescues import phase_one
from rmesh_nlp.optimize.budget import Budget, Limits
from rmesh_nlp.optimize.status import Status
from support.scripted_run import XY, linearised, run_of, x, y


def test_what_is_active_by_hand():
    """Bounds within 1e-5 (1 + |bound|), members below 1e-6; zero bounds of members are left to the pairs."""
    v = ca.SX.sym("v", 6)
    mpcc = MPCC(v, ca.sumsqr(v), ca.vertcat(v[4] - 9, 1e3 * v[5], v[4] + v[5]), v[[0, 2]], v[[1, 3]],
                lbx=[-1, 2e-6, -1, -1, 9, -np.inf], ubx=[1, 1, 9, 0, 20, 0],
                lbg=[0, -1, -9], ubg=[0, 1e3 * 2e-5, 20])  # fmt: skip
    point = np.array([1e-6, 1.1e-6, 0.5, 0.0, 9 + 9e-5, 1e-5])
    lifted, lin = linearised(mpcc, point)
    z = lifted.start(point, np.zeros(0))
    assert list(lifted.pairs[1]) == [6, 3]  # 2e-6 <= v_1 leaves no zero: a slack
    assert z[6] == pytest.approx(1.1e-6)
    assert lin.zero.tolist() == [[True, False], [False, True]]  # 1e-6 is zero
    assert list(lin.biactive) == []
    assert list(np.flatnonzero(lin.lower[4:])) == [1, 4]  # neither member, nor v_4 of bound 9 within 1e-4
    assert list(np.flatnonzero(lin.upper[4:])) == [3, 5]
    assert list(lin.lower[:4]) == [False, False, False, True]  # the equation is 9e-5 off; the slack's row
    assert list(lin.upper[:4]) == [False, True, False, True]  # 1e-2 of 1e3 x is 1e-5 of x
    assert lin.scale == pytest.approx(2 * (9 + 9e-5))


CASES = [
    ("only y is zero: x is free, y is not", -x - 9 * y, {}, [1, 0], -1, [1, 0]),
    ("only x is zero", -9 * x + y, {}, [0, 1], -1, [0, -1]),
    ("an active upper bound", -x - 2 * y, {"ubx": [9, 0]}, [0, 0], -1, [1, 0]),
    ("an active lower bound of an unknown beside the pair", y + x, {"lbx": [1, 0]}, [1, 0], 0, [0, 0]),
    ("a row from below", -x - 2 * y, {"g": x - y, "lbg": 0}, [0, 0], -1, [1, 0]),
    ("nothing descends", x + 2 * y, {}, [0, 0], 0, [0, 0]),
]


@pytest.mark.parametrize(
    ("name", "f", "changes", "point", "decrease", "step"), CASES, ids=[c[0] for c in CASES]
)
def test_direction_of_closed_form(name, f, changes, point, decrease, step):
    found = descent(*linearised(MPCC(**{"x": XY, "f": f, "g": None, "G": x, "H": y} | changes), point))
    assert found.decrease == pytest.approx(decrease, abs=1e-9)
    assert found.step[:2] == pytest.approx(step, abs=1e-9)
    if decrease:
        assert found.zero.tolist() == [[step[0] == 0], [step[0] != 0]]


@pytest.mark.parametrize(
    ("signs", "step"), [([[3], [1]], [1, 0]), ([[1], [3]], [0, 1]), ([[-3], [-1]], [0, 1])]
)
def test_signs_name_the_branch_that_is_searched_alone(signs, step):
    found = descent(*linearised(MPCC(XY, -x - 2 * y, None, x, y), [0, 0]), signs=np.array(signs))
    assert found.step[:2] == pytest.approx(step)


@pytest.mark.parametrize(
    ("x_is", "status", "fun", "decided"),
    [(None, 2, None, False), ([0] * 15, 1, 0.0, False), ([0] * 15, 1, -1.0, True), ([0] * 15, 0, 0.0, True)],
)
def test_search_that_was_given_up_decides_only_by_a_descent(x_is, status, fun, decided, monkeypatch):
    answer = SimpleNamespace(x=None if x_is is None else np.array(x_is, float), status=status, fun=fun)
    options, pairs = [], 5
    monkeypatch.setattr(lpec, "milp", lambda *_, **names: options.append(names["options"]) or answer)
    u, v = ca.SX.sym("u", pairs), ca.SX.sym("v", pairs)
    mpcc = MPCC(ca.vertcat(u, v), ca.sum1(u), None, u, v)
    found = descent(*linearised(mpcc, np.zeros(2 * pairs)), budget=Budget(Limits(2.5)))
    assert (found is not None) == decided
    assert 0 < options[0]["time_limit"] <= 2.5


@pytest.mark.parametrize(
    ("mpcc", "slope", "end"),
    [(MPCC(XY, -x, y - x - 1e-3, x, y, lbg=0, ubg=0), (-1.0, 0.0), 1e-3),
     (MPCC(XY, -x - 2 * y, None, x, y), (-1.0, -2.0), 4e-3),
     (MPCC(XY, y, 0.1 * y - 3e-4, x, y, lbg=0), (0.0, 1.0), 3e-3)],  # dearer than the violation
)  # fmt: skip
def test_nearest_branch_meets_the_rows_first_and_then_lowers_the_objective(mpcc, slope, end):
    """y = x + 1e-3 holds on x = 0 alone, though the point is nearer to y = 0."""
    lifted, z = lift(mpcc), np.array([1e-3, 0.0])
    z, zero = nearest_branch(lifted, z, *lifted.linearise(z, np.ones(1))[1:], 4e-3, np.array(slope))
    assert (z, zero.tolist()) == (pytest.approx([0, end], abs=1e-12), [[True], [False]])


v = ca.SX.sym("v", 3)
SUM = MPCC(v, ca.sum1(v), ca.dot(ca.DM([3, 5, 9]), v), v, 1 - v, lbg=14, ubg=14)
"""Each v is 0 or 1: only (0, 1, 1) is feasible."""


def end_of(mpcc, start):
    run = run_of(mpcc)
    return run, phase_one(run, run.lifted.start(np.array(start, dtype=float), np.zeros(0)))


@pytest.mark.parametrize(
    ("mpcc", "start", "known"),
    [
        *((SUM, start, {0: 0.0, 1: 1.0, 2: 1.0}) for start in ((0.5, 0.5, 0.5), (1, 0, 0), (0, 0, 0))),
        # outside the first trust region
        (MPCC(XY, x, x + 2 * y, x, y, lbg=10), (0.2, 0), {}),
        # cos(4 x) = 1/2 with x in [0.1, 3]: the first steps go too far
        (MPCC(XY, -x, ca.cos(4 * x) + y, x, y, lbg=0.5, ubg=0.5, lbx=[0.1, 0], ubx=3), (0.11, 0), {}),
        # log(x - 1) = -2 from x = 10: the first step ends at x = 0, where it is not defined
        (MPCC(XY, x, ca.log(x - 1), x, y, lbg=-2, ubg=-2), (10, 0), {0: 1 + np.exp(-2)}),
        # of two branches the one with the lower objective
        (MPCC(XY, x + 3 * y, x + y, x, y, lbg=1), (0.4, 0.5), {1: 0.0}),
    ],
)
def test_feasible_point_is_found_over_all_branches(mpcc, start, known):
    run, (z, status) = end_of(mpcc, start)
    assert status is Status.CONVERGED
    assert run.exact(z)
    assert z[[*known]] == pytest.approx([*known.values()], abs=1e-7)


EMPTY = MPCC(XY, x, ca.vertcat(x + y, x + 2 * y), x, y, lbg=[3, -np.inf], ubg=[np.inf, 2.5])
"""Not even without complementarity feasible: 3 <= x + y <= x + 2 y <= 2.5."""


@pytest.mark.parametrize("far", [1.0, 1e9])
def test_linear_program_certifies_what_is_infeasible_without_complementarity(monkeypatch, far):
    """Also from far away, where a tolerance in units of the point would allow the violation."""
    given = []
    own = lpec.milp
    monkeypatch.setattr(lpec, "milp", lambda *a, **k: given.append(k["integrality"]) or own(*a, **k))
    _, (z, status) = end_of(EMPTY, (far, 0))
    assert (status, z[1]) == (Status.INFEASIBLE, 0)
    assert 2.5 <= z[0] <= 3
    assert far > 1 or not np.any(np.concatenate(given))


def test_violation_too_small_for_linear_programs_is_no_certificate():
    """x + 1e5 y = 1e-4 x^2 far out: rows with entries of 1e5 hide a violation of 1e-3."""
    run = run_of(MPCC(XY, x, 1e5 * (ca.exp(-1e-3 * x) - y), x, y, ubg=-1e-9))
    assert phase_one(run, np.array([2e4, 0.0]))[1] is not Status.INFEASIBLE


@pytest.mark.parametrize(
    ("rows", "bounds", "start", "is_infeasible"),
    [
        (x**2 + y**2, {"ubg": -1}, (0.3, 0.2), True),
        (x * y, {"lbg": 1}, (0.3, 0.2), True),
        (x + y, {"lbg": 1}, (0.3, 0.2), False),
        ((x - 3) ** 2 * x, {"lbg": 5}, (0.3, 0.2), True),  # at 1, where the row is 4; it holds from 4.5 on
        (x**2, {"lbg": 5}, (0.3, 0.2), False),
        # a point outside its bounds is put into them
        *((ca.exp(x) + y, {"ubg": bound}, (-0.1, -0.2), bound < 1) for bound in (0.5, 1.5)),
        # a minimum within the tolerance of 1e-8 is none
        *((x**2 + y**2 + least, {"ubg": 0}, (0, 0), least > 1e-8) for least in (0.0, 1e-9, 1e-3)),
    ],
)
def test_infeasible_is_what_has_a_local_minimum_of_the_violation(rows, bounds, start, is_infeasible):
    _, (z, status) = end_of(MPCC(XY, x, rows, x, y, **bounds), start)
    assert status is (Status.INFEASIBLE if is_infeasible else Status.CONVERGED)
    assert np.min(z[:2]) == pytest.approx(0, abs=1e-8)


@pytest.mark.parametrize("start", [[np.nan, 0.0], [np.inf, 0.0]])
def test_point_that_is_not_finite_proves_nothing(start):
    run = run_of(MPCC(XY, x, x + y, x, y, lbg=1))
    assert phase_one(run, np.array(start))[1] is Status.STALLED


def test_what_the_solver_of_linear_programs_prints_is_not_seen_and_what_others_print_is(capfd, monkeypatch):
    library = ctypes.CDLL(None)

    def loud(*_, **__):
        library.puts(b"a line of HiGHS")
        return SimpleNamespace(x=None, status=2, fun=None)

    monkeypatch.setattr(lpec, "milp", loud)
    library.puts(b"before")
    assert descent(*linearised(MPCC(XY, x, None, x, y), [0, 0])) is None
    library.puts(b"after")
    library.fflush(None)
    assert capfd.readouterr().out.split() == ["before", "after"]
