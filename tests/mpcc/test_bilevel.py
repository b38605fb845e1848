"""Bilevel programs: their KKT conditions, starts, known optima, and the check of the lower level."""

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from mpcc_library.bilevel_problems import PROBLEMS
from rmesh_nlp.mpcc import bilevel, outcome, solve, solve_bilevel
from rmesh_nlp.mpcc.bilevel_solve import _inside, _moving
from rmesh_nlp.mpcc.lower_level import LowerLevel
from rmesh_nlp.optimize.status import Status
from support.scripted_run import ended

INF = np.inf
KINDS = (ca.SX, ca.MX)


def values(mpcc, at, *names, p=()):
    """The named parts of an MPCC at a point, flat."""
    function = ca.Function("parts", [mpcc.x, mpcc.p], [ca.densify(mpcc.parts[name]) for name in names])
    parts = function.call([ca.DM(at), ca.DM(p)])
    return [part.full().ravel() for part in parts]


def projection(kind=ca.SX):
    """``min (x - 3)^2 + (y - 2)^2``, y the point of [0, 1] nearest to x: x = 3, y = 1."""
    x, y = kind.sym("x"), kind.sym("y")
    return bilevel(
        {"x": x, "f": (x - 3) ** 2 + (y - 2) ** 2}, {"f": (y - x) ** 2 / 2, "lbx": 0, "ubx": 1}, variables=y
    )


def all_bounds(kind=ca.SX, variables=list):
    """A lower level with every kind of bound on its five variables and its four rows."""
    x = kind.sym("x", 2)
    y = [kind.sym(f"y{i}") for i in range(5)]
    column = ca.vertcat(*y)
    target = ca.vertcat(x, 2 * x, -x[0])
    lower = {
        "f": ca.sumsqr(column - target) / 2 + ca.exp(y[0] - y[1]),
        "g": [y[0] + y[1], y[1] * y[2], y[3] - y[4], ca.sum1(column) + x[1]],
        "lbx": [0, -INF, -1, -INF, 0.5], "ubx": [INF, 1, 1, INF, 0.5],
        "lbg": [0.2, -INF, -1, 2], "ubg": [INF, 0.5, 1, 2],
    }  # fmt: skip
    upper = {"x": x, "f": ca.sumsqr(x - 1) + ca.sum1(column), "lbx": -2, "ubx": 2}
    return bilevel(upper, lower, variables=variables(y)), lower, column, x


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("variables", [list, lambda y: ca.vertcat(*y)])
def test_multipliers_are_those_of_nlpsol(kind, variables):
    """The start satisfies the KKT conditions, and its multipliers have the values and signs of CasADi."""
    mpcc, lower, y, x = all_bounds(kind, variables)
    # pairs: lbx 2 (0, -1), ubx 2 (1, 1), lbg 2 and ubg 2; free: y[4] = 0.5 and the row of 2
    assert (mpcc.n_pairs, mpcc.n_g, mpcc.n_x) == (8, 5 + 2, 2 + 5 + 10)
    nlp = {"x": y, "p": x, "f": lower["f"], "g": ca.vertcat(*lower["g"])}
    quiet = {"print_level": 0, "sb": "yes", "tol": 1e-10, "bound_relax_factor": 0}
    known = ca.nlpsol("known", "ipopt", nlp, {"ipopt": quiet, "print_time": 0})
    for at in ([0.3, 0.1], [1.5, -0.7], [-1, 0.8]):
        bounds = {key: lower[key] for key in ("lbx", "ubx", "lbg", "ubg")}
        expected = known(p=at, x0=0, **bounds)
        start = mpcc.lower_level.start(at)
        names = ("upper", "lower", "lam_x", "lam_g")
        for name, got in zip(names, values(mpcc, start, *names), strict=True):
            right = at if name == "upper" else expected["x" if name == "lower" else name].full().ravel()
            assert got == pytest.approx(right, abs=1e-6), name
        column = ca.Function("kkt", [mpcc.x], [mpcc.g, mpcc.G, mpcc.H])
        rows, G, H = (part.full().ravel() for part in column(start))
        assert np.max(np.abs(rows)) <= 1e-7
        assert min(G.min(), H.min()) >= -1e-7
        assert np.max(np.minimum(G, H)) <= 1e-6


