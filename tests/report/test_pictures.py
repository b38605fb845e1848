"""Pictures of a solve: what is drawn, what is left out, that letters are large enough."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Laplace, Motion, Obstacle, Relative, Units
from rmesh_nlp.report.pictures import Limit, after, before, limits, pictures, write_pictures
from rmesh_nlp.report.style import SMALLEST, Page
from support.contact_geometry import block_between_two_foundations
from support.formulations import fixed, joint


def membrane() -> ContactProblem:
    """A membrane on an obstacle in the interior, with a disc of contact."""
    return ContactProblem(
        mesh=rectangle(8, 8, x=(-1, 1), y=(-1, 1)),
        law=Laplace(-4.0),
        dirichlet=("left", "right", "top", "bottom"),
        obstacle=Obstacle.interior(-0.3),
        motion=Motion(Relative(0.2)),
    )


def letters(figure: Figure) -> list[float]:
    """Sizes in points of all letters of a figure that are seen."""
    figure.draw_without_rendering()
    seen = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]
    return [float(text.get_fontsize()) for text in seen]


@pytest.mark.slow
@pytest.mark.parametrize("columns", [1, 2])
@pytest.mark.parametrize("make", [block_between_two_foundations, membrane])
def test_every_letter_is_legible_at_the_width_of_the_page(
    make: Callable[[], ContactProblem], columns: int
) -> None:
    page = Page(columns)
    for name, figure in pictures(joint.solve(make()), page):
        assert min(letters(figure)) >= SMALLEST, name
        assert figure.get_size_inches()[0] <= page.width + 1e-9


@pytest.mark.slow
def test_a_solve_of_a_body_has_all_its_pictures(tmp_path: Path) -> None:
    problem = replace(block_between_two_foundations(), units=Units("mm", "N"))
    paths = write_pictures(joint.solve(problem), tmp_path)
    names = ("mesh", "displacement", "stress", "pressure", "motion", "limits")
    assert [path.name for path in paths] == [f"{n}.{kind}" for n in names for kind in ("png", "pdf")]
    assert all(path.stat().st_size > 5000 for path in paths)


@pytest.mark.slow
def test_units_stand_on_the_axes_only_if_they_were_given() -> None:
    for units, words in ((Units(), False), (Units("mm", "N"), True)):
        problem = replace(block_between_two_foundations(), units=units)
        figures = dict(pictures(fixed.solve(problem), Page()))
        labels = [axis.get_xlabel() + axis.get_ylabel() for f in figures.values() for axis in f.axes]
        assert any("[mm]" in label for label in labels) is words
        assert any("[N/mm²]" in label for label in labels) is words
        assert not any("[m]" in label for label in labels)


@pytest.mark.slow
def test_nothing_that_is_zero_is_drawn() -> None:
    # held and not loaded: no displacement, no stress, no pressure; and nothing moved
    rest = replace(membrane(), law=Laplace(0.0), obstacle=Obstacle.interior(-1.0))
    assert [name for name, _ in pictures(fixed.solve(rest), Page())] == ["mesh"]
    assert [name for name, _ in pictures(fixed.solve(membrane()), Page())] == ["mesh", "displacement", "flux"]


def test_the_contact_set_of_a_membrane_is_where_it_touches() -> None:
    problem = membrane()
    solution = joint.solve(problem)
    _, meshes = next(pictures(solution, Page()))
    for state, axis in zip((before(problem), after(solution)), meshes.axes, strict=True):
        inside = state.closed
        assert 0 < inside.sum() < inside.size
        middle = state.nodes[:, problem.triangles].mean(axis=1)
        # in the middle, and not at the corners, where the nodes are held above the obstacle
        assert np.max(np.abs(middle[:, inside])) < 0.9
        assert inside[np.argmin(np.linalg.norm(middle, axis=0))]
        pairs = np.sort(np.hstack([problem.triangles[[i, i - 1]][:, inside] for i in range(3)]), axis=0)
        rim = np.sum(np.unique(pairs, axis=1, return_counts=True)[1] == 1)
        _, edge = axis.collections
        assert len(edge.get_segments()) == rim


def test_state_before_is_the_solution_on_the_given_mesh() -> None:
    for problem in (membrane(), block_between_two_foundations()):
        solution = fixed.solve(problem)
        cold, warm, again = before(problem), before(problem, solution.pressure), after(solution)
        for state in (cold, warm):
            np.testing.assert_allclose(state.displacement, solution.displacement, atol=1e-12)
            np.testing.assert_allclose(state.pressure, solution.pressure, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(state.stress, again.stress, rtol=1e-9)
        assert (cold.title, again.title) == ("given mesh", "given mesh, nothing moved")


def test_a_node_is_at_its_move_limit_if_its_multiplier_counts() -> None:
    problem = membrane()
    nodes = np.flatnonzero(limits(SimpleNamespace(problem=problem, multipliers=None)) == Limit.NOTHING)
    push, nothing = np.zeros(problem.mesh.p.shape[1]), np.zeros(problem.mesh.t.shape[1])
    push[nodes[:3]] = 1.0, 1e-3, 1e-7
    found = limits(
        SimpleNamespace(problem=problem, multipliers=SimpleNamespace(area=nothing, angle=nothing, limit=push))
    )
    assert np.flatnonzero(found == Limit.MOVE_LIMIT).tolist() == nodes[:2].tolist()
    assert Limit.AREA not in found


def test_a_least_angle_holds_the_nodes_of_its_element() -> None:
    problem = replace(membrane(), motion=Motion(None))
    angle = np.eye(problem.mesh.t.shape[1])[0]
    pulls = SimpleNamespace(area=0 * angle, angle=angle, limit=np.zeros(problem.mesh.p.shape[1]))
    found = limits(SimpleNamespace(problem=problem, multipliers=pulls))
    free = found != Limit.PINNED
    assert set(np.flatnonzero(found == Limit.AREA)) == set(problem.triangles[:, 0]) & set(
        np.flatnonzero(free)
    )


@pytest.mark.slow
def test_limits_name_move_limits_and_areas() -> None:
    problem = membrane()
    tight = limits(joint.solve(replace(problem, motion=Motion(Relative(0.02)))))
    assert np.sum(tight == Limit.MOVE_LIMIT) > np.sum(tight == Limit.AREA)
    wide = limits(joint.solve(replace(problem, motion=Motion(None, min_area_fraction=0.5))))
    assert Limit.MOVE_LIMIT not in wide
    assert Limit.AREA in wide
    corner = int(np.argmin(problem.mesh.p.sum(axis=0)))
    assert wide[corner] is Limit.PINNED
