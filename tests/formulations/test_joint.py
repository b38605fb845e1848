"""Joint: Newton steps from near a stationary point to one, and any unit of length."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from formulations.joint import Joint
from formulations.mpcc import AllAtOnce
from formulations.nested import Nested
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.mapping.validity import is_valid
from rmesh_nlp.meshes import shapes
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.optimize.units import Units
from rmesh_nlp.problem import ContactProblem, Motion, Obstacle, PlaneStrain, Relative, Traction
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Step
from support.formulations import joint

LOOSE = {"tol": 1e-3, "acceptable_tol": 1e-3, "tol_areas": 1e-6, "acceptable_tol_areas": 1e-6}
"""Ipopt then stops near a stationary point, not at one."""


@pytest.mark.parametrize(
    ("example", "arguments"),
    [("6.1", (4,)), ("6.3", ((4, 2),)), ("6.2", ((6, 3), (1.0, 0.5)))],
    ids=["move limits", "friction", "areas"],
)
def test_a_loose_end_is_finished_by_newton_steps_that_the_record_counts(
    example: str, arguments: tuple[Any, ...]
) -> None:
    steps: list[Step] = []
    solution = joint.solve(EXAMPLES[example](*arguments), settings=LOOSE, on_step=steps.append)
    record = solution.record()
    ipopt, newton = record["kkt_factorisations"], record["newton_steps"]
    assert newton > 0
    assert solution.status is Status.CONVERGED
    assert record["iterations"] == ipopt + newton == solution.history[-1].iteration
    assert record["contact_solves"] > 2
    exact = [step for step in solution.history if step.t == 0.0]
    assert len(exact) == newton + 1  # after Ipopt's iterates
    before, after = steps[ipopt], steps[-1]  # the last iterate of Ipopt, and the end
    assert before.dual_residual > 1e-6 >= after.dual_residual
    assert after.energy <= before.energy + 1e-9 * abs(before.energy)


def test_a_stationary_end_of_ipopt_is_left_as_it_is() -> None:
    record = joint.solve(EXAMPLES["6.1"](4)).record()
    assert "newton_steps" not in record
    assert record["contact_solves"] == 2  # at its start and at its end


@pytest.mark.parametrize("rise", [0.0, 1e-6])
def test_newton_steps_to_a_higher_energy_are_not_taken(rise: float, monkeypatch: pytest.MonkeyPatch) -> None:
    outer = Outer(EXAMPLES["6.1"](3))
    begin = np.zeros(outer.n)
    end, energies = begin + 1e-3, outer.energy
    higher = replace(energies(begin), q=end, value=energies(begin).value * (1 - rise))
    near = {begin.tobytes(): 5e-3, end.tobytes(): 1e-9}
    outer.__dict__["residual"] = lambda point: near[point.q.tobytes()]
    monkeypatch.setattr(ReducedEnergy, "__call__", lambda self, q: higher if np.any(q) else self._last)
    monkeypatch.setattr(Nested, "run", lambda *_: Outcome(outer, end, Status.CONVERGED))
    found = Joint()._finished(outer, begin, Monitor())
    np.testing.assert_array_equal(found, begin if rise else end)


@pytest.mark.parametrize(
    ("formulation", "n", "delta", "seed"), [(Joint(), 3, 0.15, 3), (AllAtOnce(), 4, 0.05, 1)]
)
def test_from_a_minimiser_the_barrier_leads_to_none_above_it(
    formulation: Joint | AllAtOnce, n: int, delta: float, seed: int
) -> None:
    outer = Outer(EXAMPLES["6.1"](n, delta))
    least = Nested().run(outer, outer.variables(seed=seed), Monitor()).q
    found = formulation.run(outer, least, Monitor())
    assert outer.energy(found.q).value <= outer.energy(least).value * (1 - 1e-9)  # both are negative


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
