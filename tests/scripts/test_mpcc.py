"""The benchmark of MPCC solvers on small collections, and points of known label."""

import json
import os
import signal
import time

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import benchmark_mpcc as benchmark
from check_mpcc_labels import main, verdict
from isolated import isolated
from mpcc_library.applications import APPLICATIONS
from mpcc_library.families import FAMILIES
from mpcc_library.labels import Active, Point, descends_by_search, label_by_search, regular
from rmesh_nlp.mpcc import solve

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


@pytest.mark.slow
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
        assert found.why == words
    assert isolated(lambda: 7, 20.0) == 7


@pytest.mark.slow
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


@pytest.mark.slow
def test_profile_has_ratios_of_times_and_what_does_not_end_lowest_is_infinite(tmp_path):
    """A second solver takes 3 times the first's time on a, misses the minimum of b, and alone solves c."""
    ends = {("a", "one"): (1.0, 0.0), ("a", "two"): (3.0, 0.0), ("b", "one"): (2.0, 0.0),
            ("b", "two"): (1.0, 0.5), ("c", "one"): (1.0, np.nan), ("c", "two"): (5.0, 0.0)}  # fmt: skip
    key = {"group": "family", "pairs": 1, "target": np.nan, "violation": 0.0}
    rows = [key | {"problem": p, "solver": s, "seconds": t, "f": f} for (p, s), (t, f) in ends.items()]
    ratios = benchmark.profile(rows)
    assert list(ratios["one"]) == [1, 1, np.inf]
    assert list(ratios["two"]) == [3, np.inf, 1]
    benchmark.profile_figure(rows, tmp_path / "profile.png")
    assert (tmp_path / "profile.png").stat().st_size > 0
    benchmark.profile_figure(rows[::2], tmp_path / "none.png")
    assert not (tmp_path / "none.png").exists()


def solution(name, size):
    """The solution of a generated problem, which is a success."""
    problem = {**FAMILIES, **APPLICATIONS}[name][0](size, 0)
    result = solve(problem.mpcc, problem.x0)
    assert result.success
    return result


@pytest.mark.slow
def test_clock_stands_still_while_the_ball_turns():
    """Unknowns of a step: thrust, q, v, mu, clock, theta. One of the modes holds, and f knows no clock."""
    result = solution("time-freezing", 10)
    _, q, _, _, clock, flight, table = result.x.reshape(10, 7).T
    assert flight + table == pytest.approx(np.ones(10), abs=1e-7)
    assert np.diff(clock, prepend=0) == pytest.approx(0.2 * flight, abs=1e-7)
    assert np.all(flight[q > 1e-4] > 1 - 1e-6)
    assert np.all(flight[q < -1e-4] < 1e-6)
    assert np.any(q < -1e-4)  # it bounces


def test_gas_flows_to_lower_pressure_and_is_conserved():
    """Without a compressor a pipe's flow has the sign of the drop; supplies sum to what is asked for."""
    result = solution("gas", 6)
    supply, squared, forth, back, lift = np.split(result.x, np.cumsum([6, 6, 8, 8]))
    random = np.random.default_rng([62, 6, 0])
    chords = [tuple(random.choice(6, 2, replace=False)) for _ in range(2)]
    demand = random.uniform(0.2, 1.5, 6) * (random.uniform(size=6) < 0.7)
    assert supply.sum() == pytest.approx(demand.sum(), abs=1e-6)
    start, end = np.array([*((i, (i + 1) % 6) for i in range(6)), *chords]).T
    passive = lift < 1e-7
    drop = (squared[start] - squared[end])[passive]
    assert np.all(drop * (forth - back)[passive] >= -1e-6)
    assert np.all(forth[~passive] > back[~passive])  # compressors work along the flow


def test_no_follower_of_a_cournot_market_gains_by_another_amount():
    """Profits of Outrata, Kocvara and Zowe's oligopoly, by a search over the amount of each follower."""
    result = solution("cournot", 4)
    random = np.random.default_rng([10, 4, 0])
    elasticity, capacity = random.uniform(1.0, 1.6), random.uniform(10, 60, 4)
    cost, power = random.uniform(2, 12, 4), random.uniform(0.5, 1.2, 4)
    amounts = result.x[1:5]
    for i in range(4):
        others = result.x[:5].sum() - amounts[i] + 1e-3

        def loss(q, i=i, others=others):
            price = (5000 / (others + q)) ** (1 / elasticity)
            return cost[i] * q + 0.1 * (q + 1e-3) ** (1 + power[i]) - price * q

        best = minimize_scalar(loss, bounds=(0, capacity[i]), method="bounded", options={"xatol": 1e-6})
        assert loss(amounts[i]) <= best.fun + 1e-5


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


@pytest.mark.slow
def test_labels_are_those_that_are_known(capsys):
    assert main(["--few", "4", "--many", "1"]) == 0
    assert "5 right, 0 undecided, 0 wrong" in capsys.readouterr().out
