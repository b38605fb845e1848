"""The Johnson-Mercier and Raviart-Thomas elements: unisolvence, exactness, order of convergence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.certificate import johnson_mercier as jm
from rmesh_nlp.certificate import raviart_thomas as rt
from rmesh_nlp.certificate.bracket import bracket
from rmesh_nlp.certificate.johnson_mercier import residual
from rmesh_nlp.certificate.skeleton import skeleton_of
from rmesh_nlp.fem.energy import triangle_rule
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Dirichlet, Laplace, PlaneStrain, PlaneStress
from support.certificates import distorted, guess_on


def test_johnson_mercier_is_unisolvent():
    """9 functions without divergence, determined by their tractions, and 6 for linear body forces."""
    reference = jm.reference()
    assert np.linalg.matrix_rank(reference.basis.reshape(54, 15)) == 15
    found = jm.divergence(reference.basis, jm.thirds(jm.CORNERS)[..., None]).reshape(18, 15)
    assert np.allclose(found[:, :9], 0, atol=1e-12)
    conditions = np.vstack([reference.forces.reshape(12, 15), found])
    assert np.linalg.matrix_rank(reference.forces.reshape(12, 15)[:, :9]) == 9
    assert np.linalg.matrix_rank(conditions) == 15
    assert all(np.allclose(jump, 0, atol=1e-12) for jump in jm.jumps(reference.basis, jm.CORNERS[..., None]))


def test_raviart_thomas_is_unisolvent():
    reference = rt.reference()
    products = reference.products.reshape(2, 2, 8, 8)
    assert np.linalg.matrix_rank(products[0, 0] + products[1, 1]) == 8
    divergence = np.zeros((3, 8))
    divergence[:, 5] = 1
    divergence[:, 6:] = np.eye(3)[:, :2] - 1 / 3
    conditions = np.vstack([reference.forces.reshape(6, 8), divergence])
    assert np.linalg.matrix_rank(conditions) == 8


@pytest.mark.parametrize("law", [PlaneStrain(3.0, 2.0), PlaneStress(3.0, 2.0), PlaneStrain(2e5, 1.0)])
def test_patch(law):
    """A linear displacement is its own stress: bounds meet, and nothing is left to correct."""
    mesh = distorted(rectangle(3, 3), 0.25, seed=2)
    ux, uy = (lambda x, y: 0.3 * x - 0.2 * y + 0.1), (lambda x, y: 0.7 * y + 0.4 * x)
    sides = tuple(Dirichlet(side, (ux, uy)) for side in ("left", "right", "top", "bottom"))
    problem = ContactProblem(mesh, law, sides)
    u = np.stack([ux(*mesh.p), uy(*mesh.p)])
    found = bracket(problem, mesh.p, guess_on(problem, displacement=u))
    assert found.guaranteed_lower
    assert found.guaranteed_upper
    assert found.upper - found.lower == pytest.approx(0, abs=1e-9 * abs(found.upper))
    assert np.max(found.local) <= 1e-9 * abs(found.upper)


def airy(x, y):
    """Displacement of a body without volume force: stresses are quadratic, for mu = 1 and lambda = 1."""
    # u = grad of a harmonic polynomial has no divergence and a harmonic strain
    return 3 * x**2 * y - y**3, x**3 - 3 * x * y**2


@pytest.mark.parametrize("kind", ["elastic", "scalar"])
def test_order_of_convergence(kind):
    """Errors of stress and flux are of the second order, so the lower bound is of the fourth."""
    lower = []
    for n in (2, 4, 8):
        mesh = rectangle(n, n, diagonal="falling")
        value = [lambda x, y: airy(x, y)[0], lambda x, y: airy(x, y)[1]]
        if kind == "scalar":
            problem = ContactProblem(mesh, Laplace(0.0), all_sides((value[0],)))
        else:
            problem = ContactProblem(mesh, PlaneStrain(1.0, 1.0), all_sides(tuple(value)))
        lower.append(bracket(problem, mesh.p, guess_on(problem)).lower)
    exact = exact_energy(kind)
    errors = exact - np.array(lower)
    assert np.all(errors > 0)
    assert np.all(np.log2(errors[:-1] / errors[1:]) > 3.6)


def all_sides(value):
    return tuple(Dirichlet(side, value) for side in ("left", "right", "top", "bottom"))


def exact_energy(kind):
    points, weights = triangle_rule(8)
    mesh = rectangle(1, 1)
    where = np.einsum("cve,vp->cpe", mesh.p[:, mesh.t], points)
    x, y = where
    if kind == "scalar":
        density = ((6 * x * y) ** 2 + (3 * x**2 - 3 * y**2) ** 2) / 2
    else:
        density = 2 * ((6 * x * y) ** 2 + (3 * x**2 - 3 * y**2) ** 2)
    return float(np.sum(weights @ density) / 2)


def test_stress_is_in_equilibrium_with_a_linear_body_force():
    """For any traces the stress balances the load, element by element, to rounding."""
    problem = ContactProblem(distorted(rectangle(4, 3), 0.3, seed=1), PlaneStrain(5.0, 1.0), ("left",))
    skeleton = skeleton_of(problem, problem.mesh.p)
    rng, count = np.random.default_rng(0), problem.mesh.t.shape[1]
    elements = jm.JohnsonMercier(
        skeleton, np.full(count, 5.0), np.ones(count), rng.normal(size=(2, 3, count))
    )
    coefficients = elements.coefficients(rng.normal(size=(count, 12)))
    stress = elements.stress(coefficients)
    assert residual(elements, stress, elements.forces(coefficients)) < 1e-12
    other = replace(elements, load=elements.load * 1.01)
    assert residual(other, stress, elements.forces(coefficients)) > 1e-8
