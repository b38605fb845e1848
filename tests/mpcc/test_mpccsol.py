"""The solver with the conventions of nlpsol: keywords, options, multipliers, symbolic calls."""

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCCSolver, mpccsol
from rmesh_nlp.mpcc.mpccsol import MPCCFunction
from support.scripted_run import XY, x, y

p = ca.SX.sym("p")
PAIR = {"x": XY, "p": p, "f": (x - p) ** 2 + (y - 1) ** 2, "g": x + y, "G": x, "H": y}
"""From (1, 1) with p >= 2: (p, 0), f = 1, and the derivative of f by y is -2."""
QUIET = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}


def numbers(answer):
    return {name: value.full().ravel() for name, value in answer.items()}


@pytest.fixture
def made(monkeypatch):
    """The solvers that are made: the problem and the options of each."""
    seen, honest = [], mpccsol.__globals__["MPCCSolver"]
    monkeypatch.setitem(mpccsol.__globals__, "MPCCSolver", lambda *of: seen.append(of) or honest(*of))
    return seen


def test_inputs_and_outputs_are_those_of_nlpsol_and_of_the_pairs():
    solver = mpccsol("solver", "scholtes", PAIR)
    assert isinstance(solver, ca.Function)
    assert (solver.name(), solver.n_in(), solver.n_out()) == ("solver", 10, 10)
    assert solver.name_in() == [*ca.nlpsol_in(), "lam_G0", "lam_H0"]
    assert solver.name_out() == [*ca.nlpsol_out(), "G", "H", "lam_G", "lam_H"]
    assert [solver.size1_in(name) for name in ("x0", "p", "ubg", "lam_G0")] == [2, 1, 1, 1]
    assert [solver.default_in(k) for k in range(8)] == [0, 0, -np.inf, np.inf, -np.inf, np.inf, 0, 0]


def test_answer_and_stats(made):
    solver = mpccsol("solver", "l1-penalty", PAIR, {"t0": 0.5, "ipopt.tol": 1e-9, "ipopt": {"max_iter": 99}})
    with pytest.raises(RuntimeError, match="solver has not been called"):
        solver.stats()
    answer = numbers(solver(x0=[1, 1], p=3, lbg=-10, ubg=10))
    assert answer["x"] == pytest.approx([3, 0], abs=1e-7)
    assert (answer["f"], answer["g"]) == (pytest.approx(1, abs=1e-7), pytest.approx(3, abs=1e-7))
    assert answer["lam_H"] == pytest.approx(2, abs=1e-5)
    stats = solver.stats()
    assert (stats["return_status"], stats["success"], stats["stationarity"]) == ("converged", True, "S")
    assert stats["unified_return_status"] == "SOLVER_RET_SUCCESS"
    ((_, options),) = made
    assert (options.relaxation, options.t0) == ("l1-penalty", 0.5)
    assert options.ipopt == {"tol": 1e-9, "max_iter": 99}


def test_without_pairs_it_answers_as_nlpsol_does():
    """Active bounds of x and g, and a parameter: all multipliers have the signs of nlpsol, lam_p too."""
    problem = {name: PAIR[name] for name in ("x", "p", "f")} | {"g": x + p * y}
    given = {"x0": [0.5, 0.5], "p": 3, "ubx": [1, 10], "lbg": 5}
    mine = numbers(mpccsol("mine", "scholtes", problem)(**given))
    theirs = numbers(ca.nlpsol("theirs", "ipopt", problem, QUIET)(**given))
    for name, value in theirs.items():
        assert mine[name] == pytest.approx(value, abs=1e-6), name
    assert min(abs(mine["lam_x"][0]), abs(mine["lam_g"][0]), abs(mine["lam_p"][0])) > 0.1


def test_solvers_are_kept_for_bounds_not_for_parameters(made):
    solver = mpccsol("solver", "scholtes", PAIR)
    for value, bound in ((3, 10), (2, 10), (3, 2), (3, 10)):
        answer = solver(x0=[1, 1], p=value, ubg=bound)
        assert float(answer["g"]) == pytest.approx(min(value, bound), abs=1e-7)
    assert len(made) == 2
    for bound, x_value in ((1, 3), (4, 4)):  # with x from 1 on, and so a slack: derivatives are shared
        assert float(solver(x0=[1, 1], p=3, lbx=[bound, -np.inf])["x"][0]) == pytest.approx(x_value, abs=1e-7)
    first, *others = (mpcc.derivatives for mpcc, _ in made)
    assert first is None
    assert len({id(derivatives) for derivatives in others}) == 1
    assert others[0] is not None


def test_multipliers_of_a_neighbour_are_a_warm_start():
    solver = mpccsol("solver", "scholtes", PAIR)
    first = solver(x0=[1, 1], p=3)
    cold = solver.stats()["n_nlp"]
    again = {f"lam_{name}0": first[f"lam_{name}"] for name in ("x", "g", "G", "H")}
    second = solver(x0=first["x"], p=3.1, **again)
    assert second["x"].full().ravel() == pytest.approx([3.1, 0], abs=1e-7)
    assert solver.stats()["n_nlp"] < cold


