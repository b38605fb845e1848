"""The motion vocabulary: what is pinned, slides, is free or tied, and how far."""

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.discretisation import discretise
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.mapping import MeshMap, Mobility
from rmesh_nlp.mapping.validity import least_angles
from rmesh_nlp.meshes import named
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import (
    ContactProblem,
    Dirichlet,
    Laplace,
    Motion,
    Obstacle,
    PiecewiseLinear,
    PlaneStrain,
    Relative,
)
from rmesh_nlp.solving.outer import Outer
from support.formulations import joint, nested


def problem(motion: Motion, **changes: object) -> ContactProblem:
    mesh = named(
        rectangle(6, 4, x=(0, 3)),
        subdomains={"a": lambda p: p[0] < 1.5, "b": lambda p: p[0] > 1.5},
    )
    mesh = named(mesh, {"load": lambda p: (p[1] == 1) & (p[0] > 2)})
    base = ContactProblem(mesh, Laplace(1.0), ("left",), motion=motion)
    return replace(base, **changes)


def node(p: ContactProblem, x: float, y: float) -> int:
    (found,) = np.flatnonzero(np.isclose(p.mesh.p[0], x) & np.isclose(p.mesh.p[1], y))
    return int(found)


def test_corners_ends_and_interfaces_are_pinned_and_lines_slide() -> None:
    p = problem(Motion(0.1))
    mobility = MeshMap.of(p).mobility
    for x, y in [(0, 0), (3, 1), (2, 1)]:  # corners, end of a load
        assert mobility[node(p, x, y)] == Mobility.PINNED
    for y in (0, 1):  # where the interface meets the boundary a coefficient may jump
        assert mobility[node(p, 1.5, y)] == Mobility.PINNED
    inside = [node(p, 1.5, y) for y in (0.25, 0.5, 0.75)]
    assert np.all(mobility[inside] == Mobility.SLIDING)
    moved = MeshMap.of(p).positions.values(np.ones(MeshMap.of(p).n))
    np.testing.assert_array_equal(moved[0, inside], 1.5)
    assert np.all(moved[1, inside] != p.mesh.p[1, inside])
    assert mobility[node(p, 1.0, 0.5)] == Mobility.FREE


def test_end_of_an_interface_inside_is_pinned() -> None:
    mesh = named(rectangle(4, 4), subdomains={"corner": lambda p: (p[0] > 0.5) & (p[1] > 0.5)})
    p = ContactProblem(mesh, Laplace(1.0), ("left",), motion=Motion(0.1))
    mobility = MeshMap.of(p).mobility
    assert mobility[node(p, 0.5, 0.5)] == Mobility.PINNED  # the corner of the interface
    assert mobility[node(p, 0.75, 0.5)] == Mobility.SLIDING


def test_nodes_at_kinks_of_the_foundation_are_pinned() -> None:
    wedge = PiecewiseLinear((0.0, 1.0, 3.0), (-0.1, -0.05, -0.2))
    p = problem(Motion(0.1), law=PlaneStrain(1.0, 1.0), obstacle=Obstacle.graph("bottom", wedge))
    mobility = MeshMap.of(p).mobility
    assert mobility[node(p, 1.0, 0)] == Mobility.PINNED
    assert mobility[node(p, 2.0, 0)] == Mobility.SLIDING


def test_nodes_held_at_a_function_of_position_are_pinned() -> None:
    held = (Dirichlet("left", (0.0,)), Dirichlet("right", (lambda x, y: y * (1 - y),)))
    p = problem(Motion(0.1), dirichlet=held)
    mobility = MeshMap.of(p).mobility
    assert np.all(mobility[p.boundary_nodes(("right",))] == Mobility.PINNED)
    assert mobility[node(p, 0, 0.5)] == Mobility.SLIDING
    with pytest.raises(ValueError, match="is held at a function of position and cannot move"):
        MeshMap.of(replace(p, motion=Motion(0.1, slides=("right",))))


def test_rules_for_names_and_numbers() -> None:
    p = problem(Motion(0.1))
    end, inner, side = node(p, 2, 1), node(p, 1.0, 0.5), node(p, 1.0, 0)
    motion = Motion(0.1, pinned=("bottom", inner), slides=(end, side), free=(node(p, 1.5, 0.5),))
    mobility = MeshMap.of(replace(p, motion=motion)).mobility
    assert mobility[end] == Mobility.SLIDING  # on a straight piece, although a part ends there
    assert mobility[inner] == Mobility.PINNED
    assert mobility[side] == Mobility.SLIDING  # a number beats a name
    assert mobility[node(p, 2.0, 0)] == Mobility.PINNED
    assert mobility[node(p, 1.5, 0.5)] == Mobility.FREE


