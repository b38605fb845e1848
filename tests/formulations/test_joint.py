"""Joint: starts with alternating steps, Newton steps from near a stationary point, any unit of length."""

from __future__ import annotations

from contextlib import suppress
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
from rmesh_nlp.models.alternating import alternated, alternating
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.optimize.budget import Limits, StoppedError
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.optimize.units import Units
from rmesh_nlp.problem import ContactProblem, Motion, Obstacle, PlaneStrain, Relative, Traction
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Step
from support.formulations import joint


@pytest.mark.parametrize(
    ("example", "arguments", "tol"),
    [("6.1", (4,), 1e-3), ("6.3", ((4, 2),), 1e-3), ("6.2", ((6, 3), (1.0, 0.5)), 1e-4)],
    ids=["move limits", "friction", "areas"],
)
def test_a_loose_end_is_finished_by_newton_steps_that_the_record_counts(
    example: str, arguments: tuple[Any, ...], tol: float
) -> None:
    """With such a tolerance (a hundredth with areas) Ipopt stops near a stationary point, not at one."""
    steps: list[Step] = []
    solution = joint.solve(EXAMPLES[example](*arguments), tol=tol, on_step=steps.append)
    record = solution.record()
    newton = record["newton_steps"]
    ipopt = record["iterations"] - newton
    assert newton > 0
    assert solution.status is Status.CONVERGED
    assert solution.history[-1].iteration == record["iterations"]
    assert record["kkt_factorisations"] in (ipopt, record["iterations"])  # with areas the steps are Ipopt's
    assert record["contact_solves"] > 2
    assert sum(step.t == 0.0 for step in solution.history) == newton + 1  # after Ipopt's iterates
    before, after = steps[ipopt], steps[-1]  # the last iterate of Ipopt, and the end
    assert before.dual_residual > 1e-6 >= after.dual_residual
    assert after.energy <= before.energy + 1e-9 * abs(before.energy)


def test_a_stationary_end_of_ipopt_is_left_as_it_is() -> None:
    record = joint.solve(EXAMPLES["6.1"](4)).record()
    assert "newton_steps" not in record
    assert record["contact_solves"] == 2  # at its start and at its end


def test_newton_steps_that_lead_up_are_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    outer = Outer.of(EXAMPLES["6.1"](4))
    zero, asked = np.zeros(outer.n), []
    monkeypatch.setattr(Nested, "run", lambda *_: asked.append(1) or Outcome(outer, zero, Status.CONVERGED))
    found = Joint(tol=1e-3).run(outer, zero, Monitor())
    assert asked
    assert outer.energy(found.q).value < outer.energy(zero).value


@pytest.mark.parametrize(
    ("formulation", "n", "delta", "seed"),
    [
        (Joint(), 3, 0.15, 3),
        (AllAtOnce(), 4, 0.05, 1),
        (Nested(ipopt={"mu_init": 10.0, "bound_push": 0.1, "max_iter": 3}), 3, 0.3, 3),
    ],
)
def test_from_a_minimiser_the_barrier_leads_to_none_above_it(
    formulation: Joint | AllAtOnce, n: int, delta: float, seed: int
) -> None:
    outer = Outer.of(EXAMPLES["6.1"](n, delta))
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
def usual() -> float:
    return joint.solve(block(1.0)).gain


@pytest.mark.parametrize("length", [1e-9, 1e6])
def test_joint_ends_as_well_in_any_unit_of_length(usual: float, length: float) -> None:
    solution = joint.solve(block(length))
    assert solution.success, solution.status
    assert solution.stationarity_residual <= 1e-6
    assert is_valid(solution.problem, solution.mesh.p)
    assert solution.gain / length**2 >= 0.9 * usual  # it may be another local minimum
    residuals = [step.dual_residual for step in solution.history if np.isfinite(step.dual_residual)]
    assert residuals[-1] <= 1e-6 < residuals[0]


