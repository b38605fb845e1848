"""The exact finish: which branches it visits, what it accepts, and how it says where it ended."""

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC
from rmesh_nlp.mpcc.finish import Finish, finish, pivot, proved
from rmesh_nlp.mpcc.lpec import Direction
from rmesh_nlp.mpcc.stationarity import Stationarity
from rmesh_nlp.optimize.status import Status
from support.scripted_run import ON_H, XY, ScriptedRun, ended, run_of, x, y

S = Status
DOWN = Direction(-1.0, np.zeros(2), ON_H)
NEAR = np.array([0.1, 2.0])


def at(z, status=S.CONVERGED, f=0.0, **changes):
    """The end of a branch of a program without rows."""
    return ended(z, status, f, **{"lam_g": np.zeros(0)} | changes)


BEST, INEXACT = at([2.0, 0.0], f=1.0), at([0.3, 0.3], S.STALLED)


def scripted(*results, **options):
    """A run whose branches end in turn as given, the last of them again and again."""
    waiting = list(results)
    return ScriptedRun(branches=lambda _: waiting.pop(0) if len(waiting) > 1 else waiting[0], **options)


@pytest.mark.parametrize(
    ("result", "status"),
    [
        (at([2.0, 0.0], S.UNBOUNDED, -1e20), S.UNBOUNDED),
        (at([2.0, 0.0], f=3.0), S.CONVERGED),
        (at([0.3, 0.3], f=1.0), S.INACCURATE),  # a point that is not exact is never solved
        (INEXACT, S.STALLED),
    ],
)
def test_end_says_why_it_is_none(result, status):
    end = finish(scripted(result), NEAR, search=False)
    assert (end.status, end.f) == (status, result.f)
    assert (end.stationarity.label == "") == (not end.solved)


class TestPivot:
    """A descent over branches; at the corner of `two_minima` f falls either way, (2, 0) is stationary."""

    @staticmethod
    def descended(*ends, start=(0.0, 0.0), f=4.0, **options):
        """From a point where the next branch is that of y = 0."""
        run = scripted(*ends, **options)
        known = Stationarity("C", None, None, DOWN)
        return run, pivot(run, Finish(np.array(start), f, S.STALLED, known))

    @pytest.mark.parametrize(
        ("values", "last", "expected"),
        [
            ([3.0, 2.0], BEST, (1.0, 3, S.CONVERGED)),  # f, pivots
            ([], at([0, 0], f=5.0), (4.0, 0, S.STALLED)),  # no branch is lower
            ([], at([2.0, 0.0], f=4.0 - 1e-9), (4.0, 0, S.STALLED)),  # by more than rounding
            ([], at([0.3, 0.3], f=0.5), (4.0, 0, S.STALLED)),  # and exact
            ([3.0, 2.0, 1.0], at([0, 0], f=0.0), (1.0, 3, S.ITERATION_LIMIT)),
            ([], at([2.0, 0.0], S.UNBOUNDED, -1e20), (-1e20, 1, S.UNBOUNDED)),
        ],
    )
    def test_it_ends_where_no_branch_descends_or_at_its_limit(self, values, last, expected):
        limit = 3 if expected[-1] is S.ITERATION_LIMIT else 30
        _, end = self.descended(*(at([0, 0], f=f) for f in values), last, max_pivots=limit)
        assert (end.f, end.pivots, end.status) == expected
        assert (end.stationarity.label == "") == (end.status is S.UNBOUNDED)

    def test_wrong_branch_is_left_by_the_descent(self):
        """The finish started on the arm x = 0 of a problem whose corner is not B-stationary crosses it."""
        run = run_of(MPCC(XY, (x - 1) ** 2 + (y + 1) ** 2, None, x, y))
        end = finish(run, np.array([0.0, 0.5]), search=False)
        assert (end.solved, end.pivots) == (True, 1)
        assert end.z == pytest.approx([1, 0], abs=1e-8)


def test_feasible_branch_is_found_when_the_sides_are_unclear():
    """x = y - 1e-3: at x = y the sides are a coin toss and one of them is infeasible."""
    run = run_of(MPCC(XY, (x - y) ** 2 + x, y - x - 1e-3, x, y, lbg=0, ubg=0))
    z = np.array([2e-3, 1e-3])  # fixes y, which is infeasible
    assert not finish(run, z, search=False).solved
    end = finish(run, z, search=True)
    assert (end.solved, end.z) == (True, pytest.approx([0, 1e-3], abs=1e-9))


def test_pairs_with_a_wrong_sign_change_sides_until_all_signs_are_right():
    """The contact boundary of an obstacle problem moves node by node, each time from the one before."""
    n = 9
    u, force = ca.SX.sym("u", n), ca.SX.sym("force", n)
    padded = ca.vertcat(0, u, 0)
    balance = (2 * padded[1:-1] - padded[:-2] - padded[2:]) * (n + 1) ** 2 + 1 - force
    run = run_of(MPCC(ca.vertcat(u, force), 0, balance, force, u + 0.05, lbg=0, ubg=0))
    z = run.lifted.start(np.concatenate([np.zeros(n), np.ones(n)]), np.zeros(0))
    end = finish(run, z, search=True)
    assert end.solved
    assert {step.phase for step in run.steps} == {"signs"}
    assert 1 < len(run.steps) < n
    touching = end.z[n : 2 * n] > 1e-6
    assert 0 < np.count_nonzero(touching) < n
    assert np.all(end.z[n : 2 * n] > -1e-8)
    assert np.all(end.z[:n] > -0.05 - 1e-8)


def test_multipliers_that_lead_nowhere_are_left_and_so_is_a_place_without_a_feasible_point():
    for results, warms in (([BEST], [BEST]), ([INEXACT, BEST], [BEST, None])):
        run = scripted(*results)
        assert finish(run, NEAR, search=True, warm=BEST).solved
        assert [call.options.get("warm") for call in run.branch_calls] == warms
    nowhere = run_of(MPCC(XY, x, x**2 + y**2, x, y, ubg=-1))
    end = finish(nowhere, np.array([0.1, 0.2]), search=True)
    assert not end.solved
    assert {step.phase for step in nowhere.steps} == {"branch", "signs"}


@pytest.mark.parametrize(("negative", "signs"), [(0.9e-8, 1), (1.1e-8, 2)])
def test_signs_within_the_tolerance_are_right(negative, signs):
    run = scripted(at([0.0, -negative]), at([2.0, 0.0], f=1.0))
    assert finish(run, np.array([0.1, 0.2]), search=True).z[1] <= 0
    assert len([call for call in run.branch_calls if call.options.get("free_signs")]) == signs


@pytest.mark.parametrize(("lam_rows", "solved"), [([0.0], True), ([1.0], False)])
def test_early_end_is_solved_only_if_its_own_multipliers_prove_it(lam_rows, solved):
    """At (0, 1) of `two_minima` without active rows; a linear program would find the label."""
    run = run_of(MPCC(XY, (x - 2) ** 2 + (y - 1) ** 2, x + y, x, y, ubg=1.0))
    result = ended([0.0, 1.0], f=4.0, lam_g=np.array(lam_rows))
    assert proved(run, result).solved is solved
    assert finish(run, np.array([0.0, 1.0]), search=False).solved
