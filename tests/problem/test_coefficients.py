"""Functions of position: their rule, and what is said where they cannot be used; material laws by hand."""

import math
import pickle
from decimal import Decimal
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.problem import Elastic, PiecewiseLinear
from rmesh_nlp.problem.coefficients import POSITION, at, is_nonzero, on_points
from rmesh_nlp.problem.quadrature import exact_rule
from rmesh_nlp.problem.switches import polynomial_degree, switches
from support.formulations import fixed


@pytest.mark.parametrize(
    ("load", "degree"),
    [
        (3.0, 0),
        (lambda x, y: x**2 * y**3, 5),
        (lambda x, y: x**7, 7),
        (lambda x, y: x**7 * y, None),
        (PiecewiseLinear((0, 1, 2), (0, 1, 2)), 1),
        (PiecewiseLinear((0, 1, 2), (0, 1, 1)), None),
        (lambda x, y: ca.fmod(x, 0.3), None),
        (lambda x, y: ca.sin(x), None),
        (lambda x, y: ca.if_else(x > 0, x, 1.0), None),
        (lambda x, y: 1 / (1 + x**2), None),
    ],
)
def test_degree_of_a_load(load: Any, degree: int | None) -> None:
    assert polynomial_degree(load) == degree


def power(n: int) -> Any:
    return lambda x, y: x**n


def sine(x: Any, y: Any) -> Any:
    return ca.sin(x)


@pytest.mark.parametrize(
    ("loads", "tractions", "rule"),
    [
        # the load times a linear function is of one degree more; on edges the rule is of degree 4 anyway
        ([], [], "midpoint"),
        ([power(1), 1.0], [power(3)], "midpoint"),
        ([power(3), 1.0], [power(2)], 4),
        ([1.0], [power(4)], 5),
        ([power(7)], [], 8),
        ([sine, 1.0], [], None),
        # of jumps what is between them counts, where elements are split there
        ([lambda x, y: ca.if_else(x > 0.3, y, 1.0)], [], 2),
        ([lambda x, y: ca.if_else(x * y > 0.3, y, 1.0)], [], None),
        ([lambda x, y: ca.fabs(x) + ca.fabs(y) + ca.fabs(x - y)], [], 2),
        ([lambda x, y: sum(ca.fabs(x - k) for k in range(5))], [], None),
        ([], [lambda x, y: ca.fabs(x) + ca.fabs(y) + ca.fabs(x - y)], "midpoint"),
    ],
)
def test_rule_is_the_cheapest_exact_one(loads: list, tractions: list, rule: str | int) -> None:
    assert exact_rule(loads, tractions) == rule


def test_a_rule_is_exact_for_the_order_of_displacements() -> None:
    assert exact_rule([power(2)], [], 2) == 4
    assert exact_rule([1.0], [1.0], 2) == "midpoint"


def test_piecewise_linear_function_interpolates_and_extends() -> None:
    f = PiecewiseLinear((0.0, 1.0, 3.0), (1.0, 2.0, 0.0))
    x = np.array([-1.0, 0.5, 1.0, 2.0, 4.0])
    np.testing.assert_allclose(on_points(f, np.stack([x, x])), [0.0, 1.5, 2.0, 1.0, -1.0], atol=1e-15)
    assert f.kinks == (1.0,)


def test_values_at_points() -> None:
    points = np.array([[1.0, -4.0], [0.0, 2.0]])
    assert on_points(2.5, points).tolist() == [2.5, 2.5]
    assert on_points(lambda x, y: x * y, points[:, :0]).shape == (0,)
    with pytest.raises(ValueError, match=r"the load is nan at \(-4, 2\)"):
        on_points(lambda x, y: ca.log(x), points, "the load")
    assert [is_nonzero(c) for c in (0.0, -1e-300, lambda x, y: 0.0)] == [False, True, True]


def stated(source: Any, **parts: Any) -> rm.ContactProblem:
    return rm.ContactProblem(rm.shapes.rectangle(4, 4), rm.Laplace(source), ("left",), **parts)


def step(x, y):
    return 1.0 if x > 0.5 else 0.0


@pytest.mark.parametrize(
    ("source", "parts", "message"),
    [
        (step, {}, r"cannot branch on x or y.*where\(condition, a, b\)"),
        (lambda x, y: max(x, y), {}, "cannot branch"),
        (1.0, {"obstacle": rm.Obstacle("bottom", (1.0,), step)}, "cannot branch"),
        (lambda x, y: math.sin(x), {}, "not those of math"),
    ],
)
def test_function_that_takes_no_symbols_is_refused_with_advice(source, parts, message) -> None:
    with pytest.raises(rm.ProblemError, match=message):
        stated(source, **parts)


