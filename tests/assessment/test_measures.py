"""Residuals, causes of a gain that is none, quantities, and the residual of Coulomb's law, by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.assessment.admissible import admissible
from rmesh_nlp.assessment.contact_results import CLEAR, ContactResult, contact_results, worse
from rmesh_nlp.assessment.coulomb import coulomb_residual, growth
from rmesh_nlp.assessment.measures import EXPLOITS, corrections, residuals
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import ActiveSet, Equilibrium
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, Dirichlet, Laplace, Motion, Obstacle, PlaneStrain, Traction
from support import sliding
from support.curved import HOLE, plate
from support.orders import ORDERS
from support.penetration import penetration
from support.problems import coulomb_slab
from support.solved import solved

LAW = PlaneStrain.from_young(1000.0, 0.3)


def sliding_block() -> ContactProblem:
    """It spreads to both sides: slip changes its sign within an edge."""
    held = (Dirichlet("top", (0.01, -0.1)),)
    obstacle = Obstacle.graph("bottom", 0.0, friction=0.5)
    return ContactProblem(rectangle(3, 1, x=(-1.5, 1.5)), LAW, held, obstacle)


def waves() -> ContactProblem:
    foundation = Obstacle.graph("bottom", lambda x, y: -0.02 + 0.004 * np.sin(24 * np.pi * x))
    loads = (Traction("top", (6.0, -10.0)),)
    return ContactProblem(rectangle(12, 3, x=(0, 2)), LAW, ("left",), foundation, tractions=loads)


SIDES = ("left", "right", "top", "bottom")
CAUSES: dict[str, Callable[[], ContactProblem]] = {
    "quadrature": lambda: EXAMPLES["6.1"](4),
    "penetration": waves,
    "friction": sliding_block,
    "geometry": lambda: plate({"hole": HOLE}),
}


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", EXPLOITS)
def test_each_cause_is_named_on_a_problem_made_for_it(name: str, order: int) -> None:
    problem = replace(CAUSES[name](), order=order)
    model = ContactSolver(problem)
    own = model.given
    exact = admissible(problem)
    found = corrections(model, problem.mesh.p, own, exact)
    assert set(found) == set(EXPLOITS)
    assert sum(found.values()) == pytest.approx(exact.energy - own.energy, rel=1e-9)
    others = max(abs(value) for cause, value in found.items() if cause != name)
    assert abs(found[name]) > 1e-7 * abs(own.energy)
    assert others < 1e-2 * abs(found[name])
    deepest = penetration(model.discretisation.space, problem.mesh.p, model.displacement.values(own.u))
    assert (deepest > 1e-3) is (name == "penetration")
    assert residuals(model.system(problem.mesh.p), own).hold
    if (name, order) == ("friction", 1):  # lumped at nodes it is too large by what lies beside the turn
        slip = exact.displacement[0, exact.body.nodes[1] == 0]
        weights = np.where(np.abs(exact.body.nodes[0, exact.body.nodes[1] == 0]) == 1.5, 0.5, 1.0)
        assert found[name] == pytest.approx(exact.friction - 0.5 * weights @ np.abs(slip))
        assert found[name] < 0


def test_on_a_mesh_that_had_to_be_cut_all_counts_as_penetration() -> None:
    mesh = rectangle(2, 2, diagonal="falling")
    bump = Obstacle.interior(lambda x, y: -0.02 + 0.1 * np.exp(-((x - 0.15) ** 2 + (y - 0.15) ** 2) / 0.002))
    problem = ContactProblem(mesh, Laplace(0.0), SIDES, bump)
    model = ContactSolver(problem)
    own = model.given
    exact = admissible(problem)
    assert exact.problem is not problem
    wanted = {**dict.fromkeys(EXPLOITS, 0.0), "penetration": exact.energy - own.energy}
    assert corrections(model, problem.mesh.p, own, exact) == wanted
    there = problem.mesh.p + np.array([[0.01], [0.0]])
    moved = replace(problem, mesh=replace(problem.mesh, doflocs=there))
    assert admissible(problem, there).energy == pytest.approx(admissible(moved).energy, rel=1e-12)


def standing(pressure: float, order: int = 1) -> ContactProblem:
    """A block of width 2 under a uniform pressure on a line."""
    return ContactProblem(
        rectangle(4, 2, x=(0, 2)),
        LAW,
        (Dirichlet("left", (0.0, None)), Dirichlet("right", (0.0, None))),
        Obstacle.graph("bottom", 0.0),
        Motion(None),
        (Traction("top", (0.0, -pressure)),),
        order=order,
    )


def test_quantities_count_nodes_that_press() -> None:
    problem = standing(3.0)
    found = admissible(problem)
    force, sideways = np.array([1.0, 0.0, 6.0, 1e-12, 2.0]), np.array([0.0, 0.0, 3.0, 0.0, 9.0])
    order = np.argsort(problem.mesh.p[0, problem.contact_nodes])  # weights 1/4, 1/2, 1/2, 1/2, 1/4
    normal, tangential = np.zeros((2, 5))
    normal[order], tangential[order] = force, sideways
    active = ActiveSet(normal > 0, np.zeros(5, dtype=np.int8))
    state = Equilibrium(found.state.u, 0.0, normal, tangential, active, Status.CONVERGED, 1)
    (values,) = contact_results(found.parts.space, problem.mesh.p, found.system, state).values()
    assert vars(values) == pytest.approx(vars(ContactResult(9.0, 12.0, 12.0, 1.0)))
    free = ContactProblem(problem.mesh, LAW, ("left",))
    alone = admissible(free)
    assert not contact_results(alone.parts.space, free.mesh.p, alone.system, alone.state)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(("example", "n"), [("6.3", (6, 4)), ("6.2", (6, 4))])
def test_the_resultant_is_what_presses_the_body_without_friction(example, n, order) -> None:
    found = admissible(replace(EXAMPLES[example](n), order=order))
    (values,) = contact_results(found.parts.space, found.body.nodes, found.system, found.state).values()
    held = found.system.stiffness @ found.state.u - found.system.load  # the foundation is the rest
    pressed, rubbed = (float(np.sum(rows @ held)) for rows in (found.system.normals, found.system.tangents))
    assert (values.normal_force, values.tangential_force) == pytest.approx((pressed, rubbed), abs=1e-6)
    assert (abs(rubbed) > 0.1 * pressed) is (example == "6.3")


def test_a_result_that_is_farther_from_its_limit_is_said() -> None:
    def on(peak: float, force: float = 6.0, length: float = 2.0) -> dict[str, ContactResult]:
        return {"bottom": ContactResult(force, 0.0, peak, length)}

    before, fine = on(3.0), on(3.1)
    for after, count in ((3.23, 0), (3.232, 1), (2.97, 0), (2.968, 1), (3.1, 0)):  # 0.1 + 1 % of 3.1
        assert len(worse(before, on(after), fine)) == count
    said = worse(before, on(3.3, 6.05, 2.5), fine)
    assert [text.split(" got")[0] for text in said] == ["the largest pressure", "the length of contact"]
    assert "3 on the given mesh, 3.3 after relocation, 3.1 on the refined" in said[0]
    assert len(worse(before, on(3.0, 6.2), fine)) == 1
    # beside another boundary a force at rounding level is none
    rounding, other = ({"top": ContactResult(size, 0.0, size, 0.0)} for size in (1e-14, 9e-12))
    assert not worse(before | rounding, fine | other, fine | rounding)


def coefficient(x: Any, _: Any) -> Any:
    """g over the exact pressure: with it the solution of support.sliding obeys Coulomb's law."""
    past = 3 * sliding.SLIDE * ca.fmax(x - sliding.TURN, 0) ** 2
    return -sliding.BOUND / (sliding.LAMBDA * (past + sliding.PRESS) + 2 * sliding.MU * sliding.PRESS)


