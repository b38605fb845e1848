"""Contact problems as a whole: obstacles, loads, refinement, words, and mistakes that are named."""

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.assessment.admissible import admissible
from rmesh_nlp.contact.penetration import penetrations
from rmesh_nlp.contact.setup_warnings import setup_warnings
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.fem.contact_pressure import contact_stresses
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.mapping import MeshMap, Mobility
from rmesh_nlp.meshes import named
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import (
    NO_CONTACT,
    ContactProblem,
    DesignVariable,
    Dirichlet,
    Laplace,
    Motion,
    Obstacle,
    Place,
    PlaneStrain,
    PointLoad,
    ProblemError,
    Relative,
    Traction,
)
from rmesh_nlp.problem.conditions import symmetric
from rmesh_nlp.problem.contact_problem import bisected, locally_refined, refined
from rmesh_nlp.problem.motion import BY_BARRIER
from support.contact_geometry import LAW, block_in_a_corner, punch_held_by_symmetry
from support.curved import HOLE, plate
from support.formulations import fixed

SCALAR = {
    "mesh": named(rectangle(2, 2), subdomains={"a": lambda x: x[0] < 0.5, "b": lambda x: x[0] > 0.5}),
    "law": Laplace(1.0),
    "dirichlet": ("left",),
}
FLOOR = Obstacle("bottom", friction=1.0)
BODY = {"mesh": rectangle(2, 2), "law": PlaneStrain(50.0, 40.0), "dirichlet": ("left",), "obstacle": FLOOR}
WALL = Obstacle.line("right", (1.0, 0.0), (-1.0, 0.0))
DISC = rm.Circle((0.0, 0.0), 1.0)
GAP = Traction("top", lambda x, y: ca.log(ca.fabs(x - 0.06) - 0.01))
BEAM = BODY | {"mesh": rectangle(4, 1, x=(0, 100)), "obstacle": NO_CONTACT}
SECOND = BODY["mesh"].p.shape[1]  # the first node of the second body of the pair
LINES = BODY["mesh"].with_boundaries({"bottom": lambda x: x[1] < 0.6}, boundaries_only=False)
PAIR = (BODY["mesh"] + rectangle(2, 2, x=(2, 3))).with_boundaries({"left": lambda x: x[0] == 0})
POLE = Laplace(lambda x, y: 1 / (x - 0.25))


def between_nodes(x: Any, y: Any) -> Any:
    """Not a number, but at the nodes of the meshes above."""
    return ca.sqrt(1e-9 - ca.sin(2 * ca.pi * x) ** 2 - ca.sin(2 * ca.pi * y) ** 2)


