"""Residuals, causes of a gain that is none, claims about errors, and the residual of Coulomb's law."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from skfem import MeshTri

import rmesh_nlp as rm
from rmesh_nlp.assessment import error_reduction as module
from rmesh_nlp.assessment.admissible import Admissible, Continuous, admissible
from rmesh_nlp.assessment.contact_results import CLEAR, ContactResult, contact_results, worse
from rmesh_nlp.assessment.coulomb import coulomb_residual, growth
from rmesh_nlp.assessment.error_reduction import by_certificate, error_reduction
from rmesh_nlp.assessment.measures import EXPLOITS, corrections, residuals
from rmesh_nlp.contact.penetration import penetrations
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import ActiveSet, Equilibrium
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.fem.contact_pressure import nodal_forces
from rmesh_nlp.meshes.geometry import relocated_mesh
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Dirichlet, Laplace, Motion, Obstacle, PlaneStrain, Traction
from support import sliding
from support.curved import HOLE, plate
from support.orders import ORDERS
from support.problems import coulomb_slab

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
    "quadrature": lambda: rm.EXAMPLES["6.1"](4),
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
    parts = penetrations(model.discretisation.space, problem.mesh.p, model.displacement.values(own.u))
    assert (max((part.depth for part in parts), default=0) > 1e-3) is (name == "penetration")
    assert residuals(model.system(problem.mesh.p), own).hold
    if (name, order) == ("friction", 1):  # lumped at nodes it is too large by what lies beside the turn
        bottom = exact.body.nodes[1] == 0
        weights = np.where(np.abs(exact.body.nodes[0, bottom]) == 1.5, 0.5, 1.0)
        slips = exact.displacement[0, bottom], model.displacement.values(own.u)[0, bottom]
        lumped = [0.5 * weights @ np.abs(slip) for slip in slips]
        along = exact.friction, exact.continuous.friction(model.displacement.values(own.u))[0]
        assert along[0] < lumped[0]
        assert found[name] == pytest.approx(np.mean(along) - np.mean(lumped))


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
    state = Equilibrium(found.state.u, 0.0, normal, tangential, active, rm.Status.CONVERGED, 1)
    (values,) = contact_results(found.continuous.space, problem.mesh.p, found.system, state).values()
    assert vars(values) == pytest.approx(vars(ContactResult(9.0, 12.0, 12.0, 1.0, 12.0, 9.0, 10.0)))
    free = ContactProblem(problem.mesh, LAW, ("left",))
    alone = admissible(free)
    assert not contact_results(alone.continuous.space, free.mesh.p, alone.system, alone.state)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(("example", "n"), [("6.3", (6, 4)), ("6.2", (6, 4))])
def test_the_resultant_is_what_presses_the_body_without_friction(example, n, order) -> None:
    found = admissible(replace(rm.EXAMPLES[example](n), order=order))
    (values,) = contact_results(found.continuous.space, found.body.nodes, found.system, found.state).values()
    held = found.system.stiffness @ found.state.u - found.system.load  # the foundation is the rest
    pressed, rubbed = (float(np.sum(rows @ held)) for rows in (found.system.normals, found.system.tangents))
    (part,), forces = (
        found.continuous.space.contact_sets,
        (found.state.normal_force, found.state.tangential_force),
    )
    at_nodes = nodal_forces(found.continuous.space, found.body.nodes, part, *forces)
    shared = np.delete(at_nodes, part.nodes, axis=1).sum(axis=1)
    pressed, rubbed = pressed + shared[0], rubbed + shared[1]
    assert bool(np.any(shared)) is (example == "6.3")
    assert (values.normal_force, values.tangential_force) == pytest.approx((pressed, rubbed), abs=1e-6)
    assert bool(abs(rubbed) > 0.1 * pressed) is (example == "6.3")


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


@pytest.mark.slow
def test_falls_with_the_edges_on_a_solution_that_sticks_and_slides() -> None:
    """The exact solution has a continuous stress and a slip of the third power of the distance."""
    coarse, fine = (residual(block(n, order=2)) for n in (4, 8))
    assert 0 < fine < coarse / 5
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


def test_growth_is_said_above_a_hundredth_only() -> None:
    assert growth(None, None) is None
    assert growth(CLEAR, 1.9 * CLEAR) is None
    assert growth(0.1 * CLEAR, 0.9 * CLEAR) is None
    assert "holds less well" in (growth(0.1 * CLEAR, 1.1 * CLEAR) or "")
    page = (Path(__file__).parents[2] / "docs/theory.md").read_text(encoding="utf-8")
    assert f"A record warns where relocation has more than doubled it, above {CLEAR:g}." in page


@pytest.mark.slow
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


def graded(seed: int, order: int = 1) -> list[Admissible]:
    """Of a random problem on its mesh and drawn towards its left side, the larger energy first."""
    problem = replace(random_problem(seed, kind="elastic"), quadrature="auto", order=order)
    nodes = np.array(problem.mesh.p)
    nodes[0] = 2 * (nodes[0] / 2) ** 1.15
    return sorted([admissible(problem), admissible(problem, nodes)], key=lambda end: -end.energy)


def on_square(fall: float, mesh: MeshTri | None = None) -> list[Admissible]:
    """Of a membrane, and the same with a larger energy before."""
    last = admissible(ContactProblem(mesh or rectangle(2, 2), Laplace(1.0), ("left", "right")))
    return [replace(last, energy=last.energy + fall), last]


def truth(problem: ContactProblem) -> float:
    """The least energy, extrapolated from refinements."""
    energies = []
    while len(energies) < 3:
        energies.append(admissible(problem).energy)
        problem = rm.refined(problem)
    one, two = -np.diff(energies)[-2:]
    return energies[-1] - two * (two / one) / (1 - two / one)


@pytest.mark.slow
@pytest.mark.parametrize("order", ORDERS)
def test_the_interval_holds_from_one_refinement_and_from_two(order, monkeypatch) -> None:
    before, after = graded(103, order)  # the interval was chosen on seeds 0 to 39
    least = truth(replace(before.problem, mesh=relocated_mesh(before.problem.mesh, before.body.nodes)))
    errors = before.energy - least, after.energy - least
    for few, closeness in ((400, 2), (0, 3)):
        monkeypatch.setattr(module, "FEW", few)
        found, _ = error_reduction(before, after, 7)
        assert (found.source, found.contact_solves) == ("refinement", 7)
        for bounds, error in zip((found.error_initial, found.error), errors, strict=True):
            assert bounds[0] <= error <= bounds[1] < closeness * error
        assert found.factor <= errors[0] / errors[1] <= found.factor_upper


@pytest.mark.slow
def test_nothing_is_claimed_where_linear_triangles_lock() -> None:
    def claimed(poisson: float, order: int) -> bool:
        law, sides = PlaneStrain.from_young(1000.0, poisson, (0.0, -50.0)), ("left",)
        given = ContactProblem(rectangle(2, 1), law, sides, Obstacle.graph("bottom", -0.01), order=order)
        finer = rm.refined(given)
        return error_reduction(admissible(given), admissible(finer), 2)[0] is not None

    assert [claimed(0.499, 1), claimed(0.3, 1), claimed(0.499, 2)] == [False, True, True]


def test_nothing_is_claimed_of_a_fall_within_rounding() -> None:
    before, last = on_square(1.0)
    assert error_reduction(before, last, 7)[0] is not None
    assert error_reduction(replace(last, energy=last.energy * (1 - 1e-12)), last, 7)[0] is None


def test_an_exact_energy_gives_the_factor_itself() -> None:
    problem = rm.EXAMPLES["6.1"](n=4)
    nodes = np.array(problem.mesh.p)
    nodes[0, problem.mesh.interior_nodes()] += 0.02
    before, after = sorted([admissible(problem), admissible(problem, nodes)], key=lambda end: -end.energy)
    found, refined_values = error_reduction(before, after, 1)
    assert refined_values is None  # nothing is refined
    errors = before.energy - problem.exact.energy, after.energy - problem.exact.energy
    assert found.factor == found.factor_upper == pytest.approx(errors[0] / errors[1])
    assert error_reduction(after, before, 1)[0] is None  # the energy rose
    below = replace(after, energy=problem.exact.energy - 1e-3)
    assert error_reduction(before, below, 1)[0] is None


def test_nothing_is_claimed_without_a_contact_solution_on_the_refined_mesh(monkeypatch) -> None:
    def failed(*given: object, **start: object) -> Admissible:
        found = admissible(*given, **start)
        return replace(found, state=replace(found.state, status=rm.Status.CYCLED))

    ends = on_square(0.1)
    assert error_reduction(*ends, 1)[0] is not None
    monkeypatch.setattr(module, "admissible", failed)
    assert error_reduction(*ends, 1) == (None, None)


def test_a_certificate_bounds_the_factor_from_below() -> None:
    found, _ = error_reduction(*on_square(0.1), 7)
    proved = by_certificate(found, 0.32, 0.08)
    assert (proved.factor, proved.factor_upper) == (pytest.approx(4.0), np.inf)
    assert (proved.error_initial, proved.error) == (pytest.approx((0.24, 0.32)), (0.0, 0.08))
    assert (proved.source, proved.nodes, proved.contact_solves) == ("certified", found.nodes, 7)
    assert "at least 4 times less" in proved.record()["text"]
    assert proved.record()["factor_upper"] is None
    for bounds in ((0.08, 0.32), (0.32, 0.0)):  # no gain, or none that is known
        assert by_certificate(found, *bounds) == found
    assert by_certificate(replace(found, source="exact"), 0.32, 0.08).source == "exact"


def refinement(*falls: float) -> Callable[[Admissible], Admissible]:
    """Refined meshes whose energies fall by given amounts."""
    left = list(falls)
    return lambda here: replace(here, energy=here.energy - left.pop(0))


@pytest.mark.parametrize(
    ("falls", "few", "low", "high"),
    [  # d / (1 - 1 / 8) and d / (1 - 1 / 1.7); of two refinements the first is known
        ((0.7,), 0, 0.8, 0.7 * 1.7 / 0.7),
        ((1.0, 0.35), 100, 1.0 + 0.4, 1.0 + 0.35 * 1.7 / 0.7),
        ((1.0, 0.99), 100, 1.0 + 0.99 * 8 / 7, 1.0 + 0.99 * 1.7 / 0.7),
        ((1.0, 1.0), 100, None, None),
        ((1.0, -0.1), 100, None, None),
        ((0.0,), 0, None, None),
    ],
)
def test_errors_are_bounded_by_what_refinements_gain(falls, few, low, high, monkeypatch) -> None:
    before, last = on_square(0.5)
    monkeypatch.setattr(module, "FEW", few)
    monkeypatch.setattr(module, "on_refined", refinement(*falls))
    found, _ = error_reduction(before, last, 3)
    if low is None:
        assert found is None
        return
    assert found.error == pytest.approx((low, high))
    assert found.error_initial == pytest.approx((low + 0.5, high + 0.5))
    assert (found.factor, found.factor_upper) == pytest.approx((1 + 0.5 / high, 1 + 0.5 / low))
    assert found.nodes == 9
    assert "by refining the last mesh" in found.text()
    assert f"{found.factor:.2g} to {found.factor_upper:.2g} times less on 9 nodes" in found.text()


@pytest.mark.parametrize(
    ("given", "low", "high"),
    [  # after refinements of a new mesh by 1 and 0.35, what those of the given one say
        ((1.0, 0.35), 1.4, 1.85),
        ((4.0, 0.7), 4.8 - 0.5, 5.7 - 0.5),
        ((1.2, 0.35), 1.4, 2.05 - 0.5),
        ((1.0, 1.0), None, None),
    ],
)
def test_a_small_new_mesh_may_miss_what_refinements_of_the_given_one_show(given, low, high, monkeypatch):
    before, last = on_square(0.5)
    other = replace(before.problem, mesh=rectangle(3, 3))
    before = replace(before, continuous=Continuous(other))
    monkeypatch.setattr(module, "on_refined", refinement(1.0, 0.35, *given))
    found, _ = error_reduction(before, last, 3)
    assert (found is None) == (low is None)
    if found is not None:
        assert found.error == pytest.approx((low, max(high, 1.85)))
