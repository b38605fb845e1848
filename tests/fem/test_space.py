"""Spaces of displacements: numbering, weights, known rates, fields cut into pieces."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.fields import Fields, constant_field
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.fem.sampling import along, edges_of, pieces, points_of, sampled
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes.curves import Circle
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import (
    ContactProblem,
    Dirichlet,
    ExactSolution,
    Motion,
    PlaneStrain,
    Traction,
)
from support.curved import HOLE, plate
from support.sliding import elastic, entries


def bent(x: Any, y: Any) -> Any:
    return ca.vertcat(ca.sin(2 * x) * ca.cos(y), x * x * ca.exp(y))


def smooth_block(n: int, order: int) -> ContactProblem:
    """Its solution on the unit square is ``bent``, which is given on the left; it is loaded elsewhere."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    _, stress, force = elastic(bent(x, y), x, y, 3.0, 2.0)
    body = ca.Function("f", [x, y], [force])
    sides = {"right": (1, 0), "bottom": (0, -1), "top": (0, 1)}
    loads = {name: ca.Function("t", [x, y], [stress @ ca.DM(n)]) for name, n in sides.items()}
    return ContactProblem(
        rectangle(n, n),
        PlaneStrain(3.0, 2.0, entries(body, 0, 1)),
        (Dirichlet("left", (lambda x, y: bent(x, y)[0], lambda x, y: bent(x, y)[1])),),
        tractions=tuple(Traction(name, entries(load, 0, 1)) for name, load in loads.items()),
        motion=Motion(None),
        quadrature=10,
        exact=ExactSolution(bent, float("nan")),
        order=order,
    )


def errors(problem: ContactProblem) -> tuple[int, list[float]]:
    """Number of nodes, and squared errors in the energy norm and in L2 of the contact solution."""
    solver = ContactSolver(problem)
    space, given = solver.discretisation.space, solver.given
    u = constant_field(solver.displacement.values(given.u))
    fields = Fields(space, constant_field(problem.mesh.p), u, u)
    functions = (parse_objective(text).on(fields).evaluate() for text in ("error-energy", "error-l2"))
    return space.n_nodes, [function(np.zeros(0)) for function in functions]


@pytest.mark.parametrize("order", [1, 2])
def test_a_smooth_solution_has_full_rates(order: int) -> None:
    """Squared errors over the number of nodes N: N^-order in the energy norm, N^-(order + 1) in L2."""
    (few, coarse), (many, fine) = (errors(smooth_block(n, order)) for n in (6, 12))
    for before, after, rate in zip(coarse, fine, (order, order + 1), strict=True):
        assert np.log(before / after) / np.log(many / few) == pytest.approx(rate, abs=0.12 * rate)


ORDERS = pytest.mark.parametrize("order", [1, 2])


def space_of(problem: ContactProblem, order: int) -> DisplacementSpace:
    return DisplacementSpace(replace(problem, order=order))


def polynomial(order: int, x: np.ndarray) -> np.ndarray:
    return np.asarray(2 * x[0] - x[1] + 0.5 + (order - 1) * (3 * x[0] * x[1] - x[1] ** 2))


@ORDERS
def test_a_polynomial_has_its_values_at_the_points_of_the_pieces(order: int) -> None:
    space = space_of(EXAMPLES["6.1"](3), order)
    nodes, cells = points_of(space, space.problem.mesh.p), space.elements
    cut = pieces(cells)
    points = sampled(cells, nodes, cut.shares)
    values = sampled(cells, polynomial(order, nodes), cut.shares)
    np.testing.assert_allclose(values, polynomial(order, points), atol=1e-14)
    areas = [np.abs(signed_areas(points[:, k], cut.triangles)) for k in range(cells.shape[1])]
    # all alike, and the square is covered
    np.testing.assert_allclose(areas, 1 / np.size(areas), rtol=1e-10)
    where = np.einsum("cve,vp->cep", nodes[:, cells[:3]], cut.centres)
    np.testing.assert_allclose(where, points[:, :, cut.triangles].mean(axis=2), atol=1e-14)


@ORDERS
def test_edges_are_those_of_the_mesh_with_their_middles(order: int) -> None:
    space = space_of(EXAMPLES["6.3"]((4, 2)), order)
    mesh, nodes = space.problem.mesh, points_of(space, space.problem.mesh.p)
    for edges, facets in (
        (edges_of(space.elements), np.arange(mesh.facets.shape[1])),
        (edges_of(space.elements, outer=True), mesh.boundary_facets()),
    ):
        expected = space.nodes_of(mesh.facets[:, facets])
        assert {frozenset(one) for one in edges.T.tolist()} == {frozenset(one) for one in expected.T.tolist()}
        assert edges.shape == expected.shape
        np.testing.assert_allclose(
            nodes[:, edges[2:]] - nodes[:, edges[:2]].mean(axis=1)[:, None], 0, atol=1e-15
        )
        values = along(edges, polynomial(order, nodes), 4)
        np.testing.assert_allclose(values, polynomial(order, along(edges, nodes, 4)), atol=1e-14)


def test_middles_of_edges_on_a_curve_are_on_it() -> None:
    space = space_of(plate({"hole": HOLE}), 2)
    mesh = space.problem.mesh
    nodes = points_of(space, np.asarray(mesh.p))
    assert isinstance(HOLE, Circle)
    on_hole = space.nodes_of(mesh.facets[:, mesh.boundaries["hole"]])
    np.testing.assert_allclose(np.linalg.norm(nodes[:, on_hole] - 5.0, axis=0), 2.5, rtol=1e-12)
    others = np.setdiff1d(np.arange(space.n_nodes), on_hole)
    np.testing.assert_array_equal(nodes[:, others], space.points(mesh.p)[:, others])
    chords = np.linalg.norm(space.points(mesh.p)[:, on_hole[2]] - 5.0, axis=0)
    assert np.all(chords < 2.49)
    # the parabola through the middle leaves the arc by far less than the chord
    bent = np.linalg.norm(along(on_hole, nodes) - 5.0, axis=0)
    assert np.max(np.abs(bent - 2.5)) < 0.02 * np.max(2.5 - chords)
