"""Settings that do not suit a problem are refused before anything is solved."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.study.cases import build_problem, plan_comparison
from support.problem_files import VALID


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)
    Path("own.toml").write_text(VALID)
    return "own.toml"


@pytest.mark.parametrize("setting", [{"n": 4}, {"delta": 0.01}, {"quadrature": 4}])
def test_sizes_are_for_the_examples(file: str, setting: dict[str, Any]) -> None:
    with pytest.raises(BadInputError, match="for the examples"):
        plan_comparison([file], ["fixed"], **setting)
    plan_comparison(["6.1"], ["fixed"], **{"n": 4, **setting})


def test_of_a_file_uniform_refinements_without_motion_are_cases_too(file: str) -> None:
    (given,) = plan_comparison([file], ["nested"], certify=True, refined=0)
    own, finer = plan_comparison([file], ["nested"], certify=True, refined=1)
    assert [given.formulation, own.formulation, finer.formulation] == ["nested", "nested", "fixed"]
    assert finer.problem.mesh.t.shape[1] == 4 * own.problem.mesh.t.shape[1]
    assert given.certify
    assert finer.certify


def test_keys_are_file_names() -> None:
    options = {"seed": 3, "objective": "error-l2 + 0.01*quality"}
    (case,) = plan_comparison(["6.1"], ["nested"], n=4, options=options)
    assert case.key == "6.1-4-nested-error-l2_+_0.01_quality-seed3"
    assert replace(case, options={}).key == "6.1-4-nested"
    assert case.identity["key"] == case.key


def test_size_and_delta_reach_the_example() -> None:
    problem = build_problem("6.1", n=5, delta=0.02, quadrature=6)
    assert (problem.size, problem.rule) == ("5", 6)
    assert problem.motion.delta_record() == [0.02, 0.02]
    assert build_problem("6.1").size == "8"
    with pytest.raises(BadInputError, match=r"6\.9"):
        build_problem("6.9")
    with pytest.raises(BadInputError):
        build_problem("6.1", n=-1)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"objective": "nonsense"}, "nonsense"),
        ({"objective": ["energy", "nonsense"]}, "nonsense"),
        ({"relaxation": "nonsense"}, "nonsense"),
        ({"outer": "nonsense"}, "nonsense"),
        ({"relaxation": "scholtes"}, "--relaxation scholtes: not an option of fixed"),
    ],
)
def test_options_are_checked(options: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInputError, match=said):
        plan_comparison(["6.1"], ["fixed"], n=4, options=options)


def test_limits_go_to_those_that_heed_them_and_are_no_error_for_others() -> None:
    (case,) = plan_comparison(["6.1"], ["fixed"], n=4, options={"time_limit_s": 5.0})
    assert case.options == {}
    nested, fixed = plan_comparison(["6.1"], ["nested", "fixed"], n=4, options={"time_limit_s": 5.0})
    assert (nested.options, fixed.options) == ({"time_limit_s": 5.0}, {})


def test_an_objective_of_errors_gives_every_problem_a_reference() -> None:
    (case,) = plan_comparison(["6.2"], ["fixed"], n=(4, 2), options={"objective": ["energy"]})
    assert case.problem.exact is None
