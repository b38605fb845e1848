"""The benchmark script on a collection of two problems."""

import importlib.util
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent.parent / "scripts" / "benchmark_mpcc.py"
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


@pytest.fixture
def main(monkeypatch):
    spec = importlib.util.spec_from_file_location("benchmark_mpcc", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)  # dataclasses look there
    spec.loader.exec_module(module)
    return module.main


def test_the_table_shows_hits_misses_and_the_plain_loop(main, tmp_path, capsys):
    path = tmp_path / "collection.py"
    path.write_text(COLLECTION)
    assert main([str(path), "--multistart", "2", "--relaxation", "kanzow-schwartz"]) == 0
    out = capsys.readouterr().out
    assert "1 of 2 within 0.0001 of the target, 2 successes" in out  # the target of arms is wrong on purpose
    assert "not at the target: arms" in out
    assert "arms: missed (target 0.5): 2 of 2 starts succeeded, f from 1 to 1" in out
    assert "ratio of times" in out


def test_unknown_problems_and_files_are_refused(main, tmp_path):
    path = tmp_path / "collection.py"
    path.write_text(COLLECTION)
    with pytest.raises(SystemExit):
        main([str(path), "--only", "nothing"])
    with pytest.raises(SystemExit, match="is not a Python file"):
        main([str(tmp_path / "absent.py")])
