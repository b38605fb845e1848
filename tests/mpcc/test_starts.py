"""Many starts, and the generated families of the benchmark."""

from dataclasses import replace
from itertools import islice

import casadi as ca
import numpy as np
import pytest

from mpcc_library.families import FAMILIES
from rmesh_nlp.mpcc import MPCC, solve
from rmesh_nlp.mpcc.outcome import best_of
from rmesh_nlp.mpcc.rescues import moved_starts
from rmesh_nlp.optimize.status import Status
from support.scripted_run import XY, x, y

p = ca.SX.sym("p")
C = Status.CONVERGED


@pytest.mark.parametrize(
    "rows",
    [
        [(Status.STALLED, -9, 0, ""), (C, 1.0, 0, "S"), (C, 2.0, 0, "S")],
        [(Status.STALLED, 0, 1, ""), (Status.STALLED, 0, 0.1, ""), (Status.STALLED, -9, 0.2, "")],
        [(Status.STALLED, 0, 0.1, ""), (Status.INFEASIBLE, 0, 0.2, ""), (Status.ITERATION_LIMIT, 0, 0, "")],
        [(Status.INFEASIBLE, 0, 0.2, ""), (C, 5, 0, "S"), (Status.UNBOUNDED, -1e16, 0.5, "")],
        [(C, -9, 0, "S"), (Status.UNBOUNDED, -1e16, 0, ""), (Status.INFEASIBLE, 0, 0.1, "")],
        [(Status.INFEASIBLE, 0, 0.1, ""), (Status.ITERATION_LIMIT, 5, 0, "C"), (Status.STALLED, 0, 0, "")],
    ],
)
def test_best_is_what_any_start_has_proved(rows):
    """The lowest success; without one a verdict, and the most nearly feasible end without a verdict."""
    names, result = ("status", "f", "constraint_violation", "stationarity"), solve(ARMS, 0.5)
    ends = [replace(result, success=row[0] is C, **dict(zip(names, row, strict=True))) for row in rows]
    assert tuple(getattr(best_of(ends), name) for name in names) == rows[1]
    assert best_of(ends).ends == tuple(ends)


@pytest.mark.slow
def test_verdicts_of_one_start_are_those_of_several():
    """Linear pairs none of whose eight branches has a point; a valley along which f falls as -3 y."""
    u = ca.SX.sym("u", 4)
    G = ca.DM([[1, 2, 0, -1], [-1, -1, -2, 1], [1, 0, 1, 0]]) @ u + [1, -1, 0]
    H = ca.DM([[-2, -2, 0, -2], [-1, -2, -1, -2], [0, -1, 1, -2]]) @ u + [1, -2, 1]
    f, g = ca.vertsplit(ca.DM([[1, -2, -2, 1], [1, -1, 1, -2]]) @ u)
    infeasible = MPCC(u, f, g, G, H, ubg=-3, lbx=-5, ubx=5)
    unbounded = MPCC(XY, (y - 1) ** 2 - x * y - x, None, x - y, y)
    for mpcc, status in ((infeasible, Status.INFEASIBLE), (unbounded, Status.UNBOUNDED)):
        assert [solve(mpcc, 0.2, starts=n).status for n in (1, 2)] == [status] * 2


