"""What made solvers fail: each difficulty on a small problem of its own."""

import sys
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC, Options, classify, homotopy, solve
from rmesh_nlp.mpcc.finish import _tighten, finish
from rmesh_nlp.mpcc.homotopy import _next
from rmesh_nlp.mpcc.lpec import linearise
from rmesh_nlp.mpcc.nlps import CompiledNLPs
from rmesh_nlp.mpcc.polish import polish, project
from rmesh_nlp.mpcc.run import Run
from rmesh_nlp.mpcc.solver import _failure
from rmesh_nlp.optimize.status import Status
from support.switch_detection import switch_detection

x, y, z = ca.SX.sym("x"), ca.SX.sym("y"), ca.SX.sym("z")
XY, XYZ = ca.vertcat(x, y), ca.vertcat(x, y, z)


def overdetermined():
    """Three equations that agree with each other leave one point per branch of ``0 <= x _|_ y >= 0``.

    On the branch x = 0: y + z = 1, y - z = 1/2, so y = 3/4, z = 1/4, and the third equation is redundant.
    """
    g = ca.vertcat(x + y + z - 1, y - z - 0.5 + x, 2 * y - 1.5 + 2 * x)
    return MPCC(XYZ, (x - 1) ** 2 + y**2, g, x, y, lbg=0, ubg=0)


def test_a_branch_with_more_equations_than_unknowns_is_met_by_projection_and_by_newton():
    programs = CompiledNLPs(overdetermined(), Options())
    run = Run(programs, np.zeros(0))
    near = np.array([1e-4, 0.7501, 0.2498])
    fix_G = np.array([True])
    exact = np.array([0.0, 0.75, 0.25])
    assert project(run, near, fix_G) == pytest.approx(exact, abs=1e-9)
    zero_rows, zero = np.zeros(programs.lifted.nlp.n_g), np.zeros(3)
    assert polish(run, near, fix_G, zero_rows, zero).z == pytest.approx(exact, abs=1e-9)
    far = Run(CompiledNLPs(MPCC(XY, x, y - 100, x, y, lbg=0, ubg=0), Options()), np.zeros(0))
    assert project(far, np.ones(2), fix_G) is None  # the branch is far away: no projection


@pytest.mark.parametrize("seed", range(3))
def test_dynamics_whose_branches_leave_no_freedom_are_solved(seed):
    """Cross complementarity: a share that is on closes several multipliers with one equation."""
    instance = switch_detection(3, seed)
    result = solve(instance.mpcc, instance.x0)
    assert result.success
    assert result.constraint_violation <= 1e-8


def test_an_exact_relaxed_point_is_not_thrown_away(monkeypatch):
    """Neither Newton nor a branch NLP ends: the relaxed point, projected, is judged all the same."""
    branch = CompiledNLPs.branch

    def lost(self, z, p, *rest, **names):
        result = branch(self, z, p, *rest, **names)
        return replace(result, x=result.x + 1.0, status=Status.STALLED)

    monkeypatch.setattr(CompiledNLPs, "branch", lost)
    monkeypatch.setattr("rmesh_nlp.mpcc.finish.polish", lambda *_: None)
    result = solve(overdetermined(), 0.5)
    assert result.success
    assert result.f == pytest.approx(min(1 + 0.75**2, (0.75 - 1) ** 2), abs=1e-7)


@pytest.mark.parametrize("size", [1.0, 1e4, 1e6])
def test_residuals_of_pairs_are_judged_relative_to_their_row(size):
    """``size (x - z)`` cannot be zero more precisely than rounding of its terms allows."""
    programs = CompiledNLPs(MPCC(XYZ, x, None, size * (x - z), y), Options())
    at = np.array([3.0, 1.0, 3.0])

    def excess(error):
        point = programs.lifted.start(at + np.array([error, 0, 0]), np.zeros(0))
        return programs.excess(point, np.ones(1))

    assert Options().complementarity == Options().feasibility == 1e-8
    assert excess(1e-9) <= 1.0
    assert excess(1e-6) > 1.0


