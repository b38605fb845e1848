"""Where nodes may move, what is pinned, slides, is free or tied, and which elements are valid."""

import itertools
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skfem import MeshTri

import rmesh_nlp as rm
from rmesh_nlp.discretisation import discretise
from rmesh_nlp.mapping import MeshMap, Mobility
from rmesh_nlp.mapping.validity import area_ratios, is_valid
from rmesh_nlp.meshes import from_arrays, named
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import PiecewiseLinear
from rmesh_nlp.problem.body import Body
from support.designs import BOW, block
from support.formulations import joint, nested


def test_nodes_keep_to_their_sides_and_move_limits() -> None:
    problem = rm.EXAMPLES["6.1"]()
    free = MeshMap.of(problem)
    assert free.n == 126  # as the paper counts
    x, y = problem.mesh.p
    on_x, on_y = np.isin(x, (0, 1)), np.isin(y, (0, 1))
    moved = free.positions.values(np.random.default_rng(0).uniform(-1, 1, free.n))
    np.testing.assert_array_equal(moved[0, on_x], x[on_x])
    np.testing.assert_array_equal(moved[1, on_y], y[on_y])
    assert discretise(problem).validity.size == 0
    assert np.max(np.abs(moved - problem.mesh.p)) <= 0.0275 * (1 + 1e-12)


def test_nodes_slide_along_a_slope_within_their_move_limits(sloped: rm.ContactProblem) -> None:
    free = MeshMap.of(sloped)
    alpha = sloped.obstacle.offset
    for sign in (-1.0, 1.0):
        moved = free.positions.values(np.full(free.n, sign))
        for node in sloped.boundary_nodes("contact"):
            assert moved[1, node] == pytest.approx(float(ca.DM(alpha(moved[0, node]))), abs=1e-12)
        shift = np.abs(moved - sloped.mesh.p)
        assert np.all(shift[0] <= 0.1 + 1e-12)
        assert np.all(shift[1] <= 0.05 + 1e-12)
        assert np.max(shift[0]) == pytest.approx(0.1)
    q = np.random.default_rng(5).uniform(-1, 1, free.n)
    np.testing.assert_allclose(free.q_of(free.positions.values(q)), q, atol=1e-12)


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.02, 0.5))
def test_elements_without_a_validity_row_never_fail(seed: int, fraction_of_h: float) -> None:
    # random meshes, random move limits, random corners of them
    rng = np.random.default_rng(seed)
    mesh = MeshTri.init_tensor(np.linspace(0, 1, 5), np.linspace(0, 1, 4)).with_boundaries(
        {"held": lambda x: np.isclose(x[0], 0), "contact": lambda x: np.isclose(x[0], 1)}
    )
    inside = mesh.interior_nodes()
    p = mesh.p.copy()
    p[:, inside] += rng.uniform(-0.05, 0.05, (2, inside.size))
    base = rm.EXAMPLES["6.1"](4)
    motion = rm.Motion((fraction_of_h / 4, fraction_of_h / 3))
    problem = replace(base, mesh=replace(mesh, doflocs=p), dirichlet=("held",), motion=motion)
    free = MeshMap.of(problem)
    ratio = area_ratios(problem, free.positions.values(np.sign(rng.uniform(-1, 1, free.n))))
    failing = np.flatnonzero(ratio < motion.min_area_fraction * (1 - 1e-9))
    assert set(failing) <= set(discretise(problem).validity.elements)


def test_elements_with_a_validity_row_can_fail() -> None:
    """Each of them does at some corner of its move limits: none is watched for nothing."""
    problem = rm.EXAMPLES["6.1"](4, 0.11)
    free = MeshMap.of(problem)
    watched = discretise(problem).validity.elements
    assert 0 < watched.size < problem.mesh.t.shape[1]
    for element in watched:
        index = free.positions.index[:, problem.triangles[:, element]]
        mine, q, ratios = np.unique(index[index >= 0]), np.zeros(free.n), []
        for corner in itertools.product((-1.0, 1.0), repeat=mine.size):
            q[mine] = corner
            ratios.append(area_ratios(problem, free.positions.values(q))[element])
        assert min(ratios) < problem.motion.min_area_fraction


def problem(motion: rm.Motion) -> rm.ContactProblem:
    return rm.ContactProblem(mesh=rectangle(2, 2), law=rm.Laplace(-1.0), dirichlet=("left",), motion=motion)


def squeezed(to: float) -> np.ndarray:
    """Nodes with the middle one at the height ``to``: the least element has 2 ``to`` of its area."""
    nodes = np.array(problem(rm.Motion(delta=None)).mesh.p)
    middle = np.flatnonzero(np.all(nodes == 0.5, axis=0))
    assert middle.size == 1
    nodes[1, middle] = to
    return nodes


