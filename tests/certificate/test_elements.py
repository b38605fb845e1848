"""The Johnson-Mercier and Raviart-Thomas elements: unisolvence, exactness, order of convergence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from skfem import ElementTriRT2

from rmesh_nlp.certificate import johnson_mercier as jm
from rmesh_nlp.certificate import raviart_thomas as rt
from rmesh_nlp.certificate.bracket import bracket
from rmesh_nlp.certificate.johnson_mercier import residual
from rmesh_nlp.certificate.skeleton import AFTER, skeleton_of
from rmesh_nlp.fem.bernstein import functions
from rmesh_nlp.fem.energy import triangle_rule
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Dirichlet, Laplace, PlaneStrain, PlaneStress
from support.certificates import distorted, guess_on, of_values


def test_johnson_mercier_is_unisolvent():
    """9 functions without divergence, determined by their tractions, and 6 for linear body forces."""
    reference = jm.reference()
    assert np.linalg.matrix_rank(reference.basis.reshape(54, 15)) == 15
    found = jm.divergence(reference.basis, jm.on_thirds(jm.CORNERS)[..., None]).reshape(18, 15)
    assert np.allclose(found[:, :9], 0, atol=1e-12)
    conditions = np.vstack([reference.forces.reshape(12, 15), found])
    assert np.linalg.matrix_rank(reference.forces.reshape(12, 15)[:, :9]) == 9
    assert np.linalg.matrix_rank(conditions) == 15
    assert all(np.allclose(jump, 0, atol=1e-12) for jump in jm.jumps(reference.basis, jm.CORNERS[..., None]))


@pytest.mark.parametrize("degree", [1, 2])
def test_raviart_thomas_is_the_element_of_scikit_fem_and_of_its_definition(degree: int) -> None:
    """Its functions span the same space: polynomials of the degree, and x times the homogeneous ones."""
    barycentric, _ = triangle_rule(8)
    x, y = barycentric[1:]
    powers = [x**i * y ** (k - i) for k in range(degree + 1) for i in range(k + 1)]
    wanted = [(q, 0 * q) for q in powers] + [(0 * q, q) for q in powers]
    wanted += [(x * q, y * q) for q in powers[-degree - 1 :]]
    theirs, size = np.array(wanted).reshape(len(wanted), -1).T, {1: 8, 2: 15}[degree]
    ours = rt._functions(barycentric, degree).reshape(-1, size)
    assert np.linalg.matrix_rank(ours) == np.linalg.matrix_rank(np.hstack([ours, theirs])) == size
    if degree == 1:
        element = ElementTriRT2()
        theirs = np.hstack([element.lbasis(barycentric[1:], i)[0].reshape(-1, 1) for i in range(8)])
        assert np.linalg.matrix_rank(np.hstack([ours, theirs])) == size


def flux_elements(degree: int) -> tuple[rt.RaviartThomas, np.ndarray]:
    mesh = distorted(rectangle(3, 2), 0.3, seed=1)
    skeleton = skeleton_of(ContactProblem(mesh, Laplace(0.0), ("left",), order=degree), mesh.p)
    rng, count = np.random.default_rng(0), mesh.t.shape[1]
    elements = rt.RaviartThomas(skeleton, np.full(count, 2.5), rng.normal(size=(3 * degree, count)))
    return elements, rng.normal(size=(count, 3 * (degree + 1)))


def at_points(elements: rt.RaviartThomas, coefficients: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
    """(2, points, elements) fluxes by Piola's map."""
    inside = np.einsum("apk,ek->ape", rt._functions(barycentric, elements.degree), coefficients)
    pushed = np.einsum("eab,bpe->ape", elements.skeleton.jacobian, inside)
    return pushed / (2 * elements.skeleton.areas)