@pytest.mark.parametrize("name", ["bard-1984-a", "toll-setting-5", "bard-1991-1", "henderson-quandt-1958"])
def test_known_optimum_from_the_given_start(name):
    problem = PROBLEMS[name]
    result = solve(problem.program(), problem.x0)
    assert result.success
    assert result.f == pytest.approx(problem.best, rel=1e-3, abs=1e-3)
    assert result.lower_level.verdict in ("global minimum", "local minimum")


@pytest.mark.slow
def test_most_of_the_library_ends_at_known_optima_and_none_below():
    reached, convex = 0, [problem for problem in PROBLEMS.values() if problem.convex]
    for problem in convex:
        result = solve(problem.program(ca.MX), problem.x0)
        assert result.success, problem.name
        assert result.b_stationary, problem.name
        tolerance = 1e-3 * (1 + abs(problem.best))
        assert result.f >= problem.best - tolerance, problem.name
        reached += result.f <= problem.best + tolerance
    assert len(convex) >= 50
    assert reached >= 0.8 * len(convex)


def test_stackelberg_duopoly_with_a_parameter():
    """Demand p - q_1 - q_2, unit cost 1: the leader sells half of p - 1, the follower a quarter."""
    leader, follower, size = (ca.SX.sym(name) for name in ("leader", "follower", "size"))
    price = size - leader - follower
    mpcc = bilevel(
        {"x": leader, "f": -(price - 1) * leader, "lbx": 0, "p": size},
        {"x": follower, "f": -(price - 1) * follower, "lbx": 0},
        variables=follower,
    )
    for p in (5.0, 13.0):
        result = solve(mpcc, 1.0, p=p)
        assert result.x == pytest.approx([(p - 1) / 2, (p - 1) / 4, 0], abs=1e-7)
        assert -result.f == pytest.approx((p - 1) ** 2 / 8)
        assert result.lower_level.verdict == "global minimum"
        assert result.lower_level.f == pytest.approx(-((p - 1) ** 2) / 16)


def test_multipliers_may_enter_the_upper_level():
    """The price of a market is the multiplier of its balance; the upper level sells x at that price.

    min y^2 / 2 over x + y = 4: y = 4 - x, price y. Revenue x (4 - x) is largest at 2.
    """
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    market = {"f": y**2 / 2, "g": x + y, "lbg": 4, "ubg": 4}
    mpcc = bilevel({"x": x, "f": 0}, market, variables=y)
    priced = mpcc.extended(f=x * mpcc.parts["lam_g"])  # the multiplier of an equality is minus the price
    result = solve(priced, 0.5)
    assert result.success
    assert result.x == pytest.approx([2, 2, -2], abs=1e-7)
    assert result.f == pytest.approx(-4)


def test_start_for_the_upper_level_alone_is_completed():
    mpcc = projection()
    assert mpcc.n_own == 1
    assert mpcc.start(3.0) == pytest.approx([3, 1, 1, 1], abs=1e-6)
    assert list(mpcc.start([1.0, 2, 3, 4])) == [1, 2, 3, 4]
    assert mpcc.lower_level.start(3.0) == pytest.approx([3, 1, 0, 2], abs=1e-6)
    with pytest.raises(ValueError, match="x0 has length 2, expected 1"):
        mpcc.start([1.0, 2.0])
    y = mpcc.parts["lower"]
    assert mpcc.extended(g=y, lbg=0.2).start(3.0).size == 4
    assert mpcc.extended(x=ca.SX.sym("new")).n_own == 5
    assert solve(mpcc.extended(g=y, ubg=0.6), 3.0).x[1] == pytest.approx(0.6, abs=1e-7)


def saddle(f, at, g=(), **bounds):
    """The check of ``min f(y_1, y_2)`` at ``at`` (y, then multipliers), to be called by a test."""

    def check():
        y, x = ca.SX.sym("y", 2), ca.SX.sym("x")
        lower = {"f": f(y), **({"g": [row(y) for row in g]} if g else {}), **bounds}
        return bilevel({"x": x, "f": x}, lower, variables=y).lower_level.check([0.0, *at])

    return check


