"""Comparisons: what is planned, which rows of an earlier run are used again, and what a run leaves of it."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

import rmesh_nlp as rm
from rmesh_nlp.io.folder import Manifest
from rmesh_nlp.io.records import REQUIRED, DamagedRecordsWarning, to_json
from rmesh_nlp.io.results import Results, read_results
from rmesh_nlp.study import comparison, engine
from rmesh_nlp.study.comparison import plan_comparison, run
from rmesh_nlp.study.runner import Done, failure, perform
from rmesh_nlp.study.worker import Worker
from support.planted import plant, raising
from support.problem_files import VALID


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("own.toml").write_text(VALID)
    return "own.toml"


def test_a_file_is_solved_on_uniform_refinements_too(file, monkeypatch):
    plan = plan_comparison([file], ["nested"], certify=True)
    assert [(one.formulation, one.certify) for one in plan] == [("nested", True), *[("fixed", True)] * 2]
    assert [one.built.mesh.t.shape[1] for one in plan] == [48, 4 * 48, 16 * 48]
    nodes = plan[1].built.mesh.p.shape[1]
    for largest, refined in ((nodes, 1), (nodes - 1, 0)):
        monkeypatch.setattr(comparison, "LARGEST", largest)
        assert len(plan_comparison([file], ["nested"])) == 1 + refined


DESIGN = "[design]\nE = { start = 1.0, bounds = [0.5, 2.0] }\n\n[materials.hard]"
DESIGNED = VALID.replace("[materials.hard]", DESIGN).replace("young = 2.2e4", 'young = "2.2e4*E"')


def test_a_file_is_compared_by_its_own_objective(file):
    text = DESIGNED
    Path(file).write_text(text + 'objective = "area"\n')
    plan = plan_comparison([file, "6.2"], ["fixed", "nested"])
    assert [one.options.get("objective") for one in plan] == ["area", "area", None, None]  # no refinements
    plan = plan_comparison([file], ["nested"], options={"objective": ["quality"]})
    assert [one.options for one in plan] == [{"objective": "quality"}]
    # the name of an example does not lend it the reference solution of that example
    Path(file).write_text('name = "6.2"\n' + VALID.replace('name = "block"\n', ""))
    options = {"objective": ["energy", "error-l2"]}
    with pytest.raises(rm.BadInputError, match=r"error-l2: needs an exact .* solution, and '6\.2' has none"):
        plan_comparison([file], ["nested"], options=options)
    assert all(one.built.exact for one in plan_comparison(["6.2"], ["fixed"], n=(2, 2), options=options))
    Path(file).write_text(VALID + 'objective = "nonsense"\n')
    with pytest.raises(rm.BadInputError, match=r"own\.toml: solve\.objective = .nonsense."):
        plan_comparison([file], ["nested"])


COULOMB = VALID.replace("friction =", "coulomb =")


@pytest.mark.parametrize(
    ("text", "options", "able"),
    [
        (VALID, {}, ["fixed", "nested", "joint", "mpcc"]),
        (COULOMB, {}, ["fixed"]),
        (COULOMB, {"objective": ["energy", "area"]}, ["fixed", "fixed", "nested", "mpcc"]),
        (DESIGNED, {}, ["fixed"]),
    ],
)
def test_by_default_formulations_are_compared_that_take_the_problem(file, text, options, able):
    Path(file).write_text(text)
    plan = [one for one in plan_comparison([file], (), options=options) if one.built.size == "48 triangles"]
    assert [one.formulation for one in plan] == able
    named = plan_comparison([file], ["joint"], options=options)
    assert {one.formulation for one in named} >= {"joint"}  # its refusal is a row


def test_keys_are_file_names_and_settings_reach_the_example():
    options = {"seed": 3, "objective": "error-l2 + 0.01*quality"}
    (one,) = plan_comparison(["6.1"], ["nested"], n=4, options=options)
    assert one.identity["key"] == one.key == "6.1-4-nested-error-l2_+_0.01_quality-seed3"
    assert replace(one, options={}).key == "6.1-4-nested"
    plan = plan_comparison(["6.1"], ["mpcc", "mpcc:start=joint", "nested:enough=0.01:seed=3"], n=4)
    assert [one.options for one in plan] == [{}, {"start": "joint"}, {"enough": 0.01, "seed": 3}]
    assert len({one.key for one in plan}) == 3
    (one,) = plan_comparison(["6.1"], ["fixed"], n=5, order=2, delta=0.02, quadrature=6)
    assert (one.built.size, one.built.order, one.built.rule) == ("5", 2, 6)
    assert one.identity == {
        **{"key": "6.1-5-order2-fixed", "example": "6.1", "formulation": "fixed"},
        **{"n": "5", "order": 2, "delta": [0.02, 0.02], "quadrature": 6},
    }


def planned(name, n=(4, 2)):
    (one,) = plan_comparison(["6.2"], [name], n=n)
    return one


@pytest.fixture(scope="module")
def plan():
    """Two solves that take some milliseconds each."""
    return [planned("fixed"), planned("fixed", n=(2, 2))]


@pytest.fixture(scope="module")
def first_run(plan, tmp_path_factory):
    """A folder in which both are solved, to be copied."""
    folder = tmp_path_factory.mktemp("first-run")
    list(run(plan, Results(folder)))
    return folder


@pytest.fixture
def ran(first_run, tmp_path):
    """A folder of the test's own in which both are solved."""
    shutil.copytree(first_run, tmp_path, dirs_exist_ok=True)
    return tmp_path


