"""Every planned solve becomes one row, whatever happens to it, its worker or its client."""

import json
import os
import re
import signal
import subprocess
import sys
import time

import pytest

from rmesh_nlp.cli import app as cli
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.records import MEASURED
from rmesh_nlp.io.results import read_results, row_files
from rmesh_nlp.io.vtu import read_vtu
from rmesh_nlp.study import engine, worker
from rmesh_nlp.study.plan import PlannedSolve, make_plan
from rmesh_nlp.study.rows import RowsFile
from rmesh_nlp.study.runner import failure
from rmesh_nlp.study.study_file import read_study
from rmesh_nlp.study.worker import Worker
from support.planted import install

SMALL = 'random = { seed = 0, count = 3 }\nformulations = ["fixed"]\n'


@pytest.fixture
def bad(tmp_path, monkeypatch):
    """Formulations that hang, leak and crash are installed, here and in processes that are started."""
    (tmp_path / "site").mkdir()
    place = install(tmp_path / "site")
    monkeypatch.syspath_prepend(place)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([place, os.environ.get("PYTHONPATH", "")]))


def solve_of(formulation, **changes):
    content = {"kind": "random", "seed": 1, "of": "scalar"}
    return PlannedSolve(content, "random-1", "random", "", formulation, formulation, **changes)


def rows_of(folder):
    return [json.loads(line) for path in row_files(folder) for line in path.read_text().splitlines()]


def study_file(folder, text=SMALL):
    (folder / "study.toml").write_text(text)
    return str(folder / "study.toml")


on_posix = pytest.mark.skipif(sys.platform == "win32", reason="signals")

PLAN = [solve_of("fixed", time_s=float(i)) for i in (21, 22, 23)]
SOLVED = []


@pytest.fixture
def answers(monkeypatch):
    """Statuses by key, with which contained solves end; ``SOLVED`` has the keys that were solved."""
    statuses = dict.fromkeys((one.key for one in PLAN), "converged")

    def solve(self, one):
        status = statuses[one.key]
        SOLVED.append(one.key)
        return {"key": one.key, "success": status == "converged", "status": status}

    monkeypatch.setattr(Worker, "solved", solve)
    SOLVED.clear()
    return statuses


@pytest.mark.slow
@pytest.mark.usefixtures("bad")
def test_a_hang_a_leak_and_a_crash_are_a_row_each_and_the_next_solve_runs(tmp_path, monkeypatch):
    monkeypatch.setattr("rmesh_nlp.study.worker.GRACE_S", 0.2)
    monkeypatch.setenv("CRASH_MARK", str(tmp_path / "mark"))
    plan = [solve_of("hang", time_s=0.5), solve_of("leak", memory_mb=600.0, time_s=60.0)]
    plan += [solve_of(name) for name in ("crash", "crash_once", "fixed")]
    told = list(engine.run(plan, tmp_path))
    statuses = {row["variant"]: row["status"] for row in told}
    assert statuses.pop("fixed") == "converged"
    assert statuses.pop("crash_once") == "converged"  # killed from outside, say: tried once more
    assert statuses == {"hang": "time_limit", "leak": "memory_limit", "crash": "died"}
    assert [row["key"] for row in rows_of(tmp_path)] == [solve.key for solve in plan]
    assert list(engine.run(plan, tmp_path)) == []  # a row, once, and not tried for ever
    assert len(read_results(tmp_path)) == 5  # rows that tables can read


@pytest.mark.slow
def test_a_study_by_command_runs_once_and_has_fields(tmp_path, capsys):
    path, out = study_file(tmp_path), tmp_path / "out"
    arguments = ["study", path, "--out", str(out), "--json"]
    assert cli.run(arguments) == 0
    first = json.loads(capsys.readouterr().out)
    assert first == {"folder": str(out), "planned": 3, "rows": 3, "succeeded": 3, "refused": 0, "failed": 0}
    rows = rows_of(out)
    assert [row["key"] for row in rows] == [one.key for one in make_plan(read_study(path), tmp_path / "x")]
    assert all(isinstance(row["shared"], bool) and row["contact_time_s"] > 0 for row in rows)
    for result in read_results(out):
        assert read_vtu(result.vtu).final.nodes.shape[1] == result.record["nodes"]
    (environment,) = (out / "rows").glob("environment-*.json")
    assert json.loads(environment.read_text())["versions"]["casadi"]
    assert cli.run(arguments) == 0
    assert rows_of(out) == rows  # nothing was solved again


