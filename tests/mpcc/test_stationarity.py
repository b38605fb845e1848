"""Labels against closed forms, against a search over all signs of multipliers, and their multipliers."""

import casadi as ca
import numpy as np
import pytest

from mpcc_library.labels import descends_by_search, label_by_search, random_block
from rmesh_nlp.mpcc import MPCC, classify, lpec, solve
from rmesh_nlp.mpcc import stationarity as module
from rmesh_nlp.mpcc.stationarity import Multipliers, Stationarity, proving, stationarity
from rmesh_nlp.optimize.budget import Budget, Limits
from rmesh_nlp.optimize.status import Status
from support.scripted_run import XY, XYW, w, x, y
from support.scripted_run import linearised as at

TOLERANCE = 1e-6
PIECES = {"S": ((-1, -1),), "M": ((-1, -1), (0, 2), (2, 0)), "C": ((-1, -1), (1, 1)), "W": ((2, 2),)}
"""Signs of the two multipliers of a biactive pair: -1 (<= 0), 0 (= 0), 1 (>= 0), 2 (free)."""
RANGES = {-1: (-np.inf, 0), 0: (0, 0), 1: (0, np.inf), 2: (-np.inf, np.inf)}


def assert_admissible(lifted, lin, found, name):
    """The multipliers make the Lagrangian stationary, with signs that their bounds and the label allow."""
    slack = 3 * TOLERANCE * lin.scale
    slope = lin.gradient + lin.jacobian.T @ found.rows + found.z
    np.add.at(slope, lifted.pairs, found.pairs)
    assert np.max(np.abs(slope)) <= slack
    values = np.append(found.rows, found.z)
    assert np.all(values[~lin.lower] >= -slack)
    assert np.all(values[~lin.upper] <= slack)
    assert not np.any(found.pairs[~lin.zero])
    for pair in found.pairs[:, lin.biactive].T:
        ranges = np.array([[RANGES[sign] for sign in piece] for piece in PIECES[name]])
        inside = (ranges[..., 0] - slack <= pair) & (pair <= ranges[..., 1] + slack)
        assert np.any(np.all(inside, axis=1)), (name, pair)


@pytest.mark.parametrize(
    ("c", "d", "label", "b_stationary"),
    [
        (1, 0, "S", True),
        (-1, 0, "M", False),  # d_x = 1 descends
        (-1, -1, "C", False),
        (1, -1, "W", False),
        (-1000, 2e-6, "M", False),  # zero is relative to the largest slope
        (-1000, 2e-2, "W", False),
        (-4e-6, 1, "W", False),  # and its tolerance is 1e-6
        (-5e-7, 1, "S", True),
    ],
)
def test_label_at_a_corner_with_unique_multipliers(c, d, label, b_stationary):
    """At 0 of ``min c x + d y, 0 <= x _|_ y >= 0`` they are (nu_x, nu_y) = -(c, d) in CasADi's sign."""
    mpcc = MPCC(XY, c * x + d * y, None, x, y)
    lifted, lin = at(mpcc, [0, 0])
    found = stationarity(lifted, lin, TOLERANCE)
    assert (found.label, found.b_stationary) == (label, b_stationary)
    assert_admissible(lifted, lin, found.multipliers, label)
    slack = 3 * TOLERANCE * lin.scale
    assert found.multipliers.pairs[:, 0] == pytest.approx([-c, -d], abs=slack)
    assert (found.direction is None) == b_stationary


CLOSED = [  # objective, rows (<= 0, >= 0 or = 0 by sign), point, label, B
    ("M and B: z <= 4x, z <= 4y", x + y - w, (w - 4 * x, w - 4 * y), (-np.inf, 0), [0, 0, 0], "M", True),
    ("no multipliers: a free unknown with slope", x + y + w, None, None, [0, 0, 0], "none", False),
    ("a row of the wrong side", x + y - w, (w - x - y - 1,), (-1, np.inf), [0, 0, 0], "none", False),
    ("the same row from the other side", x + y - w, (w - x - y - 1,), (-np.inf, -1), [0, 0, 0], "S", True),
    ("only x is zero: its sign is free", -5 * x + (y - 1) ** 2 + w**2, None, None, [0, 1, 0], "S", True),
    ("only y is zero", (x - 1) ** 2 - 5 * y + w**2, None, None, [1, 0, 0], "S", True),
    ("but the slope along the free member counts", y - 5 * x + w**2, None, None, [0, 1, 0], "none", False),
    ("no constraint qualification", -w + x + y, (w**2,), (-np.inf, 0), [0, 0, 0], "none", False),
]


