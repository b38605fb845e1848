"""Labels and their multipliers against the definition."""

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC
from rmesh_nlp.mpcc.lifting import Lifted, lift
from rmesh_nlp.mpcc.lpec import Linearisation, linearise
from rmesh_nlp.mpcc.stationarity import Multipliers, _MultiplierLP, proof_of_s, strongest

TOLERANCE = 1e-6
PIECES = {"S": ((-1, -1),), "M": ((-1, -1), (0, 2), (2, 0)), "C": ((-1, -1), (1, 1))}
"""Signs of the two multipliers of a biactive pair: -1 (<= 0), 0 (= 0), 1 (>= 0), 2 (free)."""


def at(mpcc: MPCC, x: list[float] | np.ndarray) -> tuple[Lifted, Linearisation]:
    lifted = lift(mpcc)
    z = lifted.start(np.asarray(x, dtype=float), np.zeros(0))
    return lifted, linearise(lifted, z, np.ones(1), 1e-5, 1e-6)


def slope_of_the_lagrangian(lifted: Lifted, lin: Linearisation, found: Multipliers) -> np.ndarray:
    slope = lin.gradient + lin.jacobian.T @ found.rows + found.z
    for places, values in ((lifted.first, found.G), (lifted.second, found.H)):
        for place, value in zip(places, values, strict=True):
            slope[place] += value
    return slope


def assert_admissible(lifted: Lifted, lin: Linearisation, found: Multipliers, name: str) -> None:
    """The multipliers make the Lagrangian stationary, with signs that their bounds and the label allow."""
    slack = 3 * TOLERANCE * lin.scale
    assert np.max(np.abs(slope_of_the_lagrangian(lifted, lin, found))) <= slack
    for values, lower, upper in (
        (found.rows, lin.row_lower, lin.row_upper),
        (found.z, lin.z_lower, lin.z_upper),
    ):
        assert np.all(values[~lower] >= -slack)
        assert np.all(values[~upper] <= slack)
    assert not np.any(found.G[~lin.G_zero])
    assert not np.any(found.H[~lin.H_zero])
    if name == "W":
        return
    for G, H in zip(found.G[lin.biactive], found.H[lin.biactive], strict=True):
        kinds = {-1: lambda v: v <= slack, 0: lambda v: abs(v) <= slack, 1: lambda v: v >= -slack}
        assert any(
            all(sign == 2 or kinds[sign](value) for sign, value in zip(piece, (G, H), strict=True))
            for piece in PIECES[name]
        ), (name, G, H)


x, y, w = ca.SX.sym("x"), ca.SX.sym("y"), ca.SX.sym("w")
XYW = ca.vertcat(x, y, w)


@pytest.mark.parametrize("order", [(y, w), (w, y)])
@pytest.mark.parametrize("swap", [False, True])
def test_the_multiplier_of_a_shared_unknown_goes_to_the_pair_that_leaves_its_sign_free(order, swap) -> None:
    """x is paired with y and w; at x = y = 0, w = 1 only the pair with y is biactive.

    The slope -1 in x needs a multiplier +1 of x, which S forbids in the biactive pair.
    """
    ones, others = ca.vertcat(x, x), ca.vertcat(*order)
    G, H = (others, ones) if swap else (ones, others)
    lifted, lin = at(MPCC(XYW, -x + y + (w - 1) ** 2, None, G, H), [0, 0, 1])
    proved = proof_of_s(lifted, lin, np.zeros(0), np.array([1.0, -1.0, 0.0]), TOLERANCE)
    assert proved is not None
    free = 0 if order[0] is w else 1
    of_x, of_y = (proved.H, proved.G) if swap else (
        proved.G, proved.H)  # fmt: skip
    assert of_x[free] == 1.0
    assert of_x[1 - free] == 0.0
    assert of_y[1 - free] == -1.0
    assert_admissible(lifted, lin, proved, "S")


