"""Spaces of displacements, fields in pieces, laws and stresses: known rates and closed forms."""

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.fem.fields import Fields, constant_field
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.fem.sampling import along, edges_of, pieces, sampled
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.fem.stress import stresses, von_mises
from rmesh_nlp.meshes.geometry import signed_areas
from support.curved import HOLE, plate
from support.formulations import fixed
from support.sliding import elastic, entries


def bent(x: Any, y: Any) -> Any:
    return ca.vertcat(ca.sin(2 * x) * ca.cos(y), x * x * ca.exp(y))


def smooth_block(n: int, order: int) -> rm.ContactProblem:
    """Its solution on the unit square is ``bent``, which is given on the left; it is loaded elsewhere."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    _, stress, force = elastic(bent(x, y), x, y, 3.0, 2.0)
    body = ca.Function("f", [x, y], [force])
    sides = {"right": (1, 0), "bottom": (0, -1), "top": (0, 1)}
    loads = {name: ca.Function("t", [x, y], [stress @ ca.DM(n)]) for name, n in sides.items()}
    return rm.ContactProblem(
        rm.shapes.rectangle(n, n),
        rm.PlaneStrain(3.0, 2.0, entries(body, 0, 1)),
        (rm.Dirichlet("left", (lambda x, y: bent(x, y)[0], lambda x, y: bent(x, y)[1])),),
        tractions=tuple(rm.Traction(name, entries(load, 0, 1)) for name, load in loads.items()),
        motion=rm.Motion(None),
        quadrature=10,
        exact=rm.ExactSolution(bent, float("nan")),
        order=order,
    )


def errors(problem: rm.ContactProblem) -> tuple[int, list[float]]:
    """Number of nodes, and squared errors in the energy norm and in L2 of the contact solution."""
    solver = ContactSolver(problem)
    space, given = solver.discretisation.space, solver.given
    u = constant_field(solver.displacement.values(given.u))
    fields = Fields(space, constant_field(problem.mesh.p), u, u)
    functions = (parse_objective(text).on(fields).evaluate() for text in ("error-energy", "error-l2"))
    return space.n_nodes, [function(np.zeros(0)) for function in functions]


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2])
def test_a_smooth_solution_has_full_rates(order: int) -> None:
    """Squared errors over the number of nodes N: N^-order in the energy norm, N^-(order + 1) in L2."""
    (few, coarse), (many, fine) = (errors(smooth_block(n, order)) for n in (6, 12))
    for before, after, rate in zip(coarse, fine, (order, order + 1), strict=True):
        assert np.log(before / after) / np.log(many / few) == pytest.approx(rate, abs=0.12 * rate)


ORDERS = pytest.mark.parametrize("order", [1, 2])


def space_of(problem: rm.ContactProblem, order: int) -> DisplacementSpace:
    return DisplacementSpace(replace(problem, order=order))


def polynomial(order: int, x: np.ndarray) -> np.ndarray:
    return np.asarray(2 * x[0] - x[1] + 0.5 + (order - 1) * (3 * x[0] * x[1] - x[1] ** 2))


@ORDERS
def test_a_polynomial_has_its_values_at_the_points_of_the_pieces(order: int) -> None:
    space = space_of(rm.EXAMPLES["6.1"](3), order)
    nodes, cells = space.points_on_body(space.problem.mesh.p), space.elements
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
    space = space_of(rm.EXAMPLES["6.3"]((4, 2)), order)
    mesh, nodes = space.problem.mesh, space.points_on_body(space.problem.mesh.p)
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
    nodes = space.points_on_body(np.asarray(mesh.p))
    on_hole = space.nodes_of(mesh.facets[:, mesh.boundaries["hole"]])
    np.testing.assert_allclose(np.linalg.norm(nodes[:, on_hole] - 5.0, axis=0), 2.5, rtol=1e-12)
    others = np.setdiff1d(np.arange(space.n_nodes), on_hole)
    np.testing.assert_array_equal(nodes[:, others], space.points(mesh.p)[:, others])
    chords = np.linalg.norm(space.points(mesh.p)[:, on_hole[2]] - 5.0, axis=0)
    assert np.all(chords < 2.49)
    # the parabola through the middle leaves the arc by far less than the chord
    bent = np.linalg.norm(along(on_hole, nodes) - 5.0, axis=0)
    assert np.max(np.abs(bent - 2.5)) < 0.02 * np.max(2.5 - chords)


def bar(law: object) -> rm.ContactProblem:
    """A bar (0,2) x (0,1) on rollers, stretched by 0.01 at its right end."""
    rollers = rm.Dirichlet("left", (0.0, None)), rm.Dirichlet("bottom", (None, 0.0))
    mesh = rm.shapes.rectangle(2, 1, x=(0, 2))
    return rm.ContactProblem(
        mesh, law, (*rollers, rm.Dirichlet("right", (0.01, None))), motion=rm.Motion(0.05)
    )


def test_uniaxial_tension_has_the_energy_of_youngs_modulus() -> None:
    E, nu, strain = 210.0, 0.3, 0.005
    for law, modulus, contraction in (
        (rm.PlaneStress, E, nu),
        (rm.PlaneStrain, E / (1 - nu**2), nu / (1 - nu)),
    ):
        solution = fixed.solve(bar(law.from_young(E, nu)))
        assert solution.energy == pytest.approx(0.5 * modulus * strain**2 * 2, rel=1e-12)
        lateral = -contraction * strain * solution.mesh.p[1]
        np.testing.assert_allclose(solution.displacement[1], lateral, atol=1e-15)


def pressed_block(obstacle: rm.Obstacle) -> rm.ContactProblem:
    mesh, push = rm.shapes.rectangle(4, 4, diagonal="falling"), rm.Dirichlet("top", (0.001, -0.01))
    return rm.ContactProblem(
        mesh, rm.PlaneStrain(100.0, 80.0), (push,), obstacle, rm.Motion(rm.Relative(0.2))
    )


@pytest.mark.slow
def test_penetration_between_nodes_is_measured() -> None:
    curved = fixed.solve(pressed_block(rm.Obstacle.graph("bottom", lambda x, y: -0.02 * (x - 0.5) ** 2)))
    # a parabola rises c h^2 / 4 above its chord; here edges of 1/4 touch with both ends
    assert curved.assessment.final.penetration == pytest.approx(0.02 / 4**2 / 4, rel=1e-6)
    flat = fixed.solve(pressed_block(rm.Obstacle.line("bottom", (0, 0), (0, 1))))
    assert flat.assessment.final.penetration <= 1e-16


@pytest.mark.slow
def test_a_friction_bound_may_vary_with_position() -> None:
    bound = lambda x, y: 0.1 + 0.2 * x  # noqa: E731
    solution = fixed.solve(pressed_block(rm.Obstacle.line("bottom", (0, 0), (0, 1), friction=bound)))
    nodes = solution.problem.contact_nodes[np.argsort(solution.mesh.p[0, solution.problem.contact_nodes])]
    x, force = solution.mesh.p[0, nodes], np.abs(solution.final.tangential_stress[nodes])[1:-1]
    # the integral of g times the hat function over omega_i: for a linear g its value where the hat balances
    before, after = np.diff(x)[:-1], np.diff(x)[1:]
    limit = bound(x[1:-1] + (after**2 - before**2) / (3 * (after + before)), 0)
    assert np.all(force <= limit + 1e-12)
    assert np.any(np.isclose(force, limit))


@pytest.mark.slow
def test_a_held_tangent_at_a_rough_contact_node_transmits_no_friction() -> None:
    problem = rm.ContactProblem(
        rm.shapes.rectangle(4, 2),
        rm.PlaneStrain(100.0, 80.0),
        (rm.Dirichlet("left", (0.0, None)), rm.Dirichlet("top", (None, -0.01))),
        rm.Obstacle("bottom", friction=0.1),
        rm.Motion(0.02),
    )
    with pytest.raises(ValueError, match="with friction it must be zero"):
        replace(problem, dirichlet=(rm.Dirichlet("left", (0.001, None)), rm.Dirichlet("top", (None, -0.01))))
    solution = fixed.solve(problem)
    corner = np.flatnonzero(np.all(problem.mesh.p == 0, axis=0))
    assert solution.success
    assert solution.final.pressure[corner] > 0
    assert solution.final.tangential_stress[corner] == 0


def test_von_mises_is_that_of_the_deviator() -> None:
    rng = np.random.default_rng(0)
    for xx, yy, xy, zz in rng.uniform(-1, 1, (5, 4)):
        tensor = np.array([[xx, xy, 0], [xy, yy, 0], [0, 0, zz]])
        deviator = tensor - np.trace(tensor) / 3 * np.eye(3)
        expected = np.sqrt(1.5 * np.sum(deviator**2))
        assert von_mises(np.array([xx, yy, xy, zz])) == pytest.approx(expected)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("law", [rm.PlaneStrain, rm.PlaneStress])
def test_stresses_of_a_linear_displacement_obey_hookes_law_in_space(law, order) -> None:
    mesh = rm.shapes.rectangle(3, 2)
    young, poisson = 200.0, 0.3
    problem = rm.ContactProblem(mesh, law.from_young(young, poisson), ("left",), order=order)
    gradient = np.array([[0.01, 0.004], [-0.002, 0.006]])
    points = DisplacementSpace(problem).points_on_body(mesh.p)
    xx, yy, xy, zz = stresses(problem, mesh.p, gradient @ points)
    # strains from stresses by Hooke's law in space: another form than the one under test
    strain = (gradient + gradient.T) / 2
    np.testing.assert_allclose((xx - poisson * (yy + zz)) / young, strain[0, 0])
    np.testing.assert_allclose((yy - poisson * (xx + zz)) / young, strain[1, 1])
    np.testing.assert_allclose(xy * (1 + poisson) / young, strain[0, 1])
    if law is rm.PlaneStress:
        np.testing.assert_allclose(zz, 0)
    else:
        np.testing.assert_allclose(zz - poisson * (xx + yy), 0, atol=1e-12)


@pytest.mark.parametrize("curved", [True, False])
def test_the_flux_of_a_quadratic_displacement_is_linear(curved) -> None:
    curves = {"hole": HOLE} if curved else {}
    problem = replace(plate(curves), law=rm.Laplace(), dirichlet=("left",), tractions=(), order=2)
    X, shares = problem.mesh.p, np.array([[0.2, 0.7], [0.5, 0.0], [0.3, 0.3]])
    x, y = DisplacementSpace(problem).points_on_body(X)
    straight = np.ones(problem.triangles.shape[1], dtype=bool)
    if curved:  # on blended triangles of linear displacements alone
        straight[problem.mesh.f2t[0, problem.mesh.boundaries["hole"]]] = False
    at = np.einsum("cve,vp->cep", X[:, problem.triangles], shares)
    flux = stresses(problem, X, (x**2 - 3 * x * y + 0.1 * y)[None], shares)
    expected = np.stack([2 * at[0] - 3 * at[1], 0.1 - 3 * at[0]])
    np.testing.assert_allclose(flux[:, straight], expected[:, straight], atol=1e-11)
    mean = stresses(problem, X, (x**2 - 3 * x * y + 0.1 * y)[None])
    centre = X[:, problem.triangles].mean(axis=1)
    expected = np.stack([2 * centre[0] - 3 * centre[1], 0.1 - 3 * centre[0]])
    np.testing.assert_allclose(mean[:, straight], expected[:, straight], atol=1e-11)
    plain = stresses(problem, X, (2 * x - y)[None], shares)
    np.testing.assert_allclose(plain, np.broadcast_to([[[2.0]], [[-1.0]]], plain.shape), atol=1e-11)
