"""Pictures of a solve and of a design: what is drawn, what is left out, that letters are large enough."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.text import Text

import rmesh_nlp as rm
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.io.results import Result
from rmesh_nlp.io.vtu import read_vtu
from rmesh_nlp.mapping import MeshMap
from rmesh_nlp.report.curves import design_figure, estimates_figure
from rmesh_nlp.report.drawing import DrawnBody
from rmesh_nlp.report.figures import figure_of_designs
from rmesh_nlp.report.pictures import Limit, limits, pictures
from rmesh_nlp.report.style import Page, new_figure
from rmesh_nlp.report.tables import markdown
from rmesh_nlp.solving.parts import FEW
from support.bodies import pressed, stacked
from support.contact_geometry import block_between_two_foundations
from support.designs import BOW, H0, E, block
from support.formulations import fixed, joint, nested
from support.reporting import designed, saved


def membrane() -> rm.ContactProblem:
    """A membrane on an obstacle in the interior, with a disc of contact."""
    return rm.ContactProblem(
        mesh=rm.shapes.rectangle(6, 6, x=(-1, 1), y=(-1, 1)),
        law=rm.Laplace(-4.0),
        dirichlet=("left", "right", "top", "bottom"),
        obstacle=rm.Obstacle.interior(-0.3),
        motion=rm.Motion(rm.Relative(0.2)),
    )


def letters(figure: Figure) -> list[float]:
    """Sizes in points of all letters of a figure that are seen."""
    figure.draw_without_rendering()
    seen = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]
    return [float(text.get_fontsize()) for text in seen]


@pytest.mark.slow
@pytest.mark.parametrize("make", [block_between_two_foundations, membrane])
def test_a_solve_has_its_pictures_and_every_letter_is_legible(make, tmp_path: Path) -> None:
    problem = make()
    result = saved(joint.solve(problem), tmp_path)
    for page in (Page(1), Page(2)):
        with rc_context(page.settings):
            drawn = dict(pictures(result, page))
            for name, figure in drawn.items():
                assert min(letters(figure)) >= 7.0, name
                assert figure.get_size_inches()[0] <= page.width + 1e-9
    if problem.components == 2:
        assert [*drawn] == ["mesh", "displacement", "stress", "pressure", "motion", "limits"]


@pytest.mark.slow
def test_nothing_that_is_zero_is_drawn(tmp_path: Path) -> None:
    # held and not loaded: no displacement, no stress, no pressure; and nothing moved
    rest = replace(membrane(), law=rm.Laplace(0.0), obstacle=rm.Obstacle.interior(-1.0))
    ended = replace(fixed.solve(rest), details={"meshes": []})  # before it measured a mesh
    assert [name for name, _ in pictures(saved(ended, tmp_path), Page())] == ["mesh"]
    drawn = pictures(saved(fixed.solve(membrane()), tmp_path), Page())
    assert [name for name, _ in drawn] == ["mesh", "displacement", "flux"]


@pytest.mark.slow
def test_the_contact_set_of_a_membrane_is_where_it_touches(tmp_path: Path) -> None:
    problem = membrane()
    result = saved(joint.solve(problem), tmp_path)
    _, meshes = next(pictures(result, Page()))
    fields = read_vtu(result.vtu)
    bodies = [DrawnBody("", fields.triangles, state) for state in (fields.given, fields.final)]
    for state, axis in zip(bodies, meshes.axes, strict=True):
        inside = np.isin(np.arange(state.triangles.shape[1]), state.closed)
        assert 0 < inside.sum() < inside.size
        middle = state.nodes[:, problem.triangles].mean(axis=1)
        # in the middle, and not at the corners, where the nodes are held above the obstacle
        assert np.max(np.abs(middle[:, inside])) < 0.9
        assert inside[np.argmin(np.linalg.norm(middle, axis=0))]
        pairs = np.sort(np.hstack([problem.triangles[[i, i - 1]][:, inside] for i in range(3)]), axis=0)
        rim = np.sum(np.unique(pairs, axis=1, return_counts=True)[1] == 1)
        _, edge = axis.collections
        assert len(edge.get_segments()) == rim


def test_nodes_are_at_their_limits_if_multipliers_count() -> None:
    problem = replace(membrane(), motion=rm.Motion(None))
    fields = {"mobility": MeshMap.of(problem).mobility, "triangles": problem.mesh.t}
    nodes = np.flatnonzero(limits(SimpleNamespace(**fields, multipliers=None)) == Limit.NOTHING)
    push, nothing = np.zeros(problem.mesh.p.shape[1]), np.zeros(problem.mesh.t.shape[1])
    push[nodes[:3]] = 1.0, 1e-3, 1e-7
    pulls = {"area": nothing, "angle": nothing, "limit": push}
    found = limits(SimpleNamespace(**fields, multipliers=SimpleNamespace(**pulls)))
    assert np.flatnonzero(found == Limit.MOVE_LIMIT).tolist() == nodes[:2].tolist()
    assert Limit.AREA not in found
    for kind in ("area", "angle"):  # of an element hold its nodes
        there = SimpleNamespace(**{**pulls, "limit": 0 * push, kind: np.eye(nothing.size)[0]})
        found = limits(SimpleNamespace(**fields, multipliers=there))
        held = set(problem.triangles[:, 0]) & set(np.flatnonzero(found != Limit.PINNED))
        assert set(np.flatnonzero(found == Limit.AREA)) == held


BOUNDS = {"E": (0.5, 2.0), "h": (-0.1, 0.1)}


def history(count: int = 4, names: tuple[str, ...] = ("E", "h"), objective: float = 0.1) -> pd.DataFrame:
    return pd.DataFrame(
        {"iteration": k, "objective": objective**k, "primal_residual": 1e-2 if k == 1 else 0.0}
        | {f"design.{name}": 1.0 + 0.1 * k for name in names}
        for k in range(count)
    )


def test_objective_and_each_variable_have_a_panel_with_their_bounds() -> None:
    figure = design_figure({"nested": history(), "mpcc": history(3)}, BOUNDS, "area", Page())
    assert [axis.get_ylabel() for axis in figure.axes] == ["objective", "E", "h"]
    objective, modulus, _ = figure.axes
    assert objective.get_yscale() == "log"
    every, met = objective.lines[:2]
    np.testing.assert_allclose(every.get_ydata(), [1, 0.1, 0.01, 1e-3])
    np.testing.assert_array_equal(np.isnan(met.get_ydata()), [False, True, False, False])
    assert {tuple(line.get_ydata()) for line in modulus.lines} >= {(0.5, 0.5), (2.0, 2.0)}
    assert modulus.get_ylim()[0] < 0.5 < 2.0 < modulus.get_ylim()[1]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["nested", "mpcc"]
    alone = design_figure({"": history()}, BOUNDS, "area", Page())
    assert not alone.legends


def test_many_variables_share_a_panel_and_solves_of_different_length_a_logarithmic_axis() -> None:
    names = tuple(f"v{k}" for k in range(FEW + 1))
    figure = design_figure({"": history(names=names)}, dict.fromkeys(names, (1.0, 2.0)), "area", Page())
    assert len(figure.axes) == 2
    np.testing.assert_allclose(figure.axes[1].lines[-3].get_ydata(), [0, 0.1, 0.2, 0.3])
    for count, scale in ((60, "symlog"), (30, "linear")):
        figure = design_figure({"a": history(4), "b": history(count, objective=1.0)}, BOUNDS, "area", Page())
        assert {axis.get_xscale() for axis in figure.axes} == {scale}


def test_nothing_is_drawn_without_designs_in_a_history(tmp_path: Path) -> None:
    for empty in (history(0), history(1, names=())):
        assert design_figure({"": empty}, BOUNDS, "area", Page()) is None
    missing = Result(designed(), tmp_path / "no.vtu", tmp_path / "no.csv")
    assert figure_of_designs([missing], Page()) is None
    unmoved = replace(missing, record=designed(formulation="fixed"))
    assert figure_of_designs([unmoved], Page()) is None


@pytest.mark.slow
def test_pictures_are_of_the_first_and_the_last_design(tmp_path: Path) -> None:
    problem = replace(block(E, H0, BOW, n=(4, 1)), motion=rm.Motion(0))
    solution = nested.solve(problem, objective="mean(right, uy**2)", limits={"iterations": 2})
    drawn = dict(pictures(saved(solution, tmp_path), Page()))
    assert {"mesh", "pressure", "motion", "design"} <= set(drawn)
    assert "limits" not in drawn  # no node is relocated
    titles = [axis.get_title() for axis in drawn["mesh"].axes[:2]]
    assert titles == ["first design", "last design"]
    first, last = (line.get_ydata() for line in drawn["pressure"].axes[0].lines)
    assert np.max(last) == pytest.approx(solution.final.pressure.max())
    expected = fixed.solve(problem.at_design(), objective="area").final.pressure
    assert np.max(first) == pytest.approx(expected.max(), rel=1e-9)
    assert np.max(first) != pytest.approx(np.max(last), rel=1e-3)


@pytest.mark.parametrize("order", [1, 2])
def test_both_sides_of_a_pair_are_in_fields_pictures_record_and_tables(order: int, tmp_path: Path) -> None:
    problem = replace(pressed(stacked(3), order=order), units=rm.Units("mm", "N"))
    solution = fixed.solve(problem)
    result = saved(solution, tmp_path)
    state = read_vtu(result.vtu).final
    for part in DisplacementSpace(problem).contact_sets:
        own, other = part.carriers(part.nodes)
        for name in ("pressure", "gap"):
            values = getattr(state, name)
            np.testing.assert_array_equal(values[own], values[other])
        assert state.pressure[own] == pytest.approx(5)
    drawn = dict(pictures(result, Page()))
    labels = [axis.get_xlabel() for axis in drawn["pressure"].axes]
    pairs = ["bottom-1 and top-0", "bottom-2 and top-1"]
    assert labels == [f"$x_1$ [mm] on {name}" for name in pairs]
    deformed = drawn["mesh"].axes[1]
    assert "jump at pairs" in deformed.get_title()
    assert not deformed.collections  # no foundation that would be rigid
    assert result.record["pairs"] == {name[:8]: name.split(" and ") for name in pairs}
    assert {f"{name}: normal force [N/mm]" for name in pairs} <= dict(solution.summary()).keys()
    assert all(f"| {name} |" in markdown([result.record], short=True) for name in pairs)


@pytest.mark.parametrize(
    ("what", "labels"),
    [
        ("mesh", ["$x_1$ [mm]", "$x_2$ [mm]"]),
        ("displacement", ["$|u|$ [mm]"]),
        ("stress", ["von Mises stress [N/mm²]"]),
        ("pressure", ["$x_1$ [mm]", "contact pressure [N/mm²]"]),
    ],
)
def test_pictures_of_a_solution_have_the_units_of_its_problem(what: str, labels: list[str]) -> None:
    axes = new_figure(4, 4).subplots()
    fixed.solve(replace(pressed(stacked()), units=rm.Units("mm", "N"))).plot(what, axes)
    shown = [text.get_text() for text in axes.figure.findobj(Text)]
    assert set(labels) <= set(shown)


@pytest.mark.parametrize("nodes", [(30, 42), (30, 130, 900)])
def test_sizes_of_few_meshes_have_labels(nodes: tuple[int, ...]) -> None:
    of = {"value": 1.0, "error": 0.1}
    meshes = [{"nodes": n, "seconds": 0.1 * n, "quantities": {"peak(a)": of}} for n in nodes]
    figure = estimates_figure(meshes, Page())
    figure.draw_without_rendering()
    low, high = figure.axes[0].get_xlim()
    assert sum(low <= tick <= high for tick in figure.axes[0].get_xticks()) >= 2
