"""Pressures recovered from nodal forces: exact for linear ones, shared nodes, forces in equilibrium."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.assessment.admissible import Continuous
from rmesh_nlp.assessment.contact_results import ContactResult, contact_results, unlimited_peaks
from rmesh_nlp.contact.active_set import solve
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.fem.contact_pressure import contact_stresses, force_at_end, nodal_forces, recovered
from rmesh_nlp.io.problem_file import load_problem
from rmesh_nlp.problem import PiecewiseLinear
from rmesh_nlp.solving.summary import summary
from support.orders import ORDERS

PARTS = Path(__file__).parents[2] / "docs" / "parts"


def results(problem: rm.ContactProblem) -> dict[str, ContactResult]:
    solver = ContactSolver(problem)
    nodes = np.asarray(problem.mesh.p)
    return contact_results(solver.discretisation.space, nodes, solver.system(nodes), solver.given)


def slab(order: int, slope: float = 0.0, poisson: float = 0.0) -> rm.ContactProblem:
    """A block on edges of different lengths, glued without shear on x < 5, under the pressure 1 + slope x."""
    x = np.array([0, 1, 2.5, 4, 5, 5.6, 6.8, 8.3, 9, 10.0])
    mesh = rm.shapes.rectangle(9, 5, x=(0, 10), y=(0, 5))
    mesh = replace(mesh, doflocs=np.stack([np.interp(mesh.p[0], np.linspace(0, 10, 10), x), mesh.p[1]]))
    named = {"held": lambda at: (at[1] == 0) & (at[0] < 5), "free": lambda at: (at[1] == 0) & (at[0] > 5)}
    return rm.ContactProblem(
        mesh.with_boundaries(named),
        rm.PlaneStrain.from_young(young=1000, poisson=poisson),
        (rm.Dirichlet("held", (None, 0.0)), rm.Dirichlet("left", (0.0, None))),
        rm.Obstacle("free"),
        rm.Motion(0.1),
        (rm.Traction("top", (0.0, lambda x, y: -1 - slope * x)),),
        order=order,
    )


@pytest.mark.slow
@pytest.mark.parametrize("order", ORDERS)
def test_uniform_pressure_beside_a_support_is_exact(order: int) -> None:
    (found,) = results(slab(order)).values()
    assert vars(found) == pytest.approx(vars(ContactResult(5, 0, 1, 5, 0, 5, found.moment)), abs=1e-9)
    problem = slab(order)
    assert rm.Outer.of(problem, "resultant(free)").at_start.value == pytest.approx(5, rel=1e-9)
    bounds = rm.certify(rm.solve(problem, "fixed")).bounds["resultant(free)"]
    assert bounds.lower <= bounds.value == pytest.approx(5, rel=1e-9)


@pytest.mark.parametrize("order", [1, 2])
def test_contact_ends_at_a_vertex_without_force_or_before_it_at_order_2(order: int) -> None:
    """A vertex with next to no force is the last one that touches; quadratic pressures may end before."""
    problem = rm.ContactProblem(
        rm.shapes.rectangle(8, 1, x=(0, 8)),
        rm.PlaneStrain(1.0, 1.0),
        ("left", "right"),
        rm.Obstacle("bottom"),
        order=order,
    )
    space, nodes = ContactSolver(problem).discretisation.space, problem.mesh.p
    (part,) = space.contact_sets
    x = space.points(nodes)[0, part.nodes]
    force = np.where((x == 3) | (x == 4), 1.0, np.where((x == 2) | (x == 5), 1e-9, 0.0))
    (found,) = recovered(space, nodes, part, force)
    assert found.length(1e-12) == pytest.approx(3 if order == 1 else 1, abs=1e-6)


@pytest.mark.parametrize("order", [1, 2])
def test_linear_pressure_is_recovered_on_edges_of_different_lengths(order: int) -> None:
    """Forces of the pressure 1 + x itself, on a boundary with a free end and a shared one."""
    problem = slab(order)
    space, nodes = ContactSolver(problem).discretisation.space, np.asarray(problem.mesh.p)
    (part,) = space.contact_sets
    s, w = np.polynomial.legendre.leggauss(4)
    facets, force = problem.mesh.boundaries["free"], np.zeros(space.n_nodes)
    for a, b in problem.mesh.facets[:, facets].T:
        t, ends = (s + 1) / 2, nodes[0, [a, b]]
        shapes = [1 - t, t] if order == 1 else [(1 - t) ** 2, t**2, 2 * t * (1 - t)]
        at = space.nodes_of(np.array([[a], [b]])).ravel()
        force[at] += [np.sum(w / 2 * f * (1 + ends @ [1 - t, t])) * abs(ends[1] - ends[0]) for f in shapes]
    shared = force.copy()
    shared[np.setdiff1d(np.arange(force.size), part.nodes)] = 0
    found = nodal_forces(space, nodes, part, shared[part.nodes], -shared[part.nodes])  # friction pulls
    np.testing.assert_allclose(found, [force, -force], atol=1e-12)
    pressure, _ = contact_stresses(space, nodes, force[part.nodes], np.zeros(0))
    along = np.flatnonzero((space.points(nodes)[1] == 0) & (space.points(nodes)[0] >= 5))
    np.testing.assert_allclose(pressure[along], 1 + space.points(nodes)[0, along], rtol=1e-12)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("stress", [(3, 2, 2), (3, 2.9, 0), (2, 3, 3), (2, 2.1, 5)])
def test_pressure_does_not_overshoot_beside_a_support(stress: tuple[float, ...], order: int) -> None:
    """On edges of length 1 it continues at most as steeply as between the two nodes that are next."""
    size, reach = {1: (1, 2 / 3), 2: (1 / 3, 1 / 4)}[order]
    X, forces = np.stack([np.arange(5.0), np.zeros(5)]), size * np.array(stress)
    found = float(force_at_end(order, 5, len(stress), 1.0)(X, forces)) * (1 + order)
    flat, steep = stress[0], stress[0] + reach * (stress[0] - stress[1])
    assert min(flat, steep) - 1e-12 <= found <= max(flat, steep) + 1e-12


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("objective", ["resultant(free)", "resultant(free) + 0.1*level-pressure(free)"])
def test_gradient_of_the_resultant_has_the_shared_node(order: int, objective: str) -> None:
    test = rm.verify_gradient(slab(order, slope=0.1, poisson=0.3), objective)
    assert test.passed, test.summary()
    assert test.slope != 0


def problems() -> list[rm.ContactProblem]:
    parts = [load_problem(path) for path in sorted(PARTS.glob("*.toml"))]
    every = [*(make() for make in rm.EXAMPLES.values()), *parts, slab(1, 0.1, 0.3), slab(2, 0.1, 0.3)]
    # across the axis the hoop stress of a half-section has a part
    return [one for one in every if one.components == 2 and not (one.axisymmetric or one.pairs)]


@pytest.mark.parametrize("problem", problems(), ids=lambda problem: problem.name)
def test_contact_and_supports_carry_the_loads(problem: rm.ContactProblem) -> None:
    """Reactions are those of stiffness and load alone; at shared nodes the contact's share is not theirs."""
    continuous = Continuous(problem)
    space, nodes = continuous.space, continuous.body.nodes
    system = continuous.system(continuous.first_standoff())
    state = solve(system)
    u = continuous.field.values(state.u)
    residual = (continuous.stiffness @ u.T.ravel() - continuous.load).reshape(-1, 2).T
    load, (given, _) = continuous.load.reshape(-1, 2).T, space.given()
    reactions = np.where(given, residual, 0.0)
    for part in space.contact_sets:
        normal, friction = nodal_forces(space, nodes, part, state.normal_force, state.tangential_force)
        n = part.obstacle.normals(space.points(nodes))
        reactions -= np.where(given, normal * n + friction * np.stack([n[1], -n[0]]), 0.0)
    found = contact_results(space, nodes, system, state).values()
    x, y = space.points(nodes)
    rest = reactions + load
    total = [*rest.sum(axis=1), np.sum(x * rest[1] - y * rest[0])]
    total += np.array([[one.force_x, one.force_y, one.moment] for one in found]).sum(axis=0)
    size = np.sum(np.abs(load)) + np.sum(np.abs(reactions))
    assert np.max(np.abs(total[:2])) <= 1e-9 * size
    if not problem.motion.curves:  # beside curves rotations are not among the displacements
        assert abs(total[2]) <= 1e-9 * size * np.max(np.hypot(x, y))


