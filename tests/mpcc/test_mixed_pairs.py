"""Other statements of an MPCC: mixed pairs, pairs of rows of an NLP, the call shape of nlpsol."""

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC, mpccsol, solve

x, y, z = ca.SX.sym("x"), ca.SX.sym("y"), ca.SX.sym("z")
XY, XYZ = ca.vertcat(x, y), ca.vertcat(x, y, z)


@pytest.mark.parametrize(
    ("slope", "expected"),
    [(1.0, (-1.0, 1.0)), (-1.0, (2.0, -1.0)), (0.0, (0.5, 0.0))],
)
def test_a_mixed_pair_is_at_either_bound_or_between(slope, expected):
    """``-1 <= y <= 2 _|_ x``, f pulls x to the slope and y to 1/2: the sign of x decides where y is."""
    f = 10 * (x - slope) ** 2 + (y - 0.5) ** 2
    mpcc = MPCC.mixed(XY, f, None, x, y, lbH=-1, ubH=2)
    assert (mpcc.n_own, mpcc.n_x) == (2, 4)
    result = solve(mpcc, [slope, 0.5])
    assert result.success
    assert result.x[[1, 0]] == pytest.approx(expected, abs=1e-6)


def test_one_sided_pairs_are_shifted_and_reflected():
    """``x >= 2 _|_ y <= 3``: x = 2 or y = 3."""
    mpcc = MPCC.mixed(XY, (x - 3) ** 2 + (y - 1) ** 2, None, x, y, lbG=2, ubH=3)
    result = solve(mpcc, [3, 1])
    assert result.success
    assert result.x == pytest.approx([2, 1], abs=1e-7)  # (3, 3) costs 4, (2, 1) costs 1
    fixed = solve(MPCC.mixed(XY, (x - 1) ** 2 + y, None, x, y, lbH=2, ubH=2), [0, 0])
    assert fixed.x == pytest.approx([1, 2], abs=1e-7)
    equation = solve(MPCC.mixed(XY, (x - 1) ** 2 + y**2, None, x - 4, y), [0, 0])
    assert equation.x == pytest.approx([4, 0], abs=1e-7)


def test_bounds_without_complementarity_are_refused():
    with pytest.raises(ValueError, match="pair 0 has the bounds"):
        MPCC.mixed(XY, x, None, x, y, lbG=0)
    with pytest.raises(ValueError, match=r"lbH\[0\] = 2.0 and ubH\[0\] = 1.0 leave no value"):
        MPCC.mixed(XY, x, None, x, y, lbH=2, ubH=1)
    with pytest.raises(ValueError, match="lbH has length 2, expected 1"):
        MPCC.mixed(XY, x, None, x, y, lbH=[0, 0])


def test_rows_and_unknowns_of_an_nlp_are_paired_by_place():
    nlp = {"x": XYZ, "f": (x - 1) ** 2 + ca.exp(y) - 2 * z, "g": ca.vertcat(x + z, x**2 + z - 3, x + y)}
    mpcc = MPCC.from_nlp(
        nlp, [(("g", 2), ("x", 1)), (("g", 1), ("x", 2))],
        lbx=[-np.inf, 0, -1], ubx=[np.inf, np.inf, 2], lbg=[-np.inf, -np.inf, 1], ubg=[5, np.inf, np.inf],
    )  # fmt: skip
    result = solve(mpcc, [0.5, 0.2, 0])
    # z wants to grow, so z = 2 with x^2 + z - 3 <= 0, |x| <= 1; x = 1 and y = 0: f = 0 + 1 - 4
    at, f = [1, 0, 2], -3.0
    assert result.success
    assert result.x[:3] == pytest.approx(at, abs=1e-6)
    assert result.f == pytest.approx(f, abs=1e-7)
    for pairs, words in (
        ([(("g", 9), ("x", 0))], r"no g\[9\]"),
        ([(("g", 0), ("x", 0)), (("g", 0), ("x", 1))], "already in a pair"),
    ):
        with pytest.raises(ValueError, match=words):
            MPCC.from_nlp(nlp, pairs, lbx=0, lbg=0)
    with pytest.raises(ValueError, match="x and f are needed"):
        MPCC.from_nlp({"x": x}, [])


def test_the_call_shape_of_nlpsol():
    problem = {"x": XY, "p": z, "f": (x - z) ** 2 + (y - 1) ** 2, "g": x + y, "G": x, "H": y}
    solver = mpccsol("solver", "scholtes", problem, {"t0": 0.5, "ipopt": {"tol": 1e-9}})
    with pytest.raises(RuntimeError, match="has not been called"):
        solver.stats()
    answer = solver(x0=[1, 1], p=3, lbg=-10, ubg=10)
    assert isinstance(answer["x"], ca.DM)
    assert answer["x"].full().ravel() == pytest.approx([3, 0], abs=1e-7)
    assert float(answer["lam_H"]) == pytest.approx(2, abs=1e-5)  # d/dy of the objective is -2 there
    assert solver.stats()["return_status"] == "converged"
    assert solver(x0=[1, 1], p=3, lbg=-10, ubg=2)["g"] <= 2 + 1e-8


@pytest.mark.parametrize(
    ("plugin", "problem", "options", "words"),
    [
        ("newton", {"x": x, "f": x}, {}, "unknown relaxation"),
        ("scholtes", {"x": x, "f": x, "h": x}, {}, "unknown key 'h'"),
        ("scholtes", {"x": x, "f": x}, {"tt0": 1}, "unknown setting 'tt0'"),
        ("scholtes", {"x": x, "f": y}, {}, "free symbols"),
    ],
)
def test_mpccsol_refuses_what_it_does_not_know(plugin, problem, options, words):
    with pytest.raises(ValueError, match=words):
        mpccsol("solver", plugin, problem, options)
