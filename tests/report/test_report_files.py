"""Figures come from files alone, and a broken file is named."""

from __future__ import annotations

import pytest

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.results import Result, Results, read_results
from rmesh_nlp.report.figures import write_figures
from rmesh_nlp.study.cases import plan_comparison
from rmesh_nlp.study.comparison import run


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> list[Result]:
    folder = tmp_path_factory.mktemp("results")
    list(run(plan_comparison(["6.1"], ["fixed"], n=3), Results(folder)))
    return read_results(folder)


@pytest.mark.slow
def test_nothing_is_solved_for_figures(results, tmp_path, monkeypatch):
    def refuse(*_: object) -> None:
        raise AssertionError("a solver was called")

    monkeypatch.setattr("rmesh_nlp.contact.solver.ContactSolver.solve", refuse)
    monkeypatch.setattr("casadi.nlpsol", refuse)
    assert write_figures(results, tmp_path / "figures")


@pytest.mark.parametrize("content", [None, "<VTKFile", "<VTKFile/>", "no XML"])
def test_a_missing_or_broken_solution_file_is_named(results, tmp_path, content):
    path = tmp_path / "it.vtu"
    if content is not None:
        path.write_text(content)
    with pytest.raises(BadInputError, match=r"it\.vtu"):
        write_figures([Result(results[0].record, path, results[0].history)], tmp_path)
