"""Laws per subdomain, given displacements, obstacles, stresses: against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.fem.sampling import points_of
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.fem.stress import stresses, von_mises
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import (
    ContactProblem,
    Dirichlet,
    Motion,
    Obstacle,
    PlaneStrain,
    PlaneStress,
    Relative,
)
from support.curved import HOLE, plate
from support.formulations import fixed


def bar(law: object) -> ContactProblem:
    """A bar (0,2) x (0,1) on rollers, stretched by 0.01 at its right end."""
    rollers = Dirichlet("left", (0.0, None)), Dirichlet("bottom", (None, 0.0))
    mesh = rectangle(2, 1, x=(0, 2))
    return ContactProblem(mesh, law, (*rollers, Dirichlet("right", (0.01, None))), motion=Motion(0.05))


def test_uniaxial_tension_has_the_energy_of_youngs_modulus() -> None:
    E, nu, strain = 210.0, 0.3, 0.005
    for law, modulus, contraction in ((PlaneStress, E, nu), (PlaneStrain, E / (1 - nu**2), nu / (1 - nu))):
        solution = fixed.solve(bar(law.from_young(E, nu)))
        assert solution.energy == pytest.approx(0.5 * modulus * strain**2 * 2, rel=1e-12)
        lateral = -contraction * strain * solution.mesh.p[1]
        np.testing.assert_allclose(solution.displacement[1], lateral, atol=1e-15)


def pressed_block(obstacle: Obstacle) -> ContactProblem:
    mesh, push = rectangle(4, 4, diagonal="falling"), Dirichlet("top", (0.001, -0.01))
    return ContactProblem(mesh, PlaneStrain(100.0, 80.0), (push,), obstacle, Motion(Relative(0.2)))


def test_penetration_between_nodes_is_measured() -> None:
    curved = fixed.solve(pressed_block(Obstacle.graph("bottom", lambda x, y: -0.02 * (x - 0.5) ** 2)))
    # a parabola rises c h^2 / 4 above its chord; here edges of 1/4 touch with both ends
    assert curved.assessment.final.penetration == pytest.approx(0.02 / 4**2 / 4, rel=1e-6)
    flat = fixed.solve(pressed_block(Obstacle.line("bottom", (0, 0), (0, 1))))
    assert flat.assessment.final.penetration <= 1e-16


def test_a_friction_bound_may_vary_with_position() -> None:
    bound = lambda x, y: 0.1 + 0.2 * x  # noqa: E731
    solution = fixed.solve(pressed_block(Obstacle.line("bottom", (0, 0), (0, 1), friction=bound)))
    nodes = solution.problem.contact_nodes[np.argsort(solution.mesh.p[0, solution.problem.contact_nodes])]
    x, force = solution.mesh.p[0, nodes], np.abs(solution.tangential_stress[nodes])[1:-1]
    # the integral of g times the hat function over omega_i: for a linear g its value where the hat balances
    before, after = np.diff(x)[:-1], np.diff(x)[1:]
    limit = bound(x[1:-1] + (after**2 - before**2) / (3 * (after + before)), 0)
    assert np.all(force <= limit + 1e-12)
    assert np.any(np.isclose(force, limit))


def test_a_held_tangent_at_a_rough_contact_node_transmits_no_friction() -> None:
    problem = ContactProblem(
        rectangle(4, 2),
        PlaneStrain(100.0, 80.0),
        (Dirichlet("left", (0.0, None)), Dirichlet("top", (None, -0.01))),
        Obstacle("bottom", friction=0.1),
        Motion(0.02),
    )
    with pytest.raises(ValueError, match="with friction it must be zero"):
        replace(problem, dirichlet=(Dirichlet("left", (0.001, None)), Dirichlet("top", (None, -0.01))))
    solution = fixed.solve(problem)
    corner = np.flatnonzero(np.all(problem.mesh.p == 0, axis=0))
    assert solution.success
    assert solution.pressure[corner] > 0
    assert solution.tangential_stress[corner] == 0


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
    points = points_of(DisplacementSpace(problem), mesh.p)
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
    x, y = points_of(DisplacementSpace(problem), X)
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
