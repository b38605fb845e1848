"""Solves of problems with solutions in closed form, and what a solve makes of the ends of its paths."""

import warnings

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from mpcc_library.large import obstacle_control
from rmesh_nlp.mpcc import MPCC, RELAXATIONS, Duals, MPCCSolver, classify, outcome, solve
from rmesh_nlp.mpcc.finish import Finish
from rmesh_nlp.mpcc.homotopy import Path
from rmesh_nlp.mpcc.lifting import automatic_derivatives
from support.scripted_run import START, XY, XYW, ScriptedRun, ended, two_minima, w, x, y

KINDS = [ca.SX, ca.MX]
S = rm.Status
HERE = np.array([2.0, 0.0])
ARMS = MPCC(XY, (x - 1) ** 2 + (y - 1) ** 2, None, x, y)
TRAP = MPCC(XY, (x + 1) ** 2 + (y - 1) ** 2, None, x, y)
EQUATION = {"lbg": 0, "ubg": 0}


def chosen(*paths, limit=None, infeasible=False, nearest=None, **names):
    """What is made of the ends of the paths, whose points are exact unless a test says otherwise."""
    run = ScriptedRun(**{"exact": lambda z: True} | names)
    run.nearest, run.limit, run.is_infeasible = nearest or run.nearest, limit, infeasible
    return outcome.end_of(run, paths)


@pytest.mark.parametrize(
    ("f", "point", "unbounded"),
    [(x + y, [2e15, 0.0], True), (x + y, [0.0, -2e15], True), (x + y, [1e8, 1e7], False),
     (x + y, [np.nan, 2e15], False), (-1e10 * x, [1e6, 0.0], True), (-1e10 * x, [1e4, 0.0], False)],
)  # fmt: skip
def test_iterates_or_objectives_beyond_all_measure_are_called_unbounded(f, point, unbounded):
    for path in (Path(relaxed=ended(point), failure=S.ITERATION_LIMIT),
                 Path(finish=Finish(np.array(point), 0.0, S.ITERATION_LIMIT))):  # fmt: skip
        found = chosen(path, mpcc=MPCC(XY, f, None, x, y))
        assert (found.status is S.UNBOUNDED) == unbounded == (list(found.z) == point)


@pytest.mark.parametrize(
    ("failures", "excess", "infeasible", "said"),
    [
        ([S.STALLED], 1.0, True, S.STALLED),
        ([S.INFEASIBLE, S.EVALUATION_ERROR], 1.0, True, S.EVALUATION_ERROR),
        ([S.INFEASIBLE], 0.5, True, S.STALLED),  # what ends at a feasible point is not called infeasible
        ([S.INFEASIBLE, S.FAILED], 2.0, True, S.INFEASIBLE),
        ([S.INFEASIBLE], 2.0, False, S.STALLED),  # nor what has no certificate
        ([S.INFEASIBLE, S.FAILED], 2.0, False, S.FAILED),
        ([S.STALLED, S.ITERATION_LIMIT], 2.0, False, S.ITERATION_LIMIT),
    ],
)
def test_without_an_exact_end_the_nearest_point_has_the_reason(failures, excess, infeasible, said):
    paths = [Path(failure=status) for status in failures]
    for limit in (None, S.TIME_LIMIT):
        found = chosen(*paths, limit=limit, infeasible=infeasible, nearest=(HERE, 1.0, excess))
        assert (found.z is HERE, found.lin, found.status) == (True, None, limit or said)
    assert chosen(Path(failure=S.STALLED)).z is START  # before any NLP has ended


HELPLESS = {"ipopt_relaxed": {"max_iter": 1}, "ipopt_exact": {"max_iter": 0}}
"""Options with which no NLP ends at a solution."""


def relaxed_ts(result):
    return [step.t for step in result.history if step.phase == "relaxed"]


def test_phase_one_and_then_other_t0_and_moved_starts_are_tried_once():
    far = MPCC(XY, (x - 2) ** 2, x**3 + y, x, y, lbg=1e3, ubg=1e3)
    result = solve(far, [0.5, 0.6], moves=4, **HELPLESS)
    assert not result.success
    assert result.status is not S.INFEASIBLE
    assert relaxed_ts(result) == [1.0, 0.01, 100.0, 1.0, 0.01]  # none repeats the first
    assert result.counts["rescues"] == 1 + 4
    assert solve(two_minima(), [0.5, 0.6]).counts["rescues"] == 0


