"""Every script can be called; small runs of benchmarks, and what their tables say."""

import importlib
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import ablation
import benchmark_cost
import soak_losses
from random_designs import random_design
from rmesh_nlp.solving.outer import Outer
from rows import Store, markdown

SCRIPTS = Path(__file__).parents[2] / "scripts"
MODULES = sorted(SCRIPTS.rglob("*.py"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "path",
    [path for path in MODULES if re.search(r"command_line\(__doc__|typer.run", path.read_text())],
    ids=lambda path: path.stem,
)
def test_every_script_starts_by_itself_and_says_how_it_is_called(path, tmp_path):
    """From another folder, so that nothing but its own place is on the path."""
    command = [sys.executable, str(path), "--help"]
    answer = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.lstrip().lower().startswith("usage: ")


def test_rows_are_kept_and_a_table_shows_three_digits_or_a_dash(tmp_path):
    store = Store(tmp_path / "of" / "rows.jsonl")
    store.add({"case": "a", "size": 1, "error": np.float64(0.123456)})
    store.add({"case": "b", "size": 2, "error": float("nan")})
    again = Store(tmp_path / "of" / "rows.jsonl")
    assert again.rows[0] == store.rows[0] == {"case": "a", "size": 1, "error": 0.123456}
    assert again.has(case="b", size=2)
    assert not again.has(case="b", size=1)
    lines = markdown(pd.DataFrame(again.rows)).splitlines()
    assert [line.split() for line in lines[2:]] == [
        ["|", "a", "|", "1", "|", "0.123", "|"],
        ["|", "b", "|", "2", "|", "-", "|"],
    ]


@pytest.mark.parametrize("rule", ablation.RULES, ids=lambda rule: rule.name)
def test_every_rule_that_is_switched_off_exists_and_is_put_back(rule):
    def values():
        places = (place.split(":") for place in rule.values)
        return [getattr(importlib.import_module(module), name) for module, name in places]

    before = values()
    with ablation.without(rule):
        assert all(one is other for one, other in zip(values(), rule.values.values(), strict=True))
    assert all(one is other for one, other in zip(values(), before, strict=True))
    assert rule.values or rule.settings


def test_table_of_the_ablation_has_gains_failures_and_cost():
    rule = ablation.RULES[0].name
    good = {"success": True, "status": "converged", "gain": 2.0, "cost": 10}
    rows = [
        {"rule": name, "formulation": "joint", "case": case, **good}
        for name in (ablation.PLAIN.name, rule)
        for case in "abc"
    ]
    rows[3] |= {"gain": 1.0, "cost": 30}
    rows[5] |= {"success": False, "status": "worse"}
    cells = [cell.strip() for cell in ablation.table(rows).splitlines()[-1].split("|")[1:-1]]
    assert cells == [rule, "3", "0.7500", "0.500", "1, 0", "1, 0", "2.00"]


@pytest.mark.slow
def test_cost_of_a_solve_is_larger_than_its_unit(capsys):
    assert benchmark_cost.main(["6.1:2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    header, _, row = ([one.strip() for one in line.split("|")[1:-1]] for line in lines if line)
    cost = dict(zip(header, row, strict=True))
    assert (cost["problem"], cost["nodes"]) == ("6.1:2", "9")
    assert 1 < float(cost["without assessment"]) < float(cost["whole"])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 5, 19])
def test_stated_design_obeys_all_constraints(seed):
    found = random_design(seed)
    outer = Outer.of(found.problem, found.objective)
    amplitudes = [found.feasible[shape.name] for shape in found.problem.shapes]
    nodes = found.problem.mesh.p + np.tensordot(amplitudes, found.problem.shape_motions, 1)
    q = outer.variables(nodes, design=found.feasible)
    assert outer.design(q) == pytest.approx(found.feasible)
    assert 3 <= outer.n <= 200
    assert outer.merit(outer.function(q))[0] == 0.0


@pytest.mark.slow
def test_kills_and_short_writes_lose_nothing(capsys):
    arguments = ["--kills", "1", "--short-writes", "1", "--solves", "4", "--jobs", "1", "--longest", "5"]
    soak_losses.main([*arguments, "--seed", "5"])
    assert capsys.readouterr().out.startswith("nothing lost, nothing doubled: ")


def test_a_lost_or_doubled_row_is_found_out(tmp_path):
    line, path = json.dumps({"key": "a", "success": True}), tmp_path / "records.jsonl"
    fields = tmp_path / "solutions" / "a"
    fields.parent.mkdir()
    fields.with_suffix(".vtu").write_text("<VTKFile/>")
    fields.with_suffix(".csv").write_text("x,y\n")
    path.write_text(f"{line}\n{line[:9]}")
    known = soak_losses.rows(tmp_path)
    assert known == {"a": line}
    path.write_text(f"{line}\n{line}\n")
    with pytest.raises(AssertionError, match="doubled: a"):
        soak_losses.rows(tmp_path)
    path.write_text(line.replace("true", "false") + "\n")
    with pytest.raises(AssertionError, match="lost"):
        soak_losses.survive(known, tmp_path)
