"""Study files, and the plans that they become."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

import rmesh_nlp as rm
from rmesh_nlp.cli import app as cli
from rmesh_nlp.io.folder import safe_name
from rmesh_nlp.io.problem_file import template
from rmesh_nlp.study.plan import PlannedSolve, build, make_plan, seconds_of_plan
from rmesh_nlp.study.study_file import read_study
from support.problem_files import SCALAR, VALID

JOINT = "formulations = ['joint']\n"


def plan_of(path: Path, text: str) -> list[PlannedSolve]:
    path.write_text(text)
    return make_plan(read_study(path), path)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "study.toml"


def test_the_matrix_is_problems_by_formulations_by_seeds_by_repeats(path):
    plan = plan_of(
        path,
        """
        examples = ["6.1"]
        sizes = [3, 4]
        random = { seed = 5, count = 2 }
        seeds = ["given", 1, 2]
        repeats = 2
        formulations = ["fixed", "joint"]
        """,
    )
    # fixed takes no seed: one start; joint has three
    assert len(plan) == 4 * (1 + 3) * 2
    assert len({solve.key for solve in plan}) == len(plan)
    assert [solve.name for solve in plan[::16]] == ["6.1", "random-5"]


@pytest.mark.slow
def test_the_study_of_the_page_and_the_settings_that_the_template_suggests_are_valid(path):
    path.with_name("my.toml").write_text(VALID)
    page = (Path(__file__).parents[2] / "docs/studies.md").read_text()
    (text,) = re.findall(r"```toml\n(.*?)```", page, re.S)
    settings = re.findall(r"^#   (\S.*)$", template("rmesh_nlp.study", name="mine", file="study.toml"), re.M)
    assert {solve.variant for solve in plan_of(path, text)} == {"joint", "loose"}
    suggested = "\n".join(["examples = ['6.1']", *settings])
    assert {solve.variant for solve in plan_of(path, suggested)} == {"loose"}


def test_order_is_an_axis_of_all_problems(path):
    path.with_name("own.toml").write_text(f"order = 2\n{SCALAR}")
    text = JOINT + "examples = ['6.1']\nfiles = ['own.toml']\nrandom = { count = 1 }\n"
    plain, both = plan_of(path, text), plan_of(path, text + "order = [1, 2]")
    assert [solve.order for solve in plain] == [1, 2, 1]  # files have their own
    assert [(solve.name, solve.order) for solve in both] == [
        (name, order) for name in ("6.1", "own", "random-0") for order in (1, 2)
    ]
    assert {solve.key for solve in plain} <= {solve.key for solve in both}
    assert ["order2" in solve.key for solve in both] == [False, True] * 3
    for solve in both:
        problem = build(solve)
        assert problem.order == solve.order == solve.identity["order"]
        assert replace(solve, built=problem).order == solve.order
    # quadratic displacements are integrated by a better rule than the paper's
    assert [build(solve).quadrature for solve in both[:2]] == ["midpoint", "auto"]


def test_keys_tell_everything_apart_that_decides_the_result_and_nothing_else(monkeypatch):
    monkeypatch.setattr("rmesh_nlp.study.plan.__version__", "0.1")
    problem, limits = {"kind": "random", "seed": 1, "of": "rough"}, {"time_s": 60.0, "memory_mb": 4000.0}
    one = PlannedSolve(problem, "random-1", "random", "", "a", "joint", **limits)
    changes = {"variant": "b", "formulation": "nested", "options": {"seed": 1}, "repeat": 1, "time_s": 1.0}
    changes["problem"] = {**one.problem, "seed": 2}
    others = [replace(one, **{name: value}) for name, value in changes.items()]
    assert len({solve.key for solve in (one, *others)}) == 7
    assert replace(one, fields=False).key == one.key
    assert replace(one, problem={**one.problem, "path": "/elsewhere"}).key == one.key
    assert one.key == safe_name(one.key) == "random-1-a-d9d068b5a93c963f"


def test_a_problem_file_is_known_by_its_content(path):
    for name in ("a.toml", "b.toml"):
        assert cli.run(["new", str(path.with_name(name))]) == 0
    path.with_name("b.toml").write_text(path.with_name("a.toml").read_text())
    text = 'files = ["a.toml"]\nformulations = ["fixed"]'
    (before,) = plan_of(path, text)
    (copied,) = plan_of(path, text.replace("a.toml", "b.toml"))
    assert copied.key == before.key
    changed = path.with_name("a.toml").read_text().replace("poisson = 0.3", "poisson = 0.2")
    path.with_name("a.toml").write_text(changed)
    assert plan_of(path, text)[0].key != before.key


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (JOINT, "there is nothing to solve"),
        ("examples = ['6.1']", "formulations = nothing"),
        (JOINT + "examples = ['6.9']", "unknown example '6.9'"),
        ("examples = ['6.1']\nformulations = ['jiont']", "did you mean joint"),
        (JOINT + "examples = ['6.1']\nsize = [3]", "unknown key, did you mean 'sizes'?"),
        (JOINT + "examples = ['6.1']\nsizes = ['1x4']", "two such as 12x6, got '1x4'"),
        (JOINT + "examples = ['6.1']\nseeds = [-1]", "expected seeds such as"),
        (JOINT + "examples = ['6.1']\norder = 0", "order = 0: expected 1 for linear displacements, 2 for"),
        (JOINT + "examples = ['6.1']\norder = [1, true]", "expected 1 for linear"),
        (JOINT + "examples = ['6.1']\norder = []", "expected 1 for linear"),
        (JOINT + "examples = '6.1'", "examples = '6.1': expected a list of texts"),
        ("examples = ['6.1']\n[formulations.joint]\ntol = 1979-05-27", "tol = datetime.date(1979, 5, 27)"),
        (JOINT + "examples = ['6.1']\n[limits]\nseconds = 0", "limits.seconds = 0: expected"),
        (JOINT + "examples = ['6.1']\n[limits]\ntime = 9", "limits.time = 9: unknown key"),
        (JOINT + "examples = ['6.1']\nobjectives = ['energie']", "energie"),
        (JOINT + "random = { count = 3, kinds = ['x'] }", "expected 'scalar', 'membrane'"),
        (JOINT + "random = { count = 0 }", "random.count = 0"),
        (JOINT + "examples = ['6.1']\nsizes = { '6.2' = [8] }", "sizes.6.2: '6.2' is not among the examples"),
        (JOINT + "random = { count = 10000 }\nseeds = [1, 2]\nrepeats = 10000", "200000000 solves: a study"),
        (JOINT + "files = ['none.toml']", "none.toml"),
        ("[[", "is not valid TOML"),
        ("repeats = " + "9" * 5000, "is not valid TOML"),
    ],
)
def test_what_is_wrong_is_one_line(path, text, named):
    with pytest.raises(rm.BadInputError) as caught:
        plan_of(path, text)
    assert named in str(caught.value)
    assert "\n" not in str(caught.value)
    assert str(path.parent) in str(caught.value)


@pytest.mark.parametrize(("stated", "objective"), [("", "area"), ("objectives = ['energy']\n", None)])
def test_a_study_without_objectives_has_those_of_its_files(path, stated, objective):
    (path.parent / "own.toml").write_text(VALID + 'objective = "area"\n')
    plan = plan_of(path, "formulations = ['nested']\nfiles = ['own.toml']\nexamples = ['6.1']\n" + stated)
    found = {solve.name: solve.options.get("objective") for solve in plan}
    assert found == {"6.1": None, "block": objective}


@pytest.mark.slow
def test_a_dry_run_of_the_template_lists_the_keys_and_writes_nothing(path, capsys):
    assert cli.run(["new", "--study", str(path)]) == 0
    assert cli.run(["check", str(path)]) == 0
    capsys.readouterr()
    out = path.parent / "out"
    assert cli.run(["study", str(path), "--out", str(out), "--dry-run", "--json"]) == 0
    printed, plan = json.loads(capsys.readouterr().out), make_plan(read_study(path), path)
    assert printed["solves"] == [solve.key for solve in plan]
    assert printed["guess_s"] > 0
    assert not out.exists()
    assert {solve.variant for solve in plan} == {"fixed", "auto"}
    assert [build(solve).name for solve in plan] == [solve.name for solve in plan]


@pytest.mark.slow
def test_every_solve_of_the_template_succeeds(path):
    assert cli.run(["new", "--study", str(path)]) == 0
    assert cli.run(["study", str(path), "--out", str(path.parent / "out"), "--quiet"]) == 0
    rows = rm.read_records(path.parent / "out")
    assert [row["success"] for row in rows] == [True] * 12
    moved = [row for row in rows if row["variant"] != "fixed"]
    assert all(row["gain_audited"] > 0 for row in moved)


def test_the_time_of_a_plan_is_that_of_its_rows_or_of_its_limits():
    one = PlannedSolve({}, "6.1", "6.1", "8", "a", "nested", time_s=9.5)
    assert seconds_of_plan([one, one], []) == 19.0
    quadratic = replace(one, problem={"order": 2})
    rows = [{"variant": "a", "family": "6.1", "task_time_s": t} for t in (1.0, 2.0, 30.0, None)]
    assert seconds_of_plan([one, one], rows) == 4.0
    assert seconds_of_plan([quadratic], rows) == 9.5  # rows of another order
    assert seconds_of_plan([one], [{**rows[2]}]) == 9.5  # a solve is ended at its limit