@pytest.mark.parametrize(
    ("name", "f", "rows", "bounds", "point", "label", "b"), CLOSED, ids=[c[0] for c in CLOSED]
)
def test_label_of_closed_form(name, f, rows, bounds, point, label, b):
    limits = {} if bounds is None else {"lbg": bounds[0], "ubg": bounds[1]}
    mpcc = MPCC(XYW, f, None if rows is None else ca.vertcat(*rows), x, y, **limits)
    found = classify(mpcc, point)
    assert (found.stationarity, found.b_stationary) == (label, b)
    assert found.status is not Status.INACCURATE


@pytest.mark.parametrize("seed", range(11))
def test_label_and_descent_are_those_that_a_search_over_signs_and_branches_finds(seed):
    """Everything is active at the origin, and multipliers are mostly not unique."""
    data = random_block(np.random.default_rng(seed))
    n, k, nonlinear = data.c.size, len(data.G), 0.1 * (seed % 2)
    v = ca.SX.sym("v", n)
    f, rows = ca.dot(ca.DM(data.c), v), ca.mtimes(ca.DM(data.A), v) + nonlinear * ca.sumsqr(v)
    bounds = {"lbg": np.where(data.kinds <= 0, 0, -np.inf), "ubg": np.where(data.kinds >= 0, 0, np.inf)}
    lifted, lin = at(MPCC(v, f + nonlinear * ca.sumsqr(v), rows, v[:k], v[k : 2 * k], **bounds), np.zeros(n))
    found = stationarity(lifted, lin, TOLERANCE)
    assert found.label == label_by_search(data)
    assert found.b_stationary != descends_by_search(data)
    if found.multipliers is not None:
        assert_admissible(lifted, lin, found.multipliers, found.label)
    assert (found.direction is None) == found.b_stationary
    best = lpec.descent(lifted, lin)
    members = best.step[: 2 * k].reshape(2, -1)
    assert best.decrease == pytest.approx(data.c @ best.step, abs=1e-8)
    assert np.all(np.abs(members[best.zero]) <= 1e-9)
    assert np.all(best.zero[0] != best.zero[1])
    assert members.min() >= -1e-9
    assert (best.decrease < -1e-9) == (not found.b_stationary)


TINY = 1e-12 * ((x - 1) ** 2 + (y - 2) ** 2)


@pytest.mark.parametrize(
    ("f", "point", "label"), [(x + y, [1, 1], ""), (TINY, [0, 1.5], "none"), (TINY, [0, 2], "S")]
)
def test_infeasible_point_gets_no_label_and_the_size_of_an_objective_does_not_matter(f, point, label):
    found = classify(MPCC(XY, f, None, x, y), point)
    assert (found.stationarity, found.status is Status.INACCURATE) == (label, label == "")
    assert label or found.b_stationary is None


def test_rows_that_are_zero_by_structure_are_no_obstacle():
    rows = np.array([[0.0, 0, 0], [1, 0, 0]]) @ XYW
    assert classify(MPCC(XYW, x + y + w, rows, y, w, lbg=0), np.zeros(3)).stationarity == "S"
    zero = ca.vertcat(0 * w, x)
    assert solve(MPCC(XYW, (x - 1) ** 2 + y**2 + w**2, None, zero, ca.vertcat(y, w)), 0.5).success


def test_linear_program_that_fails_decides_nothing(monkeypatch):
    class Answer:
        status, x, fun = 4, None, None  # "numerical difficulties"

    given = []
    monkeypatch.setattr(module, "linprog", lambda *_, **names: given.append(names["options"]) or Answer)
    lifted, lin = at(MPCC(XY, x + y, None, x, y), [0, 0])
    assert stationarity(lifted, lin, TOLERANCE).label == ""
    Answer.status = 2
    assert stationarity(lifted, lin, TOLERANCE, Budget(Limits(2.5))).label == "none"
    assert given[0] == {}
    assert 2.0 < given[-1]["time_limit"] <= 2.5


def test_s_is_asked_within_the_whole_tolerance():
    f, row = -5e-7 * w + y, w - 1000 * x  # descends by 5e-7 in a step of at most 1; sharp multipliers prove M
    found = stationarity(*at(MPCC(XYW, f, row, x, y, lbg=0, ubg=0), [0, 0, 0]), TOLERANCE)
    assert found.label == "S"
    assert np.max(found.multipliers.pairs) <= TOLERANCE


@pytest.mark.parametrize(("slope", "label"), [(0, "S"), (x, "none"), (-y, "none"), (x - y, "none")])
def test_without_any_multiplier_only_a_flat_objective_is_stationary(slope, label):
    f = (x - 1) ** 2 + y**2 + slope
    assert stationarity(*at(MPCC(XY, f, None, None, None), [1, 0]), TOLERANCE).label == label


