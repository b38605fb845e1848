"""Figures of designs: objective and variables over the iterations; body and pressure, first and last."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rmesh_nlp.io.results import Result
from rmesh_nlp.problem import Motion
from rmesh_nlp.report.design_figure import PANELS, design_figure
from rmesh_nlp.report.figures import figure_of_designs
from rmesh_nlp.report.pictures import pictures
from rmesh_nlp.report.style import Page
from support.designs import BOW, H0, E, block
from support.formulations import nested
from support.reporting import designed

BOUNDS = {"E": (0.5, 2.0), "h": (-0.1, 0.1)}


def history(count: int = 4, names: tuple[str, ...] = ("E", "h"), objective: float = 0.1) -> list[dict]:
    return [
        {"iteration": k, "objective": objective**k, "primal_residual": 1e-2 if k == 1 else 0.0}
        | {f"design.{name}": 1.0 + 0.1 * k for name in names}
        for k in range(count)
    ]


def test_objective_and_each_variable_have_a_panel_with_their_bounds() -> None:
    figure = design_figure({"nested": history(), "mpcc": history(3)}, BOUNDS, "area")
    assert figure is not None
    assert [axis.get_ylabel() for axis in figure.axes] == ["objective", "E", "h"]
    objective, modulus, _ = figure.axes
    assert objective.get_yscale() == "log"
    every, met, end = objective.lines[:3]
    np.testing.assert_allclose(every.get_ydata(), [1, 0.1, 0.01, 1e-3])
    np.testing.assert_array_equal(np.isnan(met.get_ydata()), [False, True, False, False])
    assert end.get_ydata() == pytest.approx([1e-3])
    assert {tuple(line.get_ydata()) for line in modulus.lines} >= {(0.5, 0.5), (2.0, 2.0)}
    assert modulus.get_ylim()[0] < 0.5 < 2.0 < modulus.get_ylim()[1]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["nested", "mpcc"]
    alone = design_figure({"": history()}, BOUNDS, "area")
    assert alone is not None
    assert not alone.legends


def test_many_variables_share_a_panel_as_parts_of_their_bounds() -> None:
    names = tuple(f"v{k}" for k in range(PANELS + 1))
    figure = design_figure({"": history(names=names)}, dict.fromkeys(names, (1.0, 2.0)), "area")
    assert figure is not None
    assert len(figure.axes) == 2
    np.testing.assert_allclose(figure.axes[1].lines[-1].get_ydata(), [0, 0.1, 0.2, 0.3])


def test_solves_of_very_different_length_have_a_logarithmic_axis() -> None:
    for count, scale in ((60, "symlog"), (30, "linear")):
        figure = design_figure({"a": history(4), "b": history(count, objective=1.0)}, BOUNDS, "area")
        assert figure is not None
        assert {axis.get_xscale() for axis in figure.axes} == {scale}


def test_nothing_is_drawn_without_designs_in_a_history(tmp_path: Path) -> None:
    assert design_figure({"": []}, BOUNDS, "area") is None
    assert design_figure({"": [{"iteration": 0, "objective": 1.0}]}, BOUNDS, "area") is None
    missing = Result(designed(), tmp_path / "no.vtu", tmp_path / "no.csv")
    assert figure_of_designs([missing]) is None
    assert figure_of_designs([Result(designed(formulation="fixed"), missing.vtu, missing.history)]) is None


def test_pictures_are_of_the_first_and_the_last_design() -> None:
    problem = replace(block(E, H0, BOW), motion=Motion(0))
    solution = nested.solve(problem, objective="mean(right, uy**2)")
    drawn = dict(pictures(solution, Page()))
    assert {"mesh", "pressure", "motion", "design"} <= set(drawn)
    assert "limits" not in drawn  # no node is relocated
    titles = [axis.get_title() for axis in drawn["mesh"].axes[:2]]
    assert titles == ["first design", "last design"]
    first, last = (line.get_ydata() for line in drawn["pressure"].axes[0].lines)
    assert np.max(last) == pytest.approx(solution.pressure.max())
    begin = problem.at_design()
    expected = nested.solve(replace(begin, design=(), motion=Motion(0)), objective="area").pressure
    assert np.max(first) == pytest.approx(expected.max(), rel=1e-9)
    assert np.max(first) != pytest.approx(np.max(last), rel=1e-3)