@pytest.mark.usefixtures("answers")
def test_rows_of_workers_that_were_killed_are_kept_and_joined(tmp_path):
    """Two of three rows are there, one line is cut: one solve is left to do, once."""
    with worker.Worker(tmp_path) as killed:
        for one in PLAN[:2]:
            killed.perform(one)
    with row_files(tmp_path)[0].open("a") as file:
        file.write(f'{{"key": "{PLAN[2].key}", "succ')
    assert engine.missing(PLAN, tmp_path) == PLAN[2:]
    SOLVED.clear()
    list(engine.run(PLAN, tmp_path))
    # a task that the scheduler repeats finds its row
    assert worker.task(PLAN[0].plain(), str(tmp_path)) == {"key": PLAN[0].key, "found": True}
    assert [PLAN[2].key] == SOLVED


@pytest.mark.parametrize(
    ("statuses", "code"),
    [(("converged", "refused"), 0), (("refused", "refused"), 1), (("converged", "died"), 1)],
)
def test_a_study_succeeds_if_what_was_not_refused_did(statuses, code, tmp_path, monkeypatch, capsys):
    left = [*statuses]

    def solve(self, one):
        row = failure(one, left.pop(0), "as planned")
        measured = {**dict.fromkeys(MEASURED, 1), "success": True}
        return row | measured if row["status"] == "converged" else row

    monkeypatch.setattr(Worker, "solved", solve)
    path = study_file(tmp_path, SMALL.replace("3", "2"))
    assert cli.run(["study", path, "--out", str(tmp_path / "out"), "--quiet"]) == code
    assert [row["status"] for row in rows_of(tmp_path / "out")] == [*statuses]
    assert cli.run(["figures", str(tmp_path / "out")]) == 0
    assert "out: those of a study compare formulations that relocate, at least two" in capsys.readouterr().err


def test_a_solve_whose_worker_was_lost_for_good_is_a_row(tmp_path, monkeypatch):
    told = {"key": PLAN[0].key, "status": "converged"}  # its worker has written it
    ended = iter([(PLAN[0], told), (PLAN[1], None)])
    monkeypatch.setattr(engine, "_distributed_rows", lambda *_: ended)
    first, lost = engine.run(PLAN, tmp_path, scheduler="tcp://127.0.0.1:1")
    assert first == told
    assert (lost["key"], lost["status"], lost["shared"]) == (PLAN[1].key, "died", True)
    assert [path.name for path in row_files(tmp_path)] == [f"records-{lost['worker']}.jsonl"]
    assert rows_of(tmp_path) == [lost]


def test_workers_that_outlived_their_client_and_a_missing_extra_are_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(engine, "PATIENCE_S", 0.01)
    with RowsFile(tmp_path).working(), pytest.raises(BadInputError, match="held by a worker"):
        list(engine.run([solve_of("fixed")], tmp_path))
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(BadInputError, match=r"^--scheduler needs dask.distributed: pip install"):
        list(engine.run([solve_of("fixed")], tmp_path, scheduler="tcp://127.0.0.1:1"))


@on_posix
def test_without_processes_a_study_ends_in_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "executable", "false")
    assert cli.run(["study", study_file(tmp_path), "--out", str(tmp_path / "out"), "--jobs", "2"]) == 2
    assert capsys.readouterr().err.endswith("study.worker could be started: it ended with code 1\n")


@pytest.mark.slow
def test_two_jobs_write_the_same_rows(tmp_path):
    told = list(engine.run(PLAN, tmp_path, jobs=2))
    for rows in (told, rows_of(tmp_path)):
        assert sorted(row["key"] for row in rows) == sorted(solve.key for solve in PLAN)
    assert 1 <= len(row_files(tmp_path)) <= 2
    assert list(engine.run(PLAN, tmp_path, jobs=2)) == []


