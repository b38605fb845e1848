"""Gaps that hold along edges: closed forms, and no penetration on any mesh."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.contact.penetration import penetrations
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.fem.edge_gaps import POWER, SAMPLES, with_edge_gaps
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes.arrays import from_arrays
from rmesh_nlp.meshes.shapes import rectangle
from support.contact_geometry import LAW, block_between_two_foundations
from support.curved import disc
from support.orders import ORDERS

CURVATURE = 0.8
PARABOLA = rm.Obstacle.graph("bottom", lambda x, y: -CURVATURE / 2 * (x - 1) ** 2)
WAVE = rm.Obstacle.graph("bottom", lambda x, y: 0.02 * ca.sin(7 * x) - 0.02)
DISC = rm.Obstacle.circle("bottom", (1.0, -1.0), 1.0)


def block(n: int, obstacle: rm.Obstacle) -> rm.ContactProblem:
    sides = (rm.Dirichlet("left", (0.0, None)), rm.Dirichlet("right", (0.0, None)))
    load = rm.Traction("top", (0.0, -900.0))
    return rm.ContactProblem(rectangle(2 * n, n, x=(0, 2)), LAW, sides, obstacle, rm.Motion(None), (load,))


def passes(problem: rm.ContactProblem, body: rm.ContactProblem | None = None) -> tuple[float, float]:
    """How deep the foundation passes into the body (by default its own), and the energy."""
    model, nodes = ContactSolver(problem), problem.mesh.p
    state = model.solve(nodes)
    assert np.sum(state.active.touching) >= 2
    parts = penetrations(DisplacementSpace(body or problem), nodes, model.displacement.values(state.u))
    return max(part.depth for part in parts), state.energy


def shaken(problem: rm.ContactProblem, seed: int) -> rm.ContactProblem:
    """The problem with nodes of the lower side at other places on it."""
    nodes = np.array(problem.mesh.p)
    below = np.flatnonzero((nodes[1] == 0) & (nodes[0] > 0) & (nodes[0] < 2))
    h = np.min(np.diff(np.sort(nodes[0, below])))
    nodes[0, below] += np.random.default_rng(seed).uniform(-0.4, 0.4, below.size) * h
    return replace(problem, mesh=replace(problem.mesh, doflocs=nodes))


@pytest.mark.parametrize("given", [0.0, 0.03, -0.03])
def test_beside_a_held_node_the_free_one_makes_up_for_it(given: float) -> None:
    h = 0.4
    x = np.array([0.0, h, 2.0])
    mesh = from_arrays(
        np.vstack([np.append(x, x), np.repeat([0.0, 1.0], 3)]).T,
        [(0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4)],
        {"bottom": [(0, 1), (1, 2)], "left": [(0, 3)], "right": [(2, 5)]},
    )
    hill = rm.Obstacle.graph("bottom", lambda x, y: -CURVATURE / 2 * (x - h) ** 2 * (x < h))  # flat behind it
    held = rm.Dirichlet("left", (0.0, given)), rm.Dirichlet("right", (0.0, 9.0))
    problem = rm.ContactProblem(mesh, LAW, held, replace(hill, gap="edge"), rm.Motion(None))
    (off,) = -ContactSolver(problem).system(mesh.p).offset
    s = np.arange(1, SAMPLES) / SAMPLES
    distance = CURVATURE / 2 * h**2 * (1 - s) ** 2  # s from the held node, where the gap is d + given
    needed = np.maximum((-distance - (1 - s) * given) / s, 0)
    assert off == pytest.approx(np.sum(needed**POWER) ** (1 / POWER), abs=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize(
    "obstacle",
    [rm.Obstacle.line("bottom", (0, -0.1), (0.1, 1)), rm.Obstacle.graph("bottom", lambda x, y: x**2 - 9)],
)
def test_straight_and_concave_foundations_need_nothing(obstacle: rm.Obstacle) -> None:
    problem = block(2, obstacle)
    assert with_edge_gaps(problem) is problem
    nodes, along = problem.mesh.p, replace(problem, obstacle=replace(obstacle, gap="edge"))
    offsets = [ContactSolver(p).system(nodes).offset for p in (problem, along)]
    np.testing.assert_allclose(offsets[1], offsets[0], atol=1e-14)


def test_only_foundations_that_rise_above_their_chords_are_changed() -> None:
    along = with_edge_gaps(block_between_two_foundations())
    assert [obstacle.gap for obstacle in along.obstacles] == ["node", "edge"]
    assert with_edge_gaps(along) is along


@pytest.mark.slow
@pytest.mark.parametrize(("obstacle", "order"), [(PARABOLA, 1), (DISC, 1), (WAVE, 2)])
def test_nothing_passes_between_the_nodes_of_any_mesh(obstacle: rm.Obstacle, order: int) -> None:
    at_nodes = replace(shaken(block(6, obstacle), seed=1), order=order)
    (deep, low), (none, high) = passes(at_nodes), passes(with_edge_gaps(at_nodes))
    assert deep > 1e-4 / 10 ** (order - 1)
    assert none < 1e-12
    assert high > low


def test_contact_of_a_curved_body_is_where_its_true_curve_touches() -> None:
    """Between its nodes an arc bulges beyond the chords, towards a flat foundation."""
    pressed = (rm.Dirichlet("axis", (0.0, None)), rm.Dirichlet("top", (None, -0.2)))
    body = disc({"arc": rm.Circle((0.0, 1.0), 1.0)})
    problem = replace(body, obstacle=rm.Obstacle.graph("arc", 0.0), dirichlet=pressed)
    assert passes(problem)[0] < 1e-12
    assert passes(replace(problem, motion=rm.Motion(None)), body=problem)[0] > 1e-5


@pytest.mark.parametrize("order", ORDERS)
def test_nothing_passes_through_the_triangles_over_an_obstacle(order: int) -> None:
    dome = rm.Obstacle.interior(lambda x, y: 0.05 - 0.4 * (x - 0.4) ** 2 - 0.6 * (y - 0.5) ** 2)
    if order == 2:  # a parabola would be met exactly
        dome = rm.Obstacle.interior(lambda x, y: 0.1 * ca.exp(-8 * ((x - 0.4) ** 2 + (y - 0.5) ** 2)) - 0.06)
    mesh = rectangle(7, 7)
    nodes, inside = np.array(mesh.p), mesh.interior_nodes()
    nodes[:, inside] += np.random.default_rng(1).uniform(-0.04, 0.04, (2, inside.size))
    mesh = replace(mesh, doflocs=nodes)
    problem = rm.ContactProblem(mesh, rm.Laplace(-2.0), ("left", "right"), dome, rm.Motion(None), order=order)
    assert passes(problem)[0] > 1e-3 / 10 ** (order - 1)
    assert passes(with_edge_gaps(problem))[0] < 1e-12


@pytest.mark.parametrize("distance", [0.0, 1e-9, 0.1])
@pytest.mark.parametrize("size", [1e-3, 1e4])
def test_a_straight_line_is_not_curved_whatever_its_direction(distance: float, size: float) -> None:
    for angle in np.linspace(0.1, 6, 9):
        normal = np.array([-np.sin(angle), np.cos(angle)])
        grid, along = rectangle(7, 3), np.array([np.cos(angle), np.sin(angle)])
        nodes = size * (np.outer(along, grid.p[0]) + np.outer(normal, grid.p[1]) + [[3.0], [-7.0]])
        low = grid.facets[:, grid.boundaries["bottom"]].T
        mesh = from_arrays(nodes.T, grid.t.T, {"low": low, "high": grid.facets[:, grid.boundaries["top"]].T})
        line = rm.Obstacle.line("low", tuple(nodes[:, 0] - distance * size * normal), tuple(normal))
        assert with_edge_gaps(rm.ContactProblem(mesh, LAW, "high", line)).obstacles[0].gap == "node"