def test_columns_of_arguments_are_solved_one_by_one():
    mx, mp = ca.MX.sym("x", 2), ca.MX.sym("p")
    in_mx = {"x": mx, "p": mp, "f": (mx[0] - mp) ** 2 + (mx[1] - 1) ** 2, "G": mx[0], "H": mx[1]}
    values = np.array([[2.0, 3.0]])
    for problem, options in ((PAIR, {}), (in_mx, {}), (in_mx, {"expand": True, **QUIET})):
        solver = mpccsol("solver", "scholtes", problem, options)
        answer = solver(x0=[1, 1], p=values)["x"].full()
        assert answer == pytest.approx(np.array([[2, 3], [0, 0]]), abs=1e-7)
    assert solver.map(2)(x0=[1, 1], p=values)["f"].full() == pytest.approx(1, abs=1e-7)


def made_into_a_function():
    """The point and the least value as functions of p, and the derivative of the point by CasADi."""
    problem, q = PAIR | {"f": PAIR["f"] + p * x}, ca.MX.sym("q")
    answer = mpccsol("solver", "scholtes", problem, {"enable_fd": True})(x0=[1, 1], p=2 * q)
    return ca.Function("outer", [q], [answer["x"], answer["f"], ca.jacobian(answer["x"], q)])


def test_symbolic_call_is_part_of_a_graph():
    """(x - p)^2 + p x is least at x = p / 2, so at q if p = 2 q: f = 3 q^2 + 1. The solver itself may go."""
    point, value, slopes = made_into_a_function()(3)
    assert point.full().ravel() == pytest.approx([3, 0], abs=1e-7)
    assert float(value) == pytest.approx(28, abs=1e-6)
    assert slopes.full().ravel() == pytest.approx([1, 0], abs=1e-4)


def test_failed_solve_is_an_answer_or_an_error():
    limited = {"max_iterations": 1}
    solver = mpccsol("solver", "scholtes", PAIR, limited)
    assert solver(x0=[1, 1], p=3)["x"].is_regular()
    assert solver.stats()["unified_return_status"] == "SOLVER_RET_LIMITED"
    with pytest.raises(RuntimeError, match="solver: Stopped at the iteration limit"):
        mpccsol("solver", "scholtes", PAIR, {"error_on_fail": True, **limited})(x0=[1, 1], p=3)


def test_bad_numbers_and_interruptions_come_through_casadi(capfd, monkeypatch):
    """It prints no traceback, and no error is left behind for the next call."""
    solver = mpccsol("solver", "scholtes", PAIR)
    for given, words in (
        ({"x0": [1, np.nan]}, r"x0.1. .y. is nan"),
        ({"p": np.inf}, r"p.0. .p. is inf"),
        ({"lbx": [3, 0], "ubx": [2, 9]}, r"lbx.0. .* = 3.0 and ubx.0. = 2.0 leave no value"),
    ):
        with pytest.raises(ValueError, match=words):
            solver(**{"x0": [1, 1], "p": 3, **given})
    assert capfd.readouterr().err == ""
    assert isinstance(solver, MPCCFunction)
    assert float(solver(x0=[1, 1], p=3)["f"]) == pytest.approx(1, abs=1e-7)

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(MPCCSolver, "__call__", interrupted)
    with pytest.raises(KeyboardInterrupt):
        solver(x0=[1, 1], p=3)


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


@pytest.mark.parametrize(
    ("more", "options", "expected"),
    [
        ({"switches": "xy"}, {}, (0, -2)),
        ({}, {"cc_pairs": [(0, 1)]}, (1, 0)),
        # x - 0.3 complements -1 <= y <= 2
        ({"G": "x", "H": "y", "lbH": -1, "ubH": 2}, {}, (1, -1)),
        ({"G": "x", "H": "y", "lbG": -5, "ubH": -1}, {}, (1, -1)),
    ],
)
def test_pairs_with_bounds_and_switches_keep_the_sizes_of_the_user(more, options, expected):
    v = ca.SX.sym("v", 2)
    names = {"x": v[0] - 0.3, "y": v[1], "xy": (v[0], v[1])}
    problem = {"x": v, "f": (v[0] - 1) ** 2 + (v[1] + 2) ** 2, "g": v[0] + v[1]}
    more = {key: names.get(value, value) if isinstance(value, str) else value for key, value in more.items()}
    solver = mpccsol("solver", "scholtes", problem | more, options)
    answer = solver(x0=[0.5, 0.5], ubg=10)
    assert answer["x"].full().ravel() == pytest.approx(expected, abs=1e-6)
    assert answer["lam_g"].shape == (1, 1)
    warm = {f"lam_{name}0": answer[f"lam_{name}"] for name in ("x", "g", "G", "H")}
    again = solver(x0=answer["x"], ubg=10, **warm)
    assert again["f"] == pytest.approx(float(answer["f"]), abs=1e-7)
