"""Stresses and their equivalent against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.fem.sampling import points_of
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.fem.stress import stresses, von_mises
from support.curved import HOLE, plate


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
    points = points_of(DisplacementSpace.of(problem), mesh.p)
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


def test_the_flux_of_a_scalar_problem_is_conductivity_times_slope_on_each_region_of_moved_nodes() -> None:
    mesh = rm.shapes.rectangle(4, 2).with_subdomains(
        {"soft": lambda x: x[0] < 0.5, "stiff": lambda x: x[0] > 0.5}
    )
    laws = {"soft": rm.Laplace(conductivity=2.0), "stiff": rm.Laplace(conductivity=7.0)}
    problem = rm.ContactProblem(mesh, laws, ("left",))
    stretched = np.vstack([2 * mesh.p[0], mesh.p[1]])
    flux = stresses(problem, stretched, (3 * mesh.p[0] - mesh.p[1])[None, :])
    for name, law in laws.items():
        expected = law.conductivity * np.array([[1.5], [-1.0]])
        elements = mesh.subdomains[name]
        np.testing.assert_allclose(flux[:, elements], np.broadcast_to(expected, (2, elements.size)))


@pytest.mark.parametrize("curved", [True, False])
def test_the_flux_of_a_quadratic_displacement_is_linear(curved) -> None:
    curves = {"hole": HOLE} if curved else {}
    problem = replace(plate(curves), law=rm.Laplace(), dirichlet=("left",), tractions=(), order=2)
    X, shares = problem.mesh.p, np.array([[0.2, 0.7], [0.5, 0.0], [0.3, 0.3]])
    x, y = points_of(DisplacementSpace.of(problem), X)
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