def test_derivatives_in_other_units_are_those_of_the_scaled_program() -> None:
    nlp, rng = relocation(block(1.0)).nlp, np.random.default_rng(0)
    units = Units(rng.uniform(0.5, 2, nlp.n_x), rng.uniform(0.5, 2, nlp.n_g))
    x, lam = 0.1 * rng.uniform(-1, 1, nlp.n_x), rng.uniform(-1, 1, nlp.n_g)
    here, there = (
        (*derivatives.grad_f(at, []), *derivatives.jac_g(at, []), derivatives.hess_lag(at, [], 0.7, by))
        for derivatives, at, by in (
            (nlp.derivatives, x, lam / units.g),
            (units.program(nlp).derivatives, x / units.x, lam),
        )
    )
    value, gradient, rows, jacobian, hessian = (np.squeeze(part.full()) for part in here)
    scaled = value, units.x * gradient, rows / units.g, jacobian * units.x / units.g[:, None]
    for one, two in zip(there, (*scaled, hessian * np.outer(units.x, units.x)), strict=True):
        np.testing.assert_allclose(np.squeeze(one.full()), two, rtol=1e-9, atol=1e-9)


def test_a_program_without_assembled_derivatives_is_refused() -> None:
    nlp = replace(relocation(block(1.0)).nlp, derivatives=None)
    with pytest.raises(ValueError, match="without assembled derivatives"):
        Units(np.ones(nlp.n_x), np.ones(nlp.n_g)).program(nlp)


def test_alternating_steps_are_red_and_black_on_a_structured_grid() -> None:
    problem = EXAMPLES["6.1"](6)
    relocation = Outer.of(problem).relocation
    steps = relocation.nodes(alternating(relocation)) - problem.mesh.p
    i, j = np.rint(6 * problem.mesh.p).astype(int)
    free = np.all(steps != 0, axis=0)
    sign = np.sign(steps[0, free]) * (-1.0) ** (i + j)[free]
    assert free.sum() == 25
    assert np.all(sign == sign[0])


@pytest.mark.parametrize("seed", [None, 3])
def test_they_go_downhill_from_any_start(seed: int | None) -> None:
    outer = Outer.of(EXAMPLES["6.1"](8))
    q = outer.variables(seed=seed)
    gradient = outer.energy(q).gradient
    moved = alternated(outer.relocation, q, gradient, 0.1, outer.is_valid)
    np.testing.assert_allclose(np.abs(moved - q)[np.abs(moved) < 1], 0.1)
    assert gradient @ (moved - q) < 0


def test_they_are_halved_until_the_mesh_is_valid() -> None:
    outer = Outer.of(EXAMPLES["6.3"]((12, 6)))
    q = np.zeros(outer.n)
    assert not outer.is_valid(alternating(outer.relocation))
    moved = alternated(outer.relocation, q, outer.energy(q).gradient, 1.0, outer.is_valid)
    assert outer.is_valid(moved)
    assert np.max(np.abs(moved)) in (0.5, 0.25, 0.125)


@pytest.mark.parametrize(
    ("fine", "name", "size", "added"),
    [(100, "6.1", 8, True), (1000, "6.1", 8, False), (10, "6.3", (12, 6), False)],
)
@pytest.mark.parametrize("formulation", [Joint(), AllAtOnce()], ids=lambda one: one.name)
def test_solves_start_with_them_on_fine_meshes_without_areas(
    formulation, fine, name, size, added, monkeypatch
) -> None:
    monkeypatch.setattr(f"formulations.{formulation.name}.FINE", fine)
    outer, first = Outer.of(EXAMPLES[name](size)), []
    monitor = Monitor(Limits(iterations=1), on_step=lambda step: first.append(step.q))
    with suppress(StoppedError):
        formulation.run(outer, np.zeros(outer.n), monitor)
    assert (np.max(np.abs(alternating(outer.relocation) * first[0])) > 0.2) == added
