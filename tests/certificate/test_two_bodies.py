"""Bounds where two bodies touch, where a force moves a foundation, and where contact alone holds a body."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.certificate.bracket import bracket, edge_residual
from rmesh_nlp.certificate.conditions import conditions_of
from rmesh_nlp.certificate.equilibration import equilibrated
from rmesh_nlp.certificate.hybrid import jumps
from rmesh_nlp.certificate.skeleton import skeleton_of
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.meshes import named
from support.bodies import STEEL, pressed, stacked
from support.certificates import guess_on
from support.orders import ORDERS

pytestmark = pytest.mark.usefixtures("estimates_unasked")

BOTH = pytest.mark.parametrize("order", ORDERS)
FRICTION = {"none": {}, "tresca": {"friction": lambda x, y: 0.5 + 0.2 * x}}


def turned(problem: rm.ContactProblem, angle: float) -> rm.ContactProblem:
    """The problem with its mesh and its loads turned; supports are not, they must hold both components."""
    c, s = np.cos(angle), np.sin(angle)
    (load,) = problem.tractions
    pull = load.value[1]
    mesh = replace(problem.mesh, doflocs=np.array([[c, -s], [s, c]]) @ problem.mesh.p)
    pulls = rm.Traction(load.boundary, (lambda x, y: -s * pull(x, y), lambda x, y: c * pull(x, y)))
    return replace(problem, mesh=mesh, obstacle=rm.Obstacle.pair("bottom-1", "top-0"), tractions=pulls)


def two_blocks(order: int, kind: str = "none") -> rm.ContactProblem:
    """One block clamped below, one at its side, under a pressure that lets a part of the pair open."""
    load = rm.Traction("top-1", (0.0, lambda x, y: -10 * (1.5 - x)))
    pair = rm.Obstacle.pair("bottom-1", "top-0", interference=1e-4, **FRICTION.get(kind, {}))
    given = ("bottom-0", "right-1")
    problem = pressed(stacked(2), pair, dirichlet=given, tractions=load, order=order)
    return turned(problem, 0.7) if kind == "turned" else problem


PUNCH = rm.Obstacle("top", (0.0, -1.0), lambda x, y: 0.02 * (x - 0.9) ** 2, force=(0.0, -500.0))


def under_tool(order: int, kind: str = "none") -> rm.ContactProblem:
    """A block under a parabolic punch, clamped or, "loose", on a foundation and beside a wall."""
    given: Any = "bottom"
    tools: Any = replace(PUNCH, friction=80.0 if kind == "rubbing" else 0.0)
    if kind == "loose":
        given, tools = rm.Dirichlet("left", (0.0, None)), (PUNCH, rm.Obstacle("bottom", friction=5.0))
    law = rm.PlaneStrain.from_young(young=1e4, poisson=0.3)
    return rm.ContactProblem(rm.shapes.rectangle(6, 3, x=(0.0, 2.0)), law, given, tools, order=order)


PROBLEMS = {
    **{f"pair, {kind}": (two_blocks, kind) for kind in ("none", "tresca", "turned")},
    **{f"tool, {kind}": (under_tool, kind) for kind in ("none", "rubbing", "loose")},
}


@cache
def solved(name: str, order: int, refinements: int) -> rm.Solution:
    make, kind = PROBLEMS[name]
    problem = make(order, kind)
    for _ in range(refinements):
        problem = replace(rm.refined(problem), order=2)
    return rm.solve(problem, "fixed")


@pytest.mark.slow
@BOTH
@pytest.mark.parametrize("name", PROBLEMS)
def test_bounds_hold_what_a_finer_mesh_finds(name: str, order: int) -> None:
    found, fine = rm.certify(solved(name, order, 0)), solved(name, order, order)
    energy = fine.energy_audited
    assert found.guaranteed_lower
    assert found.guaranteed_upper
    assert found.lower < energy < found.upper
    assert found.upper - found.lower < 1.6 * (found.upper - energy)
    for text, bounds in found.bounds.items():
        kind, place = text[:-1].split("(")
        value = fine.contact[place]["normal_force"]
        if kind == "tool_y":
            value = fine.tools[place]["displacement"][1]
        assert bounds.guaranteed
        assert bounds.lower <= value * (1 + 1e-9 * np.sign(value))
        assert bounds.upper >= value * (1 - 1e-9 * np.sign(value))
        assert bounds.lower <= bounds.value * (1 + 1e-9 * np.sign(value))
    forces = {"pair": {"resultant(bottom-1)"}, "tool": {"resultant(top)", "tool_y(top)"}}
    assert set(found.bounds) >= forces[name[:4]]


@BOTH
def test_uniform_pressure_through_blocks_is_proved_exactly(order: int) -> None:
    found = rm.certify(rm.solve(pressed(stacked(3), order=order), "fixed"))
    exact = -0.5 * 5 * 2 * 3 * 5 / 1000 * 0.91
    assert found.guaranteed_lower
    assert [found.lower, found.upper] == pytest.approx([exact, exact], rel=1e-12)
    for bounds in found.bounds.values():
        assert [bounds.lower, bounds.upper] == pytest.approx([10, 10], rel=1e-5)


@pytest.mark.slow
def test_force_of_a_crack_with_a_tip_has_a_lower_bound_and_windows_have_both() -> None:
    """No displacement has one jump up to a tip, but those that vanish there."""
    mesh, window = rm.shapes.rectangle(6, 6), "pressure(joint, x - 1/3)"
    on = np.isclose(mesh.p[1], 0.5) & (mesh.p[0] > 0.3)
    mesh = named(mesh, {"joint": mesh.facets[:, np.all(on[mesh.facets], axis=0)].T})
    load, joint = rm.Traction("top", (0.0, -1.0)), rm.Obstacle.interface("joint")
    problem = rm.ContactProblem(mesh, STEEL, "bottom", joint, tractions=load)
    found, fine = (
        rm.certify(rm.solve(each, "fixed"), quantities=[window]).bounds
        for each in (problem, replace(rm.refined(problem), order=2))
    )
    bounds = found["resultant(joint)"]
    assert bounds.guaranteed
    assert 0.4 < bounds.lower < bounds.value < bounds.upper == np.inf
    assert found[window].guaranteed
    assert 0 < found[window].lower < fine[window].value < found[window].upper < 2 * fine[window].value


@pytest.mark.parametrize("name", ["pair, tresca", "tool, rubbing"])
def test_equilibrium_across_a_pair_and_of_a_tool_is_checked(name: str) -> None:
    make, kind = PROBLEMS[name]
    problem = make(1, kind)
    skeleton, guess = skeleton_of(problem, problem.mesh.p), guess_on(problem)
    conditions, field = conditions_of(problem, skeleton), equilibrated(problem, skeleton, guess)
    assert edge_residual(skeleton, conditions, field) < 1e-11
    computed = ContactSolver(problem).given.energy
    assert bracket(problem, problem.mesh.p, guess).upper == pytest.approx(computed, rel=0.02)
    assembled, (part,) = field.balance.assembled, conditions.parts
    other = replace(conditions, parts=(part._replace(reversed=~part.reversed),))
    spoilt = replace(assembled, normals=jumps(skeleton, other)[-1])
    if problem.tools:
        spoilt = replace(assembled, applied=assembled.applied * (1 + 1e-3))
    assert (
        edge_residual(skeleton, conditions, replace(field, balance=replace(field.balance, assembled=spoilt)))
        > 1e-4
    )


@pytest.mark.slow
def test_estimates_improve_force_and_energy_of_a_pair() -> None:
    solution, fine = solved("pair, tresca", 1, 0), solved("pair, tresca", 1, 1)
    energy, force = (solution.record()["estimates"][text] for text in ("energy", "resultant(bottom-1)"))
    for found, true in ((energy, fine.energy), (force, fine.contact["bottom-1"]["normal_force"])):
        assert abs(found["value"] - true) < 0.3 * abs(found["computed"] - true)


def test_refinement_proves_the_force_of_a_pair() -> None:
    solution = rm.solve(two_blocks(2), accuracy=0.04, guaranteed=True)
    assert solution.success
    assert len(solution.record()["meshes"]) > 1
    force = solution.record()["estimates"]["resultant(bottom-1)"]
    assert force["guaranteed"]
    assert force["upper"] - force["lower"] < 0.08 * force["value"]
    assert force["lower"] < solved("pair, none", 1, 1).contact["bottom-1"]["normal_force"] < force["upper"]


@pytest.mark.slow
def test_force_of_a_crack_with_a_tip_is_estimated_by_richer_displacements() -> None:
    """No displacement opens it at its tip: the integral of an equilibrated pressure corrects nothing."""
    crack = {"crack": lambda x: np.isclose(x[1], 0.5) & (x[0] < 1.5)}
    mesh = rm.shapes.rectangle(12, 6, x=(0.0, 3.0), y=(0.0, 1.0))
    lines = mesh.facets[:, crack["crack"](mesh.p[:, mesh.facets].mean(axis=1))]
    mesh = named(mesh, boundaries={"crack": lines.T})
    down = rm.Traction("top", (0.0, lambda x, y: 0.3 * x - 1))
    problem = rm.ContactProblem(
        mesh, STEEL, ("right", "bottom"), rm.Obstacle.interface("crack"), rm.Motion(0.1), (down,)
    )
    estimate = rm.solve(problem, "fixed").details["estimates"]["resultant(crack)"]
    fine = problem
    for _ in range(2):
        fine = rm.refined(fine)
    truth = rm.solve(replace(fine, order=2), "fixed", audit=False).contact["crack"]["normal_force"]
    assert abs(estimate["value"] - truth) < 1.5 * estimate["error"]
    assert abs(estimate["value"] - truth) < abs(estimate["computed"] - truth)


@pytest.mark.slow
def test_force_on_a_circle_between_two_bodies_is_as_accurate_as_asked() -> None:
    path = Path(__file__).parents[2] / "docs" / "parts" / "rings.toml"
    solution = rm.solve(rm.read_problem(path), "adaptive", accuracy=0.01)
    assert solution.success
    estimate = solution.details["estimates"]["resultant(fit)"]
    assert estimate["value"] == pytest.approx(184.08, rel=1e-3)  # Lame, docs/two_bodies.md


@pytest.mark.slow
def test_best_known_values_obey_guaranteed_bounds() -> None:
    solution = rm.solve(pressed(stacked(2)), "fixed", certify=True)
    certificate, found = solution.certificate, solution.details["estimates"]
    assert certificate.lower <= found["energy"]["value"] <= certificate.upper
    for text, bounds in certificate.bounds.items():
        assert bounds.lower <= found[text]["value"] <= bounds.upper
