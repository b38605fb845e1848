"""Meshes and series out: gmsh's physical groups by name, frames by number, tables by column."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.io.export import Series, element_table, gaps, node_table, write_mesh
from rmesh_nlp.mapping import MeshMap
from rmesh_nlp.meshes import read_mesh
from rmesh_nlp.problem import ContactProblem, Motion, Obstacle, PlaneStrain
from rmesh_nlp.solving.parts import Step
from support.formulations import fixed


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
    mesh = rm.shapes.rectangle(3, 2).with_subdomains(
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


def test_a_mesh_without_names_is_triangles_alone(tmp_path: Path) -> None:
    mesh = replace(rm.shapes.rectangle(2, 1), _boundaries=None, _subdomains=None)
    write_mesh(mesh, tmp_path / "mesh.msh")
    file = meshio.read(tmp_path / "mesh.msh")
    assert [block.type for block in file.cells] == ["triangle"]
    assert file.field_data == {}
    x, y = file.points[:, :2].T
    a, b, c = file.cells[0].data.T
    assert np.all((x[b] - x[a]) * (y[c] - y[a]) - (x[c] - x[a]) * (y[b] - y[a]) > 0)
    np.testing.assert_array_equal(file.points[:, 2], 0)


@pytest.fixture(scope="module")
def problem() -> ContactProblem:
    obstacles = (Obstacle("bottom", (0.0, 1.0), 0.3), Obstacle("bottom", (0.0, 1.0), 0.1))
    law = PlaneStrain(50.0, 50.0, body_force=(0.0, -1.0))
    return ContactProblem(rm.shapes.rectangle(3, 2), law, ("left",), obstacles[1], Motion(0.05))


def test_frames_are_the_first_every_so_many_and_the_last(problem: ContactProblem, tmp_path: Path) -> None:
    def step(k: int, q: bool = True) -> Step:
        n = fixed_freedoms
        return Step(k, 0.0, 0.0, 0.0, 0.0, 0, 0.0, np.full(n, 0.1 * k) if q else None)

    fixed_freedoms = MeshMap.of(problem).n
    series = Series(problem, every=3)
    for k in range(6):
        series(step(k))
    series(step(99, q=False))  # without positions there is nothing to draw
    assert series.frames == 6
    expected = [f"run-{k:05d}.vtu" for k in (0, 3, 5)]
    assert series.names("run") == ["run.pvd", *expected]
    series.write(tmp_path, "run")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(["run.pvd", *expected])
    last = meshio.read(tmp_path / expected[-1])
    positions = MeshMap.of(problem).positions.values(np.full(fixed_freedoms, 0.5))
    np.testing.assert_allclose(last.points[:, :2].T, positions)
    motion = last.point_data["motion"]
    np.testing.assert_allclose(motion[:, :2].T, positions - problem.mesh.p, atol=1e-15)
    np.testing.assert_array_equal(motion[:, 2], 0)
    single = Series(problem)
    single(step(0))
    assert len(single.names()) == 2
    assert Series(problem).names() == ["iterations.pvd"]


def test_gaps_are_measured_along_the_normal(problem: ContactProblem) -> None:
    """A flat foundation 0.1 below a body that sinks by 0.03 and shifts by 0.5."""
    u = np.stack([np.full(problem.mesh.p.shape[1], 0.5), np.full(problem.mesh.p.shape[1], -0.03)])
    found = gaps(problem, np.asarray(problem.mesh.p), u)
    np.testing.assert_allclose(found[problem.contact_nodes], 0.07, rtol=1e-12)
    off = np.setdiff1d(np.arange(found.size), problem.contact_nodes)
    assert off.size
    assert np.all(np.isnan(found[off]))


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
    membrane = element_table(fixed.solve(rm.EXAMPLES["6.1"](3)))
    assert {"flux_x", "flux_y"} <= set(membrane)
    assert "stress_xx" not in membrane