@pytest.mark.parametrize(
    ("height", "upright", "valid"),
    [
        (0.5, True, True),
        (0.0501, True, True),
        (0.0499, True, False),
        (1e-9, True, False),
        (0.0, False, False),
        (-1e-9, False, False),
        (-0.1, False, False),
    ],
)
def test_a_least_area_is_a_fraction_of_the_given_one(height: float, upright: bool, valid: bool) -> None:
    """With a barrier a positive area is enough."""
    given, nodes = problem(rm.Motion(delta=None, min_area_fraction=0.1)), squeezed(height)
    assert Body(given, nodes).is_upright() is upright
    assert is_valid(given, nodes) is valid
    assert is_valid(given, nodes, by_barrier=True) is upright


def test_an_element_that_its_arc_cuts_is_not_valid_whatever_its_area() -> None:
    """Outside the unit circle, which lies between the chord of two nodes and the third one."""
    mesh = from_arrays([[1, 0], [2, 2], [0, 1]], [[0, 1, 2]], {"arc": lambda X: X.sum(axis=0) < 1.1})
    motion = rm.Motion(None, curves={"arc": rm.Circle((0.0, 0.0), 1.0)})
    problem, nodes = rm.ContactProblem(mesh, rm.Laplace(1.0), ("arc",), motion=motion), np.array(mesh.p)
    far = np.flatnonzero(nodes.sum(axis=0) > 3)
    for place, valid in ((1.5, True), (0.6, False)):
        nodes[:, far] = place
        assert area_ratios(problem, nodes)[0] > motion.min_area_fraction
        assert is_valid(problem, nodes) is Body(problem, nodes).is_upright() is valid


@pytest.mark.parametrize("by_barrier", [False, True])
def test_a_least_angle_holds_with_and_without_a_barrier(by_barrier: bool) -> None:
    motion = rm.Motion(delta=None, min_area_fraction=0.01, min_angle=20.0)
    assert is_valid(problem(motion), squeezed(0.5), by_barrier=by_barrier)
    assert not is_valid(problem(motion), squeezed(0.1), by_barrier=by_barrier)
    assert is_valid(problem(replace(motion, min_angle=0.0)), squeezed(0.1), by_barrier=by_barrier)


def test_a_least_angle_is_a_row_of_every_element_that_moves() -> None:
    plain = discretise(problem(rm.Motion(0.01)))
    assert plain.validity.size == 0  # move limits keep all areas
    validity = discretise(problem(rm.Motion(0.01, min_angle=20.0))).validity
    moves = np.any(plain.mesh_map.positions.index >= 0, axis=0)
    assert validity.elements.size == np.sum(np.any(moves[plain.problem.triangles], axis=0)) > 0


@pytest.mark.parametrize("min_angle", [0.0, 5.0])
def test_elements_that_a_shape_moves_have_a_row(min_angle: float) -> None:
    """No node moves but by the shape."""
    design = replace(block(BOW), motion=rm.Motion(0, min_angle=min_angle))
    free, triangles = MeshMap.of(design), design.triangles
    # the last unknowns are the design variables, in units of half the width of their bounds
    count = len(design.design)
    np.testing.assert_allclose((free.upper - free.lower)[-count:], 2)
    moves = np.any(free.positions.values(np.ones(free.n)) != design.mesh.p, axis=0)
    expected = np.flatnonzero(np.any(moves[triangles], axis=0))
    assert expected.size > 0
    np.testing.assert_array_equal(discretise(design).validity.elements, expected)


def two_halves(motion: rm.Motion, **changes: object) -> rm.ContactProblem:
    """A rectangle (0, 3) x (0, 1) of two subdomains that meet at x = 1.5, loaded on top for x > 2."""
    mesh = named(
        rectangle(6, 4, x=(0, 3)),
        {"load": lambda p: (p[1] == 1) & (p[0] > 2)},
        {"a": lambda p: p[0] < 1.5, "b": lambda p: p[0] > 1.5},
    )
    return replace(rm.ContactProblem(mesh, rm.Laplace(1.0), ("left",), motion=motion), **changes)


def node(p: rm.ContactProblem, x: float, y: float) -> int:
    (found,) = np.flatnonzero(np.isclose(p.mesh.p[0], x) & np.isclose(p.mesh.p[1], y))
    return int(found)


