"""The benchmark script on a collection of two problems."""

import importlib.util
import sys
from pathlib import Path

import pytest
from support.mpcc_collection import MPCC_COLLECTION

SCRIPT = Path(__file__).parents[2] / "scripts" / "benchmark_mpcc.py"


@pytest.fixture
def main(monkeypatch):
    spec = importlib.util.spec_from_file_location("benchmark_mpcc", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)  # dataclasses look there
    spec.loader.exec_module(module)
    return module.main


@pytest.mark.slow
def test_the_table_shows_hits_misses_and_the_plain_loop(main, tmp_path, capsys):
    path = tmp_path / "collection.py"
    path.write_text(MPCC_COLLECTION)
    assert main([str(path), "--multistart", "2", "--relaxation", "kanzow-schwartz"]) == 0
    out = capsys.readouterr().out
    assert "1 of 2 within 0.0001 of the target, 2 successes" in out  # the target of arms is wrong on purpose
    assert "(best known 0.5)" in out
    assert "arms: missed (target 0.5): 2 of 2 starts succeeded, f from 1 to 1" in out
    assert "| 1/2 | 1/2 |" in out  # at target, ours and the plain loop
    assert "time ratio" in out


@pytest.mark.slow
def test_a_collection_and_families_make_one_table(main, tmp_path, capsys):
    path = tmp_path / "collection.py"
    path.write_text(MPCC_COLLECTION)
    out = tmp_path / "out"
    given = [str(path), "--families", "polynomial", "--sizes", "1", "--seeds", "1", "--out", str(out)]
    assert main(given) == 0
    text = (out / "table.md").read_text()
    assert "| collection | 2 |" in text
    assert "| polynomial | 1 |" in text
    assert "| all | 3 |" in text


def test_unknown_problems_and_files_are_refused(main, tmp_path):
    path = tmp_path / "collection.py"
    path.write_text(MPCC_COLLECTION)
    with pytest.raises(SystemExit):
        main([str(path), "--only", "nothing"])
    with pytest.raises(SystemExit, match="is not a Python file"):
        main([str(tmp_path / "absent.py")])
