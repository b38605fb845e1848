"""The benchmark beside peers: it needs none of them, and one that dies is a row."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

import pytest
from support.mpcc_collection import MPCC_COLLECTION

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


@pytest.fixture
def benchmark(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(SCRIPTS))
    return importlib.import_module("benchmark_peers")


@pytest.mark.slow
def test_without_peers_ours_has_its_rows(
    benchmark: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    collection = tmp_path / "collection.py"
    collection.write_text(MPCC_COLLECTION)
    monkeypatch.setattr(benchmark, "is_installed", lambda solver: solver not in benchmark.NEEDS)
    arguments = ["--groups", "joint", "mpcc", "--n", "8", "--repeat", "1", "--out", str(tmp_path)]
    assert benchmark.main([*arguments, "--collection", str(collection)]) == 0
    lines = (tmp_path / "peers.md").read_text().splitlines()
    rows = [[cell.strip() for cell in line.split("|")[2:-1]] for line in lines[4:]]
    words = {row[0]: row[1] for row in rows}
    assert words["rmesh_nlp joint"] == words["CasADi nlpsol, written out"] == "converged"
    assert {solver for solver, word in words.items() if word == "not installed"} == {
        "Pyomo, Ipopt",
        "MPECSS",
        "pympcc",
    }
    # one program, stated three times: one energy
    assert len({row[2] for row in rows[:3]}) == 1
    # the target of the second problem is wrong on purpose
    assert [row[2] for row in rows if row[0] == "rmesh_nlp.mpcc"] == ["1 of 2"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "status"),
    [
        ("import os; os.abort()", "crashed: SIGABRT"),
        ("raise ValueError('no such thing')", "failed: ValueError: no such thing"),
        ("import time; time.sleep(60)", "stopped after 0.5 s"),
        ("pass", "no answer"),
    ],
)
def test_a_peer_that_dies_is_a_row(
    benchmark: ModuleType, monkeypatch: pytest.MonkeyPatch, code: str, status: str
) -> None:
    monkeypatch.setattr(benchmark, "GRACE", 0.0 if "sleep" in code else 30.0)
    row = benchmark.relocation_row("problem", "peer", [sys.executable, "-c", code], repeat=5, limit=0.5)
    assert (row.status, row.seconds, row.runs) == (status, None, 0)
    assert f"| problem | peer | {status} | - | - | - | - | - |" in benchmark.markdown([row])


@pytest.mark.slow
def test_a_crash_costs_one_problem_of_a_collection(benchmark: ModuleType, tmp_path: Path) -> None:
    peer = tmp_path / "peer.py"
    peer.write_text(
        "import json, os, sys\n"
        "skip, answer = int(sys.argv[2]), sys.argv[-1]\n"
        "with open(answer, 'w') as file:\n"
        "    for i in range(skip, 4):\n"
        "        if i == 2: os.abort()\n"
        "        line = dict(status='converged', seconds=1.0, solved=True, failed=False)\n"
        "        print(json.dumps(line), file=file, flush=True)\n"
    )
    row = benchmark.collection_row("peer", [sys.executable, str(peer)], size=4, repeat=2, limit=5.0)
    assert (row.status, row.result, row.seconds, row.runs) == ("1 crashed: SIGABRT", "3 of 4", 3.0, 2)
