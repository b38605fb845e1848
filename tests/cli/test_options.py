"""What is typed reaches the planned solve; what cannot be meant is refused in one line."""

from pathlib import Path
from typing import Any

import pytest

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.settings import from_texts
from rmesh_nlp.study.plan import PlannedSolve
from support.problem_files import VALID

STUDY = 'examples = ["6.1"]\nformulations = ["fixed"]\n'


@pytest.fixture
def plans(monkeypatch: pytest.MonkeyPatch) -> list[PlannedSolve]:
    """The solves that a command would do."""
    found: list[PlannedSolve] = []

    def note(solve: PlannedSolve, *_: Any) -> None:
        found.append(solve)
        raise KeyboardInterrupt

    monkeypatch.setattr("rmesh_nlp.cli.solving.perform", note)
    monkeypatch.setattr("rmesh_nlp.study.engine.perform", note)
    return found


TYPED = (
    "--relaxation lin-fukushima --seed 0 --objective error-l2 --time-limit 9 --max-iterations 7 "
    "--tolerance 0.01 --start joint --set t0=1e-3 --set ipopt_exact.tol=1e-9 --certify"
)
MEANT = {
    "relaxation": "lin-fukushima", "seed": 0, "objective": "error-l2", "tolerance": 0.01, "start": "joint",
    "limits": {"seconds": 9.0, "iterations": 7}, "t0": 1e-3, "ipopt_exact": {"tol": 1e-9},
}  # fmt: skip


def test_every_option_of_solve_reaches_the_planned_solve(rmesh, plans: list[PlannedSolve]) -> None:
    for typed in (
        f"6.1 -f mpcc --n 4 --delta 0.02,0.01 --quadrature 5 {TYPED}",
        "6.2 --n 4x2 --delta none --regularisation 1,0.1 --remesh --nodes 40",
        "6.2 -f nested --starts 2",
    ):
        assert rmesh(f"solve {typed}").code == 130
    mpcc, auto, nested = plans
    assert (mpcc.formulation, mpcc.options, mpcc.certify) == ("mpcc", MEANT, True)
    assert mpcc.identity["delta"] == [0.02, 0.01]
    assert mpcc.identity["quadrature"] == 5
    assert (auto.formulation, auto.size, auto.certify) == ("auto", "4x2", False)
    assert auto.identity["delta"] is None
    assert auto.options == {"regularisation": "1,0.1", "remesh": 40}
    assert nested.options == {"starts": 2}


def test_compare_takes_several_seeds_and_objectives(rmesh, plans: list[PlannedSolve]) -> None:
    typed = "compare 6.1 --formulations joint,fixed --n 3 --seed 1 --seed 2 --seed 3 --repeats 2"
    assert rmesh(typed).code == 130
    (first,) = plans
    assert (first.options, first.repeats) == ({"seed": 1}, 2)


IN_FILE = {"regularisation": [0.1, 0.02], "tolerance": 0.5, "seed": 4}
TYPED_TOO = "--regularisation 0.5 --seed 0 --objective quality --time-limit 9"


@pytest.mark.parametrize(
    ("asked", "typed", "formulation", "options"),
    [
        (True, "", "joint", IN_FILE),
        (True, f"-f nested {TYPED_TOO}", "nested",
         {"regularisation": "0.5", "tolerance": 0.5, "seed": 0, "objective": "quality",
          "limits": {"seconds": 9.0}}),
        # a formulation without iterations takes limits that it does not need
        (False, "-f fixed --time-limit 9 --tolerance 0.9", "fixed",
         {"limits": {"seconds": 9.0}, "tolerance": 0.9}),
    ],
)  # fmt: skip
def test_options_of_the_command_line_override_those_of_a_file(
    rmesh, plans: list[PlannedSolve], asked: bool, typed: str, formulation: str, options: dict[str, Any]
) -> None:
    in_file = "regularisation = [0.1, 0.02]\ntolerance = 0.5\ncertify = true\nseed = 4\n"
    Path("my.toml").write_text(VALID + in_file * asked)
    assert rmesh(f"solve my.toml {typed}").code == 130
    (plan,) = plans
    assert (plan.formulation, plan.certify, plan.options) == (formulation, asked, options)
    if asked:
        assert rmesh("solve my.toml -f fixed").code == 2  # it takes no seed


