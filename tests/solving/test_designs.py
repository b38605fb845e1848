"""Solves of design problems: closed forms, constraints, levels, and what is said of them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.meshes import shapes
from rmesh_nlp.optimize.status import Status
from support.designs import BOW, H0, E, F, block

FORMULATIONS = ("nested", "mpcc")
WIDTH, HEIGHT, YOUNG = 2.0, 0.5, 300.0


def column(*design: rm.DesignVariable, constraints: tuple[rm.Constraint, ...] = ()) -> rm.ContactProblem:
    """A block that a foundation lifts by d against its held top, free to widen: the pressure is E d / H."""
    names = {variable.name: variable.symbol for variable in design}
    lift, young = names.get("lift", 0.01), YOUNG * names.get("E", 1.0)
    return rm.ContactProblem(
        mesh=shapes.rectangle(2, 1, x=(0, WIDTH), y=(0, HEIGHT)),
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
    assert found.status is Status.CONVERGED
    assert found.design["lift"] == pytest.approx(30 * HEIGHT / (YOUNG * WIDTH), rel=1e-5)
    assert found.record()["resultant"] == pytest.approx(30, rel=1e-5)
    assert not found.problem.design


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_constraint_of_two_variables(formulation: str) -> None:
    """The least stiffness that carries the load: at the largest lift, by the constraint on it."""
    carries = rm.Constraint("resultant(bottom)", (60.0, np.inf))
    lifts = rm.Constraint("design(2*lift)", (-np.inf, 0.08))
    loose = rm.Constraint("design(lift)", (-np.inf, 0.09))
    problem = column(LIFT, STIFF, constraints=(carries, lifts, loose))
    found = rm.solve(problem, formulation, objective="design(E**2)")
    assert found.status is Status.CONVERGED
    assert found.design["lift"] == pytest.approx(0.04, rel=1e-4)
    assert found.design["E"] == pytest.approx(60 * HEIGHT / (YOUNG * WIDTH * 0.04), rel=1e-4)
    # the multipliers of the constraints, one active from below, one from above, prove it in two ways
    outer = rm.Outer.of(problem, "design(E**2)")
    point = outer.function(outer.variables(np.asarray(found.mesh.p), design=found.design))
    assert outer.residual(point) < 1e-4
    assert outer.branches(point).label == "S"


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_largest_pressure_by_its_epigraph(formulation: str) -> None:
    constraint = rm.Constraint("resultant(bottom)", (100.0, np.inf))
    problem = replace(block(H0, BOW, n=(4, 1), constraints=(constraint,)), motion=rm.Motion(0))
    found = rm.solve(problem, formulation, objective="max-pressure(bottom)")
    record = found.record()
    assert found.status is Status.CONVERGED
    assert record["objective_value"] == pytest.approx(record["peak_pressure"], rel=1e-6)
    assert record["objective_initial"] == pytest.approx(record["peak_pressure_initial"], rel=1e-9)
    assert record["peak_pressure"] < 0.9 * record["peak_pressure_initial"]
    assert set(record["design"]) == {"h0", "bow"}
    assert record["resultant"] >= 100 * (1 - 1e-6)


def test_a_solve_goes_on_from_a_design() -> None:
    first = lifted()
    again = rm.solve(column(LIFT), "nested", objective=PRESCRIBED, start=first)
    assert again.iterations < first.iterations
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


def test_designs_leave_given_displacements_admissible() -> None:
    """A clamped corner touches the foundation; lifting that would serve the objective and is no design."""
    lift = rm.DesignVariable("lift", 0.0, (-0.01, 0.01))
    problem = rm.ContactProblem(
        mesh=shapes.rectangle(2, 1, x=(0, 3), y=(0, 1)),
        law=rm.PlaneStrain.from_young(1000.0, 0.3),
        dirichlet="left",
        obstacle=rm.Obstacle.graph("bottom", lambda x, y: lift.symbol - 0.001 * x),
        tractions=rm.Traction("top", (0.0, -1.0)),
        motion=rm.Motion(0),
        design=lift,
    )
    found = rm.solve(problem, "nested", objective="mean(right, -uy)")
    assert found.status is Status.CONVERGED
    assert found.design["lift"] == pytest.approx(0.0, abs=1e-5)