@pytest.mark.parametrize(
    ("base", "change", "part", "message"),
    [
        (SCALAR, {"dirichlet": 3}, "dirichlet", "dirichlet must be names of boundaries or Dirichlet, got 3"),
        (SCALAR, {"dirichlet": {"left": 0}}, "dirichlet", r"got \{'left': 0\}"),
        (SCALAR, {"law": "steel"}, "laws", "PlaneStress or Axisymmetric, got 'steel'"),
        (SCALAR, {"tractions": Traction("top", lambda x: x)}, "tractions", "must take x and y"),
        (SCALAR, {"order": True}, "order", "the order of displacements must be 1 or 2, got True"),
        (SCALAR, {"motion": None}, "motion", "motion must be Motion, got None"),
        (SCALAR, {"tractions": "right"}, "tractions", "tractions must be Traction, got 'right'"),
        (SCALAR, {"dirichlet": "lft"}, "dirichlet", "unknown boundary 'lft': did you mean left"),
        (SCALAR, {"motion": Motion(0.1, pinned="x")}, "motion", "unknown boundary 'x': choose from"),
        (SCALAR, {"motion": Motion(None, curves={"x": DISC})}, "curves", "unknown boundary 'x': choose from"),
        (SCALAR, {"motion": Motion(None, curves={"top": DISC})}, "curves", "is 0.414 off its curve"),
        (SCALAR, {"law": {"a": Laplace(1.0)}}, "materials", "has 0 laws: every element needs exactly one"),
        (SCALAR, {"law": {"a": Laplace(1.0), "b": PlaneStrain(1, 1)}}, "materials", "mix scalar and elastic"),
        (SCALAR, {"dirichlet": (Dirichlet("left", None),)}, "dirichlet", "rigid body, by translation of the"),
        (SCALAR, {"dirichlet": Dirichlet("left", (1.0, 2.0))}, "dirichlet", "2 components: it needs 1 value"),
        (SCALAR, {"law": {}, "dirichlet": ()}, "dirichlet", "the energy has no minimum"),
        (SCALAR, {"obstacle": Obstacle("left", (1.0,), -1e-9)}, "contact", "makes its gap -1e-09"),
        (SCALAR, {"obstacle": Obstacle("right", (0.6, 0.8))}, "contact", "needs 1 value"),
        (SCALAR, {"point_loads": PointLoad(9, 1.0)}, "point_loads", "names node 9, which the mesh has not"),
        (SCALAR, {"point_loads": PointLoad(8, np.inf)}, "point_loads", "the point load at node 8 is inf"),
        (SCALAR, {"law": Laplace(lambda x, y: ca.log(x - 0.2))}, "material", r"source is nan at \(0, 0\)"),
        # finite at the nodes, not at the points of the rule beside them
        (SCALAR, {"law": POLE, "quadrature": "midpoint"}, "material", r"the source is .*inf at \(0.25, "),
        (SCALAR, {"tractions": GAP, "quadrature": "midpoint"}, "tractions", r"is nan at \(0.0563508, 1\)"),
        (BODY, {"law": PlaneStrain(1, 1, (0.0, between_nodes))}, "material", "component 2 of .* is nan"),
        (BODY, {"tractions": Traction("right", (between_nodes, 0.0))}, "tractions", "component 1 .* 'right'"),
        (BODY, {"tractions": Traction("right", (0.0, None))}, "tractions", "2 .* 'right'.* number, got None"),
        (BODY, {"dirichlet": Dirichlet("left", (0.0, between_nodes))}, "dirichlet", "given on 'left' is nan"),
        (BODY, {"dirichlet": Dirichlet("left", (0.0,))}, "dirichlet", "needs 2 values"),
        (BODY, {"obstacle": replace(FLOOR, offset=between_nodes)}, "contact", "obstacle on 'bottom' is nan"),
        (BODY, {"obstacle": replace(FLOOR, friction=between_nodes)}, "contact", "bound on 'bottom' is nan"),
        (BODY, {"dirichlet": Dirichlet("left", (0.0, None)), "obstacle": WALL}, "dirichlet", "rigid"),
        (BODY, {"obstacle": replace(FLOOR, friction=-1e-9)}, "contact", "must not be negative, got -1e-09"),
        (BODY, {"obstacle": replace(FLOOR, friction=np.nan)}, "contact", "bound on 'bottom' is nan"),
        (BODY, {"obstacle": replace(FLOOR, coulomb=np.inf)}, "contact", "coefficient on 'bottom' is inf"),
        (BODY, {"obstacle": replace(FLOOR, coulomb=lambda x, y: 0.5 - x)}, "contact", "got -0.5 at"),
        (BODY, {"mesh": LINES}, "contact", "'bottom' has an edge inside the body, between nodes"),
        (BODY, {"dirichlet": ("top", Dirichlet("bottom", (0.1, None)))}, "contact", "contact node 0 has"),
        (BODY, {"obstacle": (FLOOR, WALL)}, "contact", "belongs to 2 contact"),
        (BODY, {"mesh": PAIR, "obstacle": NO_CONTACT}, "dirichlet", f"of the part with node {SECOND}: the"),
    ],
)  # fmt: skip
def test_contradictions_name_their_part(base: dict, change: dict, part: str, message: str) -> None:
    with pytest.raises(ProblemError, match=message) as caught:
        ContactProblem(**(base | change))
    assert caught.value.place[0] == part


