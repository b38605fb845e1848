"""Several foundations, curves with their own normals, bodies that contact holds, point loads."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.assessment.admissible import admissible
from rmesh_nlp.contact.setup_warnings import setup_warnings
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.mapping import MeshMap, Mobility
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import (
    ContactProblem,
    Dirichlet,
    Motion,
    Obstacle,
    Place,
    PointLoad,
    ProblemError,
    Traction,
)
from rmesh_nlp.solving.state import nodal_stress
from support.contact_geometry import LAW, block_in_a_corner, punch_held_by_symmetry
from support.formulations import fixed
from support.penetration import penetration

POINTS = np.array([[4.0, 1.0], [6.0, 0.0]])


@pytest.mark.parametrize(
    ("obstacle", "gaps", "normals"),
    [
        # (4, 6) is 5 from the centre (1, 2), and (1, 0) is 2
        (Obstacle.circle("a", (1, 2), 0.5), (4.5, 1.5), ((0.6, 0.8), (0, -1))),
        (Obstacle.circle("a", (1, 2), 5.0, inside=True), (0.0, 3.0), ((-0.6, -0.8), (0, 1))),
        (Obstacle.line("a", (0, 1), (3, 4)), (6.4, -0.2), ((0.6, 0.8), (0.6, 0.8))),
        (Obstacle.graph("a", lambda x, y: x * x), (-10, -1), ((0, 1), (0, 1))),
        (Obstacle("a", (0, -1), 0.5), (0.5, 0.5), ((0, -1), (0, -1))),
    ],
    ids=["disc", "hole", "line", "graph", "offset"],
)
def test_gaps_normals_and_feet(obstacle: Obstacle, gaps: tuple, normals: tuple) -> None:
    n = np.array(normals, dtype=float)
    np.testing.assert_allclose(obstacle.distances(POINTS), gaps, atol=1e-12)
    np.testing.assert_allclose(obstacle.normals(POINTS), n.T, atol=1e-12)
    np.testing.assert_allclose(obstacle.feet(POINTS), POINTS - n.T * gaps, atol=1e-12)
    for k, (x, y) in enumerate(POINTS.T):
        assert float(obstacle.distance(x, y)) == pytest.approx(gaps[k], abs=1e-12)
        np.testing.assert_allclose(obstacle.direction(x, y).full()[:, 0], n[k], atol=1e-12)
        np.testing.assert_allclose(obstacle.tangential(x, y).full()[:, 0], (n[k, 1], -n[k, 0]), atol=1e-12)


def test_level_function_of_a_curve_may_have_any_scale() -> None:
    one = Obstacle.curve("a", lambda x, y: y - 0.1 * x**2)
    other = Obstacle.curve("a", lambda x, y: 7 * (y - 0.1 * x**2))
    points = np.array([[0.3, -1.0, 2.0], [0.5, 0.2, 0.4]])
    np.testing.assert_allclose(one.distances(points), other.distances(points))
    np.testing.assert_allclose(one.normals(points), other.normals(points))
    # at the foot of a vertical line the normal is that of the graph
    np.testing.assert_allclose(one.normals(points)[0, 2] / one.normals(points)[1, 2], -0.4)
    # a curved foundation is met where the level function is zero
    x, y = one.feet(points)
    np.testing.assert_allclose(y, 0.1 * x**2, atol=1e-12)


def test_interior_obstacle_and_friction() -> None:
    below = Obstacle.interior(lambda x, y: x - 3 * y)
    np.testing.assert_allclose(below.distances(POINTS), [14.0, -1.0])
    assert below.tangent == ()
    assert Obstacle("a", (0.6, 0.8)).tangent == (0.8, -0.6)
    for bound, frictional in ((0.0, False), (1e-9, True), (lambda x, y: 0.0, True)):
        assert Obstacle("a", friction=bound).frictional == frictional


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Obstacle("a", (1.0, 1e-5)), "has length 1.0000000000"),
        (lambda: Obstacle("a", (1.0,), friction=1.0), "two displacement components"),
        (lambda: Obstacle("a", (1.0,), coulomb=0.1), "two displacement components"),
        (lambda: Obstacle(Place.INTERIOR, friction=1.0), "two displacement components"),
        (lambda: Obstacle("a", gap="nodes"), "gap must be 'node' or 'edge', got 'nodes'"),
        (lambda: Obstacle.line("a", (0, 0), (0, 0)), "non-zero vector"),
        (lambda: Obstacle.circle("a", (0, 0), 0.0), "radius must be positive and finite, got 0.0"),
        (lambda: Obstacle.circle("a", (0, np.inf), 1.0), "centre must be finite"),
    ],
)
def test_bad_obstacles_are_named(make: Callable, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_compressed_block_between_two_plates_has_its_closed_form() -> None:
    # plates closer than the block is high: uniform strain, the lateral sides free
    problem = ContactProblem(
        mesh=rectangle(4, 4),
        law=LAW,
        dirichlet=(Dirichlet("left", (0.0, None)),),
        obstacle=(Obstacle.line("bottom", (0, 0.01), (0, 1)), Obstacle.line("top", (0, 0.97), (0, -1))),
        motion=Motion(0.05),
    )
    solution = fixed.solve(problem)
    assert solution.success
    lam, mu = LAW.lame_lambda, LAW.lame_mu
    stress = 4 * mu * (lam + mu) / (lam + 2 * mu) * 0.04
    for name in ("bottom", "top"):
        nodes = problem.boundary_nodes((name,))
        np.testing.assert_allclose(solution.pressure[nodes], stress, rtol=1e-9)
    assert solution.energy == pytest.approx(stress * 0.04 / 2, rel=1e-9)
    assert penetration(DisplacementSpace(problem), problem.mesh.p, solution.displacement) < 1e-12


def test_node_of_two_foundations_obeys_both() -> None:
    problem = block_in_a_corner()
    rows = np.flatnonzero(problem.contact_nodes == 0)
    assert rows.size == 2
    model = ContactSolver(problem)
    state, system = model.given, model.system(problem.mesh.p)
    gap = system.normals @ state.u + system.offset
    assert np.all(gap > -1e-12)
    assert np.all(state.normal_force[rows] > 0)
    np.testing.assert_allclose(gap[rows], 0, atol=1e-14)
    # the pressure at the node is that of both
    weights = DisplacementSpace(problem).weights(problem.mesh.p)
    pressure = nodal_stress(model, problem.mesh.p, state.normal_force)
    assert pressure[0] == pytest.approx(np.sum(state.normal_force[rows] / weights[rows]))


def half_ring() -> dict:
    """Half a ring on a hill: nodes that pull would be needed to hold it."""
    mesh = rectangle(8, 3, x=(np.pi, 2 * np.pi), y=(0.4, 1))
    angle, radius = mesh.p
    return {
        "mesh": replace(mesh, doflocs=radius * np.array([np.cos(angle), np.sin(angle)])),
        "law": LAW,
        "dirichlet": (),
        "tractions": (Traction("left", (0.0, -1.0)), Traction("right", (0.0, -1.0))),
        "obstacle": Obstacle.curve("top", lambda x, y: y + 1.002 + 0.3 * x**2),
    }


PUNCH = {name: getattr(punch_held_by_symmetry(), name) for name in ("mesh", "law", "dirichlet", "obstacle")}
BLOCKS = PUNCH | {
    "mesh": (rectangle(4, 4) + rectangle(4, 4, x=(2, 3))).with_boundaries(
        {"left": lambda x: x[0] % 2 == 0, "bottom": lambda x: x[1] == 0}
        | {f"top{k}": lambda x, k=k: (x[1] == 1) & (x[0] // 2 == k) for k in (0, 1)}
    ),
    "obstacle": Obstacle("bottom"),
}
TOPS = tuple(Traction(f"top{k}", (0.0, load)) for k, load in ((0, -9.0), (1, 1.0), (0, 1.0), (1, -9.0)))
PLATES = (Obstacle("bottom", offset=1.0), Obstacle("top", (0.0, -1.0), offset=1.0))


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (PUNCH, "does not press it on"),
        (
            PUNCH | {"tractions": (Traction("top", (0.0, 200.0)),)},
            r"along \(0, 1\) .* 0, and the load does not",
        ),
        # of two blocks the load pulls one off
        (BLOCKS | {"tractions": TOPS[:2]}, r"along \(0, 1\) of the part with node 25, and the load does"),
        (BLOCKS | {"tractions": TOPS[2:]}, r"along \(0, 1\) of the part with node 0, and the load does"),
        (PUNCH | {"dirichlet": ()}, "can still move as a rigid body"),
        # the gaps hold the block somewhere between the plates, and nothing says where
        (PUNCH | {"obstacle": PLATES}, r"rigid-body mode unconstrained, translation along \(0, -?1\) of"),
        (half_ring(), "rigid-body mode"),
    ],
)
def test_bodies_that_contact_does_not_hold_in_one_place_are_refused(parts: dict, message: str) -> None:
    with pytest.raises(ProblemError, match=message):
        ContactSolver(ContactProblem(**parts))


def test_point_load_pins_its_node_and_does_its_work() -> None:
    mesh = rectangle(4, 2)
    node = int(np.argmin(np.linalg.norm(mesh.p - [[0.5], [0.5]], axis=0)))
    problem = ContactProblem(
        mesh=mesh,
        law=LAW,
        dirichlet=("left",),
        motion=Motion(0.05),
        point_loads=(PointLoad(node, (3.0, -7.0)),),
    )
    assert MeshMap.of(problem).mobility[node] == Mobility.PINNED
    model = ContactSolver(problem)
    energy, u = model.given.energy, model.displacement.values(model.given.u)
    assert [warning.kind for warning in setup_warnings(model)] == ["point-load"]
    # linear elasticity: the energy is minus half the work of the load (Clapeyron)
    assert energy == pytest.approx(-0.5 * np.dot((3.0, -7.0), u[:, node]))
    parts = replace(problem, point_loads=(PointLoad(node, (1.0, -7.0)), PointLoad(node, (2.0, 0.0))))
    assert admissible(parts).energy == pytest.approx(energy, rel=1e-12)
    with pytest.raises(ValueError, match="under a point load and cannot move"):
        MeshMap.of(replace(problem, motion=Motion(0.05, free=(node,))))