@pytest.mark.parametrize("degree", [1, 2])
def test_a_flux_balances_its_source_and_has_the_energy_of_its_values(degree: int) -> None:
    elements, traces = flux_elements(degree)
    coefficients, skeleton = elements.coefficients(traces), elements.skeleton
    points, weights = triangle_rule(6)
    flux = at_points(elements, coefficients, points)
    mean = np.einsum("p,ape->ae", weights, flux)
    squares = [np.einsum("p,ape->e", weights, part**2) for part in (flux, flux - mean[:, None])]
    np.testing.assert_allclose(elements.energy(coefficients), skeleton.areas * squares[0] / (2 * 2.5))
    np.testing.assert_allclose(elements.variation(coefficients), skeleton.areas * squares[1] / 2.5)
    np.testing.assert_allclose(elements.mean(coefficients), mean, atol=1e-12)
    # pointwise: these differences are exact for cubic functions
    for where in triangle_rule(6)[0].T:
        steps = [n * 1e-2 * np.array(way) for n in (1, -1, 2, -2) for way in ((-1, 1, 0), (-1, 0, 1))]
        around = at_points(elements, coefficients, (where + np.array(steps)).T)
        one, back, two, far = around.reshape(2, 4, 2, -1).transpose(1, 0, 2, 3)
        slope = (8 * (one - back) - (two - far)) / 12e-2  # (component, reference direction, element)
        divergence = np.einsum("cre,erc->e", slope, np.linalg.inv(skeleton.jacobian))
        source = functions(degree, where) @ elements.load
        np.testing.assert_allclose(divergence, -source, atol=1e-9)
    # forces are Bernstein's coefficients along the edges, counter-clockwise
    shares = np.array([[0.8, 0.5, 0.1], [0.2, 0.5, 0.9]])
    for i, ends in enumerate(AFTER):
        along = at_points(elements, coefficients, np.eye(3)[ends].T @ shares)
        through = np.einsum("ce,cpe->ep", skeleton.normals[:, i], along)
        forces = elements.forces(coefficients).reshape(len(traces), 3, -1)[:, i]
        np.testing.assert_allclose(forces @ functions(degree, shares), through, atol=1e-12)
    # it minimises the energy less the work on the traces
    forces = np.einsum("eij,ej->ei", elements.stiffness, traces) - elements.source
    np.testing.assert_allclose(forces, elements.forces(coefficients), atol=1e-9)
    slopes = np.einsum("eij,ej->ei", elements.compliance, coefficients) - traces @ elements.rows
    np.testing.assert_allclose(slopes[:, : rt.FREE[degree]], 0, atol=1e-9)


@pytest.mark.parametrize("degree", [1, 2])
def test_a_constant_or_linear_flux_is_its_own_coefficients(degree: int) -> None:
    elements, _ = flux_elements(degree)
    q = np.random.default_rng(1).normal(size=(2, 3, elements.load.shape[1]))
    constant = rt.linear_flux(elements.skeleton, q[:, :1], degree)
    np.testing.assert_allclose(elements.mean(constant), q[:, 0], atol=1e-12)
    np.testing.assert_allclose(elements.variation(constant), 0, atol=1e-12)
    linear, (points, _) = rt.linear_flux(elements.skeleton, q, degree), triangle_rule(3)
    wanted = np.einsum("vp,cve->cpe", points, q)
    if degree == 2:
        np.testing.assert_allclose(at_points(elements, linear, points), wanted, atol=1e-12)


