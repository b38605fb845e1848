"""Bounds of forces and displacements hold known ones, and are infinite where there is none."""

from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.assessment.admissible import Continuous, admissible
from rmesh_nlp.certificate.bracket import Bracket
from rmesh_nlp.certificate.forces import force_bounds, slope_bounds
from rmesh_nlp.problem import ContactProblem, Dirichlet, Laplace, Obstacle, Place, PlaneStrain, Traction
from rmesh_nlp.solving import certify as certifying
from support.certificates import distorted, signorini
from support.formulations import fixed
from support.objectives import value_on, values_at
from support.orders import ORDERS

BOTH = pytest.mark.parametrize("order", ORDERS)


def bounds_of(problem: ContactProblem) -> tuple[float, float]:
    found = rm.certify(fixed.solve(problem))
    (bounds,) = found.bounds.values()
    assert bounds.guaranteed
    assert "np." not in repr(found)
    return bounds.lower, bounds.upper


@BOTH
def test_force_of_a_membrane_that_is_pulled_onto_its_obstacle(order: int) -> None:
    """2 w'' = 3 from -0.1 to the obstacle at -0.3, whose force is 3 / 2 - 2 (0.3 - 0.1)."""
    held, obstacle = (Dirichlet("left", (-0.1,)),), Obstacle("right", (1.0,), 0.3)
    mesh = distorted(rm.shapes.rectangle(3, 3), 0.2, 1)
    problem = ContactProblem(mesh, Laplace(-3.0, 2.0), held, obstacle, order=order)
    lower, upper = bounds_of(problem)
    assert lower < 1.1 < upper
    needle = "pressure(right, exp(-1e10*(y - 0.703)**2))"  # no point at which gaps are looked at is on it
    assert not rm.certify(fixed.solve(problem), quantities=[needle]).bounds[needle].guaranteed
    assert upper - lower < {1: 1.0, 2: 1e-3}[order]


@BOTH
def test_force_of_an_obstacle_in_the_interior(order: int) -> None:
    """-u'' = -2, u >= -1/20: contact but for sqrt(1/20) from either end."""
    for sign in (1.0, -1.0):  # below, and above
        obstacle = Obstacle(Place.INTERIOR, (sign,), 0.05)
        problem = ContactProblem(
            rm.shapes.rectangle(8, 2), Laplace(-2.0 * sign), ("left", "right"), obstacle, order=order
        )
        lower, upper = bounds_of(problem)
        assert lower < 2 * (1 - 2 * np.sqrt(0.05)) < upper
        assert upper - lower < {1: 1.2, 2: 0.3}[order]


def test_force_that_the_load_alone_gives_is_known_with_friction() -> None:
    """The search over a foundation that is shifted by a length begins where the body stands on it."""
    floor = Obstacle.graph("bottom", -0.01, friction=3.0)
    law, held = PlaneStrain.from_young(1000.0, 0.3), (Dirichlet("left", (0.0, None)),)
    mesh = rm.shapes.rectangle(4, 2, x=(0, 4), y=(0, 2))
    problem = ContactProblem(mesh, law, held, floor, tractions=(Traction("top", (0.0, -10.0)),), order=2)
    assert bounds_of(problem) == pytest.approx((40, 40), rel=1e-4)


def test_nearly_all_of_a_force_acts_where_it_is_proved_to() -> None:
    """The pressure 3/2 |x|^(1/2) up to the origin: on (a, b) acts |a|^(3/2) - |b|^(3/2)."""
    bounds = rm.certify(fixed.solve(signorini(8, 2))).bounds["resultant(free)"]
    assert bounds.guaranteed
    ((begin, end),) = bounds.within["x"]
    assert begin == pytest.approx(-9 / 17)
    assert -end < (0.05 * (9 / 17) ** 1.5) ** (2 / 3)
    assert end < 0.1  # of a boundary that goes on to 1


@pytest.mark.slow
def test_forces_act_on_intervals_with_a_gap_between_them() -> None:
    foundation = Obstacle.graph("bottom", lambda x, y: -0.01 * ca.sin(np.pi * x / 2) ** 2)
    tool = Dirichlet("top", (0.0, -0.003))
    found = {}
    for n in (8, 16):
        problem = replace(body(n, 2, 0.0), dirichlet=(tool,), obstacle=foundation, tractions=())
        solution = fixed.solve(problem)
        found[n] = rm.certify(solution).bounds["resultant(bottom)"]
    ((a, b), (c, d)) = found[8].within["x"]
    assert (a, d) == (0, 2)
    assert 0.2 < b < 0.9 < 1.1 < c < 1.8
    fine = rm.certify(solution, quantities=[f"pressure(bottom, where((x - {b})*(x - {c}) < 0, 1, 0))"])
    assert [*fine.bounds.values()][-1].value < 0.05 * found[8].lower


