"""The solver on small problems with solutions in closed form."""

import signal
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC, RELAXATIONS, MPCCSolver, Options, multistart, solve
from rmesh_nlp.mpcc.finish import finish
from rmesh_nlp.mpcc.lifting import automatic_derivatives
from rmesh_nlp.mpcc.nlps import CompiledNLPs
from rmesh_nlp.mpcc.run import Run
from rmesh_nlp.optimize.solver import Solver
from rmesh_nlp.optimize.status import Status

KINDS = [ca.SX, ca.MX]


def symbols(kind, names="xyz"):
    return [kind.sym(name) for name in names]


def bilevel(kind, derive=False):
    """``min (x - 3)^2 + (y - 2)^2`` with y the solution of ``min (y - x)^2 / 2, 0 <= y <= 1``.

    The lower level clips x to [0, 1]: y = 1 for x >= 1, so x = 3, y = 1, f = 1.
    """
    x, y, low, high = symbols(kind, ["x", "y", "low", "high"])
    unknowns = ca.vertcat(x, y, low, high)
    f, g = (x - 3) ** 2 + (y - 2) ** 2, y - x - low + high
    G, H = ca.vertcat(low, high), ca.vertcat(y, 1 - y)
    derivatives = None
    if derive:
        unknowns = kind.sym("v", 4)
        oracle = ca.Function("oracle", [ca.vertcat(x, y, low, high)], [f, g, G, H])
        f, g, G, H = oracle.call([unknowns], True, False)
        derivatives = automatic_derivatives(unknowns, kind(0, 1), f, ca.vertcat(g, G, H))
    return MPCC(unknowns, f, g, G, H, lbg=0, ubg=0, derivatives=derivatives)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("derive", [False, True])
@pytest.mark.parametrize("relaxation", RELAXATIONS)
def test_every_relaxation_solves_the_bilevel_problem(kind, derive, relaxation):
    result = solve(bilevel(kind, derive), [0.2, 0.5, 0.1, 0.1], relaxation=relaxation)
    assert result.success
    assert result.status is Status.CONVERGED
    assert result.x == pytest.approx([3, 1, 0, 2], abs=1e-7)
    assert result.f == pytest.approx(1, abs=1e-8)
    assert result.complementarity <= 1e-9
    assert result.constraint_violation <= 1e-8
    assert result.stationarity == "S"
    assert any(step.phase == "relaxed" for step in result.history)
    assert result.history[-1].phase != "relaxed"


@pytest.mark.parametrize("relaxation", [name for name in RELAXATIONS if name != "l1-penalty"])
@pytest.mark.parametrize("t", [1.0, 1e-2, 1e-4])
def test_equal_t_puts_the_corner_of_every_relaxation_at_the_same_place(relaxation, t):
    """``max x`` on the diagonal x = y: the relaxed set ends at x = y = sqrt(t)."""
    x, y = symbols(ca.SX, "xy")
    programs = CompiledNLPs(MPCC(ca.vertcat(x, y), -x, x - y, x, y, lbg=0, ubg=0), Options())
    result = programs.relaxed(relaxation, np.array([0.1, 0.1]) * np.sqrt(t), np.ones(1), t)
    assert result.x == pytest.approx([np.sqrt(t)] * 2, rel=1e-4)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("start", [(0, 0), (1, 1), (5, -3), (0, 1)])
def test_the_biactive_corner_and_the_two_arms(kind, start):
    x, y = symbols(kind, "xy")
    v = ca.vertcat(x, y)
    corner = solve(MPCC(v, (x + 1) ** 2 + (y + 1) ** 2, None, x, y), start)
    assert corner.x == pytest.approx([0, 0], abs=1e-9)
    assert list(corner.biactive) == [0]
    arms = solve(MPCC(v, (x - 1) ** 2 + (y - 1) ** 2, None, x, y), start)
    assert sorted(arms.x) == pytest.approx([0, 1], abs=1e-8)
    assert (corner.stationarity, arms.stationarity) == ("S", "S")


def test_an_optimal_start_stays():
    x, y = symbols(ca.SX, "xy")
    result = solve(MPCC(ca.vertcat(x, y), (x - 1) ** 2 + (y - 0.5) ** 2, None, x, y), [1, 0])
    assert result.x == pytest.approx([1, 0], abs=1e-9)


@pytest.mark.slow
def test_infeasible_is_named():
    x, y = symbols(ca.SX, "xy")
    result = solve(MPCC(ca.vertcat(x, y), x + y, ca.vertcat(x, y), x, y, lbg=1), [2, 1])
    assert (result.status, result.success, result.stationarity) == (Status.INFEASIBLE, False, "")
    assert max(result.constraint_violation, result.complementarity) > 0.1


