"""Results out: fields where they belong, meshes with the names of their parts, series of iterates, tables."""

import xml.etree.ElementTree as ET
from dataclasses import replace
from types import SimpleNamespace

import meshio
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.fem.sampling import edges_of
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.io.export import Series, cell_data, element_table, node_table, write_mesh, write_solution
from rmesh_nlp.io.vtu import fields_of, read_vtu, state_of
from rmesh_nlp.mapping import MeshMap
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Laplace, Motion, Obstacle, PlaneStrain, Relative, Traction
from rmesh_nlp.solving.parts import Step
from support.curved import disc
from support.designs import LOAD, E, block
from support.formulations import fixed, joint
from support.orders import ORDERS


@pytest.fixture(scope="module", params=[1, 2])
def problem(request):
    return ContactProblem(
        rectangle(4, 2, x=(0, 2), diagonal="falling"),
        PlaneStrain(100.0, 80.0),
        ("left",),
        Obstacle.graph("bottom", -0.02, friction=0.5),
        Motion(Relative(0.9), min_angle=25.0),
        (Traction("top", (0.5, -4.0)),),
        name="small <&>",
        order=request.param,
    )


@pytest.fixture(scope="module")
def solution(problem):
    return joint.solve(problem)


def series_of(problem, points, *settings):
    """A series of iterates at such outer variables."""
    series = Series(problem, *settings)
    for number, q in enumerate(points):
        series(Step(number, 0.0, 0.0, 0.0, 0.0, 0, 0.0, q))
    return series


def test_frames_of_a_design_have_its_numbers(tmp_path):
    outer = rm.Outer.of(block(E, LOAD), "area")
    q = np.zeros(outer.n)
    q[-2:] = 0.5, -0.5
    series_of(outer.problem, [0 * q, q]).write(tmp_path)
    there, same = outer.at_design(q)
    expected = there.contact.displacement.values(there.contact.solve(there.nodes(same)).u)
    frames = [meshio.read(tmp_path / f"iterations-0000{k}.vtu").point_data["displacement"] for k in (0, 1)]
    np.testing.assert_allclose(frames[1][:, :2].T, expected, atol=1e-12)
    assert not np.allclose(*frames)


@pytest.mark.slow
def test_friction_bound_is_given_plus_coulomb_times_the_pressure_of_each_node() -> None:
    problem = ContactProblem(
        rectangle(6, 3, x=(0, 2)),
        PlaneStrain(100.0, 80.0),
        "left",
        Obstacle("bottom", friction=0.5, coulomb=0.3),
        tractions=(Traction("top", (0.5, -4.0)),),
    )
    state = fields_of(fixed.solve(problem)).final
    contact = np.isclose(problem.mesh.p[1], 0)  # with the node that it shares with the support
    touched = state.pressure[contact]
    assert np.ptp(touched) > 1
    np.testing.assert_allclose(state.friction_bound[contact], 0.5 + 0.3 * touched, rtol=1e-12)
    assert not np.any(state.friction_bound[~contact])


