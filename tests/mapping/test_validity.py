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


def test_a_least_angle_is_a_row_of_every_element_that_moves() -> None:
    plain = discretise(problem(Motion(0.01)))
    assert plain.validity.size == 0  # move limits keep all areas
    validity = discretise(problem(Motion(0.01, min_angle=20.0))).validity
    moves = np.any(plain.mesh_map.positions.index >= 0, axis=0)
    assert validity.elements.size == np.sum(np.any(moves[plain.problem.triangles], axis=0)) > 0
