"""What a solve shows while it runs, where it stops, and what it starts from."""

import time

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC, Duals, MPCCSolver, Options, solve
from rmesh_nlp.mpcc.nlps import CompiledNLPs
from rmesh_nlp.mpcc.run import Run
from rmesh_nlp.optimize.status import Status


def obstacle(n=40):
    """``u'' = 1 - force``, ``0 <= force _|_ u + 0.05 >= 0`` on n nodes, steered by a load factor near 1."""
    h = 1 / (n + 1)
    v = ca.SX.sym("v", 2 * n + 1)
    u, force, load = v[:n], v[n : 2 * n], v[2 * n]
    padded = ca.vertcat(0, u, 0)
    balance = (2 * padded[1:-1] - padded[:-2] - padded[2:]) / h**2 + load - force
    f = h * ca.sumsqr(u + 0.02) + 0.01 * (load - 1) ** 2
    return MPCC(v, f, balance, force, u + 0.05, lbg=0, ubg=0)


@pytest.mark.slow
def test_steps_and_iterates_are_shown_as_they_happen():
    steps, iterates = [], []
    result = solve(obstacle(), 0.1, on_step=steps.append, on_iteration=iterates.append)
    assert result.success
    assert tuple(steps) == result.history
    # Ipopt shows its start as iteration 0 of each NLP
    assert iterates[-1].iteration == result.counts["ipopt_iterations"]
    assert [i.iteration for i in iterates] == sorted(i.iteration for i in iterates)
    nlps = [s for s in steps if s.phase != "polished"]
    assert len(iterates) == result.counts["ipopt_iterations"] + len(nlps)
    assert {(i.phase, i.t) for i in iterates} == {(s.phase, s.t) for s in nlps}
    assert iterates[-1].product == pytest.approx(nlps[-1].product, rel=1e-3)
    assert iterates[-1].objective == pytest.approx(nlps[-1].objective, rel=1e-6)
    quiet = solve(obstacle(), 0.1)
    assert quiet.x == pytest.approx(result.x, abs=1e-12)


def test_biactive_pairs_are_counted_in_relaxed_steps():
    """The corner of ``(x + 1)^2 + (y + 1)^2`` is biactive, the other pair is not."""
    v = ca.SX.sym("v", 4)
    f = (v[0] + 1) ** 2 + (v[1] + 1) ** 2 + (v[2] - 1) ** 2 + v[3] ** 2
    result = solve(MPCC(v, f, None, v[[0, 2]], v[[1, 3]]), 0.5)
    assert [step.biactive for step in result.history if step.t < 1e-2 and step.phase == "relaxed"][-1] == 1
    assert result.n_biactive == 1
    assert result.label == "S (1 biactive pair, B-stationary)"


def test_only_the_rows_of_a_relaxation_have_a_multiplier() -> None:
    """Near (0, 2) the row ``x y <= t`` holds x back against the pull 2 of ``(x - 1)^2``: 2 = mu y."""
    v = ca.SX.sym("v", 2)
    result = solve(MPCC(v, (v[0] - 1) ** 2 + (v[1] - 2) ** 2, None, v[0], v[1]), 0.5)
    relaxed = [step for step in result.history if step.phase == "relaxed"]
    others = [step for step in result.history if step.phase not in ("relaxed", "second")]
    assert others
    assert all(step.multiplier == 0 for step in others)
    assert relaxed[-1].multiplier == pytest.approx(1.0, rel=1e-2)


def test_s_without_a_biactive_pair_says_that_it_is_a_kkt_point():
    v = ca.SX.sym("v", 2)
    result = solve(MPCC(v, ca.sumsqr(v - 1), None, v[0], v[1]), [1, 0.5])
    assert (result.stationarity, result.n_biactive) == ("S", 0)
    assert result.label == "S (no biactive pair: a KKT point)"
    assert result.label in str(result)


