"""Compiled NLPs: what is solved, with which multipliers, and how residuals are measured."""

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC, RELAXATIONS, Options, solve
from rmesh_nlp.mpcc.nlps import CompiledNLPs, Watch
from rmesh_nlp.mpcc.result import excess, residuals
from support.scripted_run import ON_G, ON_H, START, XY, XYW, ended, two_minima, w, x, y

p = ca.SX.sym("p")
ONE, INF = np.ones(1), np.inf


def compiled(mpcc=None, **options):
    return CompiledNLPs(mpcc or two_minima(), Options(**options))


THREE = MPCC(XY, x, x + y, ca.vertcat(x, y), ca.vertcat(y, x), lbx=-1, ubx=4, lbg=0, ubg=1)


@pytest.mark.parametrize(
    ("point", "g", "G", "H", "violation"),
    [
        ((1, 1), 0.5, (1, 1), (1, 1), 0),
        ((1, -1.5), 0.5, (1, 1), (1, 1), 0.5),
        ((5, 1), 0.5, (1, 1), (1, 1), 1),
        ((1, 1), 1.25, (1, 1), (1, 1), 0.25),
        ((1, 1), -0.25, (1, 1), (1, 1), 0.25),
        ((1, 1), 0.5, (1, -2), (1, -3), 3),
        ((1, 1), np.nan, (1, 1), (1, 1), INF),
    ],
)
def test_violation_is_the_largest_of_any_bound_or_sign(point, g, G, H, violation):
    found = residuals(THREE, *(np.array(v, float) for v in (point, [g], G, H)))
    assert found.constraint_violation == violation


def test_complementarity_is_the_smaller_member_and_product_the_product():
    found = residuals(THREE, *(np.array(v, float) for v in ((1, 1), (0.5,), (0.1, -3.0), (4.0, 0.2))))
    assert (found.complementarity, found.product) == (pytest.approx(0.2), pytest.approx(0.6))
    none = np.zeros(0)
    found = residuals(MPCC(x, x, None, None, None), np.zeros(1), none, none, none)
    assert (found.constraint_violation, found.complementarity, found.product) == (0, 0, 0)
    assert excess(none, 0.0, 1.0) == 0.0


@pytest.mark.parametrize(
    ("point", "units"),
    [
        ([1.0, 0.0, 0.0], 0),
        ([1.0, 3e-8, 0.0], 3),  # min(x, y), tolerance 1e-8
        ([2e-8, 3.0, 0.0], 2),
        ([-4e-8, 0.0, 0.0], 4),
        ([1.0, -5e-8, 0.0], 5),
        ([1.0, 0.0, 2 + 6e-7], 30),  # 10 w <= 20 by 6e-6, in units of its term 20: 3e-7
        ([1.0, 0.0, -3 - 7e-8], 7),  # w >= -3
    ],
)
def test_excess_is_in_units_of_the_tolerance_and_of_the_terms_of_a_row(point, units):
    own = compiled(MPCC(XYW, x, 10 * w, x, y, ubg=20, lbx=[-INF, -INF, -3]))
    assert own.excess(np.array(point), ONE) == pytest.approx(units, rel=1e-3, abs=1e-6)
    assert compiled(MPCC(XYW, ca.log(x - 1), None, x, y)).excess(np.array([0.0, 1.0, 0.0]), ONE) == INF


@pytest.mark.parametrize("size", [1.0, 1e6])
def test_residuals_of_pairs_are_relative_to_their_row(size):
    """``size (x - w)`` cannot be zero more precisely than rounding of its terms allows."""
    own = compiled(MPCC(XYW, x, None, size * (x - w), y))
    at = np.array([3.0, 1.0, 3.0])
    for error, units in ((1e-9, 1 / 30), (1e-6, 100 / 3)):
        point = own.lifted.start(at + np.array([error, 0, 0]), np.zeros(0))
        assert own.excess(point, ONE) == pytest.approx(units, rel=0.01)


def test_looser_tolerances_belong_to_their_residual():
    loose = compiled(MPCC(XY, x, x, x, y, ubg=1), feasibility=1e-2, complementarity=1e-4)
    assert loose.excess(np.array([1.02, 0.0]), ONE) == pytest.approx(2 / 1.02)
    assert loose.excess(np.array([1.0, 3e-4]), ONE) == pytest.approx(3)