def test_a_minimum_of_the_violation_ends_the_search_and_a_kink_is_none():
    empty = MPCC(XY, x + y, x**2 + y**2, x, y, ubg=-1)
    result = solve(empty, 1.0, moves=2)
    assert (result.status, relaxed_ts(result)) == (S.INFEASIBLE, [1.0])
    assert result.counts["rescues"] == 1
    result = solve(MPCC(XY, ca.fabs(x - 1) + y, None, x, y), [0.3, 0.3])
    assert result.status is not S.INFEASIBLE
    assert (result.constraint_violation, result.f) == (pytest.approx(0, abs=1e-8), pytest.approx(0, abs=1e-6))


def test_infeasible_relaxation_needs_one_linear_program_more():
    """w^2 <= -1 has no solution, whatever the pair; the message names it although the pair is open."""
    open_pair = MPCC(XYW, (x - 1) ** 2 + (y - 1) ** 2, w**2, x, y, ubg=-1)
    result = solve(open_pair, 0.5)
    assert (result.status, result.columns()["phase"]) == (S.INFEASIBLE, ["relaxed"])
    assert result.complementarity > 0.1
    assert "is in g[0]" in result.message


def test_known_multipliers_are_tried_at_once_and_else_the_homotopy_follows():
    solver = MPCCSolver(two_minima())
    known = solver([0.5, 0.6])
    again = solver(known.x, start=known)
    assert (again.columns()["phase"], again.f) == (["newton"], pytest.approx(known.f))
    right = MPCC(XY, (x - 2) ** 2 + (y - 1) ** 2, x, x, y, lbg=1)  # no point with x = 0
    far = solve(right, [0.1, 0.2], start=Duals(*map(np.zeros, (2, 1, 1, 1))))
    assert far.success
    assert "relaxed" in far.columns()["phase"]


def test_seconds_of_the_phases_add_up_to_the_total():
    """Labels and linear programs count as finish."""
    result = solve(two_minima(), [0.5, 0.6])
    assert result.seconds["homotopy"] >= sum(s.seconds for s in result.history if s.phase == "relaxed") > 0
    phases = [result.seconds[name] for name in ("build", "homotopy", "finish")]
    assert min(phases) > 0
    assert sum(phases) == pytest.approx(result.seconds["total"], rel=0.2)
    kept = MPCCSolver(two_minima())
    kept([0.5, 0.6])
    assert kept([0.5, 0.6]).seconds["build"] < 1e-6  # nothing is built twice


def bilevel(kind, form):
    """``min (x - 3)^2 + (y - 2)^2`` with y the nearest point of [0, 1] to x: x = 3, y = 1, f = 1.

    Unknowns are several symbols, or one with assembled derivatives.
    """
    v = kind.sym("v", 4) if form != "symbols" else ca.vertcat(*map(kind.sym, ("x", "y", "low", "high")))
    x, y, low, high = ca.vertsplit(v)
    f, g = (x - 3) ** 2 + (y - 2) ** 2, y - x - low + high
    G, H = ca.vertcat(low, high), ca.vertcat(y, 1 - y)
    assembled = form == "assembled"
    own = automatic_derivatives(v, kind(0, 1), f, ca.vertcat(g, G, H)) if assembled else None
    return MPCC(v, f, g, G, H, **EQUATION, derivatives=own)


@pytest.mark.parametrize(
    ("kind", "form", "relaxation"),
    [
        *((kind, form, "scholtes") for kind in KINDS for form in ("symbols", "assembled")),
        *((ca.SX, "symbols", relaxation) for relaxation in RELAXATIONS if relaxation != "scholtes"),
    ],
)
def test_every_relaxation_solves_the_bilevel_problem(kind, form, relaxation):
    result = solve(bilevel(kind, form), [0.2, 0.5, 0.1, 0.1], relaxation=relaxation)
    assert (result.success, result.status, result.stationarity) == (True, S.CONVERGED, "S")
    assert result.x == pytest.approx([3, 1, 0, 2], abs=1e-7)
    assert result.f == pytest.approx(1, abs=1e-8)
    assert result.complementarity <= 1e-9
    assert result.constraint_violation <= 1e-8
    if relaxation == "scholtes":  # its multipliers say early which branch it is
        assert result.columns()["phase"].count("relaxed") <= 4


LCP = y - 2 * x + 1