@pytest.mark.slow
def test_the_iteration_limit_holds_and_gives_the_best_point():
    free = solve(obstacle(), 0.1)
    total = free.counts["ipopt_iterations"]
    for limit in (1, total // 2, total - 1):
        result = solve(obstacle(), 0.1, max_iterations=limit)
        assert result.counts["ipopt_iterations"] <= limit
        if not result.success:
            assert result.status is Status.ITERATION_LIMIT
            ends = [max(s.constraint_violation, s.complementarity) for s in result.history]
            assert max(result.constraint_violation, result.complementarity) <= min(ends) + 1e-12
    assert solve(obstacle(), 0.1, max_iterations=total + 10).success


@pytest.mark.slow
def test_the_time_limit_holds_within_an_nlp():
    """Each evaluation of this objective takes 10 ms: thousands of them would be needed."""

    class Slow(ca.Callback):
        def __init__(self):
            ca.Callback.__init__(self)
            self.construct("slow", {"enable_fd": True})

        def get_sparsity_in(self, i):
            return ca.Sparsity.dense(4, 1)

        def eval(self, arg):
            time.sleep(0.01)
            w = np.array(arg[0]).ravel()
            return [float(100 * (w[1] - w[0] ** 2) ** 2 + (1 - w[0]) ** 2 + (w[2] - w[3]) ** 2)]

    slow, v = Slow(), ca.MX.sym("v", 4)
    options = {"hessian_approximation": "limited-memory"}
    began = time.monotonic()
    result = solve(
        MPCC(v, slow(v), None, v[2], v[3]), [-1.2, 1, 0.5, 0.5], time_limit_s=1.0,
        ipopt_relaxed=options, ipopt_exact=options,
    )  # fmt: skip
    assert time.monotonic() - began < 10
    assert (result.status, result.success) == (Status.TIME_LIMIT, False)
    assert np.all(np.isfinite(result.x))


@pytest.mark.parametrize(("name", "value"), [("time_limit_s", 0), ("max_iterations", 0), ("max_pivots", 0)])
def test_limits_out_of_range_are_refused(name, value):
    with pytest.raises(ValueError, match=f"{name} must be positive and finite, got 0"):
        Options(**{name: value})


@pytest.mark.parametrize("relaxation", ["scholtes", "fischer-burmeister", "l1-penalty"])
def test_the_finish_inherits_the_multipliers_of_the_relaxation(relaxation):
    """What the rows ``G H <= t`` exert on a member is the multiplier of its bound in the branch."""
    programs, p = CompiledNLPs(obstacle(), Options()), np.ones(1)  # the parameter is the objective's weight
    z = programs.lifted.start(np.full(81, 0.1), p[:0])
    t = 1e-8
    for earlier in (1.0, 1e-2, 1e-4, 1e-6):
        z = programs.relaxed(relaxation, z, p, earlier).x
    relaxed = programs.relaxed(relaxation, z, p, t)
    warm = programs.without_relaxation(relaxation, relaxed, t)
    _, gradient, _, jacobian = programs.lifted.linearise(relaxed.x, p)
    assert np.max(np.abs(gradient + jacobian.T @ warm.lam_g + warm.lam_x)) < 1e-6
    lifted = programs.lifted
    fix_G = relaxed.x[lifted.first] <= relaxed.x[lifted.second]
    cold, hot = (Run(programs, p[:0]).branch(relaxed.x, fix_G, warm=w) for w in (None, warm))
    assert hot.converged
    assert hot.x == pytest.approx(cold.x, abs=1e-6)
    assert hot.iterations < cold.iterations


@pytest.mark.slow
def test_a_neighbouring_problem_is_solved_from_the_multipliers_of_the_first():
    """The obstacle a little lower: a few Newton steps, where the homotopy takes dozens of iterations."""
    mpcc = obstacle()
    depth = ca.SX.sym("depth")
    solver = MPCCSolver(MPCC(mpcc.x, mpcc.f, mpcc.g, mpcc.G, mpcc.H - 0.05 + depth, lbg=0, ubg=0, p=depth))
    known = solver(0.1, p=0.05)
    given = Duals(known.lam_x, known.lam_g, known.lam_G, known.lam_H)
    cold, warm = solver(known.x, p=0.0502), solver(known.x, p=0.0502, start=given)
    assert warm.success
    assert warm.f == pytest.approx(cold.f, rel=1e-7)
    assert warm.counts["ipopt_iterations"] == 0 < cold.counts["ipopt_iterations"]
    far = solver(known.x, p=0.2, start=known)  # too far for Newton's method: the homotopy goes on
    assert far.success
    assert far.f == pytest.approx(solver(known.x, p=0.2).f, rel=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("changes", [{"warm_duals": True}, {"newton_finish": False}])
def test_warm_starts_lead_to_the_same_solution(changes):
    plain = solve(obstacle(), 0.1)
    assert solve(obstacle(), 0.1, t0=1.0, factor=0.1, **changes).f == pytest.approx(plain.f, rel=1e-7)