def test_force_of_a_pin_is_the_load_and_its_pressure_more() -> None:
    """A quarter of a plate hangs on a pin: half the load on the half that is modelled."""
    mesh = rm.shapes.plate_with_hole(0.4, size=4, radius=1)
    problem = rm.ContactProblem(
        mesh,
        rm.PlaneStress.from_young(young=1000, poisson=0.3),
        (rm.Dirichlet("left", (None, 0.0)),),
        rm.Obstacle.circle("hole", (2.01, 2), 0.99),
        rm.Motion(0),
        (rm.Traction("left", (-1.0, 0.0)),),
    )
    (found,) = results(problem).values()
    assert found.force_x == pytest.approx(4, rel=1e-9)
    assert found.normal_force > 1.02 * 4
    # every force passes through the centre
    assert found.moment == pytest.approx(2.01 * found.force_y - 2 * found.force_x)


@pytest.mark.slow
def test_values_on_the_refined_mesh_are_in_equilibrium() -> None:
    """The admissible displacement of the assessment is near equilibrium, and no more."""
    mesh = rm.shapes.rectangle(8, 4, x=(0, 2))
    problem = rm.ContactProblem(
        mesh,
        rm.PlaneStrain.from_young(young=1000, poisson=0.3),
        (rm.Dirichlet("left", (0.0, None)),),
        rm.Obstacle.graph("bottom", lambda x, y: -0.05 * x**2),
        rm.Motion(0.02),
        (rm.Traction("top", (0.0, -1.0)),),
    )
    found = rm.solve(problem, "auto").contact["bottom"]
    for suffix in ("_initial", "", "_refined"):
        assert found[f"force_y{suffix}"] == pytest.approx(2, rel=1e-9)


