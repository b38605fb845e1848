"""Results out: fields where they belong, meshes with the names of their parts, series of iterates, tables."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from rich.console import Console

from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.io.export import Series, element_table, gaps, node_table, write_mesh, write_solution
from rmesh_nlp.io.vtu import read_vtu
from rmesh_nlp.mapping import MeshMap
from rmesh_nlp.meshes import read_mesh
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Laplace, Motion, Obstacle, PlaneStrain, Relative, Traction
from rmesh_nlp.solving.parts import Step
from rmesh_nlp.solving.solution import Solution
from support.formulations import fixed, joint, nested


@pytest.fixture(scope="module")
def problem() -> ContactProblem:
    return ContactProblem(
        rectangle(6, 3, x=(0, 2), diagonal="falling"),
        PlaneStrain(100.0, 80.0),
        ("left",),
        Obstacle.graph("bottom", -0.02, friction=0.5),
        Motion(Relative(0.3)),
        (Traction("top", (0.5, -4.0)),),
        name="small <&>",
    )


@pytest.fixture(scope="module")
def solution(problem: ContactProblem) -> Solution:
    return joint.solve(problem)


def test_file_has_all_fields(solution: Solution, tmp_path: Path) -> None:
    path = tmp_path / "s.vtu"
    write_solution(solution, path)
    file = meshio.read(path)
    nodes, cells = file.point_data, {name: data[0] for name, data in file.cell_data.items()}
    assert {"tangential_stress", "friction_bound", "contact", "foundation", "mobility"} <= set(nodes)
    assert {"stress", "von_mises", "least_angle", "zone"} <= set(cells)
    multipliers = solution.multipliers
    assert multipliers is not None
    np.testing.assert_array_equal(nodes["box_multiplier"], multipliers.limit)
    assert np.any(multipliers.limit != 0)
    np.testing.assert_array_equal(cells["area_multiplier"], multipliers.area)
    np.testing.assert_allclose(nodes["initial_position"] + nodes["motion"], file.points, atol=1e-15)
    touching = nodes["pressure"] > 0
    assert np.any(touching)
    np.testing.assert_allclose(nodes["gap"][touching], 0, atol=1e-15)
    assert np.all(np.isnan(np.delete(nodes["gap"], solution.problem.contact_nodes)))
    np.testing.assert_array_equal(read_vtu(path).displacement, solution.displacement)
    areas = []
    for points in (nodes["initial_position"], file.points):
        (x0, y0), (x1, y1), (x2, y2) = (points[file.cells[0].data[:, k], :2].T for k in range(3))
        areas.append((x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0))
    np.testing.assert_allclose(cells["area_ratio"], areas[1] / areas[0], rtol=1e-12)
    assert np.ptp(cells["area_ratio"]) > 0.01


def test_a_space_with_another_numbering_writes_the_same_fields_at_the_same_places(
    problem: ContactProblem, solution: Solution, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_solution(solution, tmp_path / "one.vtu")
    series, q = Series(problem), np.full(MeshMap.of(problem).n, 0.01)
    series(Step(0, 0.0, 0.0, 0.0, 0.0, 0, 0.0, q))
    series.write(tmp_path, "one", solution.pressure)
    order = np.random.default_rng(3).permutation(problem.mesh.p.shape[1])
    monkeypatch.setattr(DisplacementSpace, "of", staticmethod(lambda made: DisplacementSpace(made, order)))
    back = np.argsort(order)
    permuted = replace(
        solution,
        displacement=solution.displacement[:, back],
        pressure=solution.pressure[back],
        tangential_stress=solution.tangential_stress[back],
    )
    write_solution(permuted, tmp_path / "two.vtu")
    series.write(tmp_path, "two", permuted.pressure)
    for name, other in (("one.vtu", "two.vtu"), ("one-00000.vtu", "two-00000.vtu")):
        found, theirs = meshio.read(tmp_path / name), meshio.read(tmp_path / other)
        np.testing.assert_array_equal(theirs.points[order], found.points)
        np.testing.assert_array_equal(theirs.cells[0].data, order[found.cells[0].data])
        assert set(theirs.point_data) == set(found.point_data)
        for field, values in found.point_data.items():
            np.testing.assert_allclose(theirs.point_data[field][order], values, atol=1e-12, err_msg=field)
    np.testing.assert_array_equal(node_table(permuted)[["x", "y"]].to_numpy()[order], solution.mesh.p.T)
    assert np.array_equal(element_table(permuted)["node_2"], order[problem.triangles[1]])


def test_multipliers_of_angles_are_in_the_file(problem: ContactProblem, tmp_path: Path) -> None:
    limited = joint.solve(replace(problem, motion=Motion(Relative(0.9), min_angle=25.0)))
    path = tmp_path / "angles.vtu"
    write_solution(limited, path)
    written = meshio.read(path).cell_data["angle_multiplier"][0]
    assert np.any(written > 0)
    np.testing.assert_array_equal(written, limited.multipliers.angle)


def grouped(path: Path) -> dict[str, set[frozenset[tuple[float, ...]]]]:
    """The cells of each physical group of a gmsh file, as sets of corner positions, by name and dimension."""
    mesh = meshio.read(path)
    found: dict[str, set[frozenset[tuple[float, ...]]]] = {}
    for name, (number, dimension) in mesh.field_data.items():
        kind = {1: "line", 2: "triangle"}[int(dimension)]
        for block, tags in zip(mesh.cells, mesh.cell_data["gmsh:physical"], strict=True):
            if block.type == kind:
                cells = block.data[np.asarray(tags) == number]
                found.setdefault(name, set()).update(
                    frozenset(tuple(mesh.points[v, :2].tolist()) for v in cell) for cell in cells
                )
    return found


def corners(mesh: Any, cells: Any) -> set[frozenset[tuple[float, ...]]]:
    return {frozenset(tuple(mesh.p[:, v].tolist()) for v in cell) for cell in np.asarray(cells).T}


def test_names_of_boundaries_and_subdomains_are_groups_of_gmsh(tmp_path: Path) -> None:
    mesh = rectangle(3, 2).with_subdomains(
        {"soft": lambda x: x[0] < 0.4, "low": lambda x: x[1] < 0.5, "gmsh:other": lambda x: x[0] > 0.6}
    )
    path = tmp_path / "mesh.msh"
    write_mesh(mesh, path)
    found = grouped(path)
    assert set(found) == {"left", "right", "top", "bottom", "soft", "low"}
    for name in ("left", "right", "top", "bottom"):
        assert found[name] == corners(mesh, mesh.facets[:, mesh.boundaries[name]])
    assert found["soft"] == corners(mesh, mesh.t[:, mesh.subdomains["soft"]])
    # a triangle is written once, under its first name
    only_low = np.setdiff1d(mesh.subdomains["low"], mesh.subdomains["soft"])
    assert found["low"] == corners(mesh, mesh.t[:, only_low])
    file = meshio.read(path)
    assert sum(len(b.data) for b in file.cells if b.type == "triangle") == mesh.t.shape[1]
    numbers = [int(number) for number, _ in file.field_data.values()]
    assert sorted(numbers) == list(range(1, 7))  # each its own, from one on
    again = read_mesh(path)
    assert corners(again, again.t) == corners(mesh, mesh.t)
    assert {name: len(v) for name, v in again.boundaries.items()} == {
        name: len(v) for name, v in mesh.boundaries.items()
    }


def test_mesh_without_names_is_triangles_alone(tmp_path: Path) -> None:
    mesh = replace(rectangle(2, 1), _boundaries=None, _subdomains=None)
    write_mesh(mesh, tmp_path / "mesh.msh")
    file = meshio.read(tmp_path / "mesh.msh")
    assert [block.type for block in file.cells] == ["triangle"]
    assert file.field_data == {}
    x, y = file.points[:, :2].T
    a, b, c = file.cells[0].data.T
    assert np.all((x[b] - x[a]) * (y[c] - y[a]) - (x[c] - x[a]) * (y[b] - y[a]) > 0)
    np.testing.assert_array_equal(file.points[:, 2], 0)


@pytest.mark.parametrize(
    ("every", "most", "kept"),
    [
        (1, None, list(range(12))),
        (5, None, [0, 5, 10, 11]),
        (1, 12, list(range(12))),
        (1, 5, [0, 3, 6, 9, 11]),
        (4, 12, [0, 4, 8, 11]),
        (1, 2, [0, 11]),
        (1, 1, [0, 11]),
    ],
)
def test_series_keeps_frames_evenly_and_both_ends(
    problem: ContactProblem, every: int, most: int | None, kept: list[int]
) -> None:
    series = Series(problem, every, most)
    assert series.names() == ["iterations.pvd"]
    for number in range(12):
        series(Step(number, 0.0, 0.0, 0.0, 0.0, 0, 0.0, np.zeros(1)))
    series(Step(99, 0.0, 0.0, 0.0, 0.0, 0, 0.0, None))  # without positions there is nothing to draw
    assert series.frames == 12
    assert series.names("s") == ["s.pvd", *(f"s-{number:05d}.vtu" for number in kept)]


def test_frames_are_drawn_at_their_outer_variables(problem: ContactProblem, tmp_path: Path) -> None:
    positions = MeshMap.of(problem).positions.values
    series, q = Series(problem), np.full(MeshMap.of(problem).n, 0.01)
    for number in range(3):
        series(Step(number, 0.0, 0.0, 0.0, 0.0, 0, 0.0, number * q))
    series.write(tmp_path, "run")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(series.names("run"))
    last = meshio.read(tmp_path / "run-00002.vtu")
    np.testing.assert_allclose(last.points[:, :2].T, positions(2 * q))
    expected = np.vstack([positions(2 * q) - problem.mesh.p, np.zeros(problem.mesh.p.shape[1])])
    np.testing.assert_allclose(last.point_data["motion"].T, expected, atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("module", [joint, nested])
def test_series_plays_the_iterates(problem: ContactProblem, tmp_path: Path, module: object) -> None:
    series = Series(problem, every=5)
    final = module.solve(problem, on_step=series)
    root = ET.parse(series.write(tmp_path)).getroot()
    frames = [element.attrib["file"] for element in root.iter("DataSet")]
    assert len(frames) >= 3
    first, last = (meshio.read(tmp_path / frame) for frame in (frames[0], frames[-1]))
    np.testing.assert_allclose(first.points[:, :2].T, problem.mesh.p, atol=0.02)
    np.testing.assert_allclose(last.points[:, :2].T, final.mesh.p, atol=1e-6)
    np.testing.assert_allclose(last.point_data["displacement"][:, :2].T, final.displacement, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("components", [1, 2])
def test_frames_of_a_series_have_the_displacement_of_their_mesh(tmp_path: Path, components: int) -> None:
    """One value per node for a scalar problem, three for an elastic one, which is what viewers warp by."""
    if components == 1:
        made = ContactProblem(
            rectangle(3, 3), Laplace(-2.0), ("left",), Obstacle("right", (1.0,), 0.01), Motion(0.05)
        )
    else:
        made = ContactProblem(
            rectangle(3, 2), PlaneStrain(9.0, 8.0, (0.0, -1.0)), ("left",),
            Obstacle("bottom", (0.0, 1.0), 0.01), Motion(0.05),
        )  # fmt: skip
    series = Series(made)
    nested.solve(made, max_iterations=2, on_step=series)
    root = ET.parse(series.write(tmp_path)).getroot()
    frames = [meshio.read(tmp_path / element.attrib["file"]) for element in root.iter("DataSet")]
    assert len(frames) >= 2
    for frame in frames:
        moved = replace(made, mesh=replace(made.mesh, doflocs=frame.points[:, :2].T))
        expected = fixed.solve(moved).displacement
        found = frame.point_data["displacement"]
        assert found.shape == ((expected.shape[1],) if components == 1 else (expected.shape[1], 3))
        np.testing.assert_allclose(
            found.reshape(expected.shape[1], -1)[:, :components].T, expected, atol=1e-9
        )


def test_gap_is_the_distance_along_the_normal_to_the_nearer_foundation() -> None:
    """A body 0.1 above a floor and 0.3 beside a wall, which sinks by 0.03 and moves away by 0.5."""
    sides = (Obstacle("bottom", (0.0, 1.0), 0.1), Obstacle("left", (1.0, 0.0), 0.3))
    problem = ContactProblem(rectangle(2, 2), PlaneStrain(1.0, 1.0), "right", sides)
    u = np.stack([np.full(problem.mesh.p.shape[1], 0.5), np.full(problem.mesh.p.shape[1], -0.03)])
    x, y = problem.mesh.p
    expected = np.select([(y == 0) & (x < 1), (x == 0) & (y > 0)], [0.07, 0.8], np.nan)
    np.testing.assert_allclose(gaps(DisplacementSpace.of(problem), problem.mesh.p, u), expected, rtol=1e-12)


def test_tables_have_a_column_for_each_component(problem: ContactProblem) -> None:
    solution = fixed.solve(problem)
    nodes, elements = node_table(solution), element_table(solution)
    assert {"x", "y", "displacement_x", "displacement_y", "motion_x", "motion_y", "gap", "pressure"} <= set(
        nodes
    )
    assert not {"motion_z", "displacement", "motion"} & set(nodes)
    np.testing.assert_array_equal(nodes["x"], problem.mesh.p[0])
    np.testing.assert_array_equal(nodes["y"], problem.mesh.p[1])
    np.testing.assert_array_equal(nodes["displacement_y"], solution.displacement[1])
    assert {"stress_xx", "stress_yy", "stress_xy", "stress_zz", "von_mises", "zone"} <= set(elements)
    np.testing.assert_array_equal(elements[["node_1", "node_2", "node_3"]].T, problem.triangles)
    membrane = element_table(fixed.solve(ContactProblem(rectangle(3, 3), Laplace(-2.0), ("left",))))
    assert {"flux_x", "flux_y"} <= set(membrane)
    assert "stress_xx" not in membrane


def test_displays_escape_and_tell(problem: ContactProblem, solution: Solution) -> None:
    html = solution._repr_html_() + problem._repr_html_()
    assert "small &lt;&amp;&gt;" in html
    assert f"{solution.energy:.6g}" in html
    console = Console(width=100, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(problem, solution)
    text = console.export_text()
    assert "PlaneStrain" in text
    assert "converged" in text