def body(n: int, order: int, friction: float) -> ContactProblem:
    return ContactProblem(
        rm.shapes.rectangle(2 * n, n, x=(0, 2)),
        PlaneStrain.from_young(1000.0, 0.3),
        ("left",),
        Obstacle.graph("bottom", lambda x, y: -0.002 - 0.004 * (x - 1.2) ** 2, friction=friction),
        tractions=(Traction("top", (0.0, lambda x, y: -4.0 * x)),),
        order=order,
    )


@cache
def solved_body(n: int, order: int, friction: float) -> rm.Solution:
    return fixed.solve(body(n, order, friction))


@pytest.mark.slow
@BOTH
@pytest.mark.parametrize("friction", [0.0, 1.0])
def test_bounds_hold_values_of_a_finer_mesh_and_close_under_refinement(order: int, friction: float) -> None:
    displacements = ("boundary(right, (1+y)*ux)",) if friction else ()
    fine = rm.refined(body(6, order, friction))
    asked = ("resultant(bottom)", *displacements)
    coarse, close = (rm.certify(solved_body(n, order, friction), quantities=asked) for n in (2, 4))
    assert set(coarse.bounds) == {*asked}
    values = values_at(rm.Outer.of(fine), list(coarse.bounds))
    for value, (quantity, rough) in zip(values, coarse.bounds.items(), strict=True):
        better = close.bounds[quantity]
        for bounds in (rough, better):
            assert bounds.guaranteed
            assert bounds.lower < min(value, bounds.value)
            assert bounds.upper > max(value, bounds.value)
        assert better.upper - better.lower < 0.8 * (rough.upper - rough.lower)


def test_what_energies_may_be_wrong_by_widens_the_bounds_of_a_force(monkeypatch: pytest.MonkeyPatch) -> None:
    exact, found = admissible(body(2, 1, 0.0)), Continuous.solve
    lower = exact.energy - 1e-3 * exact.strain
    (contact,) = exact.continuous.space.contact_sets
    plain = force_bounds(exact, lower, contact)
    assert force_bounds(exact, lower, contact, lambda x, y: -1.0)[0] < -plain[0]  # of any sign
    monkeypatch.setattr(Continuous, "solve", lambda *given: replace(found(*given), doubt=1e-3 * exact.strain))
    wide = force_bounds(exact, lower, contact)
    assert 0 <= wide[0] < plain[0] < plain[1] < wide[1]
    # a displacement that is not admissible bounds nothing
    monkeypatch.setattr(Continuous, "solve", lambda *given: replace(found(*given), penetration=1e-3))
    assert force_bounds(exact, lower, contact) == (0, np.inf)


def test_bounds_do_not_depend_on_units() -> None:
    """Of length and of force: a foundation is not raised, nor a load added, by one of these."""
    found = []
    for length, force in ((1.0, 1.0), (1e6, 1e17)):
        ground = Obstacle.circle("bottom", (0.9 * length, -2.0 * length), 2 * length)
        law = PlaneStrain.from_young(1e3 * force / length**2, 0.3)
        mesh, pressed = rm.shapes.rectangle(3, 1, x=(0, 2 * length), y=(0, length)), (0.0, -0.05 * length)
        problem = ContactProblem(mesh, law, (Dirichlet("top", pressed),), ground, order=2)
        bounds = rm.certify(fixed.solve(problem), quantities=("mean(left, -ux)",)).bounds
        values = [[one.lower, one.upper] for one in bounds.values()]
        found.append(np.array(values) / [[force / length], [length]])
    np.testing.assert_allclose(*found, rtol=1e-3)


def test_a_smaller_step_bounds_a_slope_where_a_larger_one_is_not_possible() -> None:
    """P(s) = s^2 up to s = 1, known up to 1: the best step would be 4."""
    bounds = slope_bounds(lambda s: s**2 if abs(s) < 1 else np.inf, -1.0, 1.0, 1 / 8, 0.0)
    assert bounds == pytest.approx((-2.5, 2.5))


