"""Joint: Newton steps from near a stationary point, any unit of length."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from formulations.joint import Joint
from formulations.mpcc import AllAtOnce
from formulations.nested import Nested
from formulations.outer_solvers import OuterResult
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.mapping.validity import is_valid
from rmesh_nlp.meshes import shapes
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.models.residual import size_of
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import (
    ContactProblem,
    Dirichlet,
    Laplace,
    Motion,
    Obstacle,
    PlaneStrain,
    Relative,
    Traction,
)
from rmesh_nlp.solving.monitor import Monitor
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
    back = OuterResult(zero, Status.CONVERGED, 0)
    monkeypatch.setattr("formulations.finish.solved", lambda *_: asked.append(1) or back)
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


def test_the_program_in_another_unit_of_length_is_the_same() -> None:
    problem, rng, length = block(1.0), np.random.default_rng(0), 0.3
    usual, scaled = relocation(problem), relocation(problem, length=length)
    parts = usual.split(0.1 * rng.uniform(-1, 1, usual.n_x))
    unit = np.repeat([1.0, length], [usual.n_q, usual.n_u + usual.n_s])
    rows = np.repeat([length, 1.0], [usual.n_contact + 2 * usual.n_s, usual.n_valid])
    lam = rng.uniform(-1, 1, rows.size)
    assert usual.nlp.derivatives is not None
    assert scaled.nlp.derivatives is not None
    expected, measured = (
        [*derivatives.grad_f(x, []), *derivatives.jac_g(x, []), derivatives.hess_lag(x, [], 0.7, by)]
        for derivatives, x, by in (
            (usual.nlp.derivatives, usual.unknowns(*parts), lam / rows),
            (scaled.nlp.derivatives, scaled.unknowns(*parts), lam),
        )
    )
    value, gradient, g, jacobian, hessian = (np.squeeze(part.full()) for part in expected)
    transformed = (
        value,
        unit * gradient,
        g / rows,
        jacobian * unit / rows[:, None],
        hessian * np.outer(unit, unit),
    )
    for own, other in zip(measured, transformed, strict=True):
        np.testing.assert_allclose(np.squeeze(own.full()), other, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(scaled.forces(lam)[0], usual.forces(lam / rows)[0])


def test_energies_that_cancel_are_measured_by_their_size() -> None:
    """-u'' = -6 with u = 1 at one end and free at the other: 6 are stored, and done by the load."""
    outer = Outer.of(
        ContactProblem(shapes.rectangle(8, 1), Laplace(-6.0), Dirichlet("left", 1.0), motion=Motion(0))
    )
    point = outer.energy(np.zeros(outer.n))
    assert abs(point.value) < 0.1 < 2 < size_of(point)
