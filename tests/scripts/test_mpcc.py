"""The benchmark of MPCC solvers on small collections, and points of known label."""

import json
import os
import signal
import time

import numpy as np
import pytest

import benchmark_mpcc as benchmark
from check_mpcc_labels import main, verdict
from isolated import Failed, isolated
from mpcc_library.labels import Active, Point, descends_by_search, label_by_search, regular

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

SOLVERS = ("rmesh_nlp.mpcc", "plain Scholtes loop")


def cells_of(path):
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in path.read_text().splitlines()]


def test_the_table_counts_solved_and_lowest_and_a_resumed_run_solves_what_is_missing(tmp_path):
    path = tmp_path / "collection.py"
    path.write_text(COLLECTION)
    same = [str(path), "--families", "markets", "--sizes", "1", "--seeds", "1", "--out", str(tmp_path)]
    kept = []
    for number in (1, 2):
        assert benchmark.main([*same, "--solvers", *SOLVERS[:number]]) == 0
        kept.append((tmp_path / "rows.jsonl").read_text().splitlines())
    assert kept[1][:3] == kept[0]
    cells = cells_of(tmp_path / "table.md")
    for solver in SOLVERS:
        # the target of arms is wrong on purpose
        assert [row[2:4] for row in cells if row[:2] == ["collection, 2", solver]] == [["2", "1"]]
        assert [row[2:4] for row in cells if row[:2] == ["all, 3", solver]] == [["3", "2"]]
    names = [json.loads(line)["problem"] for line in kept[1]]
    assert sorted(names) == sorted(2 * ["corner", "arms", "markets-2-0"])


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


def test_large_families_end_exact_and_are_drawn(tmp_path):
    """16 pairs of each."""
    rows = []
    for name, (make, _) in benchmark.LARGE.items():
        problem = make(16, 0)
        end = benchmark.SOLVERS["rmesh_nlp.mpcc"](problem)
        f, violation = benchmark.measured(problem, end.x)
        assert (end.status, problem.mpcc.n_pairs) == ("converged", 16)
        key = {"group": name, "problem": problem.name, "solver": "rmesh_nlp.mpcc", "target": np.nan}
        rows.append({**key, "pairs": 16, "f": f, "violation": violation, "seconds": 1.0})
    benchmark.figure(rows, tmp_path / "size.png")
    assert (tmp_path / "size.png").stat().st_size > 0
    assert "| membrane          |    16 |                  1 |" in benchmark.size_table(rows)
    benchmark.figure([], tmp_path / "none.png")
    assert not (tmp_path / "none.png").exists()


@pytest.fixture(autouse=True, scope="module")
def few_blocks():
    """Of each kind some: most of the time goes into the search for blocks."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mpcc_library.labels._BLOCKS", 30)
        yield


@pytest.mark.parametrize(
    ("c", "label", "descends", "rows"),
    [
        ([1.0, 1.0], "S", False, []),
        ([-1.0, 0.0], "M", True, []),
        ([-1.0, -1.0], "C", True, []),
        ([1.0, -1.0], "W", True, []),
        ([1.0, 1.0, 1.0], "none", True, []),  # a free unknown with slope
        # min x + y - z, z <= 4 x, z <= 4 y of Scheel and Scholtes: B, but the multipliers of S are missing
        ([1.0, 1.0, -1.0], "M", False, [[-4.0, 0, 1], [0, -4.0, 1]]),
    ],
)
def test_search_finds_the_label_of_a_corner(c, label, descends, rows):
    n, A = len(c), np.reshape(rows, (len(rows), len(c)))
    data = Active(np.array(c), A, np.ones(len(rows)), np.eye(n)[:1], np.eye(n)[1:2])
    assert (label_by_search(data), descends_by_search(data)) == (label, descends)


@pytest.mark.parametrize(
    ("known", "said", "word"),
    [
        (("M", True), ("M", True), "right"),
        (("M", None), ("M", False), "right"),
        (("M", True), ("M", None), "undecided"),
        (("M", True), ("at least C", True), "undecided"),
        (("W", False), ("at least C", False), "wrong"),
        (("C", False), ("M", False), "wrong"),
        (("M", True), ("M", False), "wrong"),
        (("M", True), ("", None), "wrong"),
    ],
)
def test_verdict_tells_wrong_from_undecided(known, said, word):
    point = Point("", regular(0, 1, 1).mpcc, np.zeros(1), 1, *known)
    assert verdict(point, *said) == word


def test_labels_are_those_that_are_known(capsys):
    assert main(["--few", "4", "--many", "1"]) == 0
    assert "5 right, 0 undecided, 0 wrong" in capsys.readouterr().out