def test_a_name_with_dots_is_a_setting_of_settings_and_what_is_none_is_refused() -> None:
    given = ["t0=1e-8", "relaxation = scholtes", "blocks=[8, 4]", "twice=true"]
    found = {"t0": 1e-8, "relaxation": "scholtes", "blocks": [8, 4], "twice": True}
    assert from_texts(given) == found
    given = ["newton.forcing=0.2", "newton.step.searches=5", "tight=1"]
    assert from_texts(given) == {"newton": {"forcing": 0.2, "step": {"searches": 5}}, "tight": 1}
    said = dict.fromkeys(("tol", "=1", ".x=1", "newton.=1", "a..b=1"), "must be NAME=VALUE")
    said["tol.x=1"] = r"--set tol\.x=1: tol has a value already, 0\.5"
    for text, words in said.items():
        with pytest.raises(BadInputError, match=words):
            from_texts(["tol=0.5", text])


@pytest.mark.parametrize(
    ("typed", "named"),
    [
        ("compare --formulations fixed,,joint", "fixed,,joint"),
        ("solve 6.1 --seed -1", "-1"),
        ("solve 6.1 -f fixed --seed 1", "not an option of fixed"),
        ("solve 6.1 --order 0", "'--order'"),
        ("check my.toml --order 3", "3"),
        ("solve 6.1 --quadrature 0", "quadrature must be 'auto', 'midpoint' or a degree from 1 to 50, got 0"),
        ("solve 6.1 --out ''", "--out needs the name of a folder"),
        ("solve 6.1 --set time_limit_s=9", "9 is not an option of auto, did you mean 'limits'?"),
        ("compare 6.1 --set foo=1", "foo = 1 is not an option of fixed, nested, joint, mpcc: choose"),
        ("compare 6.1 --formulations mpcc:start", "NAME=VALUE"),
        ("compare 6.1 --formulations mpcc:speed=9", "speed = 9 is not an option of mpcc, did"),
        ("compare 6.1 --formulations mpcc:t0=x", "t0 must be positive and finite, got 'x'"),
        ("compare 6.1 --objective energy --objective nonsense", "nonsense"),
        ("compare problem.toml ./problem.toml", "two problem files are both called 'block'"),
        ("compare problem.toml --quadrature 4", "for the examples: write it into the files"),
        ("solve 6.1 --regularisation much", "'much'"),
        ("solve my.toml --n 4x2", "--n 4x2 is for the examples"),
        ("solve study.toml", "study.toml: this is a study file: use rmesh study"),
        ("study problem.toml --out o", "problem.toml: this is a problem file: use rmesh solve"),
        ("compare my.toml --jobs 2", "--jobs is for the examples"),
        ("compare 6.1 --jobs 2 --repeats 2", "--repeats"),
        ("slove 6.1", "slove"),
        ("solve", "EXAMPLE"),
        ("table nowhere", "'nowhere' is not a folder"),
        ("figures .", "holds neither records.jsonl nor record.json"),
        ("export . --parquet x.foo", "x.foo: expected a file .parquet"),
        ("compare 6.1 --n 3 --out file/x", "file/x"),
        ("new nowhere/my.toml", "nowhere"),
        ("new file", "file: File exists"),
        ("solve 6.2 --n 4x2 --nodes 40", "--nodes 40 is for --remesh"),
        ("remesh problem.toml --out better.stl", "better.stl: expected a file .msh"),
        ("remesh problem.toml --out nowhere/a.msh", "a file .msh in a folder that exists"),
        ("remesh problem.toml --nodes 2", "--nodes"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(rmesh, typed: str, named: str) -> None:
    files = {"file": "not a folder", "study.toml": STUDY, "problem.toml": VALID}
    for name, text in files.items():
        Path(name).write_text(text)
    said = rmesh(typed)
    assert (said.code, said.out) == (2, "")
    (line,) = [line for line in said.err.splitlines() if line]
    assert line.startswith("rmesh: error: ")
    assert named in line
    assert {path.name for path in Path().iterdir()} == files.keys()