@pytest.mark.slow
def test_unbounded_is_named():
    x, y = symbols(ca.SX, "xy")
    result = solve(MPCC(ca.vertcat(x, y), -x - y, None, x, y), [1, 1])
    assert (result.status, result.success) == (Status.UNBOUNDED, False)


def test_an_objective_without_a_value_is_named():
    x, y = symbols(ca.SX, "xy")
    result = solve(MPCC(ca.vertcat(x, y), ca.log(x - 1) ** 2 + y, None, x, y), [0, 1])
    assert (result.status, result.success) == (Status.EVALUATION_ERROR, False)


@pytest.mark.slow
def test_success_is_never_said_of_a_point_without_descent_certificate():
    """``(x - y)^2 <= 0`` leaves only the origin, but its linearisation leaves everything: no multipliers."""
    x, y = symbols(ca.SX, "xy")
    result = solve(MPCC(ca.vertcat(x, y), (x - 1) ** 2 + (y - 1) ** 2, (x - y) ** 2, x, y, ubg=0), [1, 1])
    assert result.x == pytest.approx([0, 0], abs=1e-3)
    assert not (result.success and result.b_stationary is False)


@pytest.mark.parametrize("kind", KINDS)
def test_square_and_overdetermined_systems(kind):
    """The linear complementarity problem x >= 0, y = 2 x - 1 >= 0, x y = 0, alone and with redundant rows."""
    x, y = symbols(kind, "xy")
    v = ca.vertcat(x, y)
    square = solve(MPCC(v, 0, y - 2 * x + 1, x, y, lbg=0, ubg=0), [1, 1])
    rows = ca.vertcat(y - 2 * x + 1, 2 * y - 4 * x + 2, x - 0.5)
    many = solve(MPCC(v, x, rows, x, y, lbg=0, ubg=0), [1, 1])
    for result in (square, many):
        assert result.success
        assert result.x == pytest.approx([0.5, 0], abs=1e-8)


@pytest.mark.slow
def test_all_unknowns_fixed():
    x, y = symbols(ca.SX, "xy")
    v = ca.vertcat(x, y)
    assert solve(MPCC(v, x, None, x, y, lbx=[1, 0], ubx=[1, 0]), [1, 0]).success
    wrong = solve(MPCC(v, x, None, x, y, lbx=[1, 1], ubx=[1, 1]), [1, 1])
    assert (wrong.success, wrong.complementarity) == (False, 1.0)


def test_bounds_of_members():
    x, y = symbols(ca.SX, "xy")
    v = ca.vertcat(x, y)
    above = solve(MPCC(v, x - y, None, x, y, lbx=[1, -np.inf]), [2, 1])
    assert above.success
    assert above.x == pytest.approx([1, 0], abs=1e-9)
    assert solve(MPCC(v, x, None, x, y, ubx=[-1, np.inf]), [-2, 1]).status is Status.INFEASIBLE


def test_scaled_members():
    x, y = symbols(ca.SX, "xy")
    f = (1e-4 * x - 1) ** 2 + (1e3 * y - 1) ** 2
    result = solve(MPCC(ca.vertcat(x, y), f, None, 1e-4 * x, 1e3 * y), [0, 0])
    assert result.success
    assert result.f == pytest.approx(1, abs=1e-6)


def test_no_pairs_is_an_ordinary_program():
    x, y = symbols(ca.SX, "xy")
    result = solve(MPCC(ca.vertcat(x, y), (x - 1) ** 2 + y**2, x + y, None, None, ubg=0.5), [0, 1])
    assert result.success
    assert result.x == pytest.approx([0.75, -0.25], abs=1e-7)


@pytest.mark.parametrize("kind", KINDS)
def test_parameters_are_values_of_one_compiled_problem(kind):
    x, y, p = symbols(kind, "xyp")
    solver = MPCCSolver(MPCC(ca.vertcat(x, y), (x - p) ** 2 + (y - 1) ** 2, None, x, y, p=p))
    for value in (3.0, 2.0):
        assert solver([1, 1], p=value).x == pytest.approx([value, 0], abs=1e-8)


def test_a_wrong_branch_is_left_by_the_descent():
    """The finish started on the arm x = 0 of a problem whose corner is not B-stationary must cross it."""
    x, y = symbols(ca.SX, "xy")
    programs = CompiledNLPs(MPCC(ca.vertcat(x, y), (x - 1) ** 2 + (y + 1) ** 2, None, x, y), Options())
    p = np.zeros(0)
    end = finish(Run(programs, p), np.array([0.0, 0.5]), search=False)
    assert end.solved
    assert end.pivots == 1
    assert end.z == pytest.approx([1, 0], abs=1e-8)