@pytest.mark.parametrize(
    ("check", "verdict", "low", "high"),
    [
        (saddle(lambda y: y[0] ** 2 + 3 * y[1] ** 2, [0, 0]), "global minimum", 2, 2),
        (saddle(lambda y: y[0] ** 2 + y[1] ** 2 + y[0] ** 4, [0, 0]), "local minimum", 2, 2),
        (saddle(lambda y: y[0] ** 2 - y[1] ** 2, [0, 0]), "no minimum", -2, -2),
        (saddle(lambda y: y[0] ** 2 + y[1] ** 4, [0, 0]), "undecided", 0, 0),
        # curvature -6e-12 at points of 1e-12
        (saddle(lambda y: y[0] ** 3 + y[1] ** 3, [-1e-12, -1e-12]), "undecided", 0, 0),
        (saddle(lambda y: y[0], [0, 0]), "not stationary", 0, 0),
        # multipliers have signs and are complementary
        (saddle(lambda y: y[0] + y[1] ** 2, [0, 0, 1, 0], lbx=0), "global minimum", 2, 2),
        (saddle(lambda y: y[0], [0.5, 0, 1], lbx=[0, -INF]), "not stationary", 0, 0),
        (saddle(lambda y: -y[0], [0, 0, -1], lbx=[0, -INF]), "not stationary", 0, 0),
        # convex, but not its constraint, which is not active
        (saddle(ca.sumsqr, [0, 0, 0], [lambda y: y[0] * y[1]], lbg=-5), "local minimum", 2, 2),
        # an equality without a multiplier leaves no direction along y_2
        (saddle(lambda y: y[0] ** 2 - y[1] ** 2, [0, 0, 0], [lambda y: y[1]], lbg=0, ubg=0),
         "local minimum", 2, 2),
        # vertex: no direction is left
        (saddle(lambda y: ca.sum1(y) - y[0] * y[1], [0, 0, 1, 1], lbx=0), "local minimum", INF, INF),
        # y_1 >= 0 holds with a multiplier, the rest is concave
        (saddle(lambda y: y[0] - y[1] ** 2, [0, 0, 1], lbx=[0, -INF]), "no minimum", -2, -2),
        # one bound without a multiplier: -2 along +y_1 is a critical direction
        (saddle(lambda y: y[1] ** 2 - y[0] ** 2, [0, 0, 0], lbx=[0, -INF]), "no minimum", -2, -2),
        # y >= 0 with y_1 y_2: the Hessian is indefinite, the quadrant has no direction of descent
        (saddle(lambda y: y[0] * y[1], [0, 0, 0, 0], lbx=0), "undecided", -1, 0),
        (saddle(lambda y: 3 * y[0] * y[1] + (y[0]**2 + y[1]**2) / 2, [0, 0, 0, 0], lbx=0),
         "undecided", -2, 1),
        # ... and with -y_1 y_2 it has one inside, though along no edge
        (saddle(lambda y: -y[0] * y[1], [0, 0, 0, 0], lbx=0), "no minimum", -1, -1),
        # y_1 = y_2^2 / 2: curvature of the constraint, with its multiplier 1
        (saddle(lambda y: y[0] - y[1] ** 2, [0, 0, -1], [lambda y: y[0] - y[1] ** 2 / 2], lbg=0, ubg=0),
         "no minimum", -1, -1),
        # the same row twice: multipliers are not unique, so negative curvature with these proves nothing
        (saddle(lambda y: y[0] - y[1] ** 2, [0, 0, -1, 0],
                [lambda y: y[0] - y[1] ** 2 / 2, lambda y: y[0] - 2 * y[1] ** 2], lbg=0, ubg=0),
         "undecided", -1, -1),
    ],
)  # fmt: skip
def test_second_order_conditions(check, verdict, low, high):
    found = check()
    assert found.verdict == verdict
    assert (found.curvature_low, found.curvature_high) == pytest.approx((low, high), abs=1e-9)
    assert verdict in str(found)