def test_file_has_all_fields(problem, solution, tmp_path):
    write_solution(solution, tmp_path / "s.vtu")
    file = meshio.read(tmp_path / "s.vtu")
    nodes, cells = file.point_data, {name: data[0] for name, data in file.cell_data.items()}
    assert {"tangential_stress", "friction_bound", "contact", "foundation bottom", "mobility"} <= set(nodes)
    assert {"stress", "von_mises", "least_angle", "zone"} <= set(cells)
    space = DisplacementSpace(solution.problem)
    assert file.cells[0].type == {1: "triangle", 2: "triangle6"}[space.order]
    assert len(file.points) == space.n_nodes
    limit = np.pad(solution.multipliers.limit, (0, space.n_nodes - space.n_vertices))
    np.testing.assert_array_equal(nodes["limit_multiplier"], limit)
    assert np.all(nodes["mobility"][: space.n_vertices] >= 0)
    assert np.all(nodes["mobility"][space.n_vertices :] == -1)
    assert np.any(solution.multipliers.limit != 0)
    np.testing.assert_array_equal(cells["area_multiplier"], solution.multipliers.area)
    np.testing.assert_array_equal(cells["angle_multiplier"], solution.multipliers.angle)
    assert np.any(solution.multipliers.angle > 0)
    np.testing.assert_allclose(nodes["initial_position"] + nodes["motion"], file.points, atol=1e-15)
    active = solution.assessment.final.equilibrium.active
    touching = space.contact_nodes[active.touching]
    assert np.all(nodes["pressure"][touching] > 0)
    np.testing.assert_allclose(nodes["gap"][touching], 0, atol=1e-15)
    assert np.all(np.isnan(np.delete(nodes["gap"], space.contact_nodes)))
    read, given = read_vtu(tmp_path / "s.vtu"), solution.assessment.given
    np.testing.assert_array_equal(read.final.displacement, solution.displacement)
    np.testing.assert_array_equal(read.given.displacement, given.displacement)
    np.testing.assert_array_equal(read.given.pressure, given.pressure)
    np.testing.assert_array_equal(read.multipliers.limit, limit)
    np.testing.assert_array_equal(read.multipliers.angle, solution.multipliers.angle)
    made = replace(solution, assessment=replace(solution.assessment, is_same_mesh=False))
    for name in ("nodes", "displacement", "pressure", "tangential_stress"):  # of a new mesh: solved once more
        values = (getattr(fields.given, name) for fields in (fields_of(made), read))
        np.testing.assert_allclose(*values, atol=1e-9)
    assert read.final.stress.shape == (problem.triangles.shape[1], {1: 1, 2: 16}[space.order])
    places = nodes["initial_position"], file.points
    before, after = (signed_areas(points[:, :2].T, file.cells[0].data.T[:3]) for points in places)
    np.testing.assert_allclose(cells["area_ratio"], after / before, rtol=1e-12)
    assert np.ptp(cells["area_ratio"]) > 0.01


@pytest.mark.parametrize("order", ORDERS)
def test_nodes_of_curved_bodies_are_on_the_curve_and_vtu_displacements_reproduce_polynomials(order, tmp_path):
    """ParaView's interpolation of what is written is the displacement that was computed."""
    problem = replace(disc({"arc": rm.Circle((0.0, 1.0), 1.0)}), order=order)
    solution = fixed.solve(problem)
    write_solution(solution, tmp_path / "disc.vtu")
    file, mesh = meshio.read(tmp_path / "disc.vtu"), solution.mesh
    ends = mesh.facets[:, mesh.boundaries["arc"]]
    nodes = DisplacementSpace(problem).nodes_of(ends)
    np.testing.assert_allclose(np.linalg.norm(file.points[nodes, :2] - [0.0, 1.0], axis=-1), 1.0, rtol=1e-12)
    assert len(nodes) == 1 + order
    # values at the middles, not coefficients: the parabola through them has the computed energy's field
    space = DisplacementSpace(problem)
    found = space.coefficients(file.point_data["displacement"].T)
    model = ContactSolver(problem)
    expected = model.displacement.values(model.solve(np.asarray(mesh.p)).u)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    outer = edges_of(read_vtu(tmp_path / "disc.vtu").triangles, outer=True)
    rim = {frozenset(one) for one in space.nodes_of(mesh.facets[:, mesh.boundary_facets()]).T.tolist()}
    assert {frozenset(one) for one in outer.T.tolist()} == rim


@pytest.mark.parametrize(
    ("name", "kind"),
    [("s.vtk", "triangle6"), ("s.inp", "triangle6"), ("s.tec", "triangle"), ("s.vol.gz", "triangle")],
)
def test_formats_without_quadratic_triangles_get_the_vertices(problem, solution, tmp_path, name, kind):
    write_solution(solution, tmp_path / name)
    (block,) = meshio.read(tmp_path / name).cells
    assert block.type == ("triangle" if problem.order == 1 else kind)
    assert len(block.data) == problem.triangles.shape[1]


@pytest.mark.parametrize(
    "write", [lambda path, one: write_mesh(one.mesh, path), lambda path, one: write_solution(one, path)]
)
def test_a_suffix_of_no_format_is_bad_input(solution, tmp_path, write):
    with pytest.raises(rm.BadInputError, match=r"^\S*a\.foo: Could not deduce file format"):
        write(tmp_path / "a.foo", solution)


