"""Claims about errors hold, or nothing is claimed."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.assessment.admissible import admissible
from rmesh_nlp.assessment.error_reduction import by_certificate, error_reduction
from rmesh_nlp.assessment.quantities import Quantities, quantities, worse
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Dirichlet, Laplace, Motion, Obstacle, PlaneStrain, Traction
from rmesh_nlp.problem.refining import refined


def graded(problem: ContactProblem, power: float) -> np.ndarray:
    """Nodes of a rectangle over (0, 2) drawn towards its left side."""
    nodes = np.array(problem.mesh.p)
    nodes[0] = 2 * (nodes[0] / 2) ** power
    return nodes


def truth(problem: ContactProblem) -> float:
    """The least energy, extrapolated from refinements."""
    energies = []
    while len(energies) < 5:
        energies.append(admissible(problem).energy)
        problem = refined(problem)
    one, two = -np.diff(energies)[-2:]
    return energies[-1] - two * (two / one) / (1 - two / one)


@pytest.mark.parametrize("seed", [101, 103])  # the interval was chosen on seeds 0 to 39
def test_the_interval_holds(seed: int) -> None:
    problem = replace(random_problem(seed, kind="elastic"), quadrature="auto")
    before, after = admissible(problem), admissible(problem, graded(problem, 1.15))
    found, _ = (
        error_reduction(before, after, 7)
        if after.energy < before.energy
        else error_reduction(after, before, 7)
    )
    least, ends = truth(problem), sorted([before.energy, after.energy], reverse=True)
    errors = [energy - least for energy in ends]
    assert found is not None
    assert found.source == "refinement"
    for bounds, error in zip((found.error_initial, found.error), errors, strict=True):
        assert bounds[0] <= error <= bounds[1] < 2 * error
    assert found.factor <= errors[0] / errors[1] <= found.factor_upper
    assert f"{found.contact_solves}" == "7"
    assert found.record()["text"].startswith("error of the energy")


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


def test_nothing_is_claimed_where_the_mesh_does_not_show_the_solution() -> None:
    # a load that one refinement does not resolve: the second one lowers the energy as much as the first
    problem = ContactProblem(
        rectangle(2, 2),
        Laplace(lambda x, y: ca.sin(7 * ca.pi * x) * ca.sin(7 * ca.pi * y)),
        ("left", "right", "top", "bottom"),
    )
    last = admissible(problem)
    assert error_reduction(replace(last, energy=last.energy + 1.0), last, 1)[0] is None


def test_a_certificate_bounds_the_factor_from_below() -> None:
    problem = replace(random_problem(101, kind="elastic"), quadrature="auto")
    before, after = admissible(problem), admissible(problem, graded(problem, 1.15))
    found, _ = (
        error_reduction(before, after, 7)
        if after.energy < before.energy
        else error_reduction(after, before, 7)
    )
    assert found is not None
    proved = by_certificate(found.record(), 0.32, 0.08, True)
    assert proved["source"] == "certified"
    assert proved["factor"] == pytest.approx(4.0)
    assert proved["factor_upper"] is None
    assert proved["error"] == (0.0, 0.08)
    assert "at least 4 times less" in proved["text"]
    assert by_certificate(found.record(), 0.32, 0.08, False) == found.record()
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


def test_a_quantity_that_is_farther_from_its_limit_is_said() -> None:
    before, refined_values = Quantities(3.0, 6.0, 2.0), Quantities(3.1, 6.0, 2.0)
    assert worse(before, Quantities(3.19, 6.0, 2.0), refined_values) == []
    (said,) = worse(before, Quantities(3.3, 6.05, 2.0), refined_values)
    assert said.startswith("the largest pressure got worse")
    assert "3 on the given mesh, 3.3 after relocation, 3.1 on the refined" in said