def test_a_feasible_branch_is_found_when_the_sides_are_unclear():
    """x = y - 1e-3: at x = y the sides are a coin toss and one of them is infeasible."""
    x, y = symbols(ca.SX, "xy")
    mpcc = MPCC(ca.vertcat(x, y), (x - y) ** 2 + x, y - x - 1e-3, x, y, lbg=0, ubg=0)
    programs, p = CompiledNLPs(mpcc, Options()), np.zeros(0)
    z = np.array([2e-3, 1e-3])  # fixes y, which is infeasible
    assert not finish(Run(programs, p), z, search=False).solved
    end = finish(Run(programs, p), z, search=True)
    assert end.solved
    assert end.z == pytest.approx([0, 1e-3], abs=1e-9)


@pytest.mark.slow
def test_multistart_finds_the_better_arm_and_is_repeatable():
    x, y = symbols(ca.SX, "xy")
    f = (x - 1) ** 2 + (y - 1) ** 2 - 0.1 * y
    mpcc = MPCC(ca.vertcat(x, y), f, None, x, y, lbx=-2, ubx=3)
    many = multistart(mpcc, [1.5, 0], n=8, seed=3, t0=1e-4)
    assert many.best.x == pytest.approx([0, 1.05], abs=1e-7)
    assert many.spread == pytest.approx((many.best.f, 0.9 + 0.1), abs=1e-2)
    again = multistart(mpcc, [1.5, 0], n=8, seed=3, t0=1e-4)
    assert [r.f for r in again.results] == [r.f for r in many.results]


def test_history_progress_and_warm_duals(capsys):
    lines = []
    result = solve(bilevel(ca.SX), 0.5, progress=lines.append, warm_duals=True)
    assert result.success
    assert len(lines) == 1 + len(result.history) == 1 + result.counts["nlp_solves"]
    assert result.table() == "\n".join(lines)
    columns = result.columns()
    assert columns["iterations"] == [step.iterations for step in result.history]
    assert sum(columns["iterations"]) == result.counts["ipopt_iterations"]
    assert {"build", "homotopy", "finish", "total"} <= set(result.seconds)
    solve(bilevel(ca.SX), 0.5, progress=True)
    assert "relaxed" in capsys.readouterr().out
    assert "converged" in str(result)


def test_a_failing_step_retreats(monkeypatch):
    """Relaxations that jump further down than a factor 10 fail: t must come down in smaller steps."""
    relaxed, reached = CompiledNLPs.relaxed, [10.0]

    def shy(self, name, z, p, t, *rest):
        result = relaxed(self, name, z, p, t, *rest)
        if t < 0.09 * reached[-1]:
            return replace(result, status=Status.STALLED)
        reached.append(t)
        return result

    monkeypatch.setattr(CompiledNLPs, "relaxed", shy)
    result = solve(bilevel(ca.SX), 0.5, factor=1e-2)
    assert result.success
    assert any(step.status is Status.CONVERGED and step.t < 1 for step in result.history)


@pytest.fixture
def _ctrl_c_raises():
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("_ctrl_c_raises")
def test_ctrl_c_in_the_middle_of_a_solve_is_not_a_failed_result():
    def press(iteration, x, f):
        if iteration == 2:
            signal.raise_signal(signal.SIGINT)

    nlp = CompiledNLPs(bilevel(ca.SX), Options()).lifted.nlp
    with pytest.raises(KeyboardInterrupt):
        Solver(nlp, monitor=press)(np.full(nlp.n_x, 0.5))
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_weakly_active_bound_does_not_spoil_the_label():
    """The bound y >= 1 is met exactly with multiplier zero; the solver stops a little before it."""
    x, y = symbols(ca.SX, "xy")
    result = solve(MPCC(ca.vertcat(x, y), x + 2 * (y - 1) ** 2, None, x, y, lbx=[0, -1], ubx=3), [2, 2])
    bounded = solve(MPCC(ca.vertcat(x, y), x + 2 * (y - 1) ** 2, y, x, y, lbg=1), [2, 2])
    assert (result.stationarity, bounded.stationarity) == ("S", "S")
    assert bounded.x == pytest.approx([0, 1], abs=1e-5)


@pytest.mark.slow
def test_a_sparse_square_problem_of_a_thousand_pairs():
    """Obstacle problem u'' + load, u >= -0.05, on 1000 nodes; the contact force is the other member."""
    n, h = 1000, 1 / 1001
    v = ca.MX.sym("v", 2 * n)
    u, force = ca.vertsplit(v, [0, n, 2 * n])
    padded = ca.vertcat(0, u, 0)
    balance = (2 * padded[1:-1] - padded[:-2] - padded[2:]) / h**2 + 1 - force
    result = solve(MPCC(v, 0.5 * h * ca.sumsqr(u), balance, force, u + 0.05, lbg=0, ubg=0), 0.0)
    assert result.success
    # u'' = 1 off the contact, u = u' = 0 relative to the obstacle at its ends: width sqrt(2 * 0.05)
    assert np.sum(result.G > 0.5) * h == pytest.approx(1 - 2 * np.sqrt(0.1), abs=3 * h)
