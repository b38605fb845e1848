"""Which elements are valid: by a barrier, by a least area, by a least angle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.discretisation import discretise
from rmesh_nlp.mapping.validity import is_upright, is_valid
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Laplace, Motion


def problem(motion: Motion) -> ContactProblem:
    return ContactProblem(mesh=rectangle(2, 2), law=Laplace(-1.0), dirichlet=("left",), motion=motion)


def squeezed(to: float) -> np.ndarray:
    """Nodes with the middle one at the height ``to``: the least element has 2 ``to`` of its area."""
    given = problem(Motion(delta=None))
    nodes = np.array(given.mesh.p)
    middle = np.flatnonzero(np.all(nodes == 0.5, axis=0))
    assert middle.size == 1
    nodes[1, middle] = to
    return nodes


@pytest.mark.parametrize(("height", "valid"), [(0.5, True), (0.06, True), (0.04, False), (-0.1, False)])
def test_a_least_area_is_a_fraction_of_the_given_one(height: float, valid: bool) -> None:
    assert is_valid(problem(Motion(delta=None, min_area_fraction=0.1)), squeezed(height)) is valid


@pytest.mark.parametrize(("height", "valid"), [(0.5, True), (0.04, True), (1e-9, True), (-1e-9, False)])
def test_with_a_barrier_a_positive_area_is_enough(height: float, valid: bool) -> None:
    motion = Motion(delta=None, min_area_fraction=0.1)
    assert bool(is_valid(problem(motion), squeezed(height), by_barrier=True)) is valid


@pytest.mark.parametrize("by_barrier", [False, True])
def test_a_least_angle_holds_with_and_without_a_barrier(by_barrier: bool) -> None:
    motion = Motion(delta=None, min_area_fraction=0.01, min_angle=20.0)
    assert is_valid(problem(motion), squeezed(0.5), by_barrier=by_barrier)
    assert not is_valid(problem(motion), squeezed(0.1), by_barrier=by_barrier)
    assert is_valid(problem(replace(motion, min_angle=0.0)), squeezed(0.1), by_barrier=by_barrier)


@pytest.mark.parametrize("min_angle", [0.0, 20.0])
def test_an_inverted_element_is_not_a_number_and_no_other_is(min_angle: float) -> None:
    stated = problem(Motion(delta=None, min_area_fraction=0.1, min_angle=min_angle))
    validity = discretise(stated).validity
    area0 = 0.125
    for height, inverted in ((0.5, False), (1e-6, False), (-1e-6, True), (-0.3, True)):
        corners = np.array([[0.0, 0.5, 0.0], [0.0, 0.0, height]]).ravel(order="F")
        given = np.asarray(validity.group.function(corners, area0)[1]).ravel()
        upright = np.asarray(validity.upright_group.function(corners, area0)[1]).ravel()
        assert not np.any(np.isnan(given))
        assert np.any(np.isnan(upright)) == inverted
        if not inverted:
            assert np.array_equal(upright, given)


@pytest.mark.parametrize(("height", "upright"), [(0.5, True), (1e-9, True), (0.0, False), (-1e-9, False)])
def test_one_flat_element_is_enough(height: float, upright: bool) -> None:
    assert is_upright(problem(Motion(delta=None, min_area_fraction=0.1)), squeezed(height)) is upright


def test_a_least_angle_is_a_row_of_every_element_that_moves() -> None:
    plain = discretise(problem(Motion(0.01)))
    assert plain.validity.size == 0  # move limits keep all areas
    validity = discretise(problem(Motion(0.01, min_angle=20.0))).validity
    moves = np.any(plain.mesh_map.positions.index >= 0, axis=0)
    assert validity.elements.size == np.sum(np.any(moves[plain.problem.triangles], axis=0)) > 0