@pytest.fixture(scope="module")
def membrane():
    obstacle = Obstacle("right", (1.0,), 0.01)
    return fixed.solve(ContactProblem(rectangle(3, 3), Laplace(-2.0), "left", obstacle, Motion(0.05)))


@pytest.mark.parametrize("scalar", [True, False])
def test_parts_of_a_certificate_are_fields_of_the_elements(solution, membrane, scalar):
    of = membrane if scalar else solution
    n = of.problem.triangles.shape[1]
    rows = np.arange(2.0 * n if scalar else 3.0 * n).reshape(-1, n)
    certificate = SimpleNamespace(local=rows[0], local_initial=rows[1], field=rows)
    data = cell_data(replace(of, certificate=certificate))
    np.testing.assert_array_equal(data["error_bound"], rows[0])
    np.testing.assert_array_equal(data["error_bound_initial"], rows[1])
    found = data["equilibrated_flux" if scalar else "equilibrated_stress"]
    np.testing.assert_array_equal(found.T, [*rows, np.zeros(n)] if scalar else rows)


def corners(points, cells):
    """Cells (nodes per cell, cells) as sets of the places of their corners."""
    return {frozenset(tuple(points[:2, v].tolist()) for v in cell) for cell in np.asarray(cells).T}


def test_names_of_boundaries_and_subdomains_are_groups_of_gmsh(tmp_path):
    mesh = rectangle(3, 2).with_subdomains(
        {"soft": lambda x: x[0] < 0.4, "low": lambda x: x[1] < 0.5, "gmsh:other": lambda x: x[0] > 0.6}
    )
    write_mesh(mesh, tmp_path / "mesh.msh")
    file = meshio.read(tmp_path / "mesh.msh")
    groups = list(zip(file.cells, file.cell_data["gmsh:physical"], strict=True))
    found = {
        (name, block.type): corners(file.points.T, block.data[tags == number].T)
        for name, (number, _) in file.field_data.items()
        for block, tags in groups
        if np.any(tags == number)
    }
    expected = {(name, "line"): mesh.facets[:, facets] for name, facets in mesh.boundaries.items()}
    expected["soft", "triangle"] = mesh.t[:, mesh.subdomains["soft"]]
    # a triangle is written once, under its first name
    expected["low", "triangle"] = mesh.t[:, np.setdiff1d(mesh.subdomains["low"], mesh.subdomains["soft"])]
    assert found == {name: corners(mesh.p, cells) for name, cells in expected.items()}
    assert sum(len(block.data) for block in file.cells if block.type == "triangle") == mesh.t.shape[1]
    assert sorted(int(number) for number, _ in file.field_data.values()) == list(range(1, 7))  # each its own
    again = rm.read_mesh(tmp_path / "mesh.msh")
    assert corners(again.p, again.t) == corners(mesh.p, mesh.t)
    sizes = [{name: len(v) for name, v in one.boundaries.items()} for one in (again, mesh)]
    assert sizes[0] == sizes[1]
    write_mesh(replace(mesh, _boundaries=None, _subdomains=None), tmp_path / "nameless.msh")
    file = meshio.read(tmp_path / "nameless.msh")
    assert ([block.type for block in file.cells], file.field_data) == (["triangle"], {})
    assert np.all(signed_areas(file.points[:, :2].T, file.cells[0].data.T) > 0)


def test_series_keeps_frames_evenly_and_both_ends(problem):
    assert Series(problem).names() == ["iterations.pvd"]
    every, ends = list(range(12)), [0, 11]
    for most, kept in ((None, every), (12, every), (5, [0, 2, 5, 8, 11]), (2, ends), (1, ends)):
        series = series_of(problem, [np.zeros(1)] * 12 + [None], most)  # nothing to draw without positions
        assert series.frames == 12
        assert series.names("s") == ["s.pvd", *(f"s-{number:05d}.vtu" for number in kept)]