@pytest.mark.slow
def test_pressure_times_a_weight_is_bounded_and_a_needle_is_not_guaranteed() -> None:
    hats = [f"pressure(bottom, max(0, 1 - abs(x - {x})))" for x in (0, 1, 2)]
    needle = "pressure(bottom, exp(-1e10*(x - 0.703)**2))"
    asked, fine = [*hats, "pressure(bottom, x)", "pressure(bottom, -x)"], solved_body(4, 2, 0.0)
    found, known = (
        rm.certify(solved_body(4, 2, 0.0), quantities=[*asked, needle]),
        rm.certify(fine, quantities=asked),
    )
    whole = found.bounds["resultant(bottom)"].value
    for text, true in known.bounds.items():
        bounds = found.bounds[text]
        assert bounds.guaranteed
        assert bounds.lower < true.value < bounds.upper
        assert bounds.lower < bounds.value < bounds.upper
        assert bounds.upper - bounds.lower < whole
    assert sum(found.bounds[hat].value for hat in hats) == pytest.approx(whole)
    assert not found.bounds[needle].guaranteed


@pytest.mark.parametrize("order", [1, 2])
def test_a_window_has_the_force_of_the_pressure_in_it(order: int) -> None:
    """Of a uniform pressure exactly, wherever the nodes are: two of them lie 0.5 apart."""
    block = ContactProblem(
        rm.shapes.rectangle(4, 1, x=(0, 2)),
        PlaneStrain(1.0, 1.0),
        (Dirichlet("left", (0.0, None)),),
        Obstacle.graph("bottom", 0.0),
        tractions=(Traction("top", (0.0, -3.0)),),
        order=order,
    )
    windows = {"where((x - 0.93)*(x - 1.03) < 0, 10, 0)": 3.0, "where(x > 0.99, 1, 0)": 3.03, "x": 6.0}
    texts = {f"pressure(bottom, {weight})": force for weight, force in windows.items()}
    found = rm.certify(fixed.solve(block), quantities=[*texts]).bounds
    for text, force in texts.items():
        assert found[text].value == pytest.approx(force, rel=1e-8)
        assert found[text].lower < force * (1 + 1e-8)


@pytest.mark.slow
def test_what_is_not_proved_under_the_load_of_a_quantity_does_not_bound_it(monkeypatch) -> None:
    build, given = certifying.refined_bracket, solved_body(2, 1, 0.0).problem.tractions

    def crude(problem: ContactProblem, *others: Any) -> Bracket:
        faults = () if problem.tractions == given else ("crude",)
        return replace(build(problem, *others), lower_faults=faults)

    monkeypatch.setattr(certifying, "refined_bracket", crude)
    found = rm.certify(solved_body(2, 1, 0.0), quantities=["mean(right, ux)"], refinements=0)
    bounds = found.bounds["mean(right, ux)"]
    assert (bounds.lower, bounds.upper) == (-np.inf, np.inf)


def test_a_foundation_that_touches_a_support_has_a_lower_bound_alone() -> None:
    problem = replace(body(2, 2, 0.0), obstacle=Obstacle("bottom"))
    lower, upper = bounds_of(problem)
    assert 0 < lower < value_on(problem, "resultant(bottom)")
    assert upper == np.inf


@pytest.mark.slow
def test_a_body_that_does_not_touch_may_carry_nothing() -> None:
    lower, upper = bounds_of(replace(body(2, 2, 0.0), obstacle=Obstacle("bottom", offset=1.0)))
    assert 0 == lower < upper < 1e-2 * value_on(body(2, 2, 0.0), "resultant(bottom)")
    pressed, ground = (Dirichlet("top", (0.0, -0.1)),), Obstacle("bottom", offset=1.0)
    law = PlaneStrain.from_young(1000.0, 0.3)
    exact = admissible(ContactProblem(rm.shapes.rectangle(2, 1), law, pressed, ground))
    (contact,) = exact.continuous.space.contact_sets
    lower, upper = force_bounds(exact, exact.energy - 1e-6, contact)
    assert 0 == lower < upper < 2e-6


@pytest.mark.parametrize(
    ("quantities", "said"),
    [
        *(([text], "no bounds") for text in ("mean(top, ux*uy)", "mean(top, uy+1)", "peak(bottom)")),
        (["resultant(top)"], "'top' is not a contact boundary"),
        (["mean(middle, uy)"], "middle"),
        ("mean(top, uy)", "quantities must be a list of texts, got 'mean"),
        ([3], "a quantity must be str, got 3"),
    ],
)
def test_what_is_not_linear_in_the_displacement_has_no_bounds(quantities: Any, said: str) -> None:
    with pytest.raises(rm.BadInputError, match=said):
        rm.certify(solved_body(2, 1, 0.0), quantities=quantities)
