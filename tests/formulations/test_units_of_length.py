"""Strategies do not depend on the unit of length of a problem."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.mapping.validity import is_valid
from rmesh_nlp.meshes import shapes
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.optimize.units import Units
from rmesh_nlp.problem import ContactProblem, Motion, Obstacle, PlaneStrain, Relative, Traction
from support.formulations import joint


def block(length: float) -> ContactProblem:
    """The block of the README, 6 x 2 squares, at a size of ``length``, under the same strains."""
    return ContactProblem(
        mesh=shapes.rectangle(6, 2, x=(0, 4 * length), y=(0, length)),
        law=PlaneStrain.from_young(young=21600, poisson=0.3),
        dirichlet=("left",),
        obstacle=Obstacle.graph("bottom", lambda x, y: -0.02 * length - 0.01 * x**2 / length, friction=10.0),
        motion=Motion(delta=Relative(0.3), pinned=("top",)),
        tractions=(Traction("top", (0.0, lambda x, y: -20 * x / length)),),
    )


@pytest.fixture(scope="module")
def usual():
    return joint.solve(block(1.0))


@pytest.mark.parametrize("length", [1e-9, 1e-6, 1e6])
def test_joint_ends_as_well_in_any_unit_of_length(usual, length: float) -> None:
    solution = joint.solve(block(length))
    assert solution.success, solution.status
    assert solution.stationarity_residual <= 1e-6
    assert is_valid(solution.problem, solution.mesh.p)
    gain = (solution.energy_initial - solution.energy) / length**2
    assert gain >= 0.9 * (usual.energy_initial - usual.energy)  # it may be another local minimum
    residuals = [step.dual_residual for step in solution.history if np.isfinite(step.dual_residual)]
    assert residuals[-1] <= 1e-6 < residuals[0]


def test_derivatives_in_other_units_are_those_of_the_scaled_program() -> None:
    nlp = relocation(block(1.0)).nlp
    rng = np.random.default_rng(0)
    units = Units(rng.uniform(0.5, 2, nlp.n_x), rng.uniform(0.5, 2, nlp.n_g))
    other = units.program(nlp)
    x, lam = 0.1 * rng.uniform(-1, 1, nlp.n_x), rng.uniform(-1, 1, nlp.n_g)
    value, gradient = (np.asarray(r).ravel() for r in nlp.derivatives.grad_f(x, []))
    same, scaled = (np.asarray(r).ravel() for r in other.derivatives.grad_f(x / units.x, []))
    np.testing.assert_allclose(same, value)
    np.testing.assert_allclose(scaled, units.x * gradient)
    rows, jacobian = (np.asarray(r.full()) for r in nlp.derivatives.jac_g(x, []))
    same, scaled = (np.asarray(r.full()) for r in other.derivatives.jac_g(x / units.x, []))
    np.testing.assert_allclose(same.ravel(), rows.ravel() / units.g)
    np.testing.assert_allclose(scaled, jacobian * units.x / units.g[:, None], atol=1e-14)
    hessian = nlp.derivatives.hess_lag(x, [], 0.7, lam / units.g).full()
    scaled = other.derivatives.hess_lag(x / units.x, [], 0.7, lam).full()
    np.testing.assert_allclose(scaled, hessian * np.outer(units.x, units.x), rtol=1e-9, atol=1e-9)


def test_a_program_without_assembled_derivatives_is_refused() -> None:
    nlp = replace(relocation(block(1.0)).nlp, derivatives=None)
    with pytest.raises(ValueError, match="without assembled derivatives"):
        Units(np.ones(nlp.n_x), np.ones(nlp.n_g)).program(nlp)