def test_a_shared_unknown_of_two_biactive_pairs_gives_its_multiplier_once() -> None:
    lifted, lin = at(MPCC(XYW, 2 * x + y + w, None, ca.vertcat(x, x), ca.vertcat(y, w)), [0, 0, 0])
    proved = proof_of_s(lifted, lin, np.zeros(0), np.array([-2.0, -1.0, -1.0]), TOLERANCE)
    assert proved is not None
    assert np.sum(proved.G) == -2.0
    assert_admissible(lifted, lin, proved, "S")
    # with the slope +1 of a member that is not zero nothing is proved
    assert proof_of_s(lifted, lin, np.zeros(0), np.array([-2.0, -1.0, 1.0]), TOLERANCE) is None


def test_a_positive_multiplier_of_a_member_belongs_to_its_upper_bound() -> None:
    """``x <= 0`` holds the biactive x from above: S although the multiplier of x is positive."""
    mpcc = MPCC(ca.vertcat(x, y), -x + y, None, x, y, ubx=[0, np.inf])
    lifted, lin = at(mpcc, [0, 0])
    proved = proof_of_s(lifted, lin, np.zeros(0), np.array([1.0, -1.0]), TOLERANCE)
    assert proved is not None
    assert (proved.z[0], proved.G[0], proved.H[0]) == (1.0, 0.0, -1.0)
    free = MPCC(ca.vertcat(x, y), -x + y, None, x, y)
    assert proof_of_s(*at(free, [0, 0]), np.zeros(0), np.array([1.0, -1.0]), TOLERANCE) is None


def test_an_active_row_may_only_push_to_its_side() -> None:
    """``x + w >= 0`` with a positive multiplier is no proof, ``x + w <= 0`` is."""
    f = x + y - (x + w)
    for bounds, proves in (({"lbg": 0.0}, False), ({"ubg": 0.0}, True), ({"lbg": 0.0, "ubg": 0.0}, True)):
        lifted, lin = at(MPCC(XYW, f, x + w, x, y, **bounds), [0, 0, 0])
        found = proof_of_s(lifted, lin, np.ones(1), np.array([-1.0, -1.0, 0.0]), TOLERANCE)
        assert (found is not None) == proves


def test_small_faults_of_sign_are_within_the_tolerance_and_large_ones_not() -> None:
    lifted, lin = at(MPCC(ca.vertcat(x, y), 1e-9 * x + y, None, x, y), [0, 0])
    assert proof_of_s(lifted, lin, np.zeros(0), np.array([5e-7, -1.0]), TOLERANCE) is not None
    lifted, lin = at(MPCC(ca.vertcat(x, y), -3e-6 * x + y, None, x, y), [0, 0])
    assert proof_of_s(lifted, lin, np.zeros(0), np.array([3e-6, -1.0]), TOLERANCE) is None


def test_a_program_that_fails_decides_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    class Answer:
        status, x, fun = 4, None, None  # "numerical difficulties"

    monkeypatch.setattr("rmesh_nlp.mpcc.stationarity.linprog", lambda *_, **__: Answer)
    lifted, lin = at(MPCC(ca.vertcat(x, y), x + y, None, x, y), [0, 0])
    assert strongest(lifted, lin, TOLERANCE)[0] == ""
    Answer.status = 2
    assert strongest(lifted, lin, TOLERANCE)[0] == "none"


def test_the_time_that_is_left_is_given_to_each_program(monkeypatch: pytest.MonkeyPatch) -> None:
    lifted, lin = at(MPCC(ca.vertcat(x, y), x + y, None, x, y), [0, 0])
    assert _MultiplierLP(lifted, lin, TOLERANCE, 2.5).limit == {"time_limit": 2.5}
    assert _MultiplierLP(lifted, lin, TOLERANCE, np.inf).limit == {}


def test_without_any_multiplier_only_a_flat_objective_is_stationary() -> None:
    v = ca.vertcat(x, y)
    assert strongest(*at(MPCC(v, (x - 1) ** 2 + y**2, None, None, None), [1, 0]), TOLERANCE)[0] == "S"
    for slope in (x, -y, x - y):
        assert strongest(*at(MPCC(v, slope, None, None, None), [1, 0]), TOLERANCE)[0] == "none"