RUBBING = tuple(replace(wall, coulomb=0.3) for wall in (WALL, Obstacle.line("left", (0.0, 0.0), (1.0, 0.0))))


@pytest.mark.parametrize(
    ("change", "motion"),
    [
        ({}, r"translation along \(1, 0\) of the part with node 0 \(friction is not counted\): the"),
        ({"obstacle": replace(FLOOR, friction=0.0, coulomb=0.3)}, r"along \(1, 0\) .* \(friction is not"),
        ({"obstacle": RUBBING}, r"translation along \(0, -?1\) .* \(friction is not counted\)"),
        ({"obstacle": Obstacle.line("bottom", (0, 0), (-3, 4))}, r"along \(-?0.8, -?0.6\) of .* 0: the"),
        ({"obstacle": Obstacle.circle("bottom", (0.5, 0.5), 1, inside=True)}, r"rotation about \(0.5, 0.5\)"),
    ],
)  # fmt: skip
def test_the_rigid_motion_that_is_left_is_named(change: dict, motion: str) -> None:
    with pytest.raises(ProblemError, match=f"can still move as a rigid body, by .*{motion}"):
        ContactProblem(**(BODY | {"dirichlet": ()} | change))


def on_a_line(height: float) -> Motion:
    line = rm.Parametrised(lambda t: t, lambda t: 1 + height + 0 * t, (-1.0, 2.0))
    return Motion(None, curves={"top": line})


def given_twice(value: float) -> tuple[Dirichlet, Dirichlet]:
    return Dirichlet("left", 1.0), Dirichlet("bottom", value)


def corner_with_a_wall(slope: float) -> tuple[Obstacle, Obstacle]:
    return Obstacle("bottom"), Obstacle.line("right", (1.0, 0.0), (-slope, 1.0))


@pytest.mark.parametrize(
    ("base", "taken", "refused", "message"),
    [
        # displacements given twice agree up to rounding
        (SCALAR, *({"dirichlet": given_twice(1 + d)} for d in (1e-10, 1e-8)), "where another boundary"),
        # nodes are on their curve, by the shortest edge of 0.5
        (SCALAR, *({"motion": on_a_line(height)} for height in (0.4e-3, 0.6e-3)), "off its curve"),
        # normals at a node of two foundations are independent
        (BODY, *({"obstacle": corner_with_a_wall(slope)} for slope in (1e-3, 1e-7)), "name one boundary"),
        # a long body held at a short edge
        (BEAM, {}, {"dirichlet": Dirichlet("left", (0.0, None))}, "still move as a rigid body"),
    ],
)  # fmt: skip
def test_thresholds_are_rounding(base: dict, taken: dict, refused: dict, message: str) -> None:
    ContactProblem(**(base | taken))
    with pytest.raises(ProblemError, match=message):
        ContactProblem(**(base | refused))


def boundary_lengths(problem: ContactProblem) -> dict[str, float]:
    mesh = problem.mesh
    ends = {name: mesh.p[:, mesh.facets[:, facets]] for name, facets in mesh.boundaries.items()}
    return {name: float(np.hypot(*(p[:, 0] - p[:, 1])).sum()) for name, p in ends.items()}


def test_refined_meshes_keep_boundaries_and_move_limits() -> None:
    problem = replace(rm.EXAMPLES["6.3"]((4, 2)), motion=Motion(Relative(0.3)))
    whole, part = refined(problem), locally_refined(problem, np.array([0, 5]))
    assert whole.motion.delta == Relative(0.6)
    assert refined(whole).motion.delta == Relative(1.0)
    assert part.motion.delta == Relative(0.3)
    assert whole.mesh.t.shape[1] == 4 * problem.mesh.t.shape[1]
    np.testing.assert_array_equal(part.mesh.p[:, : problem.mesh.p.shape[1]], problem.mesh.p)
    for one in (whole, part):
        assert boundary_lengths(one) == pytest.approx(boundary_lengths(problem))
        assert signed_areas(one.mesh.p, one.triangles).sum() == pytest.approx(4.0)