def sized(size):
    """With a row of that size, active at the solution."""
    f, g = 1e-6 * ((x - 2) ** 2 + (w - 2) ** 2 + (y + 1) ** 2), ca.vertcat(size * (x + w), x - w)
    return MPCC(XYW, f, g, x, y, lbg=[-size, 0], ubg=[size, 0])


@pytest.mark.parametrize(
    ("mpcc", "start", "x_end"),
    [
        (MPCC(XY, (x - 1) ** 2 + (y - 0.5) ** 2, None, x, y), [1, 0], [1, 0]),  # stays on its arm
        (MPCC(XY, 0, LCP, x, y, **EQUATION), [1, 1], [0.5, 0]),  # an LCP, alone and with redundant rows
        (MPCC(XY, x, ca.vertcat(LCP, 2 * LCP, x - 0.5), x, y, **EQUATION), [1, 1], [0.5, 0]),
        (MPCC(XY, x - y, None, x, y, lbx=[1, -np.inf]), [2, 1], [1, 0]),
        (MPCC(XY, (1e-4 * x - 1) ** 2 + (1e3 * y - 2) ** 2, None, 1e-4 * x, 1e3 * y), [0, 0], [0, 2e-3]),
        (MPCC(XY, (x - 1) ** 2 + y**2, x + y, None, None, ubg=0.5), [0, 1], [0.75, -0.25]),
        (MPCC(XY, (x - 1) ** 2 + y**2, None, ca.SX(0), ca.SX(1)), [0, 0], [1, 0]),
        (MPCC(XY, x + 2 * (y - 1) ** 2, y, x, y, lbg=1), [2, 2], [0, 1]),  # a weakly active row
        (MPCC(XY, (x + 1) ** 2 + (y + 1) ** 2, None, x, y), [5, -3], [0, 0]),
        # neither the size of the objective nor that of an active row matters
        *((MPCC(XY, size * ((x - 1) ** 2 + (y - 2) ** 2), None, x, y), 0.3, [0, 2]) for size in (1e-12, 1e8)),
        *((sized(size), 0.3, [0.5, 0, 0.5]) for size in (1.0, 1e6)),
        (MPCC(x, (x - 1) ** 2, None, None, None), [0], [1]),
        (MPCC(x, (x - 1) ** 2, x, None, None, ubg=0.5), [0], [0.5]),
        (MPCC(ca.SX(0, 1), 0, None, ca.SX(0), ca.SX(1)), [], []),
        (MPCC(ca.SX(0, 1), 0, None, None, None), [], []),
    ],
)
def test_solution_of_closed_form(mpcc, start, x_end):
    result = solve(mpcc, start)
    assert (result.success, result.stationarity) == (True, "S")
    assert result.x == pytest.approx(x_end, abs=1e-5)


@pytest.mark.parametrize(
    ("mpcc", "start", "status"),
    [
        (MPCC(XY, ca.log(-1 - x**2) + y, None, x, y), [0, 1], S.EVALUATION_ERROR),
        (MPCC(XY, x, None, x, y, ubx=[-1, np.inf]), [-2, 1], S.INFEASIBLE),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in (
            (MPCC(XY, x + y, XY, x, y, lbg=1), [2, 1], S.INFEASIBLE),
            (MPCC(XY, -x - y, None, x, y), [1, 1], S.UNBOUNDED),
            (MPCC(XY, x + y, None, x + 1, y + 1, lbx=0), 0.0, S.INFEASIBLE),
            (MPCC(XY, x + y, x * y, x, y, lbg=1), 1.0, S.INFEASIBLE),
            (MPCC(ca.SX(0, 1), 0, None, ca.SX(1), ca.SX(1)), [], S.INFEASIBLE),
            (MPCC(XY, x, None, x, y, lbx=[1, 1], ubx=[1, 1]), [1, 1], S.INFEASIBLE),
        )),
    ],
)  # fmt: skip
def test_problem_without_a_solution_is_named(mpcc, start, status):
    result = solve(mpcc, start)
    assert (result.status, result.success, result.stationarity) == (status, False, "")
    assert (result.b_stationary, result.n_biactive, result.counts["pivots"]) == (None, 0, 0)
    for lam in (result.lam_x, result.lam_g, result.lam_G, result.lam_H):
        assert np.all(np.isnan(lam))
    if status is S.INFEASIBLE:
        assert max(result.constraint_violation, result.complementarity) > 1e-6