def test_measure_is_of_the_source_problem():
    own = compiled(MPCC(XYW, x * p, x + w, x, 2 * y, p=p, lbg=0))
    f, res, (g, G, H) = own.measure(np.array([3.0, 1.0, -4.0, 99.0]), np.array([5.0, 7.0]))
    assert (f, list(g), list(G), list(H)) == (15, [-1], [3], [2])
    assert (res.constraint_violation, res.complementarity, res.product) == (1, 2, 6)


def test_branch_fixes_one_member_of_each_pair():
    own = compiled()
    on_first = own.branch(START, ONE, ON_G)
    on_second = own.branch(START, ONE, ON_H)
    assert (on_first.x, on_first.f) == (pytest.approx([0, 1], abs=1e-7), pytest.approx(4))
    assert (on_second.x, on_second.f) == (pytest.approx([2, 0], abs=1e-7), pytest.approx(1))
    boxed = own.branch(np.array([0.5, 0.0]), ONE, ON_H, radius=np.array([0.25, 0.1]))
    assert boxed.x == pytest.approx([0.75, 0], abs=1e-7)
    down = compiled(MPCC(XY, (x - 2) ** 2 + (y + 1) ** 2, None, x, y))
    assert down.branch(np.ones(2), ONE, ON_G).x == pytest.approx([0, 0], abs=1e-6)
    assert down.branch(np.ones(2), ONE, ON_G, free_signs=True).x == pytest.approx([0, -1], abs=1e-6)


@pytest.mark.parametrize("relaxation", RELAXATIONS)
def test_multipliers_without_the_relaxation_make_the_lifted_lagrangian_stationary(relaxation):
    own = compiled(MPCC(XYW, (x - 1) ** 2 + (y - 2) ** 2 + w**2, x + w, x, y + w, lbg=0.25))
    result = own.relaxed(relaxation, own.lifted.start(np.array([0.5, 0.5, 0.1]), np.zeros(0)), ONE, 1e-2)
    warm = own.without_relaxation(relaxation, result, 1e-2)
    _, gradient, _, jacobian = own.lifted.linearise(result.x, ONE)
    assert warm.lam_g.size == own.lifted.nlp.n_g
    assert gradient + jacobian.T @ warm.lam_g + warm.lam_x == pytest.approx(np.zeros(4), abs=1e-6)
    padded = own.padded(relaxation, warm)
    assert padded.lam_g.size == result.lam_g.size
    assert not np.any(padded.lam_g[warm.lam_g.size :])


def test_unlifted_solution_is_that_of_the_lifted_relaxation_with_its_multipliers():
    own = compiled(MPCC(XYW, (x - 1) ** 2 + (y - 2) ** 2 + w**2, x + w, x, y + w, lbg=0.25))
    weighted, t = np.array([2.0]), 0.05
    start = np.array([0.05, 1.8, 0.1])
    plain = own.unlifted(start, weighted, t)
    lifted = own.relaxed("scholtes", own.lifted.start(start, np.zeros(0)), weighted, t)
    assert plain.x == pytest.approx(lifted.x, abs=1e-3)
    _, gradient, _, jacobian = own.lifted.linearise(plain.x, weighted)
    assert gradient + jacobian.T @ plain.lam_g + plain.lam_x == pytest.approx(np.zeros(4), abs=1e-3)
    assert plain.lam_g[0] < -0.1  # x + w >= 1/4 is active


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_more_equations_than_free_unknowns_are_solved_all_the_same(scale):
    """One equation three times on one free unknown, from the relaxed multipliers too."""
    g = ca.vertcat(y - 1, 2 * y - 2, 3 * y - 3)
    own = compiled(MPCC(XY, scale * (x + y), g, x, y, lbg=0, ubg=0))
    result = own.branch(np.array([0.0, 0.5]), ONE, ON_G, warm=ended([0, 0.5], lam_g=np.zeros(3)))
    assert result.x == pytest.approx([0, 1], abs=1e-7)
    assert (result.x.size, result.lam_x.size, result.f) == (2, 2, pytest.approx(scale))
    assert solve(MPCC(XY, x, g, x, y, lbg=0, ubg=0), 0.5).success


def test_clock_of_small_problems_is_looked_at_now_and_then():
    def never(*_):
        return False

    assert [Watch(never, only_clock=True).every(n) for n in (2, 300, 3000)] == [20, 6, 1]
    assert (Watch(never).every(2), Watch().every(2)) == (1, 0)