@pytest.mark.filterwarnings("error")
def test_where_and_functions_of_numpy_work_without_a_warning() -> None:
    obstacle = rm.Obstacle("right", (1.0,), lambda x, y: 0.1 + 0.1 * np.cos(y))
    # np.maximum and np.abs need casadi 3.8
    assert fixed.solve(stated(lambda x, y: np.sin(x) * np.sqrt(y + 0.2), obstacle=obstacle)).success
    assert fixed.solve(stated(lambda x, y: rm.where(x > 0.5, 1.0, 0.0))).energy < 0


class Slope:
    """A function of position that cannot be hashed."""

    __hash__ = None  # type: ignore[assignment]

    def __init__(self, rate: float) -> None:
        self.rate = rate

    def __call__(self, x: Any, y: Any) -> Any:
        return self.rate * x


def test_degree_of_a_switch_is_known_between_known_switches_alone() -> None:
    for inner, degree in ((lambda x: x - 0.3, 1), (lambda x: np.sin(9 * x), None)):
        kink = switches(lambda x, y, inner=inner: ca.fmax(rm.where(inner(x) > 0, x, 2 * x) - y, 0))
        assert degree in kink.degrees
        assert (None in kink.degrees) is (degree is None)
        assert kink.degrees[-1] == degree


def test_what_is_kept_of_a_coefficient_is_its_own() -> None:
    at = np.array([[1.0, 2.0], [0.0, 0.0]])
    for rate in (1.0, 3.0):
        np.testing.assert_allclose(on_points(Slope(rate), at), rate * at[0])
        np.testing.assert_allclose(on_points(lambda x, y, rate=rate: rate * x, at), rate * at[0])


@pytest.mark.parametrize(
    ("law", "in_plane", "out_of_plane"),
    [(rm.PlaneStrain(12.0, 8.0), 12.0, 24.0), (rm.PlaneStress(12.0, 8.0), 192 / 28, 0.0)],
)
def test_stress_and_energy_of_an_elastic_law(law: Elastic, in_plane: float, out_of_plane: float) -> None:
    assert law.in_plane_lambda == pytest.approx(in_plane, rel=1e-15)
    assert law.out_of_plane_stress(2.0) == out_of_plane
    # strain ((1, 2.5), (2.5, 4)): trace 5, sum of squares 29.5
    density = law.energy_density(ca.DM([[1, 2], [3, 4]]))
    assert float(density) == pytest.approx(0.5 * in_plane * 25 + 8 * 29.5, rel=1e-15)
    assert law.components == 2