def resumed(plan, folder):
    """Keys of those that are solved again."""
    keys = []
    rows = list(run(plan, Results(folder), resume=True, on_start=lambda one: keys.append(one.key)))
    for found in (rows, Results(folder).read()):
        assert sorted(row["key"] for row in found) == sorted(one.key for one in plan)
    return keys


def changed(folder, key, **entries):
    """Change the row of a key in the file."""
    results = Results(folder)
    results.write([{**row, **entries} if row["key"] == key else row for row in results.read()])


def test_a_row_is_on_the_disk_when_it_is_yielded_and_a_failure_is_one(tmp_path, monkeypatch):
    plant(monkeypatch, explode=raising(RuntimeError("the\nfactor was singular")))
    seen = []
    plan = plan_comparison(["6.1"], ["explode", "fixed"], n=3)
    for count, row in enumerate(run(plan, Results(tmp_path)), 1):
        found = read_results(tmp_path)
        assert len(found) == count
        assert found[-1].vtu.exists() == found[-1].history.exists() == row["success"]
        seen.append(json.loads(to_json(row)))
    bad, good = seen
    assert (bad["status"], bad["message"]) == ("failed", "RuntimeError: the factor was singular")
    assert set(REQUIRED) <= set(bad)
    assert bad["delta"] == good["delta"]
    assert good["success"]
    assert rm.read_records(tmp_path) == [bad, good]
    names = {"records.jsonl", "solutions/6.1-3-fixed.vtu", "solutions/6.1-3-fixed.csv"}
    assert names <= set(Manifest(tmp_path).names())


def test_two_solves_of_one_key_or_what_is_in_the_way_are_found_before_anything_is_solved(plan, tmp_path):
    (tmp_path / "solutions").write_text("a file")
    for solves, said in (([plan[0], plan[0]], r"6\.2-4x2-fixed"), (plan, "solutions is a file")):
        with pytest.raises(rm.BadInputError, match=said):
            list(run(solves, Results(tmp_path), on_start=lambda _: pytest.fail("it began to solve")))


@pytest.mark.slow
def test_a_failure_an_interrupted_solve_and_one_without_its_files_are_solved_again(plan, ran):
    one = plan[1]
    for entries in ({"success": False}, {"status": "interrupted"}):
        changed(ran, one.key, **entries)
        assert resumed(plan, ran) == [one.key]
        assert all(row["success"] and row["status"] == "converged" for row in Results(ran).read())
    for file in ("vtu", "history"):
        (result,) = (result for result in read_results(ran) if result.record["key"] == one.key)
        getattr(result, file).unlink()
        assert resumed(plan, ran) == [one.key]
    assert resumed(plan[::-1], ran) == []  # in any order
    results = Results(ran)  # nor those of versions that counted no nodes
    results.write([{k: v for k, v in row.items() if k != "nodes"} for row in results.read()])
    assert resumed(plan, ran) == []