def block(n: int, order: int) -> ContactProblem:
    """A block whose lower edge sticks on one half and slides on the other, under a pressure that varies."""
    problem = sliding.sliding_block(n)
    return replace(problem, obstacle=rm.Obstacle("bottom", coulomb=coefficient), order=order, exact=None)


def slab(coulomb: float, order: int = 1) -> ContactProblem:
    return coulomb_slab(coulomb, (8, 4), order=order)


def residual(problem: ContactProblem, push: float = 1.0, motion: float = 1.0) -> float:
    """That of the contact solution with its friction and its displacement multiplied."""
    model = ContactSolver(problem)
    state, field = model.given, model.displacement
    found = coulomb_residual(
        model.discretisation.space,
        np.asarray(problem.mesh.p),
        motion * field.values(state.u),
        state.normal_force,
        push * state.tangential_force,
    )
    assert found is not None
    return found


@pytest.mark.parametrize(("order", "size", "least"), [(1, 6, 3.0), (2, 4, 5.0)])
def test_falls_with_the_edges_on_a_solution_that_sticks_and_slides(
    order: int, size: int, least: float
) -> None:
    """The exact solution has a continuous stress and a slip of the third power of the distance."""
    coarse, fine = (residual(block(n, order)) for n in (size, 2 * size))
    assert 0 < fine < coarse / least
    assert coarse < 0.01


