"""Nested dissection: an order of all unknowns, with which contact solves give what they gave."""

import numpy as np
import pytest

from rmesh_nlp.contact import solver as of_model
from rmesh_nlp.contact.sensitivity import adjoint
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import LEAF, dissected, elimination_order
from rmesh_nlp.fem.fields import CONSTANT
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Dirichlet, Motion, Obstacle, PlaneStrain, Traction


def test_every_node_is_eliminated_once_and_a_separator_after_what_it_separates() -> None:
    mesh = rectangle(24, 10, x=(0, 4))
    order = dissected(mesh.p, mesh.facets)
    assert np.array_equal(np.sort(order), np.arange(mesh.p.shape[1]))
    # without the first separator, which is last, nothing connects the two halves
    place = np.argsort(order)
    x = mesh.p[0]
    separator = np.isclose(x, 2.0)
    assert place[separator].min() == mesh.p.shape[1] - separator.sum()


def test_points_that_no_line_separates_are_ordered_too() -> None:
    n = 3 * LEAF
    assert dissected(np.zeros((2, n)), np.array([[0], [1]])).size == n


def test_given_and_tied_unknowns_are_left_out() -> None:
    points = np.array([[0.0, 1.0, 2.0], [0.0, 0.0, 0.0]])
    index = np.array([[0, CONSTANT, 0], [1, 2, CONSTANT]])
    order = elimination_order(points, np.array([[0, 1], [1, 2]]), index)
    assert np.array_equal(np.sort(order), [0, 1, 2])


def blocks() -> list[ContactProblem]:
    """Along a straight line with friction, and along a circle, where unknowns are rotated."""
    common = {
        "mesh": rectangle(12, 6, x=(0, 2)),
        "law": PlaneStrain.from_young(1000.0, 0.3),
        "dirichlet": (Dirichlet("left", (0.0, 0.0)),),
        "tractions": (Traction("top", (-5.0, -20.0)),),
        "motion": Motion(0.01),
    }
    foundations = (
        Obstacle.graph("bottom", lambda x, y: -0.001, friction=3.0),
        Obstacle.circle("bottom", (1.0, -5.0), 4.999, friction=3.0),
        Obstacle.circle("bottom", (1.0, -5.0), 4.999),
    )
    return [ContactProblem(**common, obstacle=obstacle) for obstacle in foundations]


@pytest.mark.parametrize("number", range(3))
def test_solutions_and_adjoints_do_not_depend_on_the_order(
    number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = blocks()[number]
    results = []
    for large in (5000, 10):
        monkeypatch.setattr(of_model, "LARGE", large)
        model = ContactSolver(problem)
        system = model.system(problem.mesh.p)
        assert (system.order is None) == (large == 5000)
        state = model.solve(problem.mesh.p)
        right = np.linspace(-1, 1, state.u.size)
        results.append((state, adjoint(system, state.active, right)))
    (one, back), (two, ordered_back) = results
    assert one.active.key() == two.active.key()
    assert np.any(one.active.touching)
    np.testing.assert_allclose(two.u, one.u, atol=1e-9 * np.max(np.abs(one.u)))
    np.testing.assert_allclose(two.normal_force, one.normal_force, atol=1e-8 * one.normal_force.max())
    for a, b in zip(back, ordered_back, strict=True):
        np.testing.assert_allclose(b, a, atol=1e-8 * max(np.max(np.abs(a)), 1e-300))