def test_a_mesh_bisected_twice_is_that_of_the_problem_refined_twice() -> None:
    problem, first, second = plate({"hole": HOLE}), np.arange(20), np.arange(30)
    mesh = bisected(problem, bisected(problem, problem.mesh, first), second)
    twice = locally_refined(locally_refined(problem, first), second).mesh
    np.testing.assert_allclose(mesh.p[:, mesh.t], twice.p[:, twice.t], atol=1e-12)


def test_boundary_on_an_axis_of_symmetry_stays_on_it() -> None:
    mesh = rectangle(2, 2)
    assert symmetric(mesh, "left") == Dirichlet("left", (0.0, None))
    assert symmetric(mesh, "bottom") == Dirichlet("bottom", (None, 0.0))
    assert symmetric(mesh, "bottom", 1) == Dirichlet("bottom", (None,))
    near, turned = (
        replace(mesh, doflocs=mesh.p + angle * np.array([-mesh.p[1], mesh.p[0]])) for angle in (1e-10, 1e-6)
    )
    assert symmetric(near, "left") == Dirichlet("left", (0.0, None))
    with pytest.raises(ValueError, match="not parallel to an axis"):
        symmetric(turned, "left")


def test_a_summary_describes_laws_motion_and_contact() -> None:
    problem = rm.EXAMPLES["6.3"]((4, 2))
    words = dict(problem.summary())
    assert words["contact"] == "4 nodes on contact, normal (0, 1), friction bound 10"
    assert "16 triangles" in repr(problem)
    motion = Motion(Relative(0.2), min_angle=5, pinned="top", tied=((1, 2),))
    words = dict(replace(problem, motion=motion, law=PlaneStrain(2.5, 1.5)).summary())
    assert words["motion"] == (
        "delta 0.2 of the shortest edge, areas at least 0.01 of the given ones, angles at least 5 degrees; "
        "pinned: top; 1 nodes tied"
    )
    assert "PlaneStrain, lambda 2.5, mu 1.5 N/m², body force (0, 0)" in words.values()
    assert BY_BARRIER in dict(replace(problem, motion=Motion(None)).summary())["motion"]
    assert Laplace(2.0, 3.0).in_words("") == "Laplace, conductivity 3, source 2"
    assert "the normal of the curve" in Obstacle.circle("bottom", (0, -5), 5.0).in_words()


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
    for bound, frictional in ((0.0, False), (1e-9, True), (lambda x, y: 0.0, True)):
        assert Obstacle("a", friction=bound).friction_law.has_given == frictional


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
        (lambda: Obstacle.circle("a", (0, np.inf), 1.0), "centre must be two finite numbers"),
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
        nodes = problem.boundary_nodes(name)
        np.testing.assert_allclose(solution.final.pressure[nodes], stress, rtol=1e-9)
    assert solution.energy == pytest.approx(stress * 0.04 / 2, rel=1e-9)
    parts = penetrations(DisplacementSpace(problem), problem.mesh.p, solution.displacement)
    assert max(part.depth for part in parts) < 1e-12


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
    space, nodes, none = model.discretisation.space, problem.mesh.p, np.zeros(0)
    pressure, _ = contact_stresses(space, nodes, state.normal_force, none)
    single = [np.isin(np.arange(gap.size), part.rows) * state.normal_force for part in space.contact_sets]
    each = [contact_stresses(space, nodes, force, none)[0][0] for force in single]
    assert pressure[0] == pytest.approx(sum(each))
    assert min(each) > 0


