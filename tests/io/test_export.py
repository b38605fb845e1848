"""Results out: every field where it belongs, series, tables, displays; motions prolonged."""

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest
from rich.console import Console

from formulations.refined import prolong
from rmesh_nlp.io.export import Series, gaps, write_solution
from rmesh_nlp.io.vtu import read_vtu
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import (
    ContactProblem,
    Laplace,
    Motion,
    Obstacle,
    PlaneStrain,
    Relative,
    Traction,
)
from rmesh_nlp.problem.contact_problem import refined
from rmesh_nlp.solving.solution import Solution, Step
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


def test_all_fields_are_in_the_file(solution: Solution, tmp_path: Path) -> None:
    path = tmp_path / "s.vtu"
    write_solution(solution, path)
    file = meshio.read(path)
    nodes, cells = file.point_data, {name: data[0] for name, data in file.cell_data.items()}
    assert {"displacement", "gap", "pressure", "tangential_stress", "motion", "initial_position"} <= set(
        nodes
    )
    assert {"stress", "von_mises", "area_ratio", "least_angle"} <= set(cells)
    np.testing.assert_array_equal(cells["area_multiplier"], solution.multipliers.area)
    contact = solution.problem.contact_nodes
    np.testing.assert_allclose(nodes["initial_position"] + nodes["motion"], file.points, atol=1e-15)
    touching = nodes["pressure"] > 0
    assert np.any(touching)
    np.testing.assert_allclose(nodes["gap"][touching], 0, atol=1e-15)
    assert np.all(np.isnan(np.delete(nodes["gap"], contact)))
    np.testing.assert_array_equal(
        read_vtu(path).displacement, solution.displacement
    )  # rmesh figures reads it


def test_ratios_of_areas_and_multipliers_of_boxes_are_in_the_file(solution: Solution, tmp_path: Path) -> None:
    path = tmp_path / "s.vtu"
    write_solution(solution, path)
    file = meshio.read(path)
    np.testing.assert_array_equal(file.point_data["box_multiplier"], solution.multipliers.box)
    assert np.any(file.point_data["box_multiplier"] != 0)
    areas = []
    for points in (file.point_data["initial_position"], file.points):
        (x0, y0), (x1, y1), (x2, y2) = (points[file.cells[0].data[:, k], :2].T for k in range(3))
        areas.append((x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0))
    np.testing.assert_allclose(file.cell_data["area_ratio"][0], areas[1] / areas[0], rtol=1e-12)
    assert np.ptp(areas[1] / areas[0]) > 0.01


def test_multipliers_of_angles_are_in_the_file(problem: ContactProblem, tmp_path: Path) -> None:
    limited = joint.solve(replace(problem, motion=Motion(Relative(0.9), min_angle=25.0)))
    path = tmp_path / "angles.vtu"
    write_solution(limited, path)
    written = meshio.read(path).cell_data["angle_multiplier"][0]
    assert np.any(written > 0)
    np.testing.assert_array_equal(written, limited.multipliers.angle)


@pytest.mark.slow
@pytest.mark.parametrize("module", [joint, nested])
def test_a_series_plays_the_iterates(problem: ContactProblem, tmp_path: Path, module: object) -> None:
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
def test_a_series_keeps_frames_evenly_and_both_ends(
    problem: ContactProblem, every: int, most: int | None, kept: list[int]
) -> None:
    series = Series(problem, every, most)
    for number in range(12):
        series(Step(number, -1.0, 0.0, 0.0, 0.0, 0, 0.0, q=np.zeros(3)))
        series(Step(number, -1.0, 0.0, 0.0, 0.0, 0, 0.0))  # without moves it is no frame
    assert series.frames == 12
    assert series.names("s") == ["s.pvd", *(f"s-{number:05d}.vtu" for number in kept)]


def test_displays_escape_and_tell(problem: ContactProblem, solution: Solution) -> None:
    html = solution._repr_html_() + problem._repr_html_()
    assert "small &lt;&amp;&gt;" in html
    assert f"{solution.energy:.6g}" in html
    console = Console(width=100, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(problem, solution)
    text = console.export_text()
    assert "PlaneStrain" in text
    assert "converged" in text


def test_a_prolonged_motion_keeps_the_displacement_of_the_coarse_mesh(problem: ContactProblem) -> None:
    coarse = joint.solve(problem)
    finer = refined(problem)
    nodes = prolong(problem, coarse.mesh.p, finer)
    start = fixed.solve(replace(finer, mesh=replace(finer.mesh, doflocs=nodes)))
    # the coarse P1 functions are among the fine ones on the prolonged mesh, contact is imposed at more nodes
    assert start.energy < coarse.energy
    with pytest.raises(ValueError, match="not the uniform refinement"):
        prolong(problem, coarse.mesh.p, problem)


def test_the_gap_where_two_foundations_meet_is_the_smaller_one() -> None:
    sides = tuple(Obstacle(*side) for side in (("bottom", (0.0, 1.0), 0.1), ("left", (1.0, 0.0), 0.3)))
    problem = ContactProblem(rectangle(2, 2), PlaneStrain(1.0, 1.0), "right", sides)
    found = gaps(problem, problem.mesh.p, np.zeros(problem.mesh.p.shape))
    assert found[np.argmin(problem.mesh.p.sum(axis=0))] == pytest.approx(0.1)
    assert np.nanmax(found) == pytest.approx(0.3)
