"""Claims about errors hold, or nothing is claimed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from skfem import MeshTri

from rmesh_nlp.assessment import error_reduction as module
from rmesh_nlp.assessment.admissible import Admissible, admissible
from rmesh_nlp.assessment.error_reduction import by_certificate, error_reduction
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.meshes.geometry import relocated_mesh
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, Laplace, Obstacle, PlaneStrain
from rmesh_nlp.problem.contact_problem import refined
from support.orders import ORDERS


def graded(seed: int, order: int = 1) -> list[Admissible]:
    """Of a random problem on its mesh and drawn towards its left side, the larger energy first."""
    problem = replace(random_problem(seed, kind="elastic"), quadrature="auto", order=order)
    nodes = np.array(problem.mesh.p)
    nodes[0] = 2 * (nodes[0] / 2) ** 1.15
    return sorted([admissible(problem), admissible(problem, nodes)], key=lambda end: -end.energy)


def on_square(fall: float, mesh: MeshTri | None = None) -> list[Admissible]:
    """Of a membrane, and the same with a larger energy before."""
    last = admissible(ContactProblem(mesh or rectangle(2, 2), Laplace(1.0), ("left", "right")))
    return [replace(last, energy=last.energy + fall), last]


def truth(problem: ContactProblem) -> float:
    """The least energy, extrapolated from refinements."""
    energies = []
    while len(energies) < 3:
        energies.append(admissible(problem).energy)
        problem = refined(problem)
    one, two = -np.diff(energies)[-2:]
    return energies[-1] - two * (two / one) / (1 - two / one)


@pytest.mark.parametrize("order", ORDERS)
def test_the_interval_holds_from_one_refinement_and_from_two(order, monkeypatch) -> None:
    before, after = graded(103, order)  # the interval was chosen on seeds 0 to 39
    least = truth(replace(before.problem, mesh=relocated_mesh(before.problem.mesh, before.body.nodes)))
    errors = before.energy - least, after.energy - least
    for few, closeness in ((400, 2), (0, 3)):
        monkeypatch.setattr(module, "FEW", few)
        found, _ = error_reduction(before, after, 7)
        assert found is not None
        assert (found.source, found.contact_solves) == ("refinement", 7)
        for bounds, error in zip((found.error_initial, found.error), errors, strict=True):
            assert bounds[0] <= error <= bounds[1] < closeness * error
        assert found.factor <= errors[0] / errors[1] <= found.factor_upper


def test_nothing_is_claimed_where_linear_triangles_lock() -> None:
    def claimed(poisson: float, order: int) -> bool:
        law, sides = PlaneStrain.from_young(1000.0, poisson, (0.0, -50.0)), ("left",)
        given = ContactProblem(rectangle(2, 1), law, sides, Obstacle.graph("bottom", -0.01), order=order)
        finer = refined(given)
        return error_reduction(admissible(given), admissible(finer), 2)[0] is not None

    assert [claimed(0.499, 1), claimed(0.3, 1), claimed(0.499, 2)] == [False, True, True]


def test_nothing_is_claimed_of_a_fall_within_rounding() -> None:
    before, last = on_square(1.0)
    assert error_reduction(before, last, 7)[0] is not None
    assert error_reduction(replace(last, energy=last.energy * (1 - 1e-12)), last, 7)[0] is None


def test_an_exact_energy_gives_the_factor_itself() -> None:
    problem = EXAMPLES["6.1"](n=4)
    nodes = np.array(problem.mesh.p)
    nodes[0, problem.mesh.interior_nodes()] += 0.02
    before, after = sorted([admissible(problem), admissible(problem, nodes)], key=lambda end: -end.energy)
    found, refined_values = error_reduction(before, after, 1)
    assert found is not None
    assert refined_values is None  # nothing is refined
    errors = before.energy - problem.exact.energy, after.energy - problem.exact.energy
    assert found.factor == found.factor_upper == pytest.approx(errors[0] / errors[1])
    assert error_reduction(after, before, 1)[0] is None  # the energy rose
    below = replace(after, energy=problem.exact.energy - 1e-3)
    assert error_reduction(before, below, 1)[0] is None


def test_nothing_is_claimed_without_a_contact_solution_on_the_refined_mesh(monkeypatch) -> None:
    def failed(*given: object, **start: object) -> Admissible:
        found = admissible(*given, **start)
        return replace(found, state=replace(found.state, status=Status.CYCLED))

    ends = on_square(0.1)
    assert error_reduction(*ends, 1)[0] is not None
    monkeypatch.setattr(module, "admissible", failed)
    assert error_reduction(*ends, 1) == (None, None)


def test_a_certificate_bounds_the_factor_from_below() -> None:
    found, _ = error_reduction(*on_square(0.1), 7)
    assert found is not None
    proved = by_certificate(found, 0.32, 0.08)
    assert (proved.factor, proved.factor_upper) == (pytest.approx(4.0), np.inf)
    assert (proved.error_initial, proved.error) == (pytest.approx((0.24, 0.32)), (0.0, 0.08))
    assert (proved.source, proved.nodes, proved.contact_solves) == ("certified", found.nodes, 7)
    assert "at least 4 times less" in proved.record()["text"]
    assert proved.record()["factor_upper"] is None
    for bounds in ((0.08, 0.32), (0.32, 0.0)):  # no gain, or none that is known
        assert by_certificate(found, *bounds) == found
    assert by_certificate(replace(found, source="exact"), 0.32, 0.08).source == "exact"


def refinement(*falls: float) -> Callable[[Admissible], Admissible]:
    """Refined meshes whose energies fall by given amounts."""
    left = list(falls)
    return lambda here: replace(here, energy=here.energy - left.pop(0))


@pytest.mark.parametrize(
    ("falls", "few", "low", "high"),
    [  # d / (1 - 1 / 8) and d / (1 - 1 / 1.7); of two refinements the first is known
        ((0.7,), 0, 0.8, 0.7 * 1.7 / 0.7),
        ((1.0, 0.35), 100, 1.0 + 0.4, 1.0 + 0.35 * 1.7 / 0.7),
        ((1.0, 0.99), 100, 1.0 + 0.99 * 8 / 7, 1.0 + 0.99 * 1.7 / 0.7),
        ((1.0, 1.0), 100, None, None),
        ((1.0, -0.1), 100, None, None),
        ((0.0,), 0, None, None),
    ],
)
def test_errors_are_bounded_by_what_refinements_gain(falls, few, low, high, monkeypatch) -> None:
    before, last = on_square(0.5)
    monkeypatch.setattr(module, "FEW", few)
    monkeypatch.setattr(module, "on_refined", refinement(*falls))
    found, _ = error_reduction(before, last, 3)
    if low is None:
        assert found is None
        return
    assert found is not None
    assert found.error == pytest.approx((low, high))
    assert found.error_initial == pytest.approx((low + 0.5, high + 0.5))
    assert (found.factor, found.factor_upper) == pytest.approx((1 + 0.5 / high, 1 + 0.5 / low))
    assert found.nodes == 9
    assert "by refining the last mesh" in found.text()
    assert f"{found.factor:.2g} to {found.factor_upper:.2g} times less on 9 nodes" in found.text()


@pytest.mark.parametrize(
    ("given", "low", "high"),
    [  # after refinements of a new mesh by 1 and 0.35, what those of the given one say
        ((1.0, 0.35), 1.4, 1.85),
        ((4.0, 0.7), 4.8 - 0.5, 5.7 - 0.5),
        ((1.2, 0.35), 1.4, 2.05 - 0.5),
        ((1.0, 1.0), None, None),
    ],
)
def test_a_small_new_mesh_may_miss_what_refinements_of_the_given_one_show(given, low, high, monkeypatch):
    before, last = on_square(0.5)
    other = replace(before.problem, mesh=rectangle(3, 3))
    before = replace(before, parts=replace(before.parts, problem=other))
    monkeypatch.setattr(module, "on_refined", refinement(1.0, 0.35, *given))
    found, _ = error_reduction(before, last, 3)
    assert (found is None) == (low is None)
    if found is not None:
        assert found.error == pytest.approx((low, max(high, 1.85)))