SOME = Multipliers(*np.zeros((3, 1)))


@pytest.mark.parametrize(
    ("known", "status"),
    [
        (Stationarity("S", SOME, True), Status.CONVERGED),
        (Stationarity("none", None, True), Status.CONVERGED),
        (Stationarity("W", SOME, None), Status.ACCEPTABLE),
        (Stationarity("W", SOME, False), Status.STALLED),
        (Stationarity("none", None, None), Status.STALLED),
        (Stationarity("", None, True), Status.STALLED),
    ],
)
def test_status_needs_a_label_and_b_stationarity(known, status):
    assert known.status is status


def scheel_like(n):
    """``min x + y - z, z <= 3 x, z <= 3 y``: at 0 B- and M-stationary, not S (the multipliers sum to -1)."""
    X, Y, Z = ca.SX.sym("X", n), ca.SX.sym("Y", n), ca.SX.sym("Z", n)
    return MPCC(ca.vertcat(X, Y, Z), ca.sum1(X + Y - Z), ca.vertcat(Z - 3 * X, Z - 3 * Y), X, Y, ubg=0.0)


def weighted(size):
    f = size * ((x - 2) ** 2 + (y - 1) ** 2 + (w + 1) ** 2 + 3 * w)
    bounds = {"lbx": [-9, -9, -0.5], "ubx": 9, "lbg": -9, "ubg": [1, 9]}
    return MPCC(XYW, f, ca.vertcat(x + w, w - x), x, 2 * y, **bounds)


@pytest.mark.parametrize(
    ("mpcc", "label"),
    [
        (MPCC(XY, x + 2 * y, None, x, y), "S"),
        (MPCC(XY, (x - 1) ** 2 + (y - 1) ** 2, x + y, x, y, lbg=-9, ubg=0.5), "S"),
        (MPCC(XYW, (x - w) ** 2 + w**2, w - 1, x + w, y - w, lbg=0.0, ubx=[4, 4, 4]), "S"),
        (MPCC(y, (y - 1) ** 2, None, y, y), "M"),  # y _|_ y forces y = 0 with the sign that S forbids
        (scheel_like(2), "M"),
        # each with an active row, bound and pair; the weight of the objective is not seen
        (weighted(1.0), "S"),
        (weighted(1e-4), "S"),
    ],
)
def test_multipliers_given_back_prove_the_label(mpcc, label):
    result = solve(mpcc, 1.0)
    assert (result.success, result.stationarity, result.b_stationary) == (True, label, True)
    column = ca.vertcat(mpcc.g, mpcc.G, mpcc.H)
    parts = [ca.gradient(mpcc.f, mpcc.x), ca.jacobian(column, mpcc.x), column]
    gradient, jacobian, values = (part.full() for part in ca.Function("F", [mpcc.x], parts)(result.x))
    assert np.concatenate([result.g, result.G, result.H]) == pytest.approx(values.ravel(), abs=1e-12)
    lam = np.concatenate([result.lam_g, result.lam_G, result.lam_H])
    slope = np.abs(gradient.ravel() + jacobian.T @ lam + result.lam_x)
    assert np.max(slope) < 1e-5 * min(1, np.max(abs(gradient)))
    for lam, member in ((result.lam_G, result.G), (result.lam_H, result.H)):
        assert label != "S" or np.all(lam[result.biactive] <= 1e-6)
        assert np.max(np.abs(lam[member > 1e-4]), initial=0.0) < 1e-6


def corners(slopes_G, slopes_H, g=None):
    """Pairs x_i _|_ y_i that are biactive at 0; their multipliers are minus the slopes."""
    n = len(slopes_G)
    v = ca.SX.sym("v", 2 * n)
    f = ca.dot(ca.DM([*slopes_G, *slopes_H]), v)
    return at(MPCC(v, f, None if g is None else g(v), v[:n], v[n:], ubg=0), np.zeros(2 * n))


def test_multipliers_of_a_solve_prove_s_with_its_signs_alone():
    """min x + y on x _|_ y, x - y <= 0 at 0: with lam of the row the members have -1 - lam and -1 + lam."""
    lifted, lin = corners([1], [1], lambda v: v[0] - v[1])
    for lam, pairs in ((0.0, (-1, -1)), (0.5, (-1.5, -0.5)), (-0.5, (-1, -1))):  # the last has no row's sign
        assert proving(lifted, lin, np.array([lam]), 1e-6).pairs.ravel() == pytest.approx(pairs)
    assert proving(lifted, lin, np.array([1.1]), 1e-6) is None
    assert proving(*corners([1], [-1]), np.zeros(0), 1e-6) is None