def hertz(n: int) -> rm.ContactProblem:
    """A parabola under half a block, pressed by 0.005."""
    return rm.ContactProblem(
        rm.shapes.rectangle(n, n),
        rm.PlaneStrain.from_young(young=1000, poisson=0.3),
        (rm.Dirichlet("top", (0.0, -0.005)), rm.Dirichlet("left", (0.0, None))),
        rm.Obstacle.graph("bottom", lambda x, y: -0.05 * x**2),
    )


@pytest.mark.parametrize("order", ORDERS)
def test_length_of_contact_ends_within_an_edge(order: int) -> None:
    """A parabola under a block: half-width 0.2044 and peak 11.644 are those of order 2 with 128 edges."""
    errors = []
    for n in (12, 16, 20):
        (found,) = results(replace(hertz(n), order=order)).values()
        errors += [found.contact_length / 0.2044 - 1, (found.peak_pressure / 11.644 - 1)]
    assert np.max(np.abs(errors)) < 0.05


@pytest.mark.parametrize("n", [12, 16])
def test_length_of_contact_is_in_units_of_the_edge_before_its_end(n: int) -> None:
    """Edges are the shorter the farther they are from the middle of contact."""
    mesh = rm.shapes.rectangle(n, n)
    graded = replace(mesh, doflocs=np.stack([mesh.p[0] ** 0.7, mesh.p[1]]))
    (found,) = results(replace(hertz(n), mesh=graded)).values()
    assert found.contact_length == pytest.approx(0.2044, rel=0.1)


def test_near_incompressible_peak_at_order_2() -> None:
    """The peak of 15.60 is from 128 edges; nodal forces over their weights give 21.4."""
    problem = rm.ContactProblem(
        rm.shapes.rectangle(16, 8, x=(0, 2)),
        rm.PlaneStrain.from_young(young=1000, poisson=0.4999),
        (rm.Dirichlet("top", (0.0, -0.005)),),
        rm.Obstacle.graph("bottom", lambda x, y: -0.05 * (x - 1) ** 2),
        order=2,
    )
    (found,) = results(problem).values()
    assert found.peak_pressure == pytest.approx(15.60, rel=0.02)


@pytest.mark.parametrize("order", [1, 2])
def test_pressure_of_an_obstacle_inside_is_load_and_curvature(order: int) -> None:
    problem = rm.ContactProblem(
        rm.shapes.rectangle(12, 12),
        rm.Laplace(-8.0),
        ("left", "right", "bottom", "top"),
        rm.Obstacle.interior(lambda x, y: -0.2 - 0.5 * ((x - 0.5) ** 2 + (y - 0.5) ** 2)),
        order=order,
    )
    (found,) = results(problem).values()
    assert found.peak_pressure == pytest.approx(10, rel=1e-6)
    assert found.contact_length == pytest.approx(0.191, rel=0.05)  # the force on a fine mesh, 1.91, over 10
    assert found.force_x is None


