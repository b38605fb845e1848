"""The benchmark of MPCC solvers on a collection of two problems."""

import json
import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

import benchmark_mpcc as benchmark
from isolated import Failed, isolated

COLLECTION = """
import casadi as ca

def names():
    return ["corner", "arms"]

def get(name):
    x = ca.SX.sym("x", 2)
    centre = {"corner": -1.0, "arms": 1.0}[name]
    inf = float("inf")
    return dict(x=x, f=ca.sumsqr(x - centre), g=ca.SX(0, 1), G=x[0], H=x[1], lbx=[-inf] * 2, ubx=[inf] * 2,
                lbg=[], ubg=[], x0=[0.5, 0.2], target={"corner": 2.0, "arms": 0.5}[name])
"""
"""A file of two problems; the target of arms is wrong on purpose."""

OURS = ["--solvers", "rmesh_nlp.mpcc", "plain Scholtes loop"]


@pytest.mark.slow
def test_the_table_counts_solved_and_lowest(tmp_path, capsys):
    path = tmp_path / "collection.py"
    path.write_text(COLLECTION)
    families = ["--families", "markets", "--sizes", "1", "--seeds", "1"]
    assert benchmark.main([str(path), *families, *OURS, "--out", str(tmp_path)]) == 0
    text = (tmp_path / "table.md").read_text()
    for solver in OURS[1:]:
        # the target of arms is wrong on purpose
        assert f"| collection, 2 | {solver} | 2 | 1 |" in text
        assert f"| all, 3 | {solver} | 3 | 2 |" in text
    rows = [json.loads(line) for line in (tmp_path / "rows.jsonl").read_text().splitlines()]
    assert {row["problem"] for row in rows} == {"corner", "arms", "markets-2-0"}


def test_point_is_measured_by_the_problem(tmp_path):
    path = tmp_path / "collection.py"
    path.write_text(COLLECTION)
    (_, problem), _ = benchmark.problems([path], (), 1, 1)
    # (x + 1)^2 + (y + 1)^2; the product
    assert benchmark.measured(problem, np.array([2.0, 3.0])) == (25.0, 6.0)
    assert benchmark.measured(problem, np.array([0.0, -1.0])) == (1.0, 1.0)


def test_a_solver_that_dies_is_a_row():
    for work, words in (
        (lambda: os.kill(os.getpid(), signal.SIGKILL), "crashed: SIGKILL"),
        (lambda: [][1], "IndexError: list index out of range"),
        (lambda: time.sleep(60), "stopped after 0.2 s"),
    ):
        found = isolated(work, 0.2 if "stopped" in words else 20.0)
        assert isinstance(found, Failed)
        assert found.why == words
    assert isolated(lambda: 7, 20.0) == 7


def test_unknown_families_and_files_are_refused(tmp_path, capsys):
    for arguments, words in (
        ([], "no problems"),
        (["--families", "nothing"], "unknown family 'nothing'"),
        ([str(tmp_path / "absent.py")], "is not a Python file"),
    ):
        with pytest.raises(SystemExit):
            benchmark.main([*arguments, "--out", str(tmp_path / "out")])
        assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_bilevel_problems_are_a_collection():
    path = Path(benchmark.__file__).parent / "mpcc_library/bilevel_problems.py"
    found = {problem.name: problem for problem in benchmark.read_collection(path)}
    assert len(found) > 50
    one = found["yezza-1996-4.1"]
    assert one.target == 0.5
    assert one.x0.size == one.mpcc.n_x == 4
    assert benchmark.measured(one, np.array([3.0, 1.0, 0.0, 0.0])) == pytest.approx((0.5, 0))


def test_large_families_end_exact_and_are_drawn(tmp_path):
    """16 pairs of each."""
    rows = []
    for name, (make, _) in benchmark.LARGE.items():
        problem = make(16, 0)
        end = benchmark.SOLVERS["rmesh_nlp.mpcc"](problem)
        f, violation = benchmark.measured(problem, end.x)
        assert (end.status, problem.mpcc.n_pairs) == ("converged", 16)
        rows.append(
            benchmark.Row(name, problem.name, "rmesh_nlp.mpcc", end.status, f, violation, seconds=1.0)
        )
    benchmark.figure(rows, tmp_path / "size.png")
    assert (tmp_path / "size.png").stat().st_size > 0
    assert "| membrane | 16 | 1.0 |" in benchmark.size_table(rows)
    benchmark.figure([], tmp_path / "none.png")
    assert not (tmp_path / "none.png").exists()


def test_resumed_run_solves_only_what_is_missing(tmp_path, capsys):
    same = ["--families", "markets", "--sizes", "1", "--seeds", "1", "--out", str(tmp_path)]
    rows = tmp_path / "rows.jsonl"
    assert benchmark.main([*same, "--solvers", "rmesh_nlp.mpcc"]) == 0
    (first,) = rows.read_text(encoding="utf-8").splitlines()
    both = ["--solvers", "rmesh_nlp.mpcc", "plain Scholtes loop", "--resume"]
    assert benchmark.main([*same, *both]) == 0
    again, added = rows.read_text(encoding="utf-8").splitlines()
    assert again == first
    assert "plain" in added
    assert "| markets, 1 |" in (tmp_path / "table.md").read_text(encoding="utf-8")