def test_vanishes_where_all_edges_slide_and_the_coefficient_is_constant() -> None:
    problem = slab(0.5)
    model = ContactSolver(problem)
    state = model.given
    assert np.all(state.active.sliding[state.active.touching] != 0)
    assert residual(problem) < 1e-12


@pytest.mark.parametrize("order", [1, 2])
def test_counts_stress_above_the_bound(order: int) -> None:
    """All slides: a tenth more friction is above the bound by a tenth of F p.

    At order 2 the parabolas of both stresses are below zero on the last edge, where |r| is that stress.
    """
    F = 0.5
    found = residual(slab(F, order), push=1.1)
    assert found == pytest.approx(0.1 * F / np.hypot(1, 1.1 * F), rel=0.05 if order == 2 else 1e-10)


def test_counts_slip_with_the_friction() -> None:
    """The friction pushes along the slip, which must not be: r is c times the slip."""
    problem = slab(0.5)
    model = ContactSolver(problem)
    state, nodes = model.given, np.asarray(problem.mesh.p)
    weights, slip = model.discretisation.space.weights(nodes), np.abs(model.slips(nodes, state.u))
    pressing = state.normal_force > 0
    # r at nodes, a straight line on edges between them, all of which press or are open
    r = np.where(pressing, slip, 0.0) / np.max(np.abs(state.u)) / np.sum(weights[pressing])
    found = residual(problem, motion=-1.0)
    assert 0 < found <= 1.2 * np.sum(weights * r)
    assert found >= 0.5 * np.sum(weights * r)


def test_does_not_depend_on_units() -> None:
    problem = slab(1.0)
    law = problem.law
    stiff = replace(
        problem,
        law=rm.PlaneStrain(1e6 * law.lame_lambda, 1e6 * law.lame_mu),
        tractions=tuple(replace(t, value=tuple(1e6 * v for v in t.value)) for t in problem.tractions),
    )
    assert residual(problem) > 1e-5
    assert residual(stiff) == pytest.approx(residual(problem), rel=1e-6)


def test_does_not_depend_on_contact_nodes_that_do_not_press() -> None:
    """A second foundation that nothing meets carries no force, so it adds nothing to the contact's length."""
    problem = slab(1.0)
    far = rm.Obstacle("top", (0.0, -1.0), 10.0, coulomb=1.0)
    assert residual(problem) > 1e-5
    both = replace(problem, obstacle=(problem.obstacle, far))
    assert residual(both) == pytest.approx(residual(problem), rel=1e-9)


def test_does_not_depend_on_the_frame() -> None:
    """On a slope both the normal and the tangent have two components."""

    def turned(angle: float) -> float:
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        mesh = rm.shapes.rectangle(6, 3, x=(0, 2))
        press, normal = (tuple(turn @ vector) for vector in ((0.002, -0.01), (0.0, 1.0)))
        return residual(
            rm.ContactProblem(
                replace(mesh, doflocs=turn @ mesh.p),
                rm.PlaneStrain.from_young(100.0, 0.3),
                (rm.Dirichlet("top", press),),
                rm.Obstacle("bottom", normal, coulomb=0.5),
            )
        )

    assert turned(0.0) > 1e-3
    assert turned(0.7) == pytest.approx(turned(0.0), rel=1e-6)


def test_only_with_coulomb_friction() -> None:
    assert "coulomb_residual" not in solved("fixed", "6.3", (4, 2)).record()


def test_growth_is_said_above_a_hundredth_only() -> None:
    assert growth(None, None) is None
    assert growth(CLEAR, 1.9 * CLEAR) is None
    assert growth(0.1 * CLEAR, 0.9 * CLEAR) is None
    assert "holds less well" in (growth(0.1 * CLEAR, 1.1 * CLEAR) or "")
    page = (Path(__file__).parents[2] / "docs/theory.md").read_text(encoding="utf-8")
    assert f"A record warns where relocation has more than doubled it, above {CLEAR:g}." in page


def test_record_and_summary_have_both_and_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = slab(1.0)
    found = rm.solve(problem, "fixed")
    row = found.record()
    assert row["coulomb_residual"] == row["coulomb_residual_initial"] == pytest.approx(residual(problem))
    assert "Coulomb's law along edges" in dict(found.summary())
    assert not row["warnings"]
    values = iter([0.02, 0.001])  # the final mesh is measured first
    monkeypatch.setattr("rmesh_nlp.solving.state.coulomb_residual", lambda *_: next(values))
    moved = rm.solve(problem, "nested", objective="mean(top, -uy)", iterations=1)
    assert "holds less well" in " ".join(moved.record()["warnings"])
