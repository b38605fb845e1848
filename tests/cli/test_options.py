"""What is typed reaches the planned solve; what cannot be meant is refused in one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rmesh_nlp.cli import app as cli
from rmesh_nlp.cli.options import parse_settings
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.study.plan import PlannedSolve
from support.problem_files import VALID


@pytest.fixture
def plans(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[PlannedSolve]:
    """The solves that a command would do."""
    monkeypatch.chdir(tmp_path)
    found: list[PlannedSolve] = []

    def note(solve: PlannedSolve, *_: Any) -> None:
        found.append(solve)
        raise KeyboardInterrupt

    monkeypatch.setattr("rmesh_nlp.cli.solving.perform", note)
    monkeypatch.setattr("rmesh_nlp.study.comparison.perform", note)
    return found


TYPED = (
    "--relaxation lin-fukushima --seed 0 --objective error-l2 --time-limit 9 --max-iterations 7 "
    "--tolerance 0.01 --start joint --set tol=1e-8 --set newton.forcing=0.2 --certify"
)
MEANT = {
    "relaxation": "lin-fukushima", "seed": 0, "objective": "error-l2", "time_limit_s": 9.0,
    "max_iterations": 7, "tolerance": 0.01, "start": "joint",
    "settings": {"tol": 1e-8, "newton": {"forcing": 0.2}},
}  # fmt: skip


def test_every_option_of_solve_reaches_the_planned_solve(plans: list[PlannedSolve]) -> None:
    arguments = ["solve", "6.1", "-f", "mpcc", "--n", "4", "--delta", "0.02,0.01", "--quadrature", "5"]
    assert cli.run([*arguments, *TYPED.split()]) == 130
    for typed in (
        "--n 4x2 --delta none --regularisation 1,0.1 --flips",
        "-f nested --outer ipopt --starts 2",
        "--levels 2",
    ):
        assert cli.run(["solve", "6.2", *typed.split()]) == 130
    mpcc, joint, nested, levels = plans
    assert (mpcc.formulation, mpcc.options, mpcc.certify) == ("mpcc", MEANT, True)
    assert mpcc.identity["delta"] == [0.02, 0.01]
    assert mpcc.identity["quadrature"] == 5
    assert (joint.formulation, joint.size, joint.certify) == ("joint", "4x2", False)
    assert joint.identity["delta"] is None
    assert joint.options == {"regularisation": (1.0, 0.1), "flips": True}
    assert nested.options == {"outer": "ipopt", "starts": 2}
    assert levels.options == {"levels": 2}


def test_compare_takes_several_seeds_and_objectives(plans: list[PlannedSolve]) -> None:
    typed = "compare 6.1 --formulations joint,fixed --n 3 --seed 1 --seed 2,3 --repeats 2"
    assert cli.run(typed.split()) == 130
    (first,) = plans
    assert (first.options, first.repeats) == ({"seed": 1}, 2)


def test_options_of_the_command_line_override_those_of_a_file(plans: list[PlannedSolve]) -> None:
    asked = "regularisation = [0.1, 0.02]\nflips = true\ncertify = true\nseed = 4\n"
    Path("my.toml").write_text(VALID + asked)
    assert cli.run(["solve", "my.toml"]) == 130
    typed = ["--regularisation", "0.5", "--seed", "0", "--objective", "quality", "--time-limit", "9"]
    assert cli.run(["solve", "my.toml", "-f", "nested", *typed]) == 130
    by_file, by_option = plans
    assert (by_file.formulation, by_file.certify) == ("joint", True)
    assert by_file.options == {"regularisation": (0.1, 0.02), "flips": True, "seed": 4}
    assert (by_option.formulation, by_option.certify) == ("nested", True)
    assert by_option.options == {
        **{"regularisation": (0.5,), "flips": True, "seed": 0, "objective": "quality", "time_limit_s": 9.0},
    }
    assert cli.run(["solve", "my.toml", "-f", "fixed", "--time-limit", "9", "--tolerance", "1"]) == 2  # flips
    Path("my.toml").write_text(VALID)
    assert cli.run(["solve", "my.toml", "-f", "fixed", "--time-limit", "9", "--tolerance", "1"]) == 130
    assert plans[-1].options == {}  # a formulation without iterations needs no limits


@pytest.mark.parametrize(
    ("given", "found"),
    [
        ([], {}),
        (["tol=1e-8", "relaxation = scholtes"], {"tol": 1e-8, "relaxation": "scholtes"}),
        (["blocks=[8, 4]", "without_first=true"], {"blocks": [8, 4], "without_first": True}),
        (
            ["newton.forcing=0.2", "newton.step.searches=5", "tight=1"],
            {"newton": {"forcing": 0.2, "step": {"searches": 5}}, "tight": 1},
        ),
    ],
)
def test_a_name_with_dots_is_a_setting_of_settings(given: list[str], found: dict[str, Any]) -> None:
    assert parse_settings(given) == found


@pytest.mark.parametrize("text", ["tol", "=1", ".x=1", "newton.=1", "a..b=1", "tol.x=1"])
def test_what_is_no_setting_is_refused(text: str) -> None:
    said = r"--set tol\.x=1: tol has a value already, 0\.5" if text == "tol.x=1" else "must be NAME=VALUE"
    with pytest.raises(BadInputError, match=said):
        parse_settings(["tol=0.5", text])


BAD = {
    "unknown example": (["solve", "6.4"], "6.4"),
    "unknown formulation": (["solve", "6.1", "-f", "jiont"], "did you mean joint"),
    "unknown formulation in a list": (["compare", "--formulations", "fixed,nestde"], "nestde"),
    "empty name": (["compare", "--formulations", "fixed,,joint"], "fixed,,joint"),
    "size zero": (["solve", "6.1", "--n", "0"], "'0'"),
    "size one": (["solve", "6.2", "--n", "12x1"], "'12x1'"),
    "fractional size": (["solve", "6.1", "--n", "8.5"], "8.5"),
    "odd columns": (["solve", "6.2", "--n", "7x6"], "7"),
    "negative delta": (["solve", "6.1", "--delta", "-1"], "-1"),
    "delta nan": (["solve", "6.1", "--delta", "nan"], "nan"),
    "three deltas": (["solve", "6.1", "--delta", "1,2,3"], "1,2,3"),
    "negative seed": (["solve", "6.1", "--seed", "-1"], "-1"),
    "several seeds": (["solve", "6.1", "--seed", "1,2"], "1,2"),
    "quadrature": (["solve", "6.1", "--quadrature", "0"], "'0'"),
    "quadrature too high": (["solve", "6.1", "--quadrature", "51"], "'51'"),
    "objective": (["solve", "6.1", "--objective", "energie"], "energie"),
    "objective refused": (["solve", "6.1", "--objective", "error-l2"], "error-l2"),
    "relaxation": (["solve", "6.1", "-f", "mpcc", "--relaxation", "scholtse"], "did you mean scholtes"),
    "outer solver": (["solve", "6.1", "-f", "nested", "--outer", "newtn"], "did you mean newton"),
    "outer solver not taken": (["solve", "6.1", "-f", "joint", "--outer", "newton"], "--outer newton"),
    "option not taken": (["solve", "6.1", "--relaxation", "scholtes"], "--relaxation scholtes"),
    "negative weight": (["solve", "6.1", "--regularisation=-1"], "'-1'"),
    "zero weight": (["solve", "6.1", "--regularisation", "1,0,0.1"], "'1,0,0.1'"),
    "no weight": (["solve", "6.1", "--regularisation", "much"], "'much'"),
    "weight nan": (["solve", "6.1", "--regularisation", "nan"], "'nan'"),
    "size of a file": (["solve", "my.toml", "--n", "4x2"], "--n 4x2 is for the examples"),
    "jobs for a file": (["compare", "my.toml", "--jobs", "2"], "--jobs is for the examples"),
    "jobs and repeats": (["compare", "6.1", "--jobs", "2", "--repeats", "2"], "--repeats"),
    "unknown option": (["solve", "6.1", "--fast"], "--fast"),
    "unknown command": (["slove", "6.1"], "slove"),
    "missing argument": (["solve"], "EXAMPLE"),
    "missing folder": (["table", "nowhere"], "nowhere"),
    "empty folder": (["figures", "."], "records.jsonl"),
    "folder is a file": (["solve", "6.1", "--n", "3", "--out", "file"], "file"),
    "folder below a file": (["compare", "6.1", "--n", "3", "--out", "file/x"], "file/x"),
    "no folder for a new file": (["new", "nowhere/my.toml"], "nowhere"),
    "a file that is there": (["new", "file"], "file exists"),
}


@pytest.mark.parametrize(("arguments", "named"), BAD.values(), ids=BAD.keys())
def test_bad_input_is_one_line_and_exit_code_2(
    arguments: list[str],
    named: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("not a folder")
    assert cli.run(arguments) == 2
    printed = capsys.readouterr()
    (line,) = [line for line in printed.err.splitlines() if line]
    assert line.startswith("rmesh: error: ")
    assert named in line
    assert printed.out == ""
    assert sorted(path.name for path in Path().iterdir()) == ["file"]