@pytest.mark.parametrize("kind", [rm.PlaneStrain, rm.PlaneStress])
def test_moduli_of_engineers_become_lame_coefficients(kind: type[Elastic]) -> None:
    law = kind.from_young(2600.0, 0.3, (1.0, -2.0))
    assert (law.lame_lambda, law.lame_mu) == pytest.approx((1500.0, 1000.0), rel=1e-14)
    assert type(law) is kind
    assert law.load == (1.0, -2.0)
    assert kind(1.0, 1.0).load == (0.0, 0.0)
    assert kind.from_young(1e-9, 0.4999).lame_mu > 0
    assert kind.from_young(1.0, -0.9999).in_plane_lambda < 0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: rm.Laplace(1.0, 0.0), "conductivity must be positive and finite, got 0.0"),
        (lambda: rm.PlaneStrain(1.0, 0.0), "mu=0.0 are not those of an elastic solid"),
        (lambda: rm.PlaneStrain(np.nan, 1.0), "lambda=nan"),
        (lambda: rm.PlaneStrain(-8.0, 8.0), "lambda=-8.0, mu=8.0 are not those of an elastic solid"),
        (lambda: rm.PlaneStress(-0.67, 1.0), "lambda=-0.67"),
        (lambda: rm.PlaneStress(-2.0, 1.0), "lambda=-2.0"),
        (lambda: PiecewiseLinear((0.0, 1.0), (1.0,)), "2 or more points"),
        (lambda: PiecewiseLinear((0.0, 0.0), (1.0, 2.0)), "must increase"),
        (lambda: PiecewiseLinear((0.0, 1.0), (0.0, np.nan)), "must be finite"),
        (lambda: rm.PlaneStrain(1.0, 1.0, (1.0,)), "body_force must have 2 components"),
        (lambda: rm.PlaneStrain.from_young(0.0, 0.3), "young must be positive and finite, got 0.0"),
        (lambda: rm.PlaneStrain.from_young(1.0, 0.5), "poisson must lie between -1 and 0.5, got 0.5"),
        (lambda: rm.PlaneStrain.from_young(1.0, -1.0), "between -1 and 0.5, got -1.0"),
        (lambda: rm.PlaneStrain.from_young(None, 0.3), "young must be a number, got None"),
        (lambda: rm.PlaneStrain.from_young(1.0, "x"), "poisson must be a number, got 'x'"),
    ],
)
def test_what_is_no_material_and_no_function_is_refused(make: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def with_number(n: Any) -> tuple[Any, ...]:
    """A part of each kind that holds a number, which is 0.5 after it."""
    return (
        rm.PlaneStrain(1.0, 1.0, (n, n)),
        rm.PlaneStrain.from_young(10.0 + n, n - 0.25),
        rm.Traction("top", (n, n)),
        rm.Obstacle("bottom", offset=n, friction=n, coulomb=n, kinks=(n,)),
        rm.Obstacle("bottom", force=(0.0, -n)),
        rm.Obstacle.pair("bottom", "top", n),
        rm.Motion(n, min_angle=n),
        rm.Constraint("area", (0.0, n)),
        PiecewiseLinear((0.0, n), (n, n)),
        rm.Obstacle.line("bottom", (n, n), (n, n)).distance(*POSITION),
        rm.Obstacle.circle("bottom", (n, n), n).distance(*POSITION),
        at(lambda x, y: n, *POSITION),
    )


@pytest.mark.parametrize("half", [np.longdouble(0.5), np.float32(0.5), np.array(0.5), Fraction(1, 2)])
def test_a_real_number_of_any_type_is_a_float(half: Any) -> None:
    """CasADi ends the process at a long double."""
    assert repr(with_number(half)) == repr(with_number(0.5))


@pytest.mark.parametrize("value", ["1", True, None, np.array([0.5]), 1j, Decimal("0.1")], ids=repr)
def test_what_is_no_number_is_refused_by_name(value: Any) -> None:
    for name, make in {
        "value": lambda: rm.Traction("top", ([value], 0.0)),
        "lame_mu": lambda: rm.PlaneStrain(1.0, value, (0.0, 0.0)),
        "delta": lambda: rm.Motion((value, value)),
    }.items():
        with pytest.raises(rm.BadInputError, match=f"^{name} must be a number, got"):
            make()


@pytest.mark.parametrize("value", [None, "10", (1.0, 2.0), np.ones(2), ca.vertcat(1, 2), np.array("a")])
@pytest.mark.parametrize(
    ("changes", "named"),
    [
        (lambda f: {"tractions": rm.Traction("top", (f, 0.0))}, "component 1 of the traction on 'top'"),
        (lambda f: {"law": rm.PlaneStrain(1.0, 1.0, (0.0, f))}, "component 2 of the body force"),
        (lambda f: {"obstacle": rm.Obstacle("bottom", friction=f)}, "the friction bound on 'bottom'"),
    ],
)
def test_a_coefficient_is_one_number(changes: Any, named: str, value: Any) -> None:
    parts = {"mesh": rm.shapes.rectangle(2, 2), "law": rm.PlaneStrain(1.0, 1.0), "dirichlet": "left"}
    with pytest.raises(rm.ProblemError) as error:
        rm.ContactProblem(**{**parts, "obstacle": rm.Obstacle("bottom"), **changes(lambda x, y: value)})
    assert str(error.value) == f"{named}: a coefficient must be a number, got {value!r}"


def height(x: Any, y: Any) -> Any:
    return 0.01 * x**2 - 0.05


def level(x: Any, y: Any) -> Any:
    return y - height(x, y)


OBSTACLES = {
    "graph": rm.Obstacle.graph("bottom", height, coulomb=height),
    "line": rm.Obstacle.line("bottom", (0.0, -0.05), (0.0, 2.0)),
    "circle": rm.Obstacle.circle("bottom", (0.5, -10.05), 10.0),
    "curve": rm.Obstacle.curve("bottom", level),
    "interior": rm.Obstacle.interior(height),
}


@pytest.mark.parametrize("name", OBSTACLES)
def test_a_pickled_obstacle_is_the_same(name: str) -> None:
    points = np.array([[0.1, 0.7], [0.0, 0.2]])
    obstacle = OBSTACLES[name]
    copy = pickle.loads(pickle.dumps(obstacle))
    np.testing.assert_array_equal(copy.distances(points), obstacle.distances(points))
    np.testing.assert_array_equal(copy.normals(points), obstacle.normals(points))