def test_one_foundation_under_several_names_is_one() -> None:
    """Equal formulas with equal friction: the solution is that of one boundary, whatever the order."""
    mesh = rectangle(6, 2, x=(0, 3))
    parts = {"a": (0, 1), "b": (1, 2), "c": (2, 3)}
    split = {k: lambda p, ends=v: (p[1] == 0) & (p[0] > ends[0]) & (p[0] < ends[1]) for k, v in parts.items()}

    def over(name: str, friction: float = 0.1) -> Obstacle:
        return Obstacle.graph(name, lambda x, y: 0.01 - 0.002 * x**2, friction=friction)

    def problem(*obstacles: Obstacle) -> ContactProblem:
        return ContactProblem(named(mesh, split), LAW, ("top",), obstacles)

    one = fixed.solve(problem(over("bottom")))
    for order in (("a", "b", "c"), ("a", "c", "b")):
        several = fixed.solve(problem(*map(over, order)))
        assert list(several.contact) == [several.problem.obstacles[0].boundary]
        np.testing.assert_allclose(several.displacement, one.displacement, rtol=0, atol=1e-15)
    for other in (over("b", 0.2), replace(over("b"), force=(0.0, 1.0)), Obstacle("b")):
        with pytest.raises(ProblemError, match="belongs to 2 contact boundaries"):
            problem(over("a"), other)
    assert len(problem(over("a"), over("c")).obstacles) == 2  # they do not meet


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
        (PUNCH | {"tractions": (Traction("top", (0.0, 200.0)),)}, r"\(0, 1\) .* 0, and the load does not"),
        # of two blocks the load pulls one off
        (BLOCKS | {"tractions": TOPS[:2]}, r"along \(0, 1\) of the part with node 25, and the load does"),
        (BLOCKS | {"tractions": TOPS[2:]}, r"along \(0, 1\) of the part with node 0, and the load does"),
        (PUNCH | {"dirichlet": ()}, "can still move as a rigid body"),
        # the gaps hold the block somewhere between the plates, and nothing says where
        (PUNCH | {"obstacle": PLATES}, r"rigid-body mode unconstrained, translation along \(0, -?1\) of"),
    ],
)
def test_bodies_that_contact_does_not_hold_in_one_place_are_refused(parts: dict, message: str) -> None:
    with pytest.raises(ProblemError, match=message):
        ContactSolver(ContactProblem(**parts))


def test_contact_that_is_not_solved_is_not_said_to_leave_a_motion() -> None:
    assert ContactSolver(ContactProblem(**half_ring())).given.status is Status.ITERATION_LIMIT


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


MISUSED = [
    ("units", lambda: ContactProblem(**SCALAR, units="mm")),
    ("problem", lambda: refined("body.toml")),
    ("body_force", lambda: PlaneStrain.from_young(1000, 0.3, body_force=-9.81)),
    ("lame_lambda", lambda: PlaneStrain("soft", 1.0)),
    ("node", lambda: PointLoad((0.5, 0.5), (0, -1))),
    ("delta", lambda: Motion(delta="large")),
    ("min_angle", lambda: Motion(min_angle="large")),
    ("curves", lambda: Motion(curves=rm.Circle((0, 0), 1))),
    ("radius", lambda: rm.Circle((0, 0), -1)),
    ("centre", lambda: rm.Circle(3, 1)),
    ("points", lambda: rm.Spline("abc")),
    ("x", lambda: rm.Parametrised("t", "t", (0, 1))),
    ("normal", lambda: Obstacle.line("bottom", 0, 1)),
    ("centre", lambda: Obstacle.circle("bottom", 1, 1)),
    ("start", lambda: DesignVariable("a", "x", (0, 1))),
    ("bounds", lambda: DesignVariable("a", 0.5, ("x", "y"))),
    ("x", lambda: rectangle(2, 2, x=("a", "b"))),
    ("path", lambda: rm.read_mesh(5)),
    ("condition", lambda: rm.where("a", 1, 2)),
]


@pytest.mark.parametrize(("argument", "misuse"), MISUSED)
def test_a_misused_argument_is_one_line_that_names_it(argument, misuse):
    with pytest.raises(rm.BadInputError) as caught:
        misuse()
    assert caught.value.place == (argument,)
    assert len(str(caught.value).splitlines()) == 1


def test_young_and_poisson_taken_for_lames_coefficients_are_told():
    with pytest.warns(UserWarning, match=r"lambda=1000, mu=0\.3 are .*PlaneStrain\.from_young"):
        PlaneStrain(1000, 0.3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        PlaneStrain.from_young(1.0, 0.499)
