"""Loads that follow each other, with friction on the way."""

from dataclasses import replace

import numpy as np
import pytest

import rmesh_nlp as rm
from formulations.fixed import Fixed
from formulations.multistart import MultiStart
from rmesh_nlp.solving.advice import advise
from support.orders import ORDERS

YOUNG, HEIGHT, LENGTH, FRICTION = 1000.0, 0.1, 4.0, 0.3
PULL = 0.5 * FRICTION * LENGTH  # under a pressure of 1


def pulled(part: float) -> rm.LoadStep:
    return rm.LoadStep(tractions=(rm.Traction("right", (part * PULL / HEIGHT, 0.0)),))


def bar(*steps: rm.LoadStep, **friction: float) -> rm.ContactProblem:
    return rm.ContactProblem(
        rm.shapes.rectangle(40, 1, x=(0.0, LENGTH), y=(0.0, HEIGHT)),
        rm.PlaneStress.from_young(YOUNG, 0.0),
        ("left",),
        rm.Obstacle("bottom", **(friction or {"coulomb": FRICTION})),
        rm.Motion(0),
        (rm.Traction("top", (0.0, -1.0)),),
        steps=steps,
    )


def end_of(solution: rm.Solution) -> float:
    """Displacement of the pulled end over Q^2 / (2 E h F p), that of a bar that slips over Q / (F p)."""
    end = solution.problem.mesh.p[0] == LENGTH
    one = PULL**2 / (2 * YOUNG * HEIGHT * FRICTION)
    return float(np.mean(solution.displacement[0][: end.size][end])) / one


@pytest.mark.slow
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("friction", ["coulomb", "friction"])
def test_bar_keeps_half_of_its_displacement_when_the_load_goes(friction: str, order: int) -> None:
    """Friction turns over half of the length that slipped, and all of it under the opposite load."""
    parts = (1.0, 0.0, -1.0)
    for count, wanted in enumerate((0.0, 1.0, 0.5, -1.0)):
        steps = map(pulled, parts[:count])
        solution = rm.solve(replace(bar(*steps, **{friction: FRICTION}), order=order))
        assert solution.success
        assert end_of(solution) == pytest.approx(wanted, abs=0.05)
        assert len(solution.details.get("steps", [0])) == count + 1


@pytest.mark.slow
def test_what_a_step_does_not_name_stays_and_what_holds_nothing_slips_back() -> None:
    solution = rm.solve(bar(pulled(1.0), pulled(0.0)), "fixed")
    assert [load["bottom"]["normal_force"] for load in solution.details["steps"]] == pytest.approx(
        [LENGTH] * 3, rel=0.03
    )
    assert solution.details["steps"][-1]["bottom"]["tangential_force"] == pytest.approx(0, abs=0.03 * PULL)
    smooth = rm.solve(bar(pulled(1.0), pulled(0.0), friction=0.0), "fixed")
    assert end_of(smooth) == pytest.approx(0, abs=1e-9)


def test_a_step_is_refused_by_its_name_and_where_nodes_move() -> None:
    with pytest.raises(rm.BadInputError, match="no tool under a force meets 'bottom'"):
        bar(rm.LoadStep(tools={"bottom": (0.0, 1.0)}))
    assert ("load steps", "2") in bar(pulled(1.0)).summary()
    with pytest.raises(rm.BadInputError, match="nowhere"):
        bar(rm.LoadStep(tractions=(rm.Traction("nowhere", (0.0, 1.0)),)))
    for formulation in ("joint", MultiStart(Fixed())):
        with pytest.raises(rm.BadInputError, match="by fixed, with nothing around it"):
            rm.solve(bar(pulled(1.0), friction=FRICTION), formulation)
    with pytest.raises(rm.BadInputError, match="leave out the load steps"):
        advise(bar(pulled(1.0), friction=FRICTION))
