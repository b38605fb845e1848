"""Estimated errors of contact forces and other quantities against finer meshes."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.certificate import NotCertifiableError
from rmesh_nlp.certificate.estimates import (
    Estimate,
    OnMesh,
    by_equilibrium,
    check,
    ended,
    estimates,
    unknown,
)
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.problem.contact_problem import refined
from rmesh_nlp.solving.summary import summary

pytestmark = pytest.mark.usefixtures("estimates_unasked")

FORCE = 88.198
"""Normal force of the body below by a mesh of order 2 with 2,334 vertices, refined where the error is."""

BODY = rm.ContactProblem(
    mesh=rm.shapes.rectangle(16, 4, x=(0, 4)),
    law=rm.PlaneStrain.from_young(young=21600, poisson=0.3),
    dirichlet=("left",),
    obstacle=rm.Obstacle.graph("bottom", lambda x, y: -0.02 - 0.03 * x, friction=10.0),
    tractions=(rm.Traction("top", (0.0, lambda x, y: -20 * x)),),
)


def estimated(problem: rm.ContactProblem, *texts: str) -> list[Estimate]:
    return estimates(OnMesh.of(ContactSolver(problem)), texts)


@pytest.mark.parametrize(("order", "part"), [(1, 1e-3), (2, 5e-4)])
def test_corrected_force_is_far_nearer_than_the_computed_one(order: int, part: float) -> None:
    (force,) = estimated(replace(BODY, order=order), "resultant(bottom)")
    assert abs(force.value - FORCE) < part * FORCE
    assert 0.6 < force.error / abs(force.computed - FORCE) < 1.7


def test_where_contact_ends_within_an_edge_the_place_is_part_of_the_error() -> None:
    """On six edges the value between both choices of that end is within its doubt, a part of the error."""
    coarse = replace(BODY, mesh=rm.shapes.rectangle(6, 2, x=(0, 4)), order=2)
    (force,) = estimated(coarse, "resultant(bottom)")
    assert abs(force.value - FORCE) < 0.5 * force.doubt < 0.3 * force.error
    assert force.error > 1.03 * abs(force.value - force.computed)
    assert abs(force.value - FORCE) < force.error


def test_weight_that_jumps_is_cut_where_it_jumps() -> None:
    """As in bounds; both parts are the whole."""
    left, right = (f"pressure(bottom, where(x {side} 0.62, 1, 0))" for side in "<>")
    low, high, every = estimated(BODY, left, right, "resultant(bottom)")
    bounds = rm.certify(rm.solve(BODY, "fixed"), quantities=(left,)).bounds
    assert low.computed == pytest.approx(bounds[left].value, rel=1e-9)
    assert low.value + high.value == pytest.approx(every.value, rel=1e-6)


@pytest.mark.slow
def test_change_of_contact_is_part_of_the_error() -> None:
    """On the next mesh other nodes touch, and the correction alone is a third of the error."""
    wave = rm.Obstacle.graph("bottom", lambda x, y: -0.005 + 0.003 * ca.sin(3.93 * x + 0.75))
    pushed = (rm.Traction("top", (-2.8, lambda x, y: -7.4 * (1 + 0.7 * ca.sin(8.3 * x)))),)
    law = rm.PlaneStrain.from_young(1000, 0.22, (lambda x, y: -3 * ca.sin(5 * x) * ca.cos(4 * y), 0.0))
    mesh = rm.shapes.rectangle(5, 5, x=(0, 2))
    coarse = rm.ContactProblem(mesh, law, ("left",), wave, tractions=pushed, order=2)
    (force,), (true,) = (estimated(p, "resultant(bottom)") for p in (coarse, refined(refined(coarse))))
    error = abs(force.computed - true.value)
    assert abs(force.value - force.computed) < error / 2
    assert error < force.error < 2 * error


@pytest.mark.slow
def test_quantities_of_the_displacement_and_windows_are_corrected() -> None:
    names = "mean(top, -uy)", "pressure(bottom, x)", "energy"
    coarse, fine = estimated(BODY, *names), estimated(replace(refined(BODY), order=2), *names)
    for one, true in zip(coarse, fine, strict=True):
        assert abs(one.value - true.value) < abs(one.computed - true.value) / 3
    whole, half = estimated(BODY, "resultant(bottom)", "pressure(bottom, 0.5 + 0*x)")
    assert half.value == pytest.approx(whole.value / 2)


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("bound", [0.0, 5.0])
def test_with_coulomb_friction_the_dual_adds_slips_to_gaps(order: int, bound: float) -> None:
    rough = rm.Obstacle.graph("bottom", lambda x, y: -0.02 - 0.03 * x, bound, coulomb=0.4)
    problem, texts = replace(BODY, obstacle=rough, order=order), ("resultant(bottom)", "mean(top, -uy)")
    found = by_equilibrium(OnMesh.of(ContactSolver(problem)), texts)
    fine = estimated(replace(refined(refined(problem)), order=2), *texts)
    for one, true, times in zip(found, fine, (4, 2.5), strict=True):
        assert abs(one.value - true.value) < abs(one.computed - true.value) / times


@pytest.mark.slow
def test_gaps_between_nodes_count_in_what_is_linear_in_the_displacement() -> None:
    """Contact alone holds the block: its mean height is that of the foundation, to which order 1 adds."""
    bowl = rm.Obstacle.graph("bottom", lambda x, y: 0.002 * (x - 2) ** 2)
    floats = replace(BODY, dirichlet=(rm.Dirichlet("left", (0.0, None)),), obstacle=bowl)
    (coarse,), (fine,) = (estimated(p, "mean(top, -uy)") for p in (floats, replace(refined(floats), order=2)))
    assert abs(coarse.value - fine.value) < abs(coarse.computed - fine.value) / 3


def test_displacement_of_a_tool_under_a_force_is_asked_for_and_corrected() -> None:
    press = rm.Obstacle("top", (0.0, -1.0), force=(0.0, -800.0))
    problem = replace(BODY, dirichlet="bottom", obstacle=press, tractions=())
    assert unknown(problem) == ("tool_y(top)",)
    (coarse,), (fine,) = (estimated(p, "tool_y(top)") for p in (problem, replace(refined(problem), order=2)))
    error = abs(coarse.computed - fine.value)
    assert abs(coarse.value - fine.value) < error / 4
    assert 0.7 < coarse.error / error < 1.5


def test_no_error_is_told_of_the_displacement_of_a_round_tool_at_order_1() -> None:
    """Both meshes may touch at the same few nodes."""
    roller = replace(rm.Obstacle.circle("top", (2.0, 4.02), 3.0), force=(0.0, -500.0), move="y")
    problem = replace(BODY, mesh=rm.shapes.rectangle(8, 2, x=(0, 4)), dirichlet="bottom", obstacle=roller)
    assert estimated(problem, "resultant(top)")[0].error > 0
    with pytest.raises(NotCertifiableError, match="of round tools at order 2"):
        estimated(problem, "tool_y(top)")
    assert estimated(replace(problem, order=2), "tool_y(top)")[0].error > 0


@pytest.mark.parametrize("friction", [0.0, 80.0])
def test_change_of_contact_counts_in_the_displacement_of_a_tool(friction: float) -> None:
    """Its worth and that of the residual have opposite signs here, and nearly the same size."""
    press = rm.Obstacle("top", (0.0, -1.0), lambda x, y: 0.02 * (x - 0.9) ** 2, friction)
    tool = replace(press, force=(0.0, -500.0), move="y")
    law, mesh = rm.PlaneStrain.from_young(young=1e4, poisson=0.3), rm.shapes.rectangle(6, 3, x=(0, 2))
    problem = rm.ContactProblem(mesh, law, "bottom", tool)
    fine = replace(refined(refined(problem)), order=2)
    (coarse,), (fine,) = (estimated(p, "tool_y(top)") for p in (problem, fine))
    assert 0.5 < coarse.error / abs(coarse.computed - fine.value) < 4


@pytest.mark.slow
def test_body_on_a_curved_foundation_is_estimated_by_richer_displacements() -> None:
    problem = replace(BODY, obstacle=rm.Obstacle.circle("bottom", (3.0, -30.05), 30.0))
    (coarse,), (fine,) = (estimated(p, "resultant(bottom)") for p in (problem, refined(problem)))
    assert abs(coarse.value - fine.value) < abs(coarse.computed - fine.value) / 2
    (quadratic,) = estimated(replace(problem, order=2), "resultant(bottom)")
    assert quadratic.error > 1.3 * abs(quadratic.value - quadratic.computed)  # the finer mesh errs as well


@pytest.mark.slow
def test_estimate_by_richer_displacements_counts_what_cancels() -> None:
    problem = rm.ContactProblem(
        mesh=rm.shapes.rectangle(4, 4, x=(1.181, 2.901), y=(0.0, 0.713)),
        law=rm.Axisymmetric.from_young(40.86, 0.1886, (0.0, -0.2223)),
        dirichlet=rm.Dirichlet("top", (0.0, -0.02065)),
        obstacle=rm.Obstacle.circle("bottom", (2.3705, -6.0965), 6.0965, friction=0.1089),
        order=2,
    )
    (coarse,) = estimated(problem, "resultant(bottom)")
    finer = rm.solve(refined(refined(problem)), "fixed", audit=False).contact["bottom"]["normal_force"]
    assert abs(coarse.value - coarse.computed) < 2e-4 * finer  # by chance
    assert abs(coarse.computed - finer) > 4e-3 * finer
    assert coarse.error > abs(coarse.computed - finer)


@pytest.mark.slow
@pytest.mark.parametrize("formulation", ["fixed", "joint"])
def test_solution_has_estimates_of_what_it_prints(formulation: str) -> None:
    solution = rm.solve(BODY, formulation, limits={"iterations": 20})
    force = solution.details["estimates"]["resultant(bottom)"]
    assert force["computed"] == solution.contact["bottom"]["normal_force"]
    assert abs(force["value"] - FORCE) < abs(force["computed"] - FORCE)
    assert 0.5 < force["error"] / abs(force["computed"] - FORCE) < 2
    said = dict(summary(solution))
    assert "estimated" in said["bottom: normal force"]
    assert "estimated" in said["energy"]


@pytest.mark.slow
def test_estimates_that_take_a_finer_mesh_are_left_out() -> None:
    curved = replace(BODY, obstacle=rm.Obstacle.circle("bottom", (3.0, -30.05), 30.0))
    assert "resultant(bottom)" in rm.solve(curved, "fixed").details["estimates"]
    solution = rm.solve(replace(curved, order=2), "fixed")
    assert solution.success
    assert not solution.details
    assert not rm.solve(BODY, "fixed", audit=False).details


def test_refuted_estimate_is_replaced_by_the_change() -> None:
    first, second = (Estimate(value, 0.1, value, np.ones(1)) for value in (1.0, 2.0))
    assert ended([first]).error == 0.1
    assert ended([first, second]).error == 1.0


def test_two_meshes_say_which_share_of_their_corrections_is_right() -> None:
    """Both corrections are 1.25 times too large for 1.2; a large doubt of the first hides that."""
    first, second = (Estimate(c + e, e, c, np.ones(1), doubt=0.01) for c, e in ((1.0, 0.25), (1.16, 0.05)))
    assert ended([first, second]).value == pytest.approx(1.2)
    assert ended([first, second]).error == pytest.approx(np.hypot(0.04, 0.01))
    assert ended([first._replace(doubt=0.1), second]).value == second.value


def test_growing_peak_does_not_converge() -> None:
    peaks = [Estimate(2.0**k, np.nan, 2.0**k, np.ones(1)) for k in range(5)]
    settles = [Estimate(1 - 0.2**k, np.nan, 1 - 0.2**k, np.ones(1)) for k in range(5)]
    assert not ended(peaks).converges
    assert ended(settles).converges
    assert ended(settles).error > abs(settles[-1].value - 1)
    assert np.isnan(ended(peaks).record()["error"])


def test_values_on_meshes_that_are_as_coarse_in_contact_have_no_error() -> None:
    values = [Estimate(1 + 0.01 * k, np.nan, 1, np.ones(1), touching=5 + k) for k in range(3)]
    assert np.isnan(ended(values).error)
    assert ended([*values, Estimate(1.3, np.nan, 1, np.ones(1), touching=14)]).error > 0.3


@pytest.mark.parametrize("text", ["peak(top)", "tool_y(bottom)", "pressure(bottom, z)", "mean(top, ux*uy)"])
def test_unknown_quantity_is_refused_by_name(text: str) -> None:
    with pytest.raises(BadInputError, match=r"top|bottom"):
        check(text, BODY)


def test_contact_of_a_mesh_is_where_the_solve_on_a_finer_one_begins() -> None:
    on, fine = OnMesh.of(ContactSolver(replace(BODY, order=2))), refined(replace(BODY, order=2))
    warm, cold = on.solver(fine), ContactSolver(fine)
    assert warm.start is not None
    assert np.sum(warm.start.touching != cold.given.active.touching) <= 2
    assert warm.given.iterations <= 3
    assert warm.given.energy == pytest.approx(cold.given.energy, rel=1e-12)