@pytest.mark.parametrize("scalar", [True, False])
def test_frames_of_a_series_have_the_mesh_and_the_displacement_at_their_variables(
    problem, membrane, scalar, tmp_path
):
    """One value per node for a scalar problem, three for an elastic one, which is what viewers warp by."""
    made = membrane.problem if scalar else problem
    free, n = MeshMap.of(made), made.mesh.p.shape[1]
    q = np.full(free.n, 0.01)
    series = series_of(made, [0 * q, q, 2 * q])
    files = ET.parse(series.write(tmp_path, "run")).getroot().iter("DataSet")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(series.names("run"))
    for k, file in enumerate(files):
        frame, nodes = meshio.read(tmp_path / file.attrib["file"]), free.positions.values(k * q)
        np.testing.assert_allclose(frame.points[:n, :2].T, nodes)
        np.testing.assert_allclose(frame.point_data["motion"][:n, :2].T, nodes - made.mesh.p, atol=1e-15)
        solver = ContactSolver(replace(made, mesh=replace(made.mesh, doflocs=nodes)))
        expected = DisplacementSpace(made).values(solver.displacement.values(solver.given.u))
        found = frame.point_data["displacement"]
        assert found.shape == ((n,) if scalar else (expected.shape[1], 3))
        columns = found[:, None] if scalar else found[:, :2]
        np.testing.assert_allclose(columns.T, expected, atol=1e-9)
    assert k == 2


def test_a_frame_with_inverted_elements_has_no_displacement(membrane, tmp_path) -> None:
    """All-at-once solvers pass through such meshes, whose stiffness may be singular."""
    free = MeshMap.of(membrane.problem)
    inverted = 10 * np.random.default_rng(0).standard_normal(free.n)
    series = series_of(membrane.problem, [np.zeros(free.n), inverted, np.zeros(free.n)])
    series.write(tmp_path, "run")
    fields = [meshio.read(tmp_path / name).point_data for name in series.names("run")[1:]]
    assert [bool(np.all(np.isnan(field["displacement"]))) for field in fields] == [False, True, False]
    np.testing.assert_array_equal(fields[0]["displacement"], fields[2]["displacement"])


@pytest.mark.parametrize("order", ORDERS)
def test_gap_is_the_distance_along_the_normal_to_the_nearer_foundation(order):
    """A body 0.1 above a floor and 0.3 beside a wall, which sinks by 0.03 and moves away by 0.5."""
    sides = (Obstacle("bottom", (0.0, 1.0), 0.1), Obstacle("left", (1.0, 0.0), 0.3))
    problem = ContactProblem(rectangle(2, 2), PlaneStrain(1.0, 1.0), "right", sides, order=order)
    space = DisplacementSpace(problem)
    x, y = space.points(problem.mesh.p)
    u = np.tile([[0.5], [-0.03]], x.size)
    expected = np.select([(y == 0) & (x < 1), (x == 0) & (y > 0)], [0.07, 0.8], np.nan)
    state = state_of(problem, problem.mesh.p, u, 0 * x, 0 * x)
    np.testing.assert_allclose(state.gap, expected, rtol=1e-12)
    assert [*state.feet] == ["bottom", "left"]
    np.testing.assert_allclose(state.feet["bottom"][:, y == 0], [x[y == 0], 0 * x[y == 0] - 0.1])


def test_tables_have_a_column_for_each_component(solution, membrane):
    mesh = solution.mesh
    nodes, elements = node_table(solution), element_table(solution)
    vectors = {f"{name}_{axis}" for name in ("displacement", "motion") for axis in "xy"}
    assert {"x", "y", "gap", "pressure", *vectors} <= set(nodes)
    assert not {"motion_z", "displacement", "motion"} & set(nodes)
    np.testing.assert_array_equal(nodes[["x", "y"]].to_numpy()[: mesh.p.shape[1]], mesh.p.T)
    np.testing.assert_array_equal(nodes["displacement_y"], solution.displacement[1])
    assert {"stress_xx", "stress_yy", "stress_xy", "stress_zz", "von_mises", "zone"} <= set(elements)
    corners = elements[["node_1", "node_2", "node_3"]]
    np.testing.assert_array_equal(corners.T, solution.problem.triangles)
    fluxes = element_table(membrane)
    assert {"flux_x", "flux_y"} <= set(fluxes)
    assert "stress_xx" not in fluxes


def test_displays_escape_and_tell(problem, solution):
    html = solution._repr_html_() + problem._repr_html_()
    assert "small &lt;&amp;&gt;" in html
    assert f"{solution.energy:.6g}" in html
    assert "PlaneStrain" in repr(problem)
    assert "converged" in repr(solution)
