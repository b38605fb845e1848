"""Deformed bodies over foundations as the curves that they are in space, and fields as colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from matplotlib.axes import Axes

from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.io.vtu import fields_of
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Dirichlet, Motion, Obstacle, PlaneStrain
from rmesh_nlp.report.drawing import Body, Foundation, foundations, magnification, window
from rmesh_nlp.report.figures import grid_figure
from rmesh_nlp.report.pictures import pictures
from rmesh_nlp.report.style import Page, new_figure
from rmesh_nlp.solving.plotting import draw_along, draw_elements, draw_mesh, draw_nodal
from rmesh_nlp.solving.solution import Solution
from support.formulations import fixed
from support.orders import ORDERS

BELOW = 0.002
"""Gap of the lowest node of the block."""


@cache
def pressed(rise: float, order: int = 1) -> Solution:
    """A block pressed onto a flat foundation; its bottom rises by ``rise`` to both sides."""
    mesh = rectangle(6, 2, x=(-1, 1))
    x, y = mesh.p
    problem = ContactProblem(
        mesh=replace(mesh, doflocs=np.stack([x, y + rise * x**2 * (1 - y)])),
        law=PlaneStrain.from_young(1000.0, 0.3),
        dirichlet=(Dirichlet("top", (0.0, -0.01)),),
        obstacle=Obstacle.line("bottom", (0.0, -BELOW), (0.0, 1.0)),
        motion=Motion(0.1),
        order=order,
    )
    return fixed.solve(problem)


def drawings(solution: Solution) -> Sequence[Axes]:
    """Both pictures that show the deformed body."""
    meshes = next(figure for name, figure in pictures(solution, Page()) if name == "mesh")
    return [meshes.axes[1], grid_figure({"it": fields_of(solution)}).axes[1]]


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(("rise", "factor"), [(0.0, 10), (0.3, 1)])
def test_flat_foundation_stays_flat_and_is_touched(rise: float, factor: int, order: int) -> None:
    solution = pressed(rise, order)
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


def body(displacement: np.ndarray, *ways: np.ndarray) -> Body:
    """A body of extent 1, with foundations at the given ways (2, points) from its contact boundaries."""
    nodes, none = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), np.zeros((2, 0))
    starts = [np.zeros((2, 1, way.shape[1])) for way in ways]
    known = [
        Foundation("", none[0], none, none, start, way[:, None], False)
        for start, way in zip(starts, ways, strict=True)
    ]
    return Body(nodes, np.array([[0], [1], [2]]), displacement, tuple(known))


@pytest.mark.parametrize(("below", "is_far"), [(1.9, False), (2.1, True)])
def test_foundation_farther_than_the_body_is_long_is_not_drawn(below: float, is_far: bool) -> None:
    problem = replace(pressed(0.0).problem, obstacle=Obstacle.line("bottom", (0.0, -below), (0.0, 1.0)))
    (one,) = foundations(DisplacementSpace.of(problem), problem.mesh.p)
    assert (one.name, one.is_far) == ("bottom", is_far)
    np.testing.assert_allclose(one.gaps, below)


def test_displacements_are_magnified_as_far_as_the_gap_allows() -> None:
    u, even = np.full((2, 3), 1e-4), np.tile([[0.0], [-0.1]], 4)
    uneven = np.array([[0.0] * 4, [-0.1, -0.1, -0.1, -0.099]])
    assert magnification([body(u)]) == magnification([body(u, even)]) == 500.0
    assert magnification([body(u, even, uneven)]) == 2.0  # further, 0.75e-3 of gap were seen
    assert magnification([body(u, even), body(u, uneven)]) == 2.0
    assert magnification([body(0 * u, even)]) == magnification([body(1e4 * u, even)]) == 1.0
    (near,) = body(u, even).near
    np.testing.assert_allclose(near.displaced(5.0)[:, 0], 5 * even)


def test_a_window_holds_the_body_its_motion_and_what_is_near_of_the_foundation() -> None:
    still = body(np.zeros((2, 3)), np.tile([[0.0], [-5.0]], 4))
    np.testing.assert_allclose(window([still]), [[-0.02, 1.02]] * 2)
    # the foundation is seen up to 0.15 of the extent below the body
    np.testing.assert_allclose(window([still], 1.0), [[-0.023, 1.023], [-0.173, 1.023]])
    np.testing.assert_allclose(window([body(np.full((2, 3), 0.1))], 10.0), [[-0.04, 2.04]] * 2)


@pytest.mark.parametrize(
    ("columns", "height", "size", "rows"),
    [
        (1, 0.5, (3.35, 2 * (2.6 * 0.5 + 0.62)), 2),  # flat bodies stand one below the other
        (2, 0.5, (7.0, 3.125 * 0.5 + 0.62), 1),
        (2, 9.0, (7.0, 3.125 * 2 + 0.62), 1),  # as tall as twice their width at most
    ],
)
def test_panels_fill_the_width_of_the_page(columns, height, size, rows) -> None:
    figure, axes = Page(columns).panels(2, [np.array([[0.0, 1.0], [0.0, height]])], "mm")
    assert figure.get_size_inches() == pytest.approx(size)
    assert axes.shape == (1, 2)
    assert axes[0, 0].get_gridspec().nrows == rows
    assert axes[0, 0].get_ylabel() == "$x_2$ [mm]"
    assert axes[0, 0].get_ylim() == (0.0, height)


@pytest.mark.parametrize("fine", [True, False])
def test_lines_of_fine_meshes_are_rasterised_and_fields_always(fine, monkeypatch) -> None:
    monkeypatch.setattr("rmesh_nlp.solving.plotting.FINE", 1 if fine else 100)
    mesh, axis = rectangle(3, 2), new_figure(2, 2).subplots()
    draw_mesh(axis, mesh.p, mesh.t)
    assert all(line.get_rasterized() is fine for line in axis.lines)
    assert mesh.p.shape == (2, 12)
    assert mesh.t.shape == (3, 12)  # so that the number of values does not tell what they belong to
    smooth = draw_nodal(axis, mesh.p, mesh.t, 2 * mesh.p[0])
    constant = draw_elements(axis, mesh.p, mesh.t, np.arange(mesh.t.shape[1]))
    assert (type(smooth).__name__, type(constant).__name__) == ("TriMesh", "PolyCollection")
    assert smooth.get_rasterized()
    assert constant.get_rasterized()
    np.testing.assert_array_equal(smooth.get_array(), 2 * mesh.p[0])
    np.testing.assert_array_equal(constant.get_array(), np.arange(mesh.t.shape[1]))


QUADRATIC = np.array([[0], [1], [2], [3], [4], [5]])
"""One element with its nodes in order."""


def test_edges_of_quadratic_elements_are_bent_and_their_fields_drawn_in_pieces() -> None:
    nodes = np.array([[0.0, 1.0, 0.0, 0.5, 0.5, 0.0], [0.0, 0.0, 1.0, 0.1, 0.5, 0.5]])
    axis = new_figure(2, 2).subplots()
    draw_mesh(axis, nodes, QUADRATIC)
    drawn = axis.lines[0].get_xydata()
    below = drawn[(drawn[:, 0] > 0) & (drawn[:, 1] < 0.11)]
    np.testing.assert_allclose(below[:, 1], 0.4 * below[:, 0] * (1 - below[:, 0]), atol=1e-12)
    assert len(below) >= 7
    painted = draw_nodal(axis, nodes, QUADRATIC, nodes[0] ** 2)
    values = painted.get_array()
    assert values.size > 30
    assert (values.min(), values.max()) == (0.0, 1.0)
    flat = draw_elements(axis, nodes, QUADRATIC, np.array([7.0]))
    np.testing.assert_array_equal(flat.get_array(), 7.0)
    assert flat.get_array().size > 30


def test_a_curve_along_edges_stays_between_the_values_at_their_nodes() -> None:
    nodes = np.array([[0.0, 2.0, 1.0, 4.0, 3.0, 5.0], [0.0] * 6])
    edges = np.array([[0, 1], [1, 3], [2, 4]])
    values = np.array([8.0, 0.0, 4.0, 0.0, 1.0, 9.0])
    axis = new_figure(2, 2).subplots()
    draw_along(axis, nodes, (np.array([3, 1, 0, 2, 4, 5]), edges), values, 0, marker="o")
    (line,) = axis.lines
    x, y = line.get_xydata().T
    assert np.all(np.diff(x) > 0)
    np.testing.assert_array_equal(x[line.get_markevery()], np.arange(6.0))  # marks at the nodes
    np.testing.assert_allclose(y[x <= 2], 8 - 4 * x[x <= 2], atol=1e-12)  # a parabola through a line is one
    inside = (x > 2) & (x < 4)
    assert np.count_nonzero(inside) == 7  # six between the nodes, and the one in the middle
    assert np.all((y[inside] > 0) & (y[inside] <= 1.0))
    assert np.count_nonzero(x > 4) == 1  # no edge is known there
    draw_along(axis, nodes, (np.array([0, 1, 2, 3, 4, 5]), edges), np.array([4.0, 0, 0, 0, 0, 0]), 0)
    assert np.min(axis.lines[1].get_ydata()) == 0.0
