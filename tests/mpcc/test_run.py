"""What a solve shows while it runs, where it stops, and what its result says."""

import signal
import time

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC, solve
from rmesh_nlp.mpcc.result import Stage, in_words
from rmesh_nlp.optimize.status import Status
from support.scripted_run import ended, run_of, two_minima


def test_iterates_are_shown_as_they_happen():
    mpcc, iterates = two_minima(), []
    result = solve(mpcc, 0.1, on_iteration=iterates.append)
    steps = [step for step in result.history if step.phase != "newton"]
    assert result.success
    # Ipopt shows its start as iteration 0 of each NLP
    assert result.counts["ipopt_iterations"] == sum(s.iterations for s in result.history)
    assert [i.iteration for i in iterates] == sorted(i.iteration for i in iterates)
    assert len(iterates) == sum(s.iterations for s in steps) + len(result.history)
    assert {(i.phase, i.t) for i in iterates} == {(s.phase, s.t) for s in result.history}
    assert iterates[-1].x.size == mpcc.n_x
    assert iterates[-1].product == pytest.approx(result.history[-1].product, rel=1e-3)
    assert iterates[-1].objective == pytest.approx(result.history[-1].objective, rel=1e-6)
    assert solve(mpcc, 0.1).x == pytest.approx(result.x, abs=1e-12)


def test_history_is_a_table_and_lines_are_shown(capsys):
    lines = []
    result = solve(two_minima(), 0.5, progress=lines.append)
    assert len(lines) == 1 + len(result.history) == 1 + result.counts["nlp_solves"]
    assert result.table() == "\n".join(lines)
    assert result.columns()["iterations"] == [step.iterations for step in result.history]
    assert result.lower_level is None  # and no word of it
    assert str(result) == (
        f"converged: f = 1, violation {result.constraint_violation:.1e}, complementarity "
        f"{result.complementarity:.1e}, stationarity S (no biactive pair: a KKT point)"
    )
    assert in_words("S", True, 1) == "S (1 biactive pair, B-stationary)"
    assert in_words("W", False, 2) == "W (2 biactive pairs, not B-stationary)"
    assert in_words("", None, 2) == "no label (2 biactive pairs, B not computed)"
    assert in_words("W", True, 0) == "W (0 biactive pairs, B-stationary)"
    solve(two_minima(), 0.5, progress=True)
    assert "relaxed" in capsys.readouterr().out
    measured = {"objective": 1.0, "constraint_violation": 0.0, "complementarity": 0.0, "product": 0.0}
    line = Stage(phase="branch", t=0.0, **measured, iterations=3).line()
    assert line.split() == ["branch", "0.0e+00", "1.00000000e+00", *["0.0e+00"] * 3, "3", "converged"]


class Ending:
    """A solver that ends at its start, with multipliers of a row of the problem and two of a relaxation."""

    def __init__(self, nlp):
        self.nlp = nlp

    def __call__(self, z, monitor):
        return ended(z, lam_g=np.array([9.0, 0.2, 0.7]))


def test_step_measures_pairs_near_the_corner_and_multipliers_of_the_relaxation():
    """Pairs (0.01, 0.1) and (0.3, 0.5): near at t = 0.01 are those below 0.2, at t = 0 below 1e-6.

    The first multiplier belongs to a row of the problem.
    """
    v = ca.SX.sym("v", 4)
    run = run_of(MPCC(v, ca.sumsqr(v), ca.sum1(v), v[:2], v[2:]))
    for z, t, near in (((0.01, 0.3, 0.1, 0.5), 0.01, 1), ((0.01, 0.3, 0.1, 0.5), 0.1, 2),
                       ((0, 0.3, 1e-6, 0.5), 0.0, 1), ((0, 0.3, 1.1e-6, 0.5), 0.0, 0)):  # fmt: skip
        run.solve("relaxed", t, Ending(run.lifted.nlp), np.array(z))
        assert (run.steps[-1].biactive, run.steps[-1].multiplier) == (near, 0.7 if t else 0.0)
    assert (run.iterations, run.steps[0].product) == (12, pytest.approx(0.15))


def test_iteration_limit_holds_and_gives_the_best_point():
    mpcc = two_minima()
    total = solve(mpcc, 0.1).counts["ipopt_iterations"]
    for limit in (1, total // 2, total - 1):
        result = solve(mpcc, 0.1, max_iterations=limit)
        assert result.counts["ipopt_iterations"] <= limit
        if not result.success:
            assert result.status is Status.ITERATION_LIMIT
            ends = [max(s.constraint_violation, s.complementarity) for s in result.history]
            assert max(result.constraint_violation, result.complementarity) <= min(ends) + 1e-12
    assert solve(mpcc, 0.1, max_iterations=total + 10).success


def test_time_limit_holds_within_an_nlp():
    shown = []

    def slow(iterate):
        shown.append(iterate.iteration)
        time.sleep(0.1)

    result = solve(two_minima(), 0.5, time_limit_s=0.15, on_iteration=slow)
    assert (result.status, result.success) == (Status.TIME_LIMIT, False)
    assert np.all(np.isfinite(result.x))
    assert len(shown) <= 3  # where the first NLP alone takes more


def test_ctrl_c_in_the_middle_of_a_solve_is_not_a_failed_result():
    seen = []

    def press(iterate):
        seen.append(iterate.iteration)
        if iterate.iteration == 2:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        solve(two_minima(), 0.5, on_iteration=press)
    assert seen == [0, 1, 2]  # at once
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