@pytest.mark.parametrize("weight", [1.0, 1e-6, 1e-12, 1e8])
def test_the_size_of_the_objective_does_not_matter(weight):
    """Local minima: (0, 2) with f = weight, and (1, 0) with f = 4 weight."""
    result = solve(MPCC(XY, weight * ((x - 1) ** 2 + (y - 2) ** 2), None, x, y), [0.3, 0.3])
    assert result.success
    assert min(abs(result.f / weight - 1), abs(result.f / weight - 4)) < 1e-8
    multiplier = result.lam_G[0] if result.x[0] < 0.5 else result.lam_H[0]
    assert multiplier / weight == pytest.approx(2 if result.x[0] < 0.5 else 4, rel=1e-6)


def test_the_tolerance_of_stationarity_is_relative_to_the_objective():
    """A point with slope is not stationary however small the objective is."""
    f = 1e-12 * ((x - 1) ** 2 + (y - 2) ** 2)
    assert classify(MPCC(XY, f, None, x, y), [0, 1.5]).stationarity == "none"
    assert classify(MPCC(XY, f, None, x, y), [0, 2]).stationarity == "S"


def test_t_follows_its_sequence_and_leaves_out_what_does_not_act():
    assert _next(1.0, 0.1, 0.9, 1e-8) == pytest.approx(0.1)
    assert _next(1.0, 0.1, 0.05, 1e-8) == pytest.approx(0.01)
    assert _next(1e-7, 0.1, 0.0, 1e-8) == pytest.approx(1e-8)
    corner = MPCC(XY, (x - 1) ** 2 + (y - 1) ** 2, None, x, y)
    result = solve(corner, [0.5, 0.6], t0=0.5, factor=0.2, crossover=1e-12)
    ts = [step.t for step in result.history if step.phase == "relaxed"]
    assert ts == pytest.approx([max(0.5 * 0.2**k, 1e-8) for k in range(len(ts))])
    assert ts[-1] < 2e-8  # the point at the last t may already be exact


def test_default_t_begins_at_1_and_falls_by_a_tenth():
    result = solve(MPCC(XY, (x - 1) ** 2 + (y - 1) ** 2, None, x, y), [0.5, 0.6])
    ts = [step.t for step in result.history if step.phase == "relaxed"]
    assert ts[:2] == pytest.approx([1.0, 0.1])


def test_an_early_finish_must_be_where_the_path_leads(monkeypatch):
    """A finish that is much worse than the relaxed solutions foretell is not taken before t_final."""
    honest = homotopy.polished

    def poor(*arguments):
        found = honest(*arguments)
        return None if found is None else replace(found, f=found.f + 1.0)

    monkeypatch.setattr(homotopy, "polished", poor)
    result = solve(MPCC(XY, (x - 1) ** 2 + (y - 1) ** 2, None, x, y), [0.5, 0.6])
    assert min(step.t for step in result.history if step.phase == "relaxed") == pytest.approx(1e-8)


def failing(monkeypatch, when):
    """Let relaxations fail where ``when(name, z, t)``, and record the calls."""
    relaxed, calls = CompiledNLPs.relaxed, []

    def shy(self, name, point, p, t, warm=None, *rest):
        result = relaxed(self, name, point, p, t, warm, *rest)
        bad = when(name, point, t)
        calls.append((name, t, warm is not None, bad))
        return replace(result, status=Status.STALLED) if bad else result

    monkeypatch.setattr(CompiledNLPs, "relaxed", shy)
    return calls


def test_another_relaxation_comes_to_the_rescue(monkeypatch):
    calls = failing(monkeypatch, lambda name, point, t: name == "scholtes")
    monkeypatch.setattr(
        "rmesh_nlp.mpcc.homotopy.finish", lambda run, point, **_: _nothing(run, point, finish)
    )
    mpcc = MPCC(XY, (x - 1) ** 2 + (y - 1) ** 2, None, x, y)
    result = solve(mpcc, [0.5, 0.6], second_path=False)
    assert result.success
    assert result.counts["rescues"] == 1
    assert "steffensen-ulbrich" in {name for name, *_ in calls}