def test_resume_repairs_duplicates_and_a_cut_line(plan, ran):
    path = ran / "records.jsonl"
    whole = path.read_text()
    path.write_text(whole + whole + whole[:50])
    with pytest.warns(DamagedRecordsWarning):
        assert resumed(plan, ran) == []
    with pytest.warns(DamagedRecordsWarning):
        assert resumed([*plan, planned("fixed", n=(2, 4))], ran) != []
    assert path.read_text().splitlines()[:-1] == whole.splitlines()


@pytest.mark.slow
def test_more_repeats_or_a_certificate_are_a_reason_to_solve_again(plan, ran):
    twice, certified = (replace(plan[1], **changes) for changes in ({"repeats": 2}, {"certify": True}))
    for wanted in (twice, certified):
        assert resumed([plan[0], wanted], ran) == [wanted.key]
        assert resumed([plan[0], wanted], ran) == []
        assert resumed(plan, ran) == []  # fewer would do


def test_rows_of_another_problem_under_the_same_key_are_refused(plan, ran):
    changed(ran, plan[1].key, delta=[0.1, 0.1])
    said = r"cannot resume .* with delta .*\[0.1, 0.1\], not "
    with pytest.raises(rm.BadInputError, match=said):
        resumed(plan, ran)
    changed(ran, plan[1].key, success=False)  # a failure is not resumed, whatever it was
    assert resumed(plan, ran) == [plan[1].key]


def test_without_resume_the_earlier_run_stays_until_a_solve_has_ended(plan, ran):
    rows = run(plan[:1], Results(ran), on_start=lambda _: seen.append(len(read_results(ran))))
    seen: list[int] = []
    next(rows)
    assert seen == [2]
    assert len(read_results(ran)) == 1
    assert len(read_results(ran / "previous")) == 2
    assert list(rows) == []
    list(run(plan, Results(ran)))  # set aside once, not once for each solve
    assert [len(read_results(ran / name)) for name in (".", "previous-2")] == [2, 1]
    assert not (ran / "previous-3").exists()


def test_an_interrupted_solve_leaves_its_row_and_is_the_last(plan, tmp_path, monkeypatch):
    def stopped(solve, on_step):
        done = perform(solve)
        return replace(done, row={**done.row, "status": "interrupted"})

    monkeypatch.setattr(engine, "perform", stopped)
    rows = run(plan, Results(tmp_path))
    assert next(rows)["status"] == "interrupted"
    with pytest.raises(KeyboardInterrupt):
        next(rows)
    assert len(Results(tmp_path).read()) == 1
    monkeypatch.undo()
    assert resumed(plan, tmp_path) == [one.key for one in plan]


@pytest.mark.usefixtures("estimates_unasked")
@pytest.mark.slow
def test_solves_side_by_side_leave_the_rows_and_files_of_a_run_here(plan, ran, monkeypatch):
    """As workers answer: a row of the one that is solved, nothing of one that was lost."""
    got = []

    def by_workers(todo, folder, jobs):
        for one in todo:
            got.append(one.key)
            is_lost = one.formulation != "auto"
            with Worker(folder) as worker:
                row = failure(one, "died", "killed") if is_lost else worker.solved(one)
            yield one, Done(row, aside=Results(folder).result(row))

    monkeypatch.setattr(engine, "_by_workers", by_workers)
    more = [planned("auto"), planned("joint")]
    *_, auto, lost = run([*plan, *more], Results(ran), resume=True, jobs=2)
    with Worker(ran / "bare") as worker:
        worker.solved(replace(plan[1], fields=False))
    assert not (ran / "bare" / "solutions").exists()
    assert got == [one.key for one in more]
    (alone,) = run(more[:1], Results(ran / "alone"))
    differ = {name for name in alone if auto.get(name) != alone[name]}
    assert all("time" in name or name == "error_reduction" for name in differ), differ
    assert set(auto) - set(alone) == {"task_time_s", "cpu_time_s"}
    assert (lost["status"], lost["delta"], lost["n"]) == ("died", auto["delta"], "4x2")
    stems = sorted(path.name for path in (ran / "solutions").iterdir())
    assert stems == sorted(f"{one.key}.{kind}" for one in (*plan, more[0]) for kind in ("csv", "vtu"))
    assert not list(ran.glob(".rmesh-writing*"))
    # what auto chose is found as it was asked for
    assert (auto["formulation"], auto["asked"]) == ("joint", {"formulation": "auto"})
    assert resumed([*plan, *more], ran) == [more[1].key]
