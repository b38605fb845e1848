"""Labels against problems whose multipliers are worked out by hand.

At the origin of ``min c x + d y, 0 <= x _|_ y >= 0`` the multipliers are unique: (nu_x, nu_y) = (c, d) in the
sign where S means both non-negative.
"""

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC, Options, classify, solve
from rmesh_nlp.mpcc.homotopy import _same_branch
from rmesh_nlp.mpcc.interfaces import MultiStart
from rmesh_nlp.mpcc.lpec import descent, linearise
from rmesh_nlp.mpcc.nlps import CompiledNLPs
from rmesh_nlp.mpcc.stationarity import Multipliers, Stationarity, stationarity
from rmesh_nlp.optimize.status import Status

x, y, z = ca.SX.sym("x"), ca.SX.sym("y"), ca.SX.sym("z")


@pytest.mark.parametrize(
    ("c", "d", "label", "b_stationary"),
    [
        (1, 1, "S", True),
        (1, 0, "S", True),
        (-1, 0, "M", False),  # d_x = 1 descends
        (0, -1, "M", False),
        (-1, -1, "C", False),
        (1, -1, "W", False),
        (-2, 3, "W", False),
        (-1000, 2e-6, "M", False),  # zero is relative to the largest slope
        (-1000, 2e-2, "W", False),
    ],
)
def test_each_label_at_a_corner_with_unique_multipliers(c, d, label, b_stationary):
    found = classify(MPCC(ca.vertcat(x, y), c * x + d * y, None, x, y), [0, 0])
    assert (found.stationarity, found.b_stationary) == (label, b_stationary)
    assert list(found.biactive) == [0]


@pytest.mark.parametrize(("c", "d", "label"), [(1, 1, "S"), (1, -1, "W"), (-1, 1, "W"), (-1, -1, "C")])
def test_multipliers_that_a_solver_offers_prove_s_only_with_both_signs(c, d, label):
    options = Options()
    programs = CompiledNLPs(MPCC(ca.vertcat(x, y), c * x + d * y, None, x, y), options)
    lifted = programs.lifted
    z = lifted.start(np.zeros(2), np.zeros(0))
    lin = linearise(lifted, z, np.ones(1), options.activity, options.corner)
    offered = np.zeros(lifted.nlp.n_g), -lin.gradient
    assert stationarity(lifted, lin, options.stationarity, offered).label == label


def test_a_free_unknown_with_slope_has_no_multipliers():
    found = classify(MPCC(ca.vertcat(x, y, z), x + y + z, None, x, y), [0, 0, 0])
    assert (found.stationarity, found.b_stationary) == ("none", False)


def test_an_infeasible_point_gets_no_label():
    found = classify(MPCC(ca.vertcat(x, y), x + y, None, x, y), [1, 1])
    assert (found.stationarity, found.b_stationary, found.feasible) == ("", None, False)


def test_one_pair_of_many_spoils_the_label():
    """Eight independent corners: more than the LPEC enumerates, so the MILP is asked."""
    u, v = ca.SX.sym("u", 8), ca.SX.sym("v", 8)
    good = MPCC(ca.vertcat(u, v), ca.sum1(u) + ca.sum1(v), None, u, v)
    assert classify(good, 0.0).stationarity == "S"
    bad = MPCC(ca.vertcat(u, v), ca.sum1(u) + ca.sum1(v) - 2 * v[3], None, u, v)
    found = classify(bad, 0.0)
    assert (found.stationarity, found.b_stationary) == ("W", False)


def scheel_like(n=1):
    """``min x + y - z, z <= 3 x, z <= 3 y``: at 0 B- and M-stationary, not S (the multipliers sum to -1)."""
    X, Y, Z = ca.SX.sym("X", n), ca.SX.sym("Y", n), ca.SX.sym("Z", n)
    f = ca.sum1(X + Y - Z)
    return MPCC(ca.vertcat(X, Y, Z), f, ca.vertcat(Z - 3 * X, Z - 3 * Y), X, Y, ubg=0.0)


@pytest.mark.slow
@pytest.mark.parametrize("n", [1, 2, 6])
def test_b_without_s_needs_the_exact_finish(n):
    """Here the relaxed solutions are off by sqrt(t): x = y = sqrt(t), z = 3 sqrt(t), f = -sqrt(t)."""
    result = solve(scheel_like(n), 1.0)
    assert result.success
    assert (result.stationarity, result.b_stationary) == ("M", True)
    assert len(result.biactive) == n
    assert abs(result.f) < 1e-6
    relaxed = [step for step in result.history if step.phase == "relaxed"][-1]
    assert relaxed.objective == pytest.approx(-n * np.sqrt(relaxed.t), rel=1e-2)


