"""Sides of rounded coordinates are straight, arcs of the same coordinates are not."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from skfem import MeshTri

import rmesh_nlp as rm
from rmesh_nlp.meshes import MeshRepairWarning
from rmesh_nlp.problem.lines import onto_lines, sliding_directions

FORMS = ["%.8g", "%.7g", "%.6f", "%.6g", "%.5f"]


def turned(form: str, sagitta: float, n: int, size: float, offset: float = 0.0) -> MeshTri:
    """A block turned by 20 degrees whose lower side is straight, or an arc, with coordinates as in a file."""
    grid = rm.shapes.rectangle(n, 4, x=(0, 4))
    x, y = grid.p
    y = y - 4 * sagitta * x * (1 - x / 4) * (1 - y)
    a = np.deg2rad(20)
    p = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) @ [x, y] * size / 4 + offset
    return replace(grid, doflocs=np.array([[float(form % v) for v in row] for row in p]))


@pytest.mark.parametrize(("size", "offset"), [(4.0, 0.0), (70.0, 10.0)])
@pytest.mark.parametrize("form", FORMS)
def test_nodes_of_rounded_straight_sides_slide_along_them(form: str, size: float, offset: float) -> None:
    mesh = turned(form, 0.0, 16, size, offset)
    with pytest.warns(MeshRepairWarning, match="on but for rounding"):
        problem = rm.ContactProblem(mesh, rm.Laplace(1.0), "left", rm.Obstacle("bottom", (1.0,), 1.0))
    assert np.max(np.abs(problem.mesh.p - mesh.p)) < 1e-5 * size
    _, tangents = sliding_directions(problem)
    sides = [np.unique(mesh.facets[:, facets]) for facets in mesh.boundaries.values()]
    node, count = np.unique(np.concatenate(sides), return_counts=True)
    np.testing.assert_array_equal(np.any(tangents[:, node] != 0, axis=0), count == 1)  # all but corners
    assert onto_lines(problem.mesh) is problem.mesh


@pytest.mark.parametrize(("form", "sagitta", "warns"), [("%.3f", 0, 1), ("%.5f", 0, 0), ("%.5f", 0.01, 0)])
def test_nodes_that_rounding_alone_takes_off_a_line_are_told(form: str, sagitta: float, warns: int) -> None:
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        onto_lines(turned(form, sagitta, 16, 4.0))
    assert sum("up to 0.000" in str(one.message) for one in said) == warns


@pytest.mark.parametrize("n", [8, 64, 200])
@pytest.mark.parametrize("form", ["%.17g", *FORMS])
@pytest.mark.parametrize("sagitta", [1e-3, -3e-4])
def test_arcs_are_no_straight_sides(sagitta: float, form: str, n: int) -> None:
    mesh = turned(form, sagitta, n, 4.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshRepairWarning)  # of the other sides
        found = onto_lines(mesh)
    bottom = np.unique(mesh.facets[:, mesh.boundaries["bottom"]])
    np.testing.assert_array_equal(found.p[:, bottom], mesh.p[:, bottom])