def test_tied_node_moves_as_its_leader() -> None:
    p = problem(Motion(0.1))
    pairs = ((node(p, 1, 0.25), node(p, 1, 0.5)), (node(p, 1, 0), node(p, 1, 1)))
    free = MeshMap.of(replace(p, motion=Motion(0.1, tied=pairs)))
    assert free.n == MeshMap.of(p).n - 3
    move = free.positions.values(np.random.default_rng(0).uniform(-1, 1, free.n)) - p.mesh.p
    for tied, leader in pairs:
        np.testing.assert_allclose(move[:, tied], move[:, leader], atol=1e-15)
        assert np.any(move[:, tied] != 0)
    solution = joint.solve(replace(p, motion=Motion(0.1, tied=pairs)))
    assert solution.success
    shift = solution.mesh.p - p.mesh.p
    np.testing.assert_allclose(shift[:, pairs[0][0]], shift[:, pairs[0][1]], atol=1e-15)


@pytest.mark.parametrize(
    ("motion", "message"),
    [
        (Motion(0.1, slides=((0),)), "is to slide, but it is on no straight piece"),
        (Motion(0.1, slides=((16),)), "is to slide"),
        (Motion(0.1, tied=((16, 16),)), "tied itself"),
        (Motion(0.1, tied=((16, 17), (18, 16))), "tied itself"),
        (Motion(0.1, tied=((5, 16),)), "cannot make the moves"),
    ],
)
def test_rules_that_cannot_be_obeyed_are_named(motion: Motion, message: str) -> None:
    p = ContactProblem(rectangle(5, 5), Laplace(1.0), ("left",), motion=Motion(0.1))
    with pytest.raises(ValueError, match=message):
        MeshMap.of(replace(p, motion=motion))


def test_relative_move_limits_follow_the_shortest_edge() -> None:
    p = problem(Motion(Relative(0.4)))
    free = MeshMap.of(p)
    moved = free.positions.values(np.ones(free.n))
    inner = node(p, 1.0, 0.5)
    np.testing.assert_allclose(moved[:, inner] - p.mesh.p[:, inner], 0.4 * 0.25)


@pytest.mark.slow
def test_without_move_limits_validity_alone_limits() -> None:
    p = problem(Motion(None, min_area_fraction=0.3), law=Laplace(lambda x, y: 100 * x**4))
    free = MeshMap.of(p)
    assert np.all(np.isinf(free.bound))
    assert discretise(p).validity.size == p.mesh.t.shape[1]
    one = joint.solve(p)
    two = nested.solve(p, start=one.mesh.p)  # of several minima the same
    assert one.success
    assert two.energy == pytest.approx(one.energy, rel=1e-4)
    assert one.audit.min_area_ratio == pytest.approx(0.3, abs=1e-4)
    multipliers = one.multipliers
    assert multipliers is not None
    assert np.all(multipliers.limit == 0)
    assert multipliers.area.max() > 0
    # an envelope theorem: the energy falls at the sum of the multipliers when the bound is lowered
    step = 1e-4
    wider = replace(p, motion=Motion(None, min_area_fraction=0.3 - step))
    looser = nested.solve(wider, outer="newton", start=one.mesh.p)  # a descent stays in the same basin
    assert (one.energy - looser.energy) / step == pytest.approx(multipliers.area.sum(), rel=0.05)


def test_multipliers_of_move_limits_are_the_rate_of_the_energy() -> None:
    delta, step = 0.02, 1e-5
    p = problem(Motion(delta), law=Laplace(lambda x, y: 100 * x**4))
    solution = joint.solve(p)
    q = MeshMap.of(p).q_of(solution.mesh.p)
    # the same q in wider limits: outer variables off their bounds have no first-order effect
    wider = Outer(replace(p, motion=Motion(delta + step))).energy(q)
    assert solution.multipliers is not None
    assert np.sum(solution.multipliers.limit > 0) > 10
    rate = (solution.energy - wider.value) / step
    assert solution.multipliers.limit.sum() == pytest.approx(rate, rel=1e-2)


@pytest.mark.slow
def test_least_angle_is_kept() -> None:
    loose = problem(Motion(None, min_area_fraction=0.05), law=Laplace(lambda x, y: 100 * x**4))
    tight = replace(loose, motion=replace(loose.motion, min_angle=20.0))
    sliver, kept = joint.solve(loose), joint.solve(tight)
    assert np.min(least_angles(sliver.mesh.p, loose.triangles)) < 15
    assert np.min(least_angles(kept.mesh.p, loose.triangles)) == pytest.approx(20, abs=1e-3)
    assert kept.success
    assert kept.multipliers is not None
    assert kept.multipliers.angle.max() > 0
    with pytest.raises(ValueError, match=r"min_angle is 50.0 degrees, but element 0"):
        joint.solve(replace(loose, motion=replace(loose.motion, min_angle=50.0)))


def test_least_area_is_a_constraint_unless_a_distortion_is_minimised() -> None:
    tight = replace(EXAMPLES["6.1"](3), quadrature=6, motion=Motion(None, min_area_fraction=0.3))
    held, by_barrier = joint.solve(tight), joint.solve(tight, regularisation=0.1)
    assert held.success
    assert held.audit.min_area_ratio == pytest.approx(0.3, abs=1e-6)
    assert by_barrier.success
    assert 0 < by_barrier.audit.min_area_ratio < 0.2