GIVEN = two_halves(rm.Motion(0.1))
MIDDLE, SIDE, END, INNER = (node(GIVEN, x, y) for x, y in ((1, 0.5), (1, 0), (2, 1), (1.5, 0.5)))
WEDGE = PiecewiseLinear((0.0, 1.0, 3.0), (-0.1, -0.05, -0.2))
GIVEN_ON_THE_RIGHT = {"dirichlet": ("left", rm.Dirichlet("right", lambda x, y: y * (1 - y)))}
CORNER = {"a": lambda p: (p[0] > 1.5) & (p[1] > 0.5)}
WITH_A_CORNER = named(rectangle(6, 4, x=(0, 3)), subdomains=CORNER)
FREE, SLIDING, PINNED = Mobility.FREE, Mobility.SLIDING, Mobility.PINNED


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        # corners, the end of a load, and where the interface meets the boundary a coefficient may jump
        ({}, dict.fromkeys([(0, 0), (3, 1), (2, 1), (1.5, 0), (1.5, 1)], PINNED)),
        ({}, {(1, 0.5): FREE} | dict.fromkeys([(1.5, 0.25), (1.5, 0.75), (1, 0), (0, 0.5)], SLIDING)),
        (
            {"law": rm.PlaneStrain(1.0, 1.0), "obstacle": rm.Obstacle.graph("bottom", WEDGE)},
            {(1, 0): PINNED, (2, 0): SLIDING},  # a kink of the foundation
        ),
        # the corner of an interface inside
        ({"mesh": WITH_A_CORNER, "law": rm.Laplace(1.0)}, {(1.5, 0.5): PINNED, (2, 0.5): SLIDING}),
        (GIVEN_ON_THE_RIGHT, {(3, 0.25): PINNED, (3, 0.5): PINNED, (3, 0.75): PINNED, (0, 0.5): SLIDING}),
        (
            {"motion": rm.Motion(0.1, pinned=("bottom", MIDDLE), slides=(END, SIDE), free=INNER)},
            # on a straight piece, although a part ends there; a number beats a name
            {(2, 1): SLIDING, (1, 0.5): PINNED, (1, 0): SLIDING, (2, 0): PINNED, (1.5, 0.5): FREE},
        ),
        ({"motion": rm.Motion(0.1, pinned="top", slides="top", free="top")}, {(1, 1): PINNED}),
        ({"motion": rm.Motion(0.1, slides=np.int64(SIDE), free=SIDE)}, {(1, 0): SLIDING}),
    ],
)
def test_mobility(change: dict, expected: dict) -> None:
    p = replace(GIVEN, **change)
    mobility = MeshMap.of(p).mobility
    assert {place: mobility[node(p, *place)] for place in expected} == expected


def test_nodes_of_an_interface_slide_along_it_and_limits_may_follow_the_shortest_edge() -> None:
    inside = [node(GIVEN, 1.5, y) for y in (0.25, 0.5, 0.75)]
    for delta, limit in ((0.1, 0.1), (rm.Relative(0.4), 0.4 * 0.25)):
        free = MeshMap.of(two_halves(rm.Motion(delta)))
        shift = free.positions.values(np.ones(free.n)) - GIVEN.mesh.p
        np.testing.assert_array_equal(shift[0, inside], 0)
        np.testing.assert_allclose(shift[1, inside], limit)
        np.testing.assert_allclose(shift[:, MIDDLE], limit)


@pytest.mark.parametrize(("bend", "mobility"), [(1e-7, SLIDING), (1e-5, PINNED)])
def test_node_slides_where_its_piece_is_straight(bend: float, mobility: Mobility) -> None:
    p = GIVEN.mesh.p.copy()
    p[1, SIDE] -= 0.25 * bend  # the facets beside it are 0.5 long
    bent = replace(GIVEN, mesh=replace(GIVEN.mesh, doflocs=p))
    assert MeshMap.of(bent).mobility[SIDE] == mobility


def test_tied_node_moves_as_its_leader() -> None:
    p = two_halves(rm.Motion(0.1))
    pairs = ((node(p, 1, 0.25), node(p, 1, 0.5)), (node(p, 1, 0), node(p, 1, 1)))
    free = MeshMap.of(replace(p, motion=rm.Motion(0.1, tied=pairs)))
    assert free.n == MeshMap.of(p).n - 3
    move = free.positions.values(np.random.default_rng(0).uniform(-1, 1, free.n)) - p.mesh.p
    for tied, leader in pairs:
        np.testing.assert_allclose(move[:, tied], move[:, leader], atol=1e-15)
        assert np.any(move[:, tied] != 0)


