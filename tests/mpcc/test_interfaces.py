"""Many starts, and the generated families of the benchmark."""

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from mpcc_library.families import FAMILIES
from rmesh_nlp.mpcc import MPCC, MultiStart, interfaces, multistart, solve
from support.scripted_run import XY, x, y


def end(success, f=0.0, violation=0.0, complementarity=0.0):
    residuals = {"constraint_violation": violation, "complementarity": complementarity}
    return SimpleNamespace(success=success, f=f, **residuals)


@pytest.mark.parametrize(
    ("ends", "best", "spread"),
    [
        ([end(True, 2.0), end(True, 1.0), end(False, -9.0)], 1, (1.0, 2.0)),
        # the most nearly feasible one
        ([end(False, 0, 0, 1), end(False, 0, 0.1), end(False, -9, 0.2)], 1, (np.nan, np.nan)),
    ],
)
def test_best_is_the_lowest_success_else_the_most_feasible(ends, best, spread):
    many = MultiStart(tuple(ends), (), 0)
    assert many.best is ends[best]
    assert many.spread == pytest.approx(spread, nan_ok=True)
    assert f"{sum(e.success for e in ends)} of 3 starts succeeded" in str(many)


def test_starts_are_seeded_within_bounds_and_the_first_is_given(monkeypatch):
    """x in [-2, 3] is drawn between its bounds, y around its start but not below -1e3."""
    monkeypatch.setattr(interfaces, "MPCCSolver", lambda *_: lambda start, **_: end(True))
    mpcc = MPCC(XY, x, None, None, None, lbx=[-2, -1e3], ubx=[3, np.inf])
    many, again, other = (multistart(mpcc, [1.5, 7], n=200, seed=seed) for seed in (3, 3, 4))
    drawn = np.array(many.starts)
    np.testing.assert_array_equal(drawn, again.starts)
    assert not np.array_equal(drawn[1:], other.starts[1:])
    assert list(drawn[0]) == [1.5, 7]
    assert (drawn[:, 0].min(), drawn[:, 0].max()) == (pytest.approx(-2, abs=0.2), pytest.approx(3, abs=0.2))
    assert drawn[:, 0].mean() == pytest.approx(0.5, abs=0.3)
    assert (drawn[:, 1].min() >= -1e3, len(drawn)) == (True, 200)
    assert np.median(drawn[:, 1]) == pytest.approx(7, abs=8)
    assert 5 < np.median(np.abs(drawn[1:, 1] - 7)) < 60  # 8 times 10^-1 to 10^1.5


def test_start_of_a_mixed_problem_is_completed_with_its_parameters(monkeypatch):
    """-1 <= y <= 2 _|_ x - p: at x = 1 and p = 3 the new unknowns are 0 and 2."""
    monkeypatch.setattr(interfaces, "MPCCSolver", lambda *_: lambda start, **_: end(True))
    p = ca.SX.sym("p")
    mpcc = MPCC.mixed(XY, x, None, x - p, y, lbH=-1, ubH=2, p=p)
    assert list(multistart(mpcc, [1, 0], n=2, p=3).starts[0]) == [1, 0, 0, 2]


@pytest.mark.slow
def test_multistart_finds_the_better_arm():
    mpcc = MPCC(XY, (x - 1) ** 2 + (y - 1) ** 2 - 0.1 * y, None, x, y, lbx=-2, ubx=3)
    many = multistart(mpcc, [1.5, 0], n=8, seed=3, t0=1e-4)
    assert many.best.x == pytest.approx([0, 1.05], abs=1e-7)
    assert many.spread == pytest.approx((many.best.f, 1.0), abs=1e-2)


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