@pytest.mark.slow
def test_success_is_never_said_of_a_point_without_multipliers():
    """``(x - y)^2 <= 0`` leaves only the origin, but its linearisation leaves everything."""
    result = solve(MPCC(XY, (x - 1) ** 2 + (y - 1) ** 2, (x - y) ** 2, x, y, ubg=0), [1, 1])
    assert result.x == pytest.approx([0, 0], abs=1e-3)
    assert not (result.success and result.b_stationary is False)
    assert solve(MPCC(XY, x, None, x, y, lbx=[1, 0], ubx=[1, 0]), [1, 0]).success  # all unknowns are fixed


def test_equations_that_follow_from_each_other_do_not_hide_that_a_point_is_not_stationary():
    """The same equation twice above quartics: Ipopt's multipliers grow without bound, it stops far away."""
    v = ca.SX.sym("v", 6)
    row = v[1] - 2 * v[2] + 2 * v[3] + 3 * v[4] + v[5] + 3
    f = ca.sum1((v - ca.DM([-2, 1, 2, -3, -2, 3])) ** 4)
    start = [1.27509206, 0.59510941, -0.25152303, -0.40165235, 0.84203573, 1.82822258]
    result = solve(MPCC(v, f, ca.vertcat(row, 2 * row), None, None, lbx=-5, ubx=5, **EQUATION), start)
    assert result.success
    assert result.f == pytest.approx(4.467838, rel=1e-5)


def test_the_exact_finish_alone_descends_over_the_branches_without_any_relaxation():
    """From a feasible point of one branch to its minimum, or over the corner to that of the other."""
    for mpcc, end, pivots in ((ARMS, [1.0, 0.0], 0), (TRAP, [0.0, 1.0], 1)):
        result = MPCCSolver(mpcc).finish([0.5, 0.0])
        assert (result.success, result.stationarity, result.counts["pivots"]) == (True, "S", pivots)
        assert set(result.columns()["phase"]) == {"branch"}
        assert result.x == pytest.approx(end, abs=1e-7)
    assert MPCCSolver(TRAP, max_iterations=1).finish([0.5, 0.0]).status is S.ITERATION_LIMIT


@pytest.mark.slow
def test_large_obstacle_control_is_exact_and_labelled():
    problem = obstacle_control(34**2, 0)
    result = solve(problem.mpcc, problem.x0)
    assert (result.status, result.stationarity) == (S.CONVERGED, "S")
    assert result.complementarity == 0.0
    assert result.n_biactive > 0
    assert result.f == pytest.approx(0.0584295510, rel=1e-8)  # of an end that linear programs proved
    assert {step.phase for step in result.history} <= {"relaxed", "newton", "branch"}


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"options": {"t1": 0.1}}, "unknown setting 't1'"),
        ({"options": 5}, "options must be Options or a mapping"),
        ({"start": [1, 2]}, "start must be a former result"),
        ({"start": Duals(np.zeros(3), *np.zeros((3, 1)))}, "3 multipliers lam_x, the problem needs 2"),
        ({"progress": 5}, "progress must be callable, got 5"),
        ({"on_iteration": 5}, "on_iteration must be callable, got 5"),
    ],
)
def test_a_wrong_argument_is_one_line(given, words):
    with pytest.raises(rm.BadInputError, match=words) as refused:
        solve(two_minima(), 0.5, **given)
    assert "\n" not in str(refused.value)


def test_options_may_be_a_mapping_and_values_beyond_all_measure_warn_of_nothing():
    assert solve(two_minima(), 0.5, options={"t0": 0.1}).history[0].t == 0.1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not classify(MPCC(XY, x, ca.exp(x), x, y), [1e3, 0.0]).success


def test_products_of_any_sign_vanish_and_a_start_leaves_out_their_parts():
    """(x - 1)^2 + (y + 2)^2 is least at (0, -2) where x y = 0."""
    f = (x - 1) ** 2 + (y + 2) ** 2
    plain = MPCC(XY, f, switches=(x, y))
    result = solve(plain, [0.5, 0.5])
    assert (result.success, plain.n_own, plain.n_x) == (True, 2, 6)
    assert result.x[:2] == pytest.approx([0, -2], abs=1e-6)
    assert plain.start([3, -4]) == pytest.approx([3, -4, 3, 0, 0, 4])
    with pytest.raises(ValueError, match="1 and 2 entries"):
        MPCC(XY, f, switches=(x, XY))
