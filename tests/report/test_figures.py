"""Figures: they exist, show the data they are made from, in space as it is, and can be read."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

import rmesh_nlp as rm
from rmesh_nlp.io.folder import Manifest
from rmesh_nlp.io.results import Result, Results, read_results
from rmesh_nlp.io.vtu import MeshState, SolutionFields, read_vtu, state_of
from rmesh_nlp.meshes.geometry import lines_of
from rmesh_nlp.problem.units import Units
from rmesh_nlp.report.blocks import blocks
from rmesh_nlp.report.curves import bracket_figure, convergence_figure
from rmesh_nlp.report.drawing import DrawnBody, contact_figure, displacement_figure, window
from rmesh_nlp.report.figures import block_figures, error_figure
from rmesh_nlp.report.figures import figures as figures_of
from rmesh_nlp.report.pictures import pictures
from rmesh_nlp.report.style import SETTINGS, Page, add_legend, new_figure, write
from rmesh_nlp.solving.plotting import course, draw_along, draw_elements, draw_mesh, draw_nodal
from rmesh_nlp.study.comparison import plan_comparison, run
from support.formulations import fixed
from support.orders import ORDERS
from support.reporting import joint_61, saved

PAGE = Page()


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> list[Result]:
    """Small solves of a scalar example and of one with friction."""
    folder = tmp_path_factory.mktemp("results")
    cases = plan_comparison(["6.1"], ["fixed", "nested", "joint", "mpcc"], n=4)
    cases += plan_comparison(["6.1"], ["fixed", "joint"], n=3, order=2)
    cases += plan_comparison(["6.3"], ["fixed", "joint"], n=(4, 3))
    list(run(cases, Results(folder)))
    return read_results(folder)


@pytest.fixture(scope="module")
def figures(results: list[Result]) -> dict[str, Figure]:
    records = [result.record for result in results]
    return {
        name: figure
        for block in blocks(records)
        for name, figure in block_figures(block, [r for r in results if r.record in block.records], PAGE)
    }


@pytest.mark.slow
def test_every_example_has_its_figures_without_a_solve(results, tmp_path, monkeypatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("a solver was called")

    monkeypatch.setattr("rmesh_nlp.contact.solver.ContactSolver.solve", refuse)
    monkeypatch.setattr("casadi.nlpsol", refuse)
    paths = write(figures_of(results, PAGE), Manifest(tmp_path), PAGE)
    grids = ("nested-grid", "joint-grid", "mpcc-grid")
    stems = {f"6.1-4-{what}" for what in (*grids, "stress", "convergence")}
    stems |= {f"6.1-3-order2-{what}" for what in ("joint-grid", "stress", "convergence")}
    stems |= {f"6.3-4x3-{what}" for what in ("joint-grid", "stress", "convergence")}
    assert {path.name for path in paths} == {f"{stem}.png" for stem in stems}
    for path in paths:
        assert path.read_bytes()[:5] == b"\x89PNG\r"


@pytest.mark.slow
def test_texts_are_legible_and_do_not_overlap(figures: dict[str, Figure]) -> None:
    for name, figure in figures.items():
        with rc_context(SETTINGS):
            figure.draw_without_rendering()
        assert figure.get_size_inches()[0] <= PAGE.width
        texts = [t for t in figure.findobj(Text) if t.get_text() and t.get_visible()]
        assert min(text.get_fontsize() for text in texts) >= 8, name
        labels = [part for axis in figure.axes for part in (axis.xaxis.label, axis.yaxis.label, axis.title)]
        labels += [t for legend in figure.legends for t in legend.get_texts()]
        boxes = [(t.get_text(), t.get_window_extent()) for t in labels if t.get_text() and t.get_visible()]
        frame = figure.bbox.padded(1)
        for i, (text, box) in enumerate(boxes):
            assert frame.x0 <= box.x0 <= box.x1 <= frame.x1, (name, text)
            assert frame.y0 <= box.y0 <= box.y1 <= frame.y1, (name, text)
            for other_text, other in boxes[i + 1 :]:
                assert not box.overlaps(other), (name, text, other_text)


@pytest.mark.parametrize("content", [None, "<VTKFile/>", "no XML"])
def test_missing_or_broken_solution_file_is_named(tmp_path, content) -> None:
    path = tmp_path / "it.vtu"
    if content is not None:
        path.write_text(content)
    with pytest.raises(rm.BadInputError, match=r"it\.vtu"):
        list(figures_of([Result(joint_61(), path, tmp_path / "it.csv")], PAGE))


@pytest.mark.slow
def test_a_figure_whose_name_is_taken_is_numbered(tmp_path: Path) -> None:
    drawn = [(name, new_figure(1, 1)) for name in ("a", "b", "a", "a")]
    for _, figure in drawn:
        figure.subplots().set_axis_off()  # nothing but their names counts
    paths = write(drawn, Manifest(tmp_path), Page(kind="pdf"))
    assert [path.name for path in paths] == ["a.pdf", "b.pdf", "a-2.pdf", "a-3.pdf"]
    assert paths[0].read_bytes()[:5] == b"%PDF-"


def test_legend_is_not_wider_than_its_figure() -> None:
    many = [f"nested, mean(load, -uy), seed {k}" for k in range(7)]
    for names in (many, ["newton from forty random starts " * 6]):
        figure = new_figure(PAGE.width, 3.0)
        axis = figure.subplots()
        for name in names:
            axis.plot([], [], label=name)
        axis.set_axis_off()
        with rc_context(SETTINGS):
            add_legend(figure, [axis])
        (legend,) = figure.legends
        figure.draw_without_rendering()
        assert legend.get_window_extent().width <= figure.get_window_extent().width


def state(friction: float, components: int = 2, upright: bool = False) -> MeshState:
    """Three contact nodes out of order, and one that is none."""
    nodes = np.array([[2.0, 0.0, 1.0, 0.5], [0.0, 0.0, 0.0, 3.0]])
    nodes = nodes[::-1] if upright else nodes
    contact = np.array([True, True, True, False])
    return MeshState(
        nodes=nodes, displacement=np.zeros((components, 4)), pressure=np.array([20.0, 0.0, 10.0, 99.0]),
        tangential_stress=np.array([2.0, 0.0, -1.0, 99.0]),
        friction_bound=np.array([friction, friction, 2 * friction, 0.0]),
        gap=np.where(contact, 0.0, np.nan), feet={"low": np.where(contact, nodes, np.nan)},
        stress=np.zeros((2, 1)),
    )  # fmt: skip


CELLS = np.array([[1, 2], [2, 0], [3, 3]])


def stress_figure(curves: dict[str, MeshState], page: Page = PAGE) -> Figure:
    """Contact stresses of states by name."""
    figure = contact_figure([DrawnBody(name, CELLS, one) for name, one in curves.items()], page)
    assert figure is not None
    return figure


def test_contact_stress_is_drawn_along_the_boundary() -> None:
    (axis,) = stress_figure({"given grid": state(0.0), "joint": state(0.0)}).axes
    assert [line.get_label() for line in axis.lines] == ["given grid", "joint"]
    for line in axis.lines:
        np.testing.assert_array_equal(line.get_xydata(), [[0, 0], [1, 10], [2, 20]])
    assert axis.get_xlabel() == "$x_1$ on low"
    (axis,) = stress_figure({"a": state(0.0, upright=True)}, Page(units=Units("m", "N"))).axes
    np.testing.assert_array_equal(axis.lines[0].get_xydata()[:, 0], [0, 1, 2])
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("$x_2$ [m] on low", "contact pressure [N/m²]")
    (axis,) = stress_figure({"a": state(0.0, components=1)}, Page(units=Units("m", "N"))).axes
    assert axis.get_ylabel() == "contact stress"  # of a scalar problem it has no unit


def test_with_friction_a_second_panel_has_the_bounds() -> None:
    figure = stress_figure({"given grid": state(3.0)})
    contact, tangential = figure.axes
    assert len(contact.lines) == 1
    drawn = [line.get_xydata().tolist() for line in tangential.lines]
    assert drawn == [[[0, 0], [1, -1], [2, 2]], [[0, 3], [1, 6], [2, 3]], [[0, -3], [1, -6], [2, -3]]]
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["given grid", "friction bound ±g"]
    # friction of a single node, or of a later curve, is enough
    rough = state(0.0)
    rough.friction_bound[2] = 1.0
    assert len(stress_figure({"a": state(0.0), "b": rough}).axes) == 2


def test_error_is_drawn_per_root_of_area_on_each_mesh() -> None:
    record = {"relative_error_bound": 0.25, "guaranteed_lower": True}
    bounds = {"error_bound_initial": np.array([3.0, 3.0]), "error_bound": np.array([0.75, 0.75])}
    fields = SolutionFields(CELLS, state(0.0), state(0.0), np.zeros(4, np.int32), **bounds)
    figure = error_figure(fields, record, PAGE)  # of areas 1.5
    before, after = figure.axes[:2]
    assert [float(axis.collections[0].get_array()[0]) for axis in (before, after)] == pytest.approx([2, 1])
    assert (before.get_title(), after.get_title()) == ("given, ", "relocated, error estimated at 25 %")


def test_convergence_is_drawn_down_to_a_part_of_the_best() -> None:
    known = {"iteration": range(3), "cost": [1.0, 2.0, 4.0], "value": [-1.0, -1.5, -2.0]}
    way = pd.DataFrame(known).assign(feasible=True)
    known = {"objective": "energy", "energy": -9.0}
    iterations, costs = convergence_figure([("joint", way)], known, PAGE).axes
    np.testing.assert_allclose(iterations.lines[0].get_xydata(), [[0, 1], [1, 0.5], [2, 2e-8]])
    np.testing.assert_allclose(costs.lines[0].get_xdata(), way["cost"])
    assert iterations.get_ylabel() == "|J − J*|"
    assert not np.any(iterations.get_xticks() % 1)  # iterations are whole


def test_brackets_of_orders_are_over_unknowns() -> None:
    rows = [
        joint_61(nodes=nodes, unknowns=n, order=order, energy_lower_bound=-2.0, energy_upper_bound=-1.0)
        for order, nodes, n in ((1, 25, 12), (1, 81, 56), (2, 25, 56), (2, 9, 12))
    ]
    (axis,) = bracket_figure(rows, PAGE).axes
    assert axis.get_xlabel() == "unknowns"
    assert [text.get_text() for text in axis.get_legend().get_texts()] == ["joint", "joint, order 2"]
    assert all(line.get_xdata().tolist() == [12, 56] for line in axis.lines)
    (axis,) = bracket_figure(rows[:2], PAGE).axes
    assert axis.get_xlabel() == "nodes"


BELOW = 0.002
"""Gap of the lowest node of the block."""


@cache
def pressed(rise: float, order: int = 1) -> rm.Solution:
    """A block pressed onto a flat foundation; its bottom rises by ``rise`` to both sides."""
    mesh = rm.shapes.rectangle(6, 2, x=(-1, 1))
    x, y = mesh.p
    problem = rm.ContactProblem(
        mesh=replace(mesh, doflocs=np.stack([x, y + rise * x**2 * (1 - y)])),
        law=rm.PlaneStrain.from_young(1000.0, 0.3),
        dirichlet=(rm.Dirichlet("top", (0.0, -0.01)),),
        obstacle=rm.Obstacle.line("bottom", (0.0, -BELOW), (0.0, 1.0)),
        motion=rm.Motion(0.1),
        order=order,
    )
    return fixed.solve(problem)


def drawings(solution: rm.Solution, folder: Path) -> Sequence[Axes]:
    """Both pictures that show the deformed body."""
    result = saved(solution, folder)
    meshes = next(figure for name, figure in pictures(result, PAGE) if name == "mesh")
    fields = read_vtu(result.vtu)
    bodies = [DrawnBody("it", fields.triangles, fields.final)]
    grids = displacement_figure(bodies, PAGE, deformed=True)
    return [meshes.axes[1], grids.axes[1]]


@pytest.mark.slow
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(("rise", "factor"), [(0.0, 10), (0.3, 1)])
def test_flat_foundation_stays_flat_and_is_touched(rise, factor, order, tmp_path):
    solution = pressed(rise, order)
    assert np.any(solution.final.pressure > 0)
    for axis in drawings(solution, tmp_path):
        scale = f"$u$ and gap × {factor}" if factor > 1 else "true scale"
        assert axis.get_title() == f"deformed, {scale}"
        ground = np.vstack([path.vertices for c in axis.collections for path in c.get_paths()])
        body = np.asarray(axis.lines[0].get_xydata())
        assert np.ptp(ground[:, 1]) < 1e-12
        assert ground[0, 1] == pytest.approx(-factor * BELOW)
        assert np.nanmin(body[:, 1]) == pytest.approx(ground[0, 1], abs=1e-9)
        limits = np.array([axis.get_xlim(), axis.get_ylim()])
        assert np.all((limits[:, 0] < np.nanmin(body, axis=0)) & (np.nanmax(body, axis=0) < limits[:, 1]))


@pytest.mark.parametrize(("below", "is_far"), [(0.55, False), (0.65, True)])
def test_foundation_farther_than_a_part_of_the_body_is_not_drawn(below: float, is_far: bool) -> None:
    problem = replace(pressed(0.0).problem, obstacle=rm.Obstacle.line("bottom", (0.0, -below), (0.0, 1.0)))
    none = np.zeros(problem.mesh.p.shape[1])
    state = state_of(problem, problem.mesh.p, np.stack([none, none]), none, none)
    block = DrawnBody("", problem.mesh.t, state)
    (one,) = block.contacts
    assert (one.name, block.near) == ("bottom", [] if is_far else [one])
    assert one.distance == pytest.approx(below)
    np.testing.assert_allclose(block.state.gap[one.nodes], below)
    np.testing.assert_allclose(window([block]), [[-1.04, 1.04], [-0.04, 1.04]])
    np.testing.assert_allclose(window([block], 1.0)[1], [-0.04 if is_far else -below - 0.04, 1.04])


@pytest.mark.parametrize(
    ("columns", "height", "size"),
    [
        (1, 0.5, (3.35, 2 * (2.6 * 0.5 + 0.62))),  # one below the other
        (2, 9.0, (7.0, 3.125 * 2 + 0.62)),  # as tall as twice their width at most
    ],
)
def test_panels_fill_the_width_of_the_page(columns, height, size) -> None:
    figure, axes = Page(columns, units=Units("mm")).panels(2, [np.array([[0.0, 1.0], [0.0, height]])])
    assert figure.get_size_inches() == pytest.approx(size)
    assert axes.shape == (1, 2)
    assert axes[0, 0].get_ylabel() == "$x_2$ [mm]"
    assert axes[0, 0].get_ylim() == (0.0, height)
    assert not axes[0, 0].lines


def test_half_section_has_its_axis() -> None:
    _, axes = Page(1, units=Units("mm", "N", "revolution")).panels(1, [np.array([[-0.1, 1.0], [0.0, 1.0]])])
    assert (axes[0, 0].get_xlabel(), axes[0, 0].get_ylabel()) == ("$r$ [mm]", "$z$ [mm]")
    assert axes[0, 0].lines[0].get_xdata() == [0.0, 0.0]
    assert axes[0, 0].get_xlim() == (-0.1, 1.0)


@pytest.mark.parametrize("fine", [True, False])
def test_lines_of_fine_meshes_are_rasterised_and_fields_always(fine, monkeypatch) -> None:
    monkeypatch.setattr("rmesh_nlp.solving.plotting.FINE", 1 if fine else 100)
    mesh, axis = rm.shapes.rectangle(3, 2), new_figure(2, 2).subplots()
    draw_mesh(axis, mesh.p, mesh.t)
    assert all(line.get_rasterized() is fine for line in axis.lines)
    assert mesh.p.shape[1] == mesh.t.shape[1]  # the number of values does not tell what they belong to
    smooth = draw_nodal(axis, mesh.p, mesh.t, 2 * mesh.p[0])
    constant = draw_elements(axis, mesh.p, mesh.t, np.arange(mesh.t.shape[1]))
    assert smooth.get_rasterized()
    assert constant.get_rasterized()
    np.testing.assert_allclose(smooth.get_array(), 2 * mesh.p[0, mesh.t].T.ravel(), atol=1e-15)
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
    assert values.size == 15
    assert (values.min(), values.max()) == (0.0, 1.0)
    flat = draw_elements(axis, nodes, QUADRATIC, np.array([7.0]))
    np.testing.assert_array_equal(flat.get_array(), 7.0)
    assert flat.get_array().size == 16


@pytest.mark.parametrize("part", [8, 6])
def test_pressure_on_a_bore_is_a_function_of_the_angle(part: int) -> None:
    number, turns = np.random.default_rng(1).permutation(8), np.arange(8) / 8
    nodes = np.zeros((2, 8))
    nodes[:, number] = [2 + np.cos(2 * np.pi * turns), 1 + np.sin(2 * np.pi * turns)]
    edges = number[np.array([np.arange(part), (np.arange(part) + 1) % 8])]
    (line,) = lines = lines_of(edges, nodes)
    assert line.size == part + 1
    assert (line[0] == line[-1]) is np.bool_(part == 8)
    name, over = course(nodes[:, line], Units("mm"))
    assert name == "angle about (2, 1) [°]"
    axis = new_figure(2, 2).subplots()
    draw_along(axis, nodes, lines, nodes[1], over)
    angle, height = axis.lines[0].get_xydata().T
    assert np.abs(np.diff(angle)) == pytest.approx(45)
    assert np.ptp(angle) == pytest.approx(45 * part)
    np.testing.assert_allclose(height, 1 + np.sin(np.radians(angle)), atol=1e-12)


def test_other_boundaries_are_drawn_over_a_coordinate_or_the_arc_length() -> None:
    nodes = np.array([[0.0, 3.0, 3.0, 6.0, 6.0, 5.0], [0.0, 4.0, 8.0, 0.0, 5.0, 5.0]])
    lines = lines_of(np.array([[2, 0, 4], [1, 1, 3]]), nodes)
    assert [line.tolist() for line in lines] == [[0, 1, 2], [3, 4]]
    name, over = course(nodes[:, lines[0]], Units())
    assert name == "arc length from (0, 0)"
    axis = new_figure(2, 2).subplots()
    draw_along(axis, nodes, lines[:1], nodes[1], over)
    np.testing.assert_allclose(axis.lines[0].get_xydata(), [[0, 0], [5, 4], [9, 8]])
    name, over = course(nodes[:, lines[1]], Units("mm"))
    assert (name, over(nodes[:, lines[1]]).tolist()) == ("$x_2$ [mm]", [0, 5])
    assert course(nodes[:, lines[1]], Units("mm", per="revolution"))[0] == "$z$ [mm]"
    slanted = np.array([np.arange(9.0), np.arange(9.0)])
    assert course(slanted, Units("m"))[0] == "arc length from (0, 0) [m]"
    draw_along(axis, nodes, lines, nodes[1], over)
    assert np.isnan(axis.lines[1].get_ydata()[3])  # lines apart stay apart