def _nothing(run, point, honest):
    """The finish, except from the start of the solve, where it would succeed without any relaxation."""
    ends = honest(run, point, search=False)
    started = all(step.status is not Status.CONVERGED for step in run.steps if step.phase == "relaxed")
    return replace(ends, status=Status.STALLED, stationarity=None) if started else ends


def test_a_step_that_fails_from_the_last_solution_is_tried_from_the_start(monkeypatch):
    start = np.array([0.5, 0.6])
    calls = failing(monkeypatch, lambda name, point, t: t < 1 and not np.array_equal(point, start))
    result = solve(MPCC(XY, (x - 1) ** 2 + (y - 1) ** 2, None, x, y), start)
    assert result.success
    assert result.counts["rescues"] == 0
    assert [t for _, t, _, bad in calls if not bad][:2] == pytest.approx([1.0, 0.1])


def test_warm_duals_hand_the_multipliers_on(monkeypatch):
    calls = failing(monkeypatch, lambda *_: False)
    mpcc = MPCC(XY, (x - 1) ** 2 + (y - 1) ** 2, None, x, y)
    solve(mpcc, [0.5, 0.6], crossover=1e-12, warm_duals=True)
    assert [warm for _, _, warm, _ in calls] == [False] + [True] * (len(calls) - 1)
    calls.clear()
    solve(mpcc, [0.5, 0.6], crossover=1e-12)
    assert not any(warm for _, _, warm, _ in calls)


def test_a_pair_that_ends_next_to_the_corner_is_put_into_it_if_that_is_free():
    programs = CompiledNLPs(MPCC(XY, (x - 1) ** 2 + y**4, None, x - 1, y), Options())
    run = Run(programs, np.zeros(0))
    lifted = programs.lifted
    point = lifted.start(np.array([1.0, 1e-5]), np.zeros(0))
    fix_G = np.array([True])
    solved = run.branch(point, fix_G)
    near = replace(solved, x=point, f=1e-20)
    tight = _tighten(run, near, fix_G)
    assert run.steps[-1].phase == "tightened"
    assert tight.x[lifted.second] == 0.0
    lin = linearise(lifted, tight.x, run.p, 1e-5, 1e-6)
    assert list(lin.biactive) == [0]
    # where closing costs the pair stays open
    dear = CompiledNLPs(MPCC(XY, (x - 1) ** 2 + 1e8 * (y - 1e-5) ** 2, None, x - 1, y), Options())
    run = Run(dear, np.zeros(0))
    point = dear.lifted.start(np.array([1.0, 1e-5]), np.zeros(0))
    kept = _tighten(run, replace(solved, x=point, f=0.0), fix_G)
    assert kept.x[dear.lifted.second] == 1e-5


def test_a_kink_of_the_objective_is_not_infeasibility():
    result = solve(MPCC(XY, ca.fabs(x - 1) + y, None, x, y), [0.3, 0.3])
    assert result.status is not Status.INFEASIBLE
    assert result.constraint_violation <= 1e-8
    assert result.f == pytest.approx(0, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mpcc", "start"),
    [
        (MPCC(XY, x + y, None, x + 1, y + 1, lbx=0), 0.0),
        (MPCC(XY, x + y, x**2 + y**2, x, y, ubg=-1), 1.0),
        (MPCC(XY, x + y, x * y, x, y, lbg=1), 1.0),
        (MPCC(ca.SX(0, 1), 0, None, ca.SX(1), ca.SX(1)), []),
    ],
)
def test_problems_without_feasible_points_end_infeasible(mpcc, start):
    result = solve(mpcc, start)
    assert (result.status, result.success) == (Status.INFEASIBLE, False)
    assert max(result.constraint_violation, result.complementarity) > 1e-6  # the third's vanishes at infinity


