"""Where nodes may move and which elements are valid: by a barrier, by a least area, by a least angle."""

from __future__ import annotations

import itertools
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skfem import MeshTri

from rmesh_nlp.discretisation import discretise
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.mapping import MeshMap
from rmesh_nlp.mapping.validity import area_ratios, is_upright, is_valid
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Laplace, Motion, signed_areas
from support.designs import BOW, block


def test_nodes_keep_to_their_sides_and_move_limits() -> None:
    problem = EXAMPLES["6.1"]()
    free = MeshMap.of(problem)
    assert free.n == 126  # as the paper counts
    x, y = problem.mesh.p
    on_x, on_y = np.isin(x, (0, 1)), np.isin(y, (0, 1))
    moved = free.positions.values(np.random.default_rng(0).uniform(-1, 1, free.n))
    np.testing.assert_array_equal(moved[0, on_x], x[on_x])
    np.testing.assert_array_equal(moved[1, on_y], y[on_y])
    assert discretise(problem).validity.size == 0
    assert np.max(np.abs(moved - problem.mesh.p)) <= 0.0275 * (1 + 1e-12)


def test_nodes_slide_along_a_slope_within_their_move_limits(sloped: ContactProblem) -> None:
    free = MeshMap.of(sloped)
    alpha = sloped.obstacle.offset
    for sign in (-1.0, 1.0):
        moved = free.positions.values(np.full(free.n, sign))
        for node in sloped.boundary_nodes(("contact",)):
            assert moved[1, node] == pytest.approx(float(ca.DM(alpha(moved[0, node]))), abs=1e-12)
        shift = np.abs(moved - sloped.mesh.p)
        assert np.all(shift[0] <= 0.1 + 1e-12)
        assert np.all(shift[1] <= 0.05 + 1e-12)
        assert np.max(shift[0]) == pytest.approx(0.1)
    q = np.random.default_rng(5).uniform(-1, 1, free.n)
    np.testing.assert_allclose(free.q_of(free.positions.values(q)), q, atol=1e-12)


def test_scaled_areas_are_those_of_the_moved_mesh() -> None:
    problem = EXAMPLES["6.1"](4, 0.6)
    free, validity = MeshMap.of(problem), discretise(problem).validity
    q = np.random.default_rng(2).uniform(-1, 1, free.n)
    _, _, rows, _ = validity.assembled.first(q, None)
    ratios = area_ratios(problem, free.positions.values(q))
    np.testing.assert_allclose(rows, ratios, atol=1e-13)
    areas = signed_areas(free.positions.values(q), problem.triangles)
    np.testing.assert_allclose(ratios * signed_areas(problem.mesh.p, problem.triangles), areas)


@settings(max_examples=15, deadline=None)
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
    base = EXAMPLES["6.1"](4)
    motion = Motion((fraction_of_h / 4, fraction_of_h / 3))
    problem = replace(base, mesh=replace(mesh, doflocs=p), dirichlet=("held",), motion=motion)
    free = MeshMap.of(problem)
    ratio = area_ratios(problem, free.positions.values(np.sign(rng.uniform(-1, 1, free.n))))
    failing = np.flatnonzero(ratio < motion.min_area_fraction * (1 - 1e-9))
    assert set(failing) <= set(discretise(problem).validity.elements)


def test_elements_with_a_validity_row_can_fail() -> None:
    """Each of them does at some corner of its move limits: none is watched for nothing."""
    problem = EXAMPLES["6.1"](4, 0.11)
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


def problem(motion: Motion) -> ContactProblem:
    return ContactProblem(mesh=rectangle(2, 2), law=Laplace(-1.0), dirichlet=("left",), motion=motion)


def squeezed(to: float) -> np.ndarray:
    """Nodes with the middle one at the height ``to``: the least element has 2 ``to`` of its area."""
    nodes = np.array(problem(Motion(delta=None)).mesh.p)
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
    given, nodes = problem(Motion(delta=None, min_area_fraction=0.1)), squeezed(height)
    assert is_upright(given, nodes) is upright
    assert is_valid(given, nodes) is valid
    assert is_valid(given, nodes, by_barrier=True) is upright


@pytest.mark.parametrize("by_barrier", [False, True])
def test_a_least_angle_holds_with_and_without_a_barrier(by_barrier: bool) -> None:
    motion = Motion(delta=None, min_area_fraction=0.01, min_angle=20.0)
    assert is_valid(problem(motion), squeezed(0.5), by_barrier=by_barrier)
    assert not is_valid(problem(motion), squeezed(0.1), by_barrier=by_barrier)
    assert is_valid(problem(replace(motion, min_angle=0.0)), squeezed(0.1), by_barrier=by_barrier)


def test_a_least_angle_is_a_row_of_every_element_that_moves() -> None:
    plain = discretise(problem(Motion(0.01)))
    assert plain.validity.size == 0  # move limits keep all areas
    validity = discretise(problem(Motion(0.01, min_angle=20.0))).validity
    moves = np.any(plain.mesh_map.positions.index >= 0, axis=0)
    assert validity.elements.size == np.sum(np.any(moves[plain.problem.triangles], axis=0)) > 0


@pytest.mark.parametrize("min_angle", [0.0, 5.0])
def test_elements_that_a_shape_moves_have_a_row(min_angle: float) -> None:
    """No node moves but by the shape."""
    design = replace(block(BOW), motion=Motion(0, min_angle=min_angle))
    free, triangles = MeshMap.of(design), design.triangles
    # the last unknowns are the design variables, in units of half the width of their bounds
    count = len(design.design)
    np.testing.assert_allclose((free.upper - free.lower)[-count:], 2)
    moves = np.any(free.positions.values(np.ones(free.n)) != design.mesh.p, axis=0)
    expected = np.flatnonzero(np.any(moves[triangles], axis=0))
    assert expected.size > 0
    np.testing.assert_array_equal(discretise(design).validity.elements, expected)