def test_even_pressure_at_planes_of_symmetry_of_a_ring() -> None:
    """A ring pressed on a shaft by 0.01 (Lame): single end nodes are 14 % off."""
    mesh = rm.shapes.rectangle(12, 8)
    angle, radius = np.pi / 2 * (1 - mesh.p[0]), 1 + mesh.p[1]
    names = mesh.boundaries
    mesh = replace(
        mesh,
        doflocs=np.round(radius * np.stack([np.cos(angle), np.sin(angle)]), 15),
        _boundaries={"hole": names["bottom"], "x": names["left"], "y": names["right"]},
    )
    problem = rm.ContactProblem(
        mesh,
        rm.PlaneStrain.from_young(young=1000, poisson=0.3),
        (rm.Dirichlet("x", (0.0, None)), rm.Dirichlet("y", (None, 0.0))),
        rm.Obstacle.circle("hole", (0, 0), 1.01),
        rm.Motion(0, curves={"hole": rm.Circle((0, 0), 1)}),
    )
    (found,) = results(problem).values()
    exact = 0.01 / (1.3 / 1000 * (0.4 + 4) / 3)
    assert found.peak_pressure == pytest.approx(exact, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(("wide", "words"), [(1.0, "the end of the contact boundary"), (0.5, "kink")])
def test_peak_without_a_limit_is_told(wide: float, words: str) -> None:
    """A punch: the body ends, or the foundation falls away."""
    mesh = rm.shapes.rectangle(8, 6)
    boundaries = {"bottom": lambda at: (at[1] == 0) & (at[0] < 0.5)} if wide == 1 else {}
    steep = rm.Obstacle("bottom", offset=lambda x, y: 0.1 * (x > 0.5), kinks=(0.5,))
    problem = rm.ContactProblem(
        mesh.with_boundaries(boundaries) if boundaries else mesh,
        rm.PlaneStrain.from_young(young=1000, poisson=0.3),
        (rm.Dirichlet("top", (0.0, -0.001)), rm.Dirichlet("left", (0.0, None))),
        rm.Obstacle("bottom") if wide == 1 else steep,
    )
    assert any(words in text for text in rm.solve(problem, "fixed").record()["warnings"])


def test_resolution_is_warned_of_by_one_rule() -> None:
    """Less than three vertices under pressure, or at order 2 two edges."""
    for order, n, is_said in ((1, 8, True), (2, 8, True), (1, 16, False), (2, 16, False)):
        texts = rm.check(replace(hertz(n), order=order))
        assert any("too coarse" in text for text in texts) is is_said


def test_peak_beside_a_kink_between_nodes_may_have_no_limit() -> None:
    """Not that of a table of a parabola, whose kinks are many and small."""
    x = np.linspace(0, 4, 101)
    tables = ((0.0, 1.83, 2.41, 4.0), (-0.05, -0.01, -0.01, -0.06)), (x, -0.01 - 0.02 * (x - 2.03) ** 2)
    told = []
    for places, heights in tables:
        problem = rm.ContactProblem(
            rm.shapes.rectangle(14, 5, x=(0, 4)),
            rm.PlaneStrain.from_young(1000, 0.3),
            ("left", "right"),
            rm.Obstacle.graph("bottom", PiecewiseLinear(tuple(places), tuple(heights))),
            tractions=(rm.Traction("top", (0.0, -30.0)),),
            order=2,
        )
        solver = ContactSolver(problem)
        told.append(list(unlimited_peaks(solver.discretisation.space, problem.mesh.p, solver.given)))
    assert told == [["bottom"], []]


@pytest.mark.parametrize("n", [8, 9])
def test_peak_on_the_ridge_of_an_obstacle_may_have_no_limit(n: int) -> None:
    """At nodes or between them; not on a parabola, nor beside the valley of two or a smooth end of one."""
    told = []
    for height in (
        lambda x, y: 0.3 - ca.fabs(x) - 0.5 * y**2,
        lambda x, y: 0.3 - x**2 - y**2,
        lambda x, y: ca.fmax(0.3 - (x - 0.3) ** 2, 0.3 - (x + 0.3) ** 2) - y**2,
        lambda x, y: 0.3 - 0.5 * x**2 - ca.fmax(x, 0) ** 2 - y**2,
    ):
        mesh, obstacle = rm.shapes.rectangle(n, n, x=(-1, 1), y=(-1, 1)), rm.Obstacle.interior(height)
        problem = rm.ContactProblem(mesh, rm.Laplace(), ("left", "right", "top", "bottom"), obstacle)
        solution = rm.solve(problem, "fixed", audit=False)
        told.append(any("no limit" in text for text in solution.warnings))
        assert any(label == "interior: contact area" for label, _ in summary(solution))
    assert told == [True, False, False, False]