@pytest.mark.parametrize("name", ["mitsos-barton-3.12", "mitsos-barton-3.13", "mitsos-barton-3.17"])
def test_end_at_a_maximum_of_the_lower_level_is_no_success(name):
    """The MPCC takes a stationary point of the lower level that is better for the upper one."""
    problem = PROBLEMS[name]
    result = solve(problem.program(), problem.x0)
    assert (result.status, result.success) == (Status.NO_MINIMUM, False)
    assert result.f < problem.best - 0.1
    assert result.stationarity == "S"
    assert result.lower_level.verdict == "no minimum"
    assert result.lower_level.curvature_high < 0
    assert "lower level: no minimum, a lower value was found, least curvature -" in str(result)


def levels(name):
    """The levels of a problem of the library, and its start."""
    problem = PROBLEMS[name]
    x, y = ca.SX.sym("x", len(problem.x0)), ca.SX.sym("y", len(problem.y0))
    upper, lower = problem.levels(x, y)
    return {"x": x, **upper}, lower, y, problem


@pytest.mark.slow
def test_cuts_lead_to_the_optimum_of_a_lower_level_that_is_not_convex():
    upper, lower, y, problem = levels("mitsos-barton-3.13")
    end = solve_bilevel(upper, lower, problem.x0, variables=y, starts=1)
    assert end.success
    assert end.cuts >= 1
    assert (end.status, end.lower_level.searched) == (Status.CONVERGED, 20)
    assert end.f == pytest.approx(problem.best, abs=2e-3)
    assert f"; {end.cuts} cut" in str(end)


def test_without_cuts_a_local_minimum_of_the_lower_level_is_found_out():
    upper, lower, y, problem = levels("mitsos-barton-3.15")
    end = solve_bilevel(upper, lower, problem.x0, variables=y, starts=1, cuts=0)
    assert (end.success, end.cuts, end.lower_level.verdict) == (False, 0, "no minimum")
    assert "a lower value was found" in str(end)
    assert end.lower_level.lower == pytest.approx([1], abs=1e-6)
    level = bilevel(upper, lower, variables=y).lower_level
    assert level.check(end.result.x).verdict == "local minimum"  # to second order, without a search


@pytest.mark.slow
def test_cut_holds_only_where_its_point_is_feasible():
    """y >= x: at x = -2 the lower level has the minima y = x and 1; above it y = 1 alone, where F = 4."""
    upper, lower, y, _ = levels("vogel-2012")
    end = solve_bilevel(upper, lower, [-1.5, -2.0, 0.0], variables=y, starts=1)
    assert (end.success, end.cuts >= 1) == (True, True)
    assert (end.x[0], end.y[0], end.f) == pytest.approx((-2, -2, 1), abs=1e-3)


def test_cut_point_is_inside_constraints_that_move():
    """-y^2 over -0.5 <= y <= x: at x = 1 and y = 0 the lowest y is 1, on the constraint that moves."""
    level = bilevel(
        {"x": x, "f": x}, {"f": -(y**2), "g": y - x, "ubg": 0, "lbx": -0.5}, variables=y
    ).lower_level
    violations = _moving(level)
    end = SimpleNamespace(x=np.array([1.0, 0, 0, 0]), lower_level=SimpleNamespace(f=0.0))
    inner = _inside(level, violations, end, np.array([1.0]), np.zeros(0))
    assert -0.8 - 1e-6 <= -(inner[0] ** 2) < -0.7


def test_an_end_that_the_last_search_refutes_is_no_success(monkeypatch):
    """Of 100 starts one finds a lower value than those of each solve, and no cut may be made."""
    lower, start = {"f": (y**2 - 1) ** 2, "lbx": -2, "ubx": 2}, [0.5, 1.2, 0.0, 0.0]
    monkeypatch.setattr(
        LowerLevel, "lowest", lambda *_, n=20, **__: ended([0.5], Status.CONVERGED, -9.0 if n == 100 else 9.0)
    )
    end = solve_bilevel({"x": x, "f": x**2 + (y - 1) ** 2}, lower, start, variables=y, starts=1, cuts=0)
    assert (end.success, end.status) == (False, Status.ITERATION_LIMIT)


