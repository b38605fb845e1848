"""Deformed bodies are drawn over the foundation as the curve that it is in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from matplotlib.axes import Axes

from rmesh_nlp.io.vtu import fields_of
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Dirichlet, Motion, Obstacle, PlaneStrain
from rmesh_nlp.report.before_after import pictures
from rmesh_nlp.report.foundations import displaced, magnification
from rmesh_nlp.report.grids import grid_figure
from rmesh_nlp.report.page import Page
from rmesh_nlp.solving.solution import Solution
from support.formulations import fixed

BELOW = 0.002
"""Gap of the lowest node of the block."""


@cache
def pressed(rise: float) -> Solution:
    """A block pressed onto a flat foundation; its bottom rises by ``rise`` to both sides."""
    mesh = rectangle(6, 2, x=(-1, 1))
    x, y = mesh.p
    problem = ContactProblem(
        mesh=replace(mesh, doflocs=np.stack([x, y + rise * x**2 * (1 - y)])),
        law=PlaneStrain.from_young(1000.0, 0.3),
        dirichlet=(Dirichlet("top", (0.0, -0.01)),),
        obstacle=Obstacle.line("bottom", (0.0, -BELOW), (0.0, 1.0)),
        motion=Motion(0.1),
    )
    return fixed.solve(problem)


def drawings(solution: Solution) -> Sequence[Axes]:
    """Both pictures that show the deformed body."""
    meshes = next(figure for name, figure in pictures(solution, Page()) if name == "mesh")
    return [meshes.axes[1], grid_figure({"it": fields_of(solution)}).axes[1]]


@pytest.mark.parametrize(("rise", "factor"), [(0.0, 10), (0.3, 1)])
def test_flat_foundation_stays_flat_and_is_touched(rise: float, factor: int) -> None:
    solution = pressed(rise)
    assert np.any(solution.pressure > 0)
    for axis in drawings(solution):
        assert axis.get_title() == (
            f"deformed, u and gap × {factor}" if factor > 1 else "deformed, true scale"
        )
        ground = np.vstack([path.vertices for c in axis.collections for path in c.get_paths()])
        body = np.asarray(axis.lines[0].get_xydata())
        assert np.ptp(ground[:, 1]) < 1e-12
        assert ground[0, 1] == pytest.approx(-factor * BELOW)
        assert np.nanmin(body[:, 1]) == pytest.approx(ground[0, 1], abs=1e-9)


def test_displacements_are_magnified_as_far_as_the_gap_allows() -> None:
    u, even = np.full((2, 3), 1e-4), np.tile([[0.0], [-0.1]], 4)
    uneven = np.array([[0.0] * 4, [-0.1, -0.1, -0.1, -0.099]])
    assert magnification([u], [], 1.0) == magnification([u], [even], 1.0) == 500.0
    assert magnification([u], [even, uneven], 1.0) == 2.0  # further, 0.75e-3 of gap were seen
    assert magnification([0 * u], [even], 1.0) == magnification([1e4 * u], [even], 1.0) == 1.0
    np.testing.assert_allclose(displaced(even, even, 5.0), 5 * even)
