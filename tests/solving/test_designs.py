"""Designs: derivatives, closed forms, constraints, levels, and what is said of them."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.evaluation import Evaluator
from rmesh_nlp.models.kkt_model import bilevel
from rmesh_nlp.models.reduced_constraints import ReducedConstraints
from rmesh_nlp.problem import ContactProblem, DesignVariable, ProblemError, Shape
from rmesh_nlp.solving.outer import Outer
from support.designs import BOW, DESIGNS, H0, LIMITED, E, F, block, largest_mean
from support.orders import ORDERS, slow_but
from support.taylor import difference_order, taylor_order

FORMULATIONS = ("nested", "mpcc")
WIDTH, HEIGHT, YOUNG = 2.0, 0.5, 300.0


def column(*design: rm.DesignVariable, constraints: tuple[rm.Constraint, ...] = ()) -> rm.ContactProblem:
    """A block that a foundation lifts by d against its held top, free to widen: the pressure is E d / H."""
    names = {variable.name: variable.symbol for variable in design}
    lift, young = names.get("lift", 0.01), YOUNG * names.get("E", 1.0)
    return rm.ContactProblem(
        mesh=rm.shapes.rectangle(2, 1, x=(0, WIDTH), y=(0, HEIGHT)),
        law=rm.PlaneStress.from_young(young, 0.0),
        dirichlet=(rm.Dirichlet("top", (None, 0.0)), rm.Dirichlet("left", (0.0, None))),
        obstacle=rm.Obstacle("bottom", (0, 1), -lift),
        motion=rm.Motion(0),
        design=design,
        constraints=constraints,
    )


LIFT = rm.DesignVariable("lift", 0.01, (0.0, 0.1))
STIFF = rm.DesignVariable("E", 1.0, (0.2, 5.0))
PRESCRIBED = "square(resultant(bottom) - 30)"


@cache
def lifted() -> rm.Solution:
    return rm.solve(column(LIFT), "nested", objective=PRESCRIBED)


def test_prescribed_resultant() -> None:
    found = lifted()
    assert found.status is rm.Status.CONVERGED
    assert found.design["lift"] == pytest.approx(30 * HEIGHT / (YOUNG * WIDTH), rel=1e-5)
    assert found.record()["resultant"] == pytest.approx(30, rel=1e-5)
    assert not found.problem.design


@pytest.mark.slow
@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_constraint_of_two_variables(formulation: str) -> None:
    """The least stiffness that carries the load: at the largest lift, by the constraint on it."""
    carries = rm.Constraint("resultant(bottom)", (60.0, np.inf))
    lifts = rm.Constraint("design(2*lift)", (-np.inf, 0.08))
    loose = rm.Constraint("design(lift)", (-np.inf, 0.09))
    problem = column(LIFT, STIFF, constraints=(carries, lifts, loose))
    found = rm.solve(problem, formulation, objective="design(E**2)")
    assert found.status is rm.Status.CONVERGED
    assert found.design["lift"] == pytest.approx(0.04, rel=1e-4)
    assert found.design["E"] == pytest.approx(60 * HEIGHT / (YOUNG * WIDTH * 0.04), rel=1e-4)
    # the multipliers of the constraints, one active from below, one from above, prove it in two ways
    outer = rm.Outer.of(problem, "design(E**2)")
    point = outer.function(outer.variables(np.asarray(found.mesh.p), design=found.design))
    assert outer.residual(point) < 1e-4
    assert outer.branches(point).label == "S"


@pytest.mark.slow
@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_largest_pressure_by_its_epigraph(formulation: str) -> None:
    constraint = rm.Constraint("resultant(bottom)", (100.0, np.inf))
    problem = replace(block(H0, BOW, n=(4, 1), constraints=(constraint,)), motion=rm.Motion(0))
    found = rm.solve(problem, formulation, objective="max-pressure(bottom)")
    record = found.record()
    assert found.status is rm.Status.CONVERGED
    assert record["objective_value"] == pytest.approx(largest_mean(found.problem), rel=1e-6)
    assert record["objective_initial"] == pytest.approx(largest_mean(problem.at_design()), rel=1e-9)
    assert record["peak_pressure"] < 0.9 * record["peak_pressure_initial"]
    assert set(record["design"]) == {"h0", "bow"}
    assert record["resultant"] >= 100 * (1 - 1e-6)


@pytest.mark.slow
def test_a_solve_goes_on_from_a_design() -> None:
    first = lifted()
    again = rm.solve(column(LIFT), "nested", objective=PRESCRIBED, start=first)
    assert again.trace.iterations < first.trace.iterations
    assert again.design["lift"] == pytest.approx(first.design["lift"], rel=1e-6)


def test_seeds_draw_designs_within_their_bounds() -> None:
    outer = rm.Outer.of(block(E, F, H0), "design(E)")
    drawn = [outer.design(outer.variables(seed=seed)) for seed in range(5)]
    for variable in (E, F, H0):
        values = [design[variable.name] for design in drawn]
        assert variable.bounds[0] <= min(values) < max(values) <= variable.bounds[1]


@pytest.mark.parametrize(
    ("formulation", "objective", "words"),
    [
        *((name, "energy", "do not compare") for name in ("joint", "nested", "auto")),
        ("mpcc", "max-pressure(bottom)", "nothing presses on 'bottom'"),
        ("nested", "design(lfit)", "'lfit' is no design variable"),
    ],
)
def test_what_designs_cannot_be_asked(formulation: str, objective: str, words: str) -> None:
    problem = replace(column(LIFT), obstacle=rm.Obstacle("bottom", (0, 1), 0.5 - LIFT.symbol))
    with pytest.raises(ValueError, match=words):
        rm.solve(problem, formulation, objective=objective)


def test_an_expression_of_a_design_may_be_a_number() -> None:
    for text, value in (("3", 3.0), ("0*lift + 2", 2.0)):
        assert rm.Outer.of(column(LIFT), f"design({text})").function(np.zeros(1)).value == value


@pytest.mark.slow
def test_designs_leave_given_displacements_admissible() -> None:
    """A clamped corner touches the foundation; lifting that would serve the objective and is no design."""
    lift = rm.DesignVariable("lift", 0.0, (-0.01, 0.01))
    problem = rm.ContactProblem(
        mesh=rm.shapes.rectangle(2, 1, x=(0, 3), y=(0, 1)),
        law=rm.PlaneStrain.from_young(1000.0, 0.3),
        dirichlet="left",
        obstacle=rm.Obstacle.graph("bottom", lambda x, y: lift.symbol - 0.001 * x),
        tractions=rm.Traction("top", (0.0, -1.0)),
        motion=rm.Motion(0),
        design=lift,
    )
    found = rm.solve(problem, "nested", objective="mean(right, -uy)")
    assert found.status is rm.Status.CONVERGED
    assert found.design["lift"] == pytest.approx(0.0, abs=1e-5)


RADIUS = rm.DesignVariable("R", 6.0, (3.0, 12.0))
CENTRE = rm.DesignVariable("c", -5.98, (-6.1, -5.9))
BOUND = rm.DesignVariable("g", 5.0, (0.0, 20.0))
STIFFNESS = rm.DesignVariable("k", 1.0, (0.5, 3.0))
PSI = rm.DesignVariable("psi", -0.03, (-0.06, -0.01))
PULL = rm.DesignVariable("P", 1.0, (0.0, 3.0))


def on_a_disc(order: int = 1) -> rm.ContactProblem:
    """A block over a disc of any radius and centre, with any friction bound."""
    return rm.ContactProblem(
        rm.shapes.rectangle(4, 3, x=(-1, 1), y=(0, 1)),
        rm.PlaneStrain.from_young(1000.0, 0.3),
        "top",
        rm.Obstacle.circle("bottom", (0.0, CENTRE.symbol), RADIUS.symbol, friction=BOUND.symbol),
        rm.Motion(0),
        tractions=rm.Traction("right", (5.0, 0.0)),
        order=order,
        design=(RADIUS, CENTRE, BOUND),
    )


def membrane(order: int = 1) -> rm.ContactProblem:
    """A membrane over an obstacle of any height, one half of any stiffness, with any load and force."""
    mesh = rm.shapes.rectangle(4, 4).with_subdomains({"a": lambda x: x[0] < 0.5, "b": lambda x: x[0] > 0.5})
    node = int(np.argmin(np.hypot(mesh.p[0] - 0.5, mesh.p[1] - 0.25)))
    load = rm.Laplace(lambda x, y: -4 * PULL.symbol * (1 + x))
    return rm.ContactProblem(
        mesh,
        {"a": replace(load, conductivity=STIFFNESS.symbol), "b": load},
        ("left", "right", "top", "bottom"),
        rm.Obstacle.interior(lambda x, y: PSI.symbol + 0.02 * x),
        rm.Motion(0),
        point_loads=rm.PointLoad(node, -0.1 * PULL.symbol),
        order=order,
        design=(STIFFNESS, PSI, PULL),
    )


MORE = {"disc": on_a_disc, "membrane": membrane}

OBJECTIVE = "mean(right, uy) + 0.3*boundary(bottom, ux**2) + body(x*ux)"


def at_random(problem: ContactProblem, objective: str = OBJECTIVE, seed: int = 3) -> tuple[Outer, np.ndarray]:
    outer = Outer.of(problem, objective)
    return outer, 0.3 * outer.variables(seed=seed)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", [*DESIGNS, *slow_but(MORE)])
def test_derivatives_by_designs_and_positions(name: str, order: int) -> None:
    """And the same values as the problem with numbers in the place of its variables."""
    problem = (DESIGNS | MORE)[name](order)
    bent = f"body(exp(200*{'u' if problem.components == 1 else 'uy'}))"
    outer, q = at_random(problem, bent if name in MORE else OBJECTIVE)
    seed, step = (5, 2e-3) if name in MORE else (4, 1e-3)
    by_design, d = np.random.default_rng(seed).uniform(-1, 1, (2, q.size))
    by_design[: outer.discretisation.mesh_map.n_positions] = 0.0
    for along in (by_design, d):
        assert taylor_order(outer.function, q, along, step) == pytest.approx(2, abs=0.02)
    product = outer.function.hessian(outer.function(q))(d)
    order_of = difference_order(lambda at: outer.function(at).gradient, product, q, d, 2 * step)
    assert order_of == pytest.approx(2, abs=0.05)
    there, same = outer.at_design(q)
    assert not there.problem.design
    assert there.function(same).value == pytest.approx(outer.function(q).value, rel=1e-9)
    np.testing.assert_allclose(there.nodes(same), outer.nodes(q), atol=1e-12)


@pytest.fixture(scope="module")
def limited() -> tuple[Outer, np.ndarray]:
    return at_random(block(E, F, BOW, constraints=LIMITED, n=(4, 2)))


@pytest.mark.slow
def test_rows_of_constraints_are_those_of_the_kkt_model(limited: tuple[Outer, np.ndarray]) -> None:
    outer, q = limited
    constraints, point = ReducedConstraints(outer.conditions), outer.function(q)
    program = bilevel(outer.discretisation, outer.objective, length=1e-2, force=10.0)
    x = program.point(point)
    rows = Evaluator(program.mpcc.derivatives.jac_g)(x, [])[0]
    n, size = program.n_equations, constraints.rows.size
    np.testing.assert_allclose(rows[:n], 0, atol=1e-9)
    np.testing.assert_allclose(rows[n : n + size], constraints.at(point)[0], rtol=1e-9, atol=1e-12)


def test_derivatives_of_constraints(limited: tuple[Outer, np.ndarray]) -> None:
    outer, q = limited
    constraints = ReducedConstraints(outer.conditions)
    rng = np.random.default_rng(6)
    d, multiples = rng.uniform(-1, 1, q.size), rng.uniform(-1, 1, constraints.rows.size)

    def gradient(at: np.ndarray) -> np.ndarray:
        point = outer.function(at)
        return point.gradient + constraints.at(point)[1].T @ multiples

    def values(at: np.ndarray) -> np.ndarray:
        return constraints.at(outer.function(at))[0]

    by_d = constraints.at(outer.function(q))[1] @ d
    assert difference_order(values, by_d, q, d, 1e-3) == pytest.approx(2, abs=0.05)
    conditions = outer.conditions
    curvature = conditions.at(outer.function(q)).hessian(conditions.program.value, multiples)
    assert difference_order(gradient, curvature(d), q, d, 1e-3) == pytest.approx(2, abs=0.05)


def test_shapes_keep_straight_sides_and_their_own_motion() -> None:
    problem = block(BOW)
    motion = problem.shape_motions[0]
    x, y = problem.mesh.p
    bottom = y == 0
    np.testing.assert_allclose(motion[1, bottom], x[bottom] * (4 - x[bottom]) / 4)
    assert np.all(motion[0, (x == 0) | (x == 4)] == 0)
    assert np.all(motion[1, y == 1] == 0)
    inside = (y > 0) & (y < 1) & (x > 0) & (x < 4)
    assert np.all(motion[1, inside] > 0)  # the maximum principle
    assert motion[1, inside].max() < 1


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: DesignVariable("x", 0.0, (0, 1)), "name of its own"),
        (lambda: DesignVariable("a", 2.0, (0, 1)), "'a' starts at 2.0"),
        (lambda: DesignVariable("a", 0.0, (1, 1)), "must be finite and increase"),
        (lambda: Shape("a", "bottom", (0.0, 1.0), (0.1, 1.0)), "'a' starts at 0.0"),
        (lambda: block(E, E), "two design variables are named 'E'"),
        (lambda: block(Shape("a", "base", (0.0, 1.0), (-1, 1))), "unknown boundary 'base'"),
        (lambda: replace(block(E), design=F), "'E' is no design variable: choose from F"),
    ],
)
def test_nonsense_is_named(make: object, message: str) -> None:
    with pytest.raises((ProblemError, ValueError), match=message):
        make()  # type: ignore[operator]