@pytest.mark.slow
def test_cuts_make_progress_where_constraints_move_and_their_limit_is_a_status():
    """The lower level's two minima are equal at x = 0.3228, above which F is 0.41943 and more (by a grid).

    y = (x, 0) or (0, x) in the second, not y = (x, x) / 2: F = (x - 1)^2 + (x - 1/2)^2, at least 1/8.
    """
    quartic = 2 * x * y - y**2 / 2 - x * y**2 + 0.875 * y**4 - y**3 / 3 - y / 2
    upper = {"x": x, "f": (x + 0.217830387) ** 2 + (y + 0.248472508) ** 2, "lbx": -1, "ubx": 1}
    lower = {"f": quartic, "g": x + y, "ubg": 1, "lbx": -2, "ubx": 2}
    few, many = (solve_bilevel(upper, lower, 0.3, variables=y, starts=1, cuts=n) for n in (2, 20))
    assert (few.success, few.status) == (False, Status.ITERATION_LIMIT)
    assert "no cut excludes" in few.message
    assert (many.success, many.f) == (True, pytest.approx(0.41943, abs=1e-4))


def test_lowest_of_several_starts_is_a_solution_and_no_lower_end_that_is_none(monkeypatch):
    of = (Status.CONVERGED, 2.0), (Status.ITERATION_LIMIT, 0.0), (Status.CONVERGED, 1.0)
    ends = iter([ended([0.0], *each) for each in of])
    monkeypatch.setattr(LowerLevel, "solve", lambda *_, **__: next(ends))
    upper, lower, y, problem = levels("mitsos-barton-3.13")
    level = bilevel(upper, lower, variables=y).lower_level
    assert level.lowest(problem.x0, n=3).f == 1.0


def test_convex_lower_levels_are_neither_searched_nor_cut(monkeypatch):
    monkeypatch.setattr(LowerLevel, "lowest", lambda *_, **__: pytest.fail("searched"))
    upper, lower, y, problem = levels("sinha-tp6")
    end = solve_bilevel(upper, lower, problem.x0, variables=y, starts=1)
    assert (end.success, end.lower_level.searched, end.cuts) == (True, 0, 0)
    assert end.f == pytest.approx(problem.best, rel=1e-3)


def test_large_lower_level_is_checked_on_request_only(monkeypatch):
    monkeypatch.setattr(outcome, "DENSE", 0)
    mpcc = projection()
    result = solve(mpcc, 0.5)
    assert (result.success, result.lower_level) == (True, None)
    assert mpcc.lower_level.check(result.x).verdict == "global minimum"


x, y, z = (ca.SX.sym(name) for name in "xyz")


@pytest.mark.parametrize(
    ("upper", "lower", "words"),
    [
        ({"x": x, "f": x, "h": x}, {"f": y}, "upper: unknown key 'h'"),
        ({"f": y}, {"f": y}, "upper: 'x' is missing"),
        ({"x": x}, {"f": y}, "upper: 'f' is missing"),
        ({"x": x, "f": x}, {"g": y, "ubg": 0}, "lower: 'f' is missing"),
        ({"x": x, "f": x}, {"f": y, "p": z}, "lower: parameters p belong to the upper level"),
        ({"x": x, "f": x}, {"f": y, "g": x + y}, "lower: g has neither lbg nor ubg"),
        ({"x": x, "f": x}, {"f": y, "x": z}, "lower: x is not the column of the variables"),
        ({"x": x, "f": x}, {"f": y + z}, "lower: free symbols"),
        ({"x": x, "f": z}, {"f": y}, "upper: free symbols"),
        ({"x": x, "f": x}, {"f": y, "lbx": [0, 1]}, "lower: lbx has length 2"),
        ({"x": x, "f": x}, {"f": y, "lbx": 1, "ubx": 0}, "lower: lbx.0. .*= 1.0 and ubx.0. = 0.0"),
        ({"x": [x, y], "f": x}, {"f": y}, "upper: x has variables of the lower level"),
        ({"x": ca.MX.sym("x"), "f": 0}, {"f": y}, "variables must be a column of MX"),
    ],
)  # fmt: skip
def test_malformed_levels_are_refused(upper, lower, words):
    with pytest.raises(ValueError, match=words):
        bilevel(upper, lower, variables=y)