def test_moved_starts_are_seeded_within_bounds_and_around_the_start_and_the_origin():
    """x in [-2, 3] is drawn between its bounds, y around 700 and around 0 but not below -1e3."""
    mpcc = MPCC(XY, x, None, None, None, lbx=[-2, -1e3], ubx=[3, np.inf])
    drawn, again, other = (
        np.array(list(islice(moved_starts(mpcc, np.array([1.5, 700.0]), seed), 200))) for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(drawn, again)
    assert not np.any(np.all(drawn == other, axis=1))
    assert (drawn[:, 0].min(), drawn[:, 0].max()) == (pytest.approx(-2, abs=0.2), pytest.approx(3, abs=0.2))
    assert drawn[:, 0].mean() == pytest.approx(0.5, abs=0.3)
    assert drawn[:, 1].min() >= -1e3
    assert np.median(drawn[1::2, 1]) == pytest.approx(0, abs=8)
    assert 0.5 < np.median(np.abs(drawn[1::2, 1])) < 8  # 10^-1 to 10^1.5
    assert np.median(np.abs(drawn[::2, 1] - 700)) > 100


def test_start_of_a_mixed_problem_is_consistent():
    """-1 <= y <= 2 _|_ x - p: the new unknowns are the parts of x - p, of moved starts too."""
    mpcc = MPCC.mixed(XY, x**2 + y**2, None, x - p, y, lbH=-1, ubH=2, p=p)
    assert list(mpcc.start([1, 0], p=3)) == [1, 0, 0, 2]
    assert list(mpcc.start([4, 0], p=3)) == [4, 0, 1, 0]
    assert [own.size for own in islice(moved_starts(mpcc, mpcc.start([1, 0], p=3), 0), 3)] == [2] * 3
    assert solve(mpcc, [1, 0], p=3, starts=2).success


ARMS = MPCC(XY, (x - 1) ** 2 + (y - 1) ** 2 - 0.1 * y, None, x, y, lbx=-2, ubx=3)
"""Minima (1, 0) with f = 1 and (0, 1.05) with f = 0.8975; from t0 = 1e-4 each start keeps its arm."""


@pytest.mark.slow
def test_best_of_several_starts_says_what_they_reached_and_no_trajectory_is_followed_twice():
    many = solve(ARMS, [1.5, 0], starts=8, seed=3, t0=1e-4)
    assert many.x == pytest.approx([0, 1.05], abs=1e-7)
    assert [end.f for end in many.reached] == pytest.approx([0.8975, 1.0], abs=1e-6)
    assert sum(end.starts for end in many.reached) == len(many.ends) == 8
    assert "starts: " in str(many)
    alone = solve(ARMS, [1.5, 0], t0=1e-4)
    assert not alone.reached
    own = {id(end): end for end in many.ends}.values()
    assert 2 <= len(own) < 8
    assert many.counts["nlp_solves"] == sum(end.counts["nlp_solves"] for end in own)
    limit = alone.counts["ipopt_iterations"] + 5  # of all starts together
    many = solve(ARMS, [1.5, 0], starts=50, t0=1e-4, max_iterations=limit)
    assert 2 <= len(many.ends) < 50
    assert many.success
    late = solve(ARMS, [1.5, 0], starts=50, time_limit_s=1e-9)
    assert (late.status, late.history, late.ends) == (Status.TIME_LIMIT, (), ())


def test_starts_that_are_all_alike_at_the_first_t_are_followed_from_a_smaller_one():
    """At t = 1 both arms have one relaxed minimum, (1, 1.05) or nearly."""
    assert [end.f for end in solve(ARMS, [1.5, 0], starts=6).reached] == pytest.approx([0.8975, 1.0])


def test_rescue_from_a_moved_start_where_the_given_one_leads_nowhere():
    """log(x) is not defined between the bounds next to the given start: Ipopt gives up at once."""
    mpcc = MPCC(XY, (x - 2) ** 2 + y, ca.log(x - 0.5), x, y, lbg=-5, lbx=0, ubx=9)
    alone = solve(mpcc, [0.1, 1.0], moves=0)
    rescued = solve(mpcc, [0.1, 1.0])
    assert not alone.success
    assert rescued.success
    assert rescued.x == pytest.approx([2, 0], abs=1e-6)
    assert rescued.counts["rescues"] > alone.counts["rescues"]


@pytest.mark.parametrize("name", FAMILIES)
def test_generated_problem_is_that_of_its_seed_and_is_solved(name):
    make, sizes = FAMILIES[name]
    one, again, other = (make(sizes[0], seed) for seed in (0, 0, 1))
    assert (one.name, again.name) == (f"{name}-{sizes[0]}-0",) * 2
    point = np.linspace(0.1, 0.9, one.mpcc.n_x)

    def value(instance):
        mpcc = instance.mpcc
        column = ca.vertcat(mpcc.f, mpcc.g, mpcc.G, mpcc.H)
        return ca.Function("value", [mpcc.x], [column])(point).full().ravel()

    assert np.array_equal(value(one), value(again), equal_nan=True)
    assert other.mpcc.n_x != point.size or not np.array_equal(value(one), value(other))
    result = solve(one.mpcc, one.x0)
    assert result.success
    assert result.complementarity <= 1e-8
    assert result.constraint_violation <= 1e-7
