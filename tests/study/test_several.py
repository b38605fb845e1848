"""Several objectives, seeds and formulations with options of their own in one comparison."""

from __future__ import annotations

from pathlib import Path

import pytest

from rmesh_nlp.cli.app import run
from rmesh_nlp.cli.commands import does_not_apply
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.results import read_results
from rmesh_nlp.study.cases import formulation_options, plan_comparison
from support.problem_files import VALID

QUICKLY = ("--quiet", "--no-figures")


def test_objectives_and_seeds_are_multiplied() -> None:
    options = {"objective": ["energy", "error-l2"], "seed": [1, 2]}
    cases = plan_comparison(["6.1"], ["fixed", "joint"], n=4, options=options)
    assert len({case.key for case in cases}) == len(cases)
    joint = [case.options for case in cases if case.formulation == "joint"]
    assert [(o["objective"], o["seed"]) for o in joint] == [
        ("energy", 1), ("energy", 2), ("error-l2", 1), ("error-l2", 2)
    ]  # fmt: skip
    # fixed takes no seed: once for each objective
    assert len([case for case in cases if case.formulation == "fixed"]) == 2


def test_errors_of_a_problem_of_ones_own_need_a_solution_that_is_known(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    # the name of an example does not lend it the reference solution of that example
    path.write_text('name = "6.2"\n' + VALID.replace('name = "block"\n', ""))
    with pytest.raises(
        BadInputError, match=r"error-l2: needs an exact or reference solution, and '6\.2' has none"
    ):
        plan_comparison([str(path)], ["nested"], options={"objective": ["energy", "error-l2"]})


def test_a_formulation_may_have_options_of_its_own() -> None:
    cases = plan_comparison(["6.1"], ["mpcc", "mpcc:start=joint", "nested:outer=ipopt:seed=3"], n=4)
    assert [dict(case.options) for case in cases] == [{}, {"start": "joint"}, {"outer": "ipopt", "seed": 3}]
    assert len({case.key for case in cases}) == 3


@pytest.mark.parametrize(
    ("text", "said"),
    [("mpcc:start", "name=value"), ("mpcc:speed=9", "takes no option 'speed'"), ("mpc:start=joint", "mpc")],
)
def test_wrong_options_are_named(text: str, said: str) -> None:
    with pytest.raises(BadInputError, match=said):
        formulation_options(text)


@pytest.mark.slow
def test_an_objective_that_joint_refuses_is_a_dash_and_no_failure(tmp_path: Path) -> None:
    arguments = ["compare", "6.1", "--n", "4", "--quadrature", "6", "--formulations", "joint,nested"]
    arguments += [*QUICKLY]
    assert run([*arguments, "--objective", "energy", "--objective", "error-l2", "--out", str(tmp_path)]) == 0
    rows = [result.record for result in read_results(tmp_path)]
    assert [does_not_apply(row) for row in rows] == [False, False, True, False]
    assert (rows[2]["status"], rows[2]["success"], rows[2]["energy"]) == ("refused", False, None)
    assert "error-l2" in rows[2]["message"]
    assert rows[2]["message"] in (tmp_path / "table.md").read_text()
    table = (tmp_path / "table.md").read_text()
    assert "| nested, error-l2 |" in table
    assert all(row["I1"] + row["I2"] > 0 for row in rows if row["success"])


def test_refusing_the_only_objective_is_no_success(tmp_path: Path) -> None:
    arguments = ["compare", "6.1", "--n", "4", "--formulations", "joint", *QUICKLY, "--out", str(tmp_path)]
    assert run([*arguments, "--objective", "error-l2"]) == 1


@pytest.mark.slow
def test_seeds_given_one_after_the_other_are_all_solved_and_joined(tmp_path: Path) -> None:
    arguments = ["compare", "6.1", "--n", "3", "--quadrature", "6", "--formulations", "joint", *QUICKLY]
    assert run([*arguments, "--seed", "1", "--seed", "2,3", "--out", str(tmp_path)]) == 0
    assert [result.record["seed"] for result in read_results(tmp_path)] == [1, 2, 3]
    assert "## Several starts" in (tmp_path / "table.md").read_text()


@pytest.mark.slow
def test_another_objective_joins_what_is_there(tmp_path: Path) -> None:
    arguments = ["compare", "6.1", "--n", "3", "--quadrature", "6", "--formulations", "nested", *QUICKLY]
    assert run([*arguments, "--objective", "energy", "--out", str(tmp_path)]) == 0
    assert run([*arguments, "--objective", "error-l2", "--resume", "--out", str(tmp_path)]) == 0
    assert [result.record["objective"] for result in read_results(tmp_path)] == ["energy", "error-l2"]
    assert not (tmp_path / "previous").exists()
    assert not (tmp_path / "figures").exists()  # as asked
