"""Least squares to measured displacements: values by hand, derivatives, files, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from skfem import Basis, ElementTriP1, ElementTriP2

import rmesh_nlp as rm
from rmesh_nlp.fem.fit import read_measurements
from rmesh_nlp.fem.objective_text import beside, parse_objective
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes.geometry import relocated_mesh
from rmesh_nlp.models.reduced_model import ReducedObjective
from rmesh_nlp.models.second_derivatives import ObjectiveCurvature
from rmesh_nlp.problem import ContactProblem, DesignVariable
from rmesh_nlp.problem.contact_problem import refined
from rmesh_nlp.solving.outer import Outer
from support.designs import block
from support.reduced import reduced
from support.solved import example
from support.taylor import difference_order, taylor_order


def at_zero(problem: ContactProblem, objective: object) -> float:
    """An objective at the contact solution on the given mesh."""
    outer = Outer.of(problem, objective)  # type: ignore[arg-type]
    return float(outer.function(np.zeros(outer.n)).value)


def still(problem: ContactProblem) -> ContactProblem:
    """The same with nodes that do not move."""
    return replace(problem, motion=rm.Motion(delta=0.05, pinned=tuple(range(problem.mesh.p.shape[1]))))


def test_the_weighted_squares_by_hand() -> None:
    """Order 2 has the parabola u = x (1 - x / 2) exactly."""
    problem = ContactProblem(
        rm.shapes.rectangle(4, 4), rm.Laplace(1.0), "left", rm.Obstacle("right", (1.0,), 9.0), order=2
    )
    points = np.array([[0.1, 0.5, 1.0, 0.61], [0.05, 0.5, 0.3, 0.0]])
    exact = points[0] * (1 - points[0] / 2)
    assert at_zero(still(problem), rm.quantities.fit(points, exact)) == pytest.approx(0, abs=1e-20)
    values = exact + np.array([0.1, -0.2, np.nan, 0.3])
    found = at_zero(still(problem), rm.quantities.fit(points, values, [1.0, 2.0, 7.0, 3.0]))
    assert found == pytest.approx(0.01 + 2 * 0.04 + 3 * 0.09, rel=1e-10)


@pytest.mark.parametrize("order", [1, 2])
def test_derivatives_where_points_are_in_space(order: int) -> None:
    """In triangles whose nodes move, on a boundary along which they slide, and at a corner."""
    problem = replace(example("6.3", (6, 4)), order=order, motion=rm.Motion(delta=0.02))
    points = np.array([[0.9, 2.43, 4.0, 1.0], [0.34, 0.66, 0.0, 1.0]])
    values = np.array([[1e-4, np.nan, -3e-4, 0.0], [-1e-3, -2e-3, np.nan, -1e-3]])
    objective = rm.quantities.fit(points, values, [1, 2, 3, 4])
    energy, rng = reduced(problem), np.random.default_rng(1)
    function = ReducedObjective(energy, objective)
    q, d = rng.uniform(-1, 1, (2, energy.relocation.n_q)) * [[0.3], [1]]
    here = function(q)
    displacement = energy.relocation.displacement.values(energy.point(q, here.equilibrium))
    moved = replace(problem, mesh=relocated_mesh(problem.mesh, energy.relocation.nodes(q)))
    assert here.value == pytest.approx(_by_skfem(moved, displacement, points, values), rel=1e-9)
    assert taylor_order(function, q, d) == pytest.approx(2, abs=0.02)
    hessian = ObjectiveCurvature(energy, objective).at(here)
    np.testing.assert_allclose(hessian.gradient, here.gradient, atol=1e-9 * np.abs(here.gradient).max())
    assert difference_order(lambda x: function(x).gradient, hessian(d), q, d) > 1.9


def _by_skfem(problem: ContactProblem, u: np.ndarray, points: np.ndarray, values: np.ndarray) -> float:
    """The weighted squares, the displacement of order 1 or 2 evaluated by barycentric coordinates."""
    basis = Basis(problem.mesh, ElementTriP1() if problem.order == 1 else ElementTriP2())
    nodal = DisplacementSpace.of(problem).values(u)
    dofs = np.hstack([basis.nodal_dofs, *([basis.facet_dofs] if problem.order == 2 else [])])[0]
    inside = points + 1e-12 * (np.array([[2.0], [0.5]]) - points)
    total = 0.0
    for component, measured in zip(nodal, values, strict=True):
        found = np.zeros(basis.N)
        found[dofs] = component
        there = basis.probes(inside) @ found
        total += float(np.nansum([1, 2, 3, 4] * (there - measured) ** 2))
    return total


FILE = "x, y, ux, uy, weight\n0.9,0.4,1e-4,-1e-3,1\n\n2.2,0.7,,-2e-3,2\n4,0,-3e-4,,3\n"


def test_files_have_empty_cells_and_weights(tmp_path: Path) -> None:
    path = tmp_path / "measured.csv"
    path.write_text(FILE)
    found = read_measurements(path)
    np.testing.assert_array_equal(found.points, [[0.9, 2.2, 4], [0.4, 0.7, 0]])
    np.testing.assert_array_equal(found.values, [[1e-4, np.nan, -3e-4], [-1e-3, -2e-3, np.nan]])
    np.testing.assert_array_equal(found.weights, [1, 2, 3])
    problem = still(example("6.3", (6, 4)))
    same = rm.quantities.fit(found.points, found.values, found.weights)
    assert at_zero(problem, f"2*fit({path}) + area") == pytest.approx(2 * at_zero(problem, same) + 4)
    path.write_text("\ufeffy,x,u\n0.25,0.5,0.1\n")  # as spreadsheets write it
    np.testing.assert_array_equal(read_measurements(path).points, [[0.5], [0.25]])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "expected the columns x, y, u or ux, uy"),
        ("x,y\n0,0\n", "expected the columns"),
        ("x,y,u,u\n0,0,1,1\n", "expected the columns"),
        ("x,y,ux\n0,0,1\n", "expected the columns"),
        ("x,y,ux,uy\n", "nothing is measured"),
        ("x,y,ux,uy\n0,0,,\n", "nothing is measured"),
        ("x,y,ux,uy\n0,0,1\n", "line 2 has 3 cells, expected 4"),
        ("x,y,ux,uy\n\n0,0,1,a\n", "line 3: uy = 'a' is not a number"),
        ("x,y,ux,uy\n,0,1,1\n", "line 2: x = '' is not a number"),
        ("x,y,ux,uy\n0,0,inf,1\n", "must be finite"),
        ("x,y,ux,uy,weight\n0,0,1,1,0\n", "weights must be positive"),
        ("x,y,u\n1,0.5,1\n", "the displacement of .* is ux and uy"),
        ("x,y,ux,uy\n1,2,1,1\n", r"the point \(1, 2\) lies outside of the mesh"),
        ("x,y,ux,uy\n1,0.5,1,1\n", r"the point \(1, 0.5\) may pass into another triangle: pin"),
    ],
)
def test_what_is_wrong_with_measurements_is_said(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "measured.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=said):
        at_zero(example("6.3", (6, 4)), f"fit({path})")


def test_what_cannot_be_found_is_said(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"nowhere\.csv: cannot be read: No such file"):
        at_zero(example("6.3", (6, 4)), f"fit({tmp_path / 'nowhere.csv'})")
    with pytest.raises(ValueError, match=r"expected fit\(FILE\)"):
        parse_objective("fit()")
    with pytest.raises(ValueError, match="expected points"):
        rm.quantities.fit([0.0, 1.0], [1.0])
    free = replace(example("6.3", (6, 4)), motion=rm.Motion(delta=None))
    with pytest.raises(ValueError, match="may pass into another triangle"):
        at_zero(free, rm.quantities.fit([[0.9], [0.4]], [[0.0], [0.0]]))


def test_files_are_beside_the_file_that_names_them() -> None:
    folder = Path("/a/b")
    assert beside("2*fit( m.csv ) + square(fit(c/m.csv) - 1)", folder) == (
        "2*fit(/a/b/m.csv) + square(fit(/a/b/c/m.csv) - 1)"
    )
    assert beside("fit(/m.csv) + mean(fit, -uy)", folder) == "fit(/m.csv) + mean(fit, -uy)"


@pytest.mark.parametrize("formulation", ["nested", "mpcc"])
def test_moduli_and_friction_are_identified(formulation: str) -> None:
    """From the displacement at the lower edge of the same block with other numbers."""
    E, F = DesignVariable("E", 1.0, (0.5, 2.0)), DesignVariable("F", 0.05, (0.0, 0.3))
    problem = replace(block(E, F), motion=rm.Motion(delta=0.0))
    true = rm.solve(problem.at_design({"E": 1.4, "F": 0.2}), "fixed")
    nodes = np.flatnonzero(problem.mesh.p[1] == 0)
    objective = 1e6 * rm.quantities.fit(problem.mesh.p[:, nodes], true.displacement[:, nodes])
    found = rm.solve(problem, formulation, objective=objective)
    assert found.success
    if formulation == "nested":  # mpcc follows two paths
        assert found.record()["iterations"] < 100
    assert found.design["E"] == pytest.approx(1.4, rel=1e-4)
    assert found.design["F"] == pytest.approx(0.2, rel=1e-3)


def test_the_gain_is_measured_on_refined_meshes_whose_triangles_a_point_could_leave() -> None:
    problem = replace(example("6.3", (6, 4)), motion=rm.Motion(delta=0.02))
    objective = 1e6 * rm.quantities.fit([[0.99], [0.3]], [[np.nan], [-2e-3]])
    with pytest.raises(ValueError, match="may pass into another triangle"):
        at_zero(refined(problem), objective)
    solution = rm.solve(problem, "nested", objective=objective)
    assert solution.success
    assert np.isfinite(solution.record()["gain_surviving"])
