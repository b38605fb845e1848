"""Claims about errors hold, or nothing is claimed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.assessment import error_reduction as module
from rmesh_nlp.assessment.admissible import Admissible, admissible
from rmesh_nlp.assessment.assessor import Quantities, quantities, worse
from rmesh_nlp.assessment.error_reduction import by_certificate, error_reduction
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, Dirichlet, Laplace, Motion, Obstacle, PlaneStrain, Traction
from rmesh_nlp.problem.contact_problem import refined


def graded(problem: ContactProblem, power: float) -> np.ndarray:
    """Nodes of a rectangle over (0, 2) drawn towards its left side."""
    nodes = np.array(problem.mesh.p)
    nodes[0] = 2 * (nodes[0] / 2) ** power
    return nodes


def truth(problem: ContactProblem) -> float:
    """The least energy, extrapolated from refinements."""
    energies = []
    while len(energies) < 4:
        energies.append(admissible(problem).energy)
        problem = refined(problem)
    one, two = -np.diff(energies)[-2:]
    return energies[-1] - two * (two / one) / (1 - two / one)


@pytest.mark.parametrize("seed", [101, 103])  # the interval was chosen on seeds 0 to 39
def test_the_interval_holds_from_one_refinement_and_from_two(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = replace(random_problem(seed, kind="elastic"), quadrature="auto")
    ends = [admissible(problem), admissible(problem, graded(problem, 1.15))]
    before, after = sorted(ends, key=lambda end: -end.energy)
    least = truth(problem)
    errors = before.energy - least, after.energy - least
    for few, closeness in ((400, 2), (0, 3)):
        monkeypatch.setattr(module, "FEW", few)
        found, _ = error_reduction(before, after, 7)
        assert found is not None
        assert (found.source, found.contact_solves) == ("refinement", 7)
        for bounds, error in zip((found.error_initial, found.error), errors, strict=True):
            assert bounds[0] <= error <= bounds[1] < closeness * error
        assert found.factor <= errors[0] / errors[1] <= found.factor_upper


def test_an_exact_energy_gives_the_factor_itself() -> None:
    problem = EXAMPLES["6.1"](n=4)
    nodes = np.array(problem.mesh.p)
    inside = problem.mesh.interior_nodes()
    nodes[0, inside] += 0.02
    before, after = admissible(problem), admissible(problem, nodes)
    one, two = sorted([before, after], key=lambda found: -found.energy)
    found, refined_values = error_reduction(one, two, 1)
    assert found is not None
    assert refined_values is None  # nothing is refined
    exact = problem.exact.energy
    assert found.factor == found.factor_upper == pytest.approx((one.energy - exact) / (two.energy - exact))
    assert error_reduction(two, one, 1)[0] is None  # the energy rose
    assert error_reduction(one, replace(two, energy=exact - 1e-3), 1)[0] is None  # below the least energy


def test_nothing_is_claimed_where_the_mesh_does_not_show_the_solution() -> None:
    # a load that one refinement does not resolve: the second one lowers the energy as much as the first
    problem = ContactProblem(
        rectangle(2, 2),
        Laplace(lambda x, y: ca.sin(7 * ca.pi * x) * ca.sin(7 * ca.pi * y)),
        ("left", "right", "top", "bottom"),
    )
    last = admissible(problem)
    assert error_reduction(replace(last, energy=last.energy + 1.0), last, 1)[0] is None


@pytest.mark.parametrize(
    "spoilt",
    [
        lambda found: replace(found, energy=found.energy + 1.0),
        lambda found: replace(found, state=replace(found.state, status=Status.CYCLED)),
    ],
    ids=["energy rises", "no contact solution"],
)
def test_nothing_is_claimed_where_refined_meshes_give_no_error(
    spoilt: Callable[[Admissible], Admissible], monkeypatch: pytest.MonkeyPatch
) -> None:
    last = admissible(ContactProblem(rectangle(2, 2), Laplace(1.0), ("left", "right", "top", "bottom")))
    before = replace(last, energy=last.energy + 0.1)
    assert error_reduction(before, last, 1)[0] is not None
    monkeypatch.setattr(module, "FEW", 0)
    monkeypatch.setattr(module, "admissible", lambda *given, **start: spoilt(admissible(*given, **start)))
    assert error_reduction(before, last, 1)[0] is None


def test_a_certificate_bounds_the_factor_from_below() -> None:
    problem = replace(random_problem(101, kind="elastic"), quadrature="auto")
    ends = [admissible(problem), admissible(problem, graded(problem, 1.15))]
    found, _ = error_reduction(*sorted(ends, key=lambda end: -end.energy), 7)
    assert found is not None
    proved = by_certificate(found.record(), 0.32, 0.08, True)
    assert proved["source"] == "certified"
    assert proved["factor"] == pytest.approx(4.0)
    assert proved["factor_upper"] is None
    assert (proved["error_initial"], proved["error"]) == ((0.24, 0.32), (0.0, 0.08))
    assert "at least 4 times less" in proved["text"]
    for bounds in ((0.32, 0.08, False), (0.08, 0.32, True), (0.32, 0.0, True)):  # not proved, or no gain
        assert by_certificate(found.record(), *bounds) == found.record()
    assert by_certificate({**found.record(), "source": "exact"}, 0.32, 0.08, True)["source"] == "exact"


def test_quantities_by_hand() -> None:
    # a block of width 2 under a uniform pressure of 3 stands on a line: pressure 3, force 6, contact 2
    problem = ContactProblem(
        rectangle(4, 2, x=(0, 2)),
        PlaneStrain.from_young(1000.0, 0.3),
        (Dirichlet("left", (0.0, None)), Dirichlet("right", (0.0, None))),
        Obstacle.graph("bottom", 0.0),
        Motion(None),
        (Traction("top", (0.0, -3.0)),),
    )
    found = admissible(problem)
    values = quantities(problem, found.body.nodes, found.system, found.state)
    assert values is not None
    assert vars(values) == pytest.approx({"peak_pressure": 3.0, "resultant": 6.0, "contact_length": 2.0})


def test_the_resultant_is_what_holds_the_body_friction_included() -> None:
    problem = EXAMPLES["6.3"]((6, 4))
    found = admissible(problem)
    values = quantities(problem, found.body.nodes, found.system, found.state)
    held = found.system.stiffness @ found.state.u - found.system.load  # the foundation is the rest
    pressed, rubbed = (float(np.sum(rows @ held)) for rows in (found.system.normals, found.system.tangents))
    assert abs(rubbed) > 0.1 * pressed
    assert values is not None
    assert values.resultant == pytest.approx(np.hypot(pressed, rubbed))


def test_a_quantity_that_is_farther_from_its_limit_is_said() -> None:
    before, refined_values = Quantities(3.0, 6.0, 2.0), Quantities(3.1, 6.0, 2.0)
    assert worse(before, Quantities(3.19, 6.0, 2.0), refined_values) == []
    (said,) = worse(before, Quantities(3.3, 6.05, 2.0), refined_values)
    assert said.startswith("the largest pressure got worse")
    assert "3 on the given mesh, 3.3 after relocation, 3.1 on the refined" in said