@pytest.mark.parametrize("lame", [(3.0, 2.0), (0.0, 1.0)])
def test_stresses_have_the_energy_of_their_law_balance_the_load_and_minimise(
    lame: tuple[float, float],
) -> None:
    mesh = distorted(rectangle(3, 2), 0.3, seed=1)
    skeleton = skeleton_of(ContactProblem(mesh, PlaneStrain(3.0, 2.0), ("left",)), mesh.p)
    rng, count = np.random.default_rng(0), mesh.t.shape[1]
    moduli = (np.full(count, part) for part in lame)
    elements = jm.JohnsonMercier(skeleton, *moduli, rng.normal(size=(2, 3, count)))
    traces = rng.normal(size=(count, 12))
    coefficients = elements.coefficients(traces)
    stress, through = elements.stress(coefficients), elements.forces(coefficients)
    form = np.einsum("ei,eij,ej->e", coefficients, elements.compliance, coefficients) / 2
    np.testing.assert_allclose(elements.energy(stress), form)
    # a constant stress by Hooke's law: strain energy of the strain that makes it
    lam, mu = lame
    strain = np.array([0.3, -0.2, 0.1])
    made = np.array([lam * 0.1 + 2 * mu * 0.3, lam * 0.1 - 2 * mu * 0.2, 2 * mu * 0.1])
    density = (made[:2] @ strain[:2] + 2 * made[2] * strain[2]) / 2
    everywhere = np.broadcast_to(made[:, None], (3, 6, 3, count))
    np.testing.assert_allclose(elements.energy(everywhere), density * skeleton.areas)
    forces = np.einsum("eij,ej->ei", elements.stiffness, traces) - elements.source
    np.testing.assert_allclose(forces, through, atol=1e-9)
    # for any traces the stress balances the load, element by element, to rounding
    assert residual(elements, stress, through) < 1e-12
    assert residual(replace(elements, load=elements.load * 1.01), stress, through) > 1e-8
    # among stresses with the same divergence it has the least energy less the work on the traces
    work = [
        elements.energy(elements.stress(c)) - np.sum(elements.forces(c) * traces, axis=1)
        for c in (coefficients, *(coefficients + 1e-3 * free for free in np.eye(15)[: jm.FREE]))
    ]
    assert np.all(work[1:] > work[0])


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    "law", [PlaneStrain(3.0, 2.0), PlaneStress(3.0, 2.0), PlaneStrain(2e5, 1.0), Laplace(0.0, 2.0)]
)
def test_patch(law: PlaneStrain | PlaneStress | Laplace, order: int) -> None:
    """A displacement of the order is its own stress: bounds meet, and nothing is left to correct."""
    mesh = distorted(rectangle(3, 3), 0.25, seed=2)
    bent = (order - 1) / 10
    ux = lambda x, y: 0.3 * x - 0.2 * y + 0.1 + bent * (x * x - 3 * x * y + 2 * y * y)  # noqa: E731
    uy = lambda x, y: 0.7 * y + 0.4 * x + bent * (x * x + x * y)  # noqa: E731
    given, scalar = (ux, uy)[: len(law.load)], isinstance(law, Laplace)
    if scalar:  # less the divergence of the flux
        law = replace(law, source=-2.0 * 6 * bent)
    else:  # grad div u = bent (3, -3), laplace u = bent (6, 2)
        lam, mu = law.in_plane_lambda, law.lame_mu
        law = replace(law, body_force=tuple(-bent * ((lam + mu) * a + mu * b) for a, b in ((3, 6), (-3, 2))))
    sides = tuple(Dirichlet(side, given) for side in ("left", "right", "top", "bottom"))
    problem = ContactProblem(mesh, law, sides, order=order)
    found = bracket(problem, mesh.p, guess_on(problem, of_values(problem, given)))
    assert found.guaranteed_lower
    assert found.guaranteed_upper
    assert found.upper - found.lower == pytest.approx(0, abs=1e-9 * abs(found.upper))
    assert np.max(found.local) <= 1e-9 * abs(found.upper)


HARMONIC = (lambda x, y: 3 * x**2 * y - y**3), (lambda x, y: x**3 - 3 * x * y**2)
"""Displacement of a body without volume force whose stresses are quadratic, for mu = 1 and lambda = 1: the
gradient of a harmonic polynomial has no divergence and a harmonic strain."""


@pytest.mark.parametrize(
    ("law", "factor", "order", "rate"),
    [(Laplace(0.0), 1 / 2, 1, 4), (PlaneStrain(1.0, 1.0), 2.0, 1, 4), (PlaneStrain(1.0, 1.0), 2.0, 2, 4)],
)
def test_order_of_convergence(law: Laplace | PlaneStrain, factor: float, order: int, rate: float) -> None:
    """Errors of stress and flux are of the second order, so the lower bound is of the fourth."""
    lower = []
    for n in (2, 4, 8):
        given = HARMONIC[: len(law.load)]
        sides = tuple(Dirichlet(side, given) for side in ("left", "right", "top", "bottom"))
        problem = ContactProblem(rectangle(n, n, diagonal="falling"), law, sides, order=order)
        lower.append(bracket(problem, problem.mesh.p, guess_on(problem)).lower)
    # the integral of |(6 x y, 3 x^2 - 3 y^2)|^2 over the unit square
    exact = factor * (36 / 9 + 9 * (1 / 5 - 2 / 9 + 1 / 5))
    errors = exact - np.array(lower)
    assert np.all(errors > 0)
    assert np.all(np.log2(errors[:-1] / errors[1:]) > rate - 0.4)
