"""The Johnson-Mercier and Raviart-Thomas elements: unisolvence, exactness, order of convergence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.certificate import johnson_mercier as jm
from rmesh_nlp.certificate.bracket import bracket
from rmesh_nlp.certificate.johnson_mercier import residual
from rmesh_nlp.certificate.skeleton import skeleton_of
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Dirichlet, Laplace, PlaneStrain, PlaneStress
from support.certificates import distorted, guess_on, of_values


def test_a_stress_that_does_not_balance_its_load_is_noticed() -> None:
    mesh = distorted(rectangle(3, 2), 0.3, seed=1)
    skeleton = skeleton_of(ContactProblem(mesh, PlaneStrain(3.0, 2.0), ("left",)), mesh.p)
    rng, count = np.random.default_rng(0), mesh.t.shape[1]
    elements = jm.JohnsonMercier(skeleton, *np.full((2, count), 1.0), rng.normal(size=(2, 3, count)))
    coefficients = elements.coefficients(rng.normal(size=(count, 12)))
    stress, through = elements.stress(coefficients), elements.forces(coefficients)
    assert residual(elements, stress, through) < 1e-12
    assert residual(replace(elements, load=elements.load * 1.01), stress, through) > 1e-8


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
