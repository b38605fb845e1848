"""The second trajectory: the lower end counts, and it stops where it cannot help."""

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC, Options, solve
from rmesh_nlp.mpcc.finish import Finish, finish
from rmesh_nlp.mpcc.homotopy import Path, follow, second_path
from rmesh_nlp.mpcc.lifting import automatic_derivatives, lift
from rmesh_nlp.mpcc.nlps import CompiledNLPs, unlifted_nlp
from rmesh_nlp.mpcc.run import Run
from rmesh_nlp.mpcc.solver import _choose
from rmesh_nlp.optimize.status import Status

x, y = ca.SX.sym("x"), ca.SX.sym("y")
XY = ca.vertcat(x, y)
POOR = Finish(np.array([0.0, 1.0]), 4.0, Status.CONVERGED)


def two_minima():
    """(0, 1) with f = 4 and (2, 0) with f = 1; the distances to (2, 1) are weighted."""
    return MPCC(XY, (x - 2) ** 2 + (y - 1) ** 2, None, x, y)


def looked(first, start=(0.5, 0.5), **options):
    run, path = Run(CompiledNLPs(two_minima(), Options(**options)), np.zeros(0)), Path()
    second_path(run, path, np.array(start), first)
    return run, path


def test_a_lower_minimum_than_the_first_is_found_and_chosen():
    run, path = looked(POOR)
    assert path.finish.solved
    assert path.finish.f == pytest.approx(1.0)
    ts = [step.t for step in run.steps if step.phase == "second"]
    assert ts == pytest.approx([1.0, 0.1, 0.01])  # to the crossover, no further
    assert _choose([Path(finish=POOR), path]) is path.finish


def test_of_equal_ends_the_first_is_kept():
    path, again = Path(finish=POOR), Path(finish=POOR)
    assert _choose([path, again]) is path.finish
    failed = Path(finish=Finish(POOR.z, -9.0, Status.STALLED))
    assert _choose([path, failed]) is path.finish
    assert _choose([failed, path]) is path.finish


def test_it_ends_where_it_lies_above_the_first():
    good = Finish(np.array([2.0, 0.0]), 0.0, Status.CONVERGED)
    run, path = looked(good)
    assert path.finish is None
    assert len(run.steps) == 1


def test_it_ends_without_a_finish_in_the_branch_of_the_first():
    same = Finish(np.array([2.0, 0.0]), 1.0 + 1e-4, Status.CONVERGED)
    run, path = looked(same)
    assert path.finish is None
    assert [step.phase for step in run.steps] == ["second"] * 3


def test_multipliers_are_those_of_the_lifted_program():
    """The gradient of the Lagrangian vanishes at the relaxed point up to what the product row exerts."""
    run = Run(CompiledNLPs(two_minima(), Options()), np.zeros(0))
    result = run.unlifted(np.array([0.5, 0.5]), 0.01)
    _, gradient, _, jacobian = run.lifted.linearise(result.x, run.p)
    assert gradient + jacobian.T @ result.lam_g + result.lam_x == pytest.approx(np.zeros(2), abs=1e-6)


def test_it_is_an_option_and_needs_expressions():
    def phases(**options):
        return {step.phase for step in solve(two_minima(), [0.5, 0.5], **options).history}

    assert "second" in phases()
    assert "second" not in phases(second_path=False)
    pairless = solve(MPCC(XY, x**2 + y**2, None, None, None), 1.0)
    assert "second" not in {step.phase for step in pairless.history}


def contradiction():
    """Both members at least 0.2: empty for every t below 0.04, not for t = 1."""
    return MPCC(XY, (x - 1) ** 2 + y**2, XY, x, y, lbg=0.2)


@pytest.mark.slow
def test_an_infeasible_problem_is_given_up_after_few_programs():
    result = solve(contradiction(), [0.5, 0.5])
    assert (result.status, result.success) == (Status.INFEASIBLE, False)
    assert result.counts["nlp_solves"] <= 25
    assert result.counts["rescues"] > 0  # another relaxation was asked all the same


@pytest.mark.slow
def test_a_penalty_that_ends_at_a_violation_is_not_followed_to_the_end():
    run = Run(CompiledNLPs(contradiction(), Options()), np.zeros(0))
    path = Path()
    follow(run, path, "l1-penalty", np.array([0.5, 0.5]), 1.0)
    assert path.failure is Status.INFEASIBLE
    assert min(step.t for step in run.steps if step.phase == "relaxed") > 1e-8
    feasible = Path()
    run = Run(CompiledNLPs(two_minima(), Options()), np.zeros(0))
    follow(run, feasible, "l1-penalty", np.array([0.5, 0.5]), 1.0)
    assert feasible.finish.solved


def test_an_exact_point_above_the_ceiling_is_left():
    run = Run(CompiledNLPs(two_minima(), Options()), np.zeros(0))
    z = np.array([1e-3, 1.0])  # next to the minimum 4
    assert finish(run, z, search=False, ceiling=3.0).status is Status.WORSE
    assert finish(run, z, search=False, ceiling=5.0).solved


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_derivatives_of_the_unlifted_program_are_those_of_casadi(kind):
    x, p = kind.sym("x", 3), kind.sym("p", 1)
    G, H = ca.vertcat(x[0] * x[1], x[2]), ca.vertcat(x[1] + p, ca.exp(x[0]) * x[2])
    mpcc = MPCC(x, ca.sumsqr(x - 1) * x[2], x[0] ** 3 - x[1], G, H, p=p, lbg=0, ubg=0)
    nlp = unlifted_nlp(mpcc, lift(mpcc).base)
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", nlp.n_g)
    rows = [nlp.f, ca.gradient(nlp.f, nlp.x), nlp.g, ca.jacobian(nlp.g, nlp.x)]
    hessian = ca.triu(ca.hessian(lam_f * nlp.f + ca.dot(lam_g, nlp.g), nlp.x)[0])
    given = ca.Function("given", [nlp.x, nlp.p, lam_f, lam_g], [*rows, hessian])
    at = np.random.default_rng(3)
    point, parameters, weight, lam = at.normal(size=3), at.normal(size=3), 0.7, at.normal(size=nlp.n_g)
    f, gradient, g, jacobian, second = given(point, parameters, weight, lam)
    derivatives = nlp.derivatives
    ours = [
        *derivatives.grad_f(point, parameters),
        *derivatives.jac_g(point, parameters),
        derivatives.hess_lag(point, parameters, weight, lam),
    ]
    for mine, casadi in zip(ours, [f, gradient, g, jacobian, second], strict=True):
        np.testing.assert_allclose(np.array(ca.DM(mine)), np.array(ca.DM(casadi)), rtol=1e-11, atol=1e-12)


def test_constant_derivatives_are_numbers_and_the_same():
    random = np.random.default_rng(0)
    Q, A = random.normal(size=(12, 12)), random.normal(size=(5, 12))
    x, p = ca.SX.sym("x", 12), ca.SX(0, 1)
    f, g = ca.bilin(ca.DM(Q), x, x) + x[0], ca.mtimes(ca.DM(A), x) - 1
    derivatives = automatic_derivatives(x, p, f, g)
    point, none = random.normal(size=12), np.zeros((0, 1))
    upper = derivatives.hess_lag(point, none, 2.0, np.ones(5))
    np.testing.assert_allclose(np.array(upper), np.triu(2 * (Q + Q.T)), rtol=1e-12)
    np.testing.assert_allclose(np.array(derivatives.jac_g(point, none)[1]), A, rtol=1e-14)
    assert derivatives.hess_lag.n_instructions() < 500