def test_a_pair_of_one_unknown_with_itself_is_m_not_s():
    """y _|_ y forces y = 0; the gradient of f then has the sign that S forbids, a free multiplier allows."""
    result = solve(MPCC(y, (y - 1) ** 2, None, y, y), 1.0)
    assert (result.success, result.stationarity, result.b_stationary) == (True, "M", True)


def test_labels_do_not_depend_on_which_multipliers_the_solver_returns():
    """A redundant row makes the multipliers non-unique: S must be found although W multipliers exist too."""
    redundant = MPCC(ca.vertcat(x, y), x + y, ca.vertcat(x + y, 2 * x + y), x, y, lbg=0.0)
    assert classify(redundant, [0, 0]).stationarity == "S"
    shielded = MPCC(ca.vertcat(x, y), x - y, y, x, y, ubg=0.0)  # y <= 0 takes over nu_y
    assert classify(shielded, [0, 0]).stationarity == "S"


def lagrangian_gradient(mpcc, result):
    column = ca.vertcat(mpcc.g, mpcc.G, mpcc.H)
    F = ca.Function("F", [mpcc.x], [ca.gradient(mpcc.f, mpcc.x), ca.jacobian(column, mpcc.x)])
    gradient, jacobian = (part.full() for part in F(result.x))
    multipliers = np.concatenate([result.lam_g, result.lam_G, result.lam_H])
    return gradient.ravel() + jacobian.T @ multipliers + result.lam_x


@pytest.mark.parametrize(
    "mpcc",
    [
        MPCC(ca.vertcat(x, y), x + 2 * y, None, x, y),
        MPCC(ca.vertcat(x, y), (x - 1) ** 2 + (y - 1) ** 2, x + y, x, y, lbg=-9, ubg=0.5),
        MPCC(ca.vertcat(x, y, z), (x - z) ** 2 + z**2, z - 1, x + z, y - z, lbg=0.0, ubx=[4, 4, 4]),
        scheel_like(2),
    ],
)
def test_the_multipliers_given_back_prove_the_label(mpcc):
    result = solve(mpcc, 1.0)
    assert result.success
    assert np.max(np.abs(lagrangian_gradient(mpcc, result))) < 1e-5
    both = result.biactive
    if result.stationarity == "S":
        assert np.all(result.lam_G[both] <= 1e-6)
        assert np.all(result.lam_H[both] <= 1e-6)
    inactive = result.G > 1e-4
    assert np.max(np.abs(result.lam_G[inactive]), initial=0.0) < 1e-6


def test_a_descent_does_not_leave_an_active_upper_bound():
    mpcc = MPCC(ca.vertcat(x, y, z), -x - z, None, x, y, ubx=[9, 9, 1])
    options, lifted = (programs := CompiledNLPs(mpcc, Options())).options, programs.lifted
    at = lifted.start(np.array([0.0, 0.0, 1.0]), np.zeros(0))
    direction = descent(lifted, linearise(lifted, at, np.ones(1), options.activity, options.corner))
    assert direction.decrease == pytest.approx(-1)
    assert direction.step[:3] == pytest.approx([1, 0, 0])


def test_without_multipliers_an_undecided_point_is_no_success():
    assert Stationarity("none").status is Status.STALLED
    some = Multipliers(*np.zeros((4, 1)))
    assert Stationarity("W", some).status is Status.ACCEPTABLE


def test_a_known_corner_is_no_branch_and_of_failures_the_most_nearly_feasible_is_best():
    lifted = SimpleNamespace(members=lambda z: (z[[0]], z[[1]]), on_first=lambda z: z[[0]] <= z[[1]])
    run = SimpleNamespace(lifted=lifted, options=SimpleNamespace(corner=1e-6))
    for z, known, same in (((0, 1), (0, 2), True), ((1, 0), (0, 2), False), ((0, 1), (0, 0), False)):
        assert _same_branch(run, np.array(z), np.array(known)) is same
    ends = [
        SimpleNamespace(success=False, constraint_violation=a, complementarity=b)
        for a, b in ((0.0, 1.0), (0.1, 0.0), (0.2, 0.0))
    ]
    assert MultiStart(tuple(ends), (), 0).best is ends[1]