def beside_a_circle(**rules: object) -> rm.ContactProblem:
    """Left of the unit circle: node 1 where its angle jumps, node 4 on a straight side along its tangent."""
    angle = np.deg2rad([170.0, 180.0, 190.0])
    nodes = [*zip(np.cos(angle), np.sin(angle), strict=True), (-2, 0.5), (-2, 0), (-2, -0.5)]
    triangles = [[0, 4, 1], [0, 3, 4], [1, 5, 2], [1, 4, 5]]
    mesh = from_arrays(nodes, triangles, {"arc": lambda X: np.hypot(*X) < 1.01})
    motion = rm.Motion(None, curves={"arc": rm.Circle((0.0, 0.0), 1.0)}, **rules)
    return rm.ContactProblem(mesh, rm.Laplace(1.0), ("arc",), motion=motion)


def test_unknowns_of_positions_are_those_they_come_from_also_where_an_angle_jumps() -> None:
    free = MeshMap.of(beside_a_circle())
    for q in (np.full(free.n, 0.1), np.full(free.n, -0.1)):
        np.testing.assert_allclose(free.q_of(free.positions.values(q)), q, atol=1e-12)
    with pytest.raises(ValueError, match="cannot make the moves"):  # those of the leader turn
        MeshMap.of(beside_a_circle(tied=((4, 1),)))


@pytest.mark.parametrize(
    ("motion", "change", "message"),
    [
        (rm.Motion(0.1, slides=0), {}, "is to slide, but it is on no straight piece"),
        (rm.Motion(0.1, slides=MIDDLE), {}, "is to slide"),
        (rm.Motion(0.1, tied=((16, 16),)), {}, "tied itself"),
        (rm.Motion(0.1, tied=((16, 17), (18, 16))), {}, "tied itself"),
        (rm.Motion(0.1, tied=((5, MIDDLE),)), {}, "cannot make the moves"),
        (rm.Motion(0.1, slides="right"), GIVEN_ON_THE_RIGHT, "is held at a function of position and"),
    ],
)
def test_rules_that_cannot_be_obeyed_are_named(motion: rm.Motion, change: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        MeshMap.of(replace(GIVEN, motion=motion, **change))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: rm.Motion(-0.1), "delta must be positive and finite, or 0, got -0.1"),
        (lambda: rm.Motion((0.0, 0.1)), r"delta must be positive and finite, or 0, got \(0.0, 0.1\)"),
        (lambda: rm.Motion((0.1, np.inf)), r"got \(0.1, inf\)"),
        (lambda: rm.Motion((1, 2, 3)), "two numbers, Relative or None, got"),
        (lambda: rm.Motion(rm.Relative(0.0)), "relative must be a positive part .*, got 0.0"),
        (lambda: rm.Motion(rm.Relative(1.1)), "relative must be a positive part of .*, at most 1, got 1.1"),
        (lambda: rm.Motion(0.1, min_area_fraction=1.0), "min_area_fraction must be below 1, got 1.0"),
        (lambda: rm.Motion(0.1, min_area_fraction=0.0), "area_fraction must be positive and finite, got 0.0"),
        (lambda: rm.Motion(0.1, min_angle=60.0), "less than 60 degrees, got 60.0"),
        (lambda: rm.Motion(0.1, min_angle=-1.0), "at least 0"),
        (lambda: rm.Motion(0.1, pinned=(1.5,)), "pinned must be names .* or node numbers, got 1.5"),
        (lambda: rm.Motion(0.1, tied=(1, 2)), "tied must be pairs of node numbers, got 1"),
        (lambda: rm.Motion(0.1, curves={"top": 3}), "the curve of 'top' must be a Circle"),
    ],
)
def test_bad_motions_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.slow
def test_without_move_limits_validity_alone_limits() -> None:
    p = two_halves(rm.Motion(None, min_area_fraction=0.3), law=rm.Laplace(lambda x, y: 100 * x**4))
    free = MeshMap.of(p)
    assert np.all(np.isinf(free.upper))
    assert discretise(p).validity.size == p.mesh.t.shape[1]
    one = joint.solve(p)
    two = nested.solve(p, start=one.mesh.p)  # of several minima the same
    assert one.success
    assert two.energy == pytest.approx(one.energy, rel=1e-4)
    assert one.assessment.final.min_area_ratio == pytest.approx(0.3, abs=1e-4)
    multipliers = one.multipliers
    assert np.all(multipliers.limit == 0)
    assert multipliers.area.max() > 0
    # an envelope theorem: the energy falls at the sum of the multipliers when the bound is lowered
    step = 1e-4
    wider = replace(p, motion=rm.Motion(None, min_area_fraction=0.3 - step))
    looser = nested.solve(wider, start=one.mesh.p)  # a descent stays in the same basin
    assert (one.energy - looser.energy) / step == pytest.approx(multipliers.area.sum(), rel=0.05)