def test_constant_pairs_and_no_unknowns_are_problems_like_others():
    assert solve(MPCC(ca.SX(0, 1), 0, None, ca.SX(0), ca.SX(1)), []).success
    assert solve(MPCC(ca.SX(0, 1), 0, None, None, None), []).success
    assert solve(MPCC(XY, (x - 1) ** 2 + y**2, None, ca.SX(0), ca.SX(1)), 0.0).x == pytest.approx([1, 0])
    assert solve(MPCC(x, (x - 1) ** 2, None, None, None), 0.0).x == pytest.approx([1])
    assert solve(MPCC(x, (x - 1) ** 2, x, None, None, ubg=0.5), 0.0).x == pytest.approx([0.5])


@pytest.mark.slow
def test_without_a_label_nothing_is_called_a_success(monkeypatch):
    """The multiplier programs fail numerically: the point may be right, but it is not shown to be."""
    module = sys.modules["rmesh_nlp.mpcc.stationarity"]
    monkeypatch.setattr(module, "proof_of_s", lambda *_: None)
    monkeypatch.setattr(module, "strongest", lambda *_: ("", None))
    result = solve(MPCC(XY, (x - 1) ** 2 + (y - 1) ** 2, None, x, y), [0.5, 0.6])
    assert (result.success, result.stationarity) == (False, "")
    assert result.status is Status.STALLED


def test_one_nlp_has_a_limit_that_does_not_grow_with_the_problem():
    options = Options()
    assert options.relaxed(10, warm=False)["max_iter"] <= 310
    assert options.relaxed(100_000, warm=False)["max_iter"] <= 600


def test_what_ends_at_a_feasible_point_is_not_called_infeasible():
    failed = [homotopy.Path(failure=Status.INFEASIBLE)]
    assert _failure(failed, excess=0.5) is Status.STALLED
    assert _failure(failed, excess=5.0) is Status.INFEASIBLE
    assert _failure([homotopy.Path(failure=Status.STALLED)], excess=5.0) is Status.INFEASIBLE
    assert _failure([homotopy.Path(failure=Status.ITERATION_LIMIT)], excess=5.0) is Status.ITERATION_LIMIT


@pytest.mark.parametrize("size", [1.0, 1e3, 1e6])
def test_the_size_of_a_row_does_not_hide_that_it_is_active(size):
    """Minimum at x + z = 1, y = 0, where the multiplier of the row is of size 1 / size."""
    f = 1e-6 * ((x - 2) ** 2 + (z - 2) ** 2 + (y + 1) ** 2)
    result = solve(MPCC(XYZ, f, ca.vertcat(size * (x + z), x - z), x, y, lbg=[-size, 0], ubg=[size, 0]), 0.3)
    assert result.success
    assert result.x == pytest.approx([0.5, 0, 0.5], abs=1e-6)


def test_equations_that_follow_from_each_other_do_not_hide_that_a_point_is_not_stationary():
    """The same equation twice above quartics: Ipopt's multipliers grow without bound, it stops far away."""
    w = ca.SX.sym("w", 6)
    row = w[1] - 2 * w[2] + 2 * w[3] + 3 * w[4] + w[5] + 3
    f = ca.sum1((w - ca.DM([-2, 1, 2, -3, -2, 3])) ** 4)
    start = [1.27509206, 0.59510941, -0.25152303, -0.40165235, 0.84203573, 1.82822258]
    result = solve(MPCC(w, f, ca.vertcat(row, 2 * row), None, None, lbx=-5, ubx=5, lbg=0, ubg=0), start)
    assert result.success
    assert result.f == pytest.approx(4.467838, rel=1e-5)


def test_rows_that_are_zero_by_structure():
    """A constraint and a member whose expressions CasADi knows to be zero."""
    rows = np.array([[0.0, 0, 0], [1, 0, 0]]) @ XYZ
    assert classify(MPCC(XYZ, x + y + z, rows, y, z, lbg=0), np.zeros(3)).stationarity == "S"
    zero = ca.vertcat(0 * z, x)
    assert solve(MPCC(XYZ, (x - 1) ** 2 + y**2 + z**2, None, zero, ca.vertcat(y, z)), 0.5).success