def test_failures_are_tried_again_when_that_is_asked_for(tmp_path, answers):
    answers.update(zip((one.key for one in PLAN), ("converged", "time_limit", "refused"), strict=True))
    with worker.Worker(tmp_path) as outlives:  # as on a cluster that goes on from client to client
        for one in PLAN:
            outlives.perform(one)
        SOLVED.clear()
        assert list(engine.run(PLAN, tmp_path)) == []
        answers[PLAN[1].key] = "converged"
        list(engine.run(PLAN, tmp_path, retry_failed=True))
        assert [PLAN[1].key] == SOLVED
        assert {row["key"]: row["status"] for row in rows_of(tmp_path)} == answers
        assert len(rows_of(tmp_path)) == 3
        (kept,) = (tmp_path / "rows" / "failed.jsonl").read_text().splitlines()
        assert json.loads(kept)["status"] == "time_limit"
        assert worker.task(PLAN[1].plain(), str(tmp_path)) == {"key": PLAN[1].key, "found": True}


def rmesh(*arguments):
    """``rmesh`` as a process that heeds Ctrl-C, also where this one does not."""
    return subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", "from rmesh_nlp.cli.entry import main; main()", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


LONG = 'random = { count = 300 }\nformulations = ["fixed"]\nfields = false\n'


def two_jobs(folder):
    return rmesh("study", study_file(folder, LONG), "--out", str(folder / "out"), "--jobs", "2")


@pytest.mark.slow
@on_posix
def test_ctrl_c_with_two_jobs_keeps_what_is_finished_in_one_line(tmp_path):
    psutil = pytest.importorskip("psutil")
    with two_jobs(tmp_path) as process:
        end = time.monotonic() + 100
        while not rows_of(tmp_path / "out") and time.monotonic() < end:
            time.sleep(0.1)
        below = psutil.Process(process.pid).children()
        for one in (process, *below):  # as on a terminal, where all processes get it
            one.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert len(below) == 2
    assert not any(one.is_running() for one in below)
    assert process.returncode == 130
    (line,) = [line for line in said.splitlines() if "interrupted" in line]
    assert "Traceback" not in said
    kept = int(re.search(r"(\d+) of 300 solves are kept", line)[1])
    rows = [row["key"] for row in rows_of(tmp_path / "out")]
    assert 1 <= kept <= len(rows) < 300
    assert len(set(rows)) == len(rows)


@pytest.mark.slow
def test_a_scheduler_that_is_there_already_is_used(tmp_path):
    distributed = pytest.importorskip("distributed")
    path, out = study_file(tmp_path), tmp_path / "out"
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None, memory_limit=0
    ) as cluster:
        for _ in range(2):  # the cluster goes on, and nothing is solved again
            address = cluster.scheduler_address
            assert cli.run(["study", path, "--out", str(out), "--scheduler", address]) == 0
            assert len(rows_of(out)) == 3


@pytest.mark.slow
def test_a_scheduler_that_is_not_there_is_one_line(tmp_path, monkeypatch, capsys):
    pytest.importorskip("distributed")
    monkeypatch.setattr(engine, "PATIENCE_S", 0.5)
    path, out = study_file(tmp_path), tmp_path / "out"
    places = {"tcp://127.0.0.1:1": "no cluster at {}", "nonsense://x": "no cluster at {}"}
    places["tls://127.0.0.1:1"] = "{} asks for a certificate"
    for address, message in places.items():
        assert cli.run(["study", path, "--out", str(out), "--scheduler", address]) == 2
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert message.format(address) in line


@pytest.mark.skipif(sys.platform != "linux", reason="processes are pinned on Linux")
def test_a_solve_that_did_not_have_a_core_to_itself_is_marked(tmp_path, monkeypatch):
    """By cores that no machine has, so that studies which run beside the tests do not matter."""
    cpu = [0.91]
    monkeypatch.setattr(Worker, "solved", lambda *_: {"task_time_s": 1.0, "cpu_time_s": cpu[0]})
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {900_001, 900_002})

    def shared(*workers):
        return [one.row(PLAN[0])["shared"] for one in workers]

    with worker.Worker(tmp_path) as one:
        with worker.Worker(tmp_path) as other, worker.Worker(tmp_path) as third:
            assert shared(one, other, third) == [False, False, True]
        with worker.Worker(tmp_path) as again:  # a core given back is free
            assert shared(again) == [False]
        for cpu[0], busy in ((0.89, True), (None, False)):
            assert shared(one) == [busy]
