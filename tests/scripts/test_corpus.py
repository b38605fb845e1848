"""What ``scripts/corpus.py`` reports of a version that is worse than its baseline."""

from typing import cast

import pytest

import corpus
from baseline.cases import cases
from baseline.comparison import Comparison, Row, compare, compare_seconds

KEYS = ["energy", "units", "units.length"]

GOOD = {
    "keys": KEYS,
    "status": "converged",
    "text": "",
    "success": True,
    "label": "S",
    "value": -1.0,
    "iterations": 5,
    "contact_solves": 6,
    "seconds": 1.0,
    "numbers": {"resultant": 3.0},
}


def row(**changes: object) -> Row:
    return cast(Row, {**GOOD, **changes})


def held(*olds: Row, new: Row, allowed: tuple[str, ...] = ()) -> Comparison:
    return compare([{"group: case": old} for old in olds], {"group: case": new}, allowed)


def test_what_is_no_loss_is_no_fault() -> None:
    assert not held(row(), row(), new=row(value=-1.0 + 1e-8, seconds=3.0)).faults
    keys = {"keys": ["energy"]}  # entries may be allowed to go
    assert not held(row(), new=row(**keys), allowed=("units",)).faults
    better = held(row(status="stalled", label="C"), new=row(value=-1.1))
    assert better.remarks[:2] == [
        "group: case: status stalled (success) -> converged (success)",
        "group: case: lower value, -1 -> -1.1",
    ]
    # a stopped solve may lose a thousandth of its gain
    stopped = {"status": "stalled", "numbers": {"energy_initial_audited": 9.0}}
    assert not held(row(**stopped), new=row(**stopped, value=-0.995)).faults
    assert held(row(**stopped), new=row(**stopped, value=-0.98)).faults


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"status": "stalled"}, "not converged: 1 cases"),
        ({"status": "stalled", "success": False}, "no success: 1 cases"),
        ({"status": "crashed", "success": False, "text": "KeyError: 'x'"}, "-> crashed KeyError: 'x'"),
        ({"status": "over the time limit", "success": False, "value": None}, "over the time limit"),
        ({"label": "C"}, "weaker label: 1 cases, up to 0 among runs of the baseline; group: case: S -> C"),
        ({"label": "at least M"}, "S -> at least M"),
        ({"value": -0.99999}, "higher value: 1 cases, up to 0 among runs of the baseline"),
        ({"keys": ["energy"]}, "entry missing units: 1 cases"),
        ({"keys": [*KEYS, "fresh"]}, "entry new fresh: 1 cases"),
        ({"numbers": {"resultant": 3.01}}, "number resultant: 1 cases"),
    ],
)
def test_a_loss_is_a_fault(changes: dict[str, object], words: str) -> None:
    faults = held(row(), row(), new=row(**changes)).faults
    assert any(words in fault for fault in faults), faults


def test_a_refused_problem_stays_refused() -> None:
    refused = row(status="refused", success=False, value=None, text="ProblemError: no")
    assert "status refused -> converged" in held(refused, new=row()).faults[0]
    other = held(refused, new={**refused, "text": "ProblemError: yes"})
    assert not other.faults
    assert "message 'ProblemError: no' -> 'ProblemError: yes'" in other.remarks[0]


def test_a_case_is_as_good_as_its_worst_run() -> None:
    worst = row(value=-0.5, status="stalled", label="M", numbers={"resultant": 2.0})
    assert not held(row(), worst, new=worst).faults
    assert not held(row(), worst, new=row(value=-0.7, numbers={"resultant": 9.0})).faults
    assert "higher value" in held(row(), worst, worst, new=row(value=-0.4)).faults[0]


def runs_of(*values: float) -> dict[str, Row]:
    return {f"group: {k}": row(value=value) for k, value in enumerate(values)}


def test_as_many_cases_may_be_worse_as_one_run_has_against_the_others() -> None:
    baseline = [runs_of(-1, -1, -1, -1, -1), runs_of(-0.9, -1, -1, -1, -1), runs_of(-1, -0.9, -1, -1, -1)]
    result = compare(baseline, runs_of(-1, -1, -0.9, -0.9, -1))
    assert not result.faults
    assert sum("group: higher value: group:" in line for line in result.remarks) == 2
    (higher, best) = compare(baseline, runs_of(-1, -1, -0.9, -0.9, -0.9)).faults
    assert higher.startswith("group: higher value: 3 cases, up to 1 among runs of the baseline")
    assert best == "group: 4 to 5 -> 2 of 5 cases at the best known value"


def test_slower_by_more_than_a_tenth_is_a_fault() -> None:
    result, olds = Comparison(), [{"joint": 1.0, "mpcc": 5.0}, {"joint": 2.0, "mpcc": 4.0}]
    compare_seconds(result, olds, {"joint": 2.3, "mpcc": 4.0})
    assert result.faults == ["seconds of joint: 1.0 to 2.0 -> 2.3"]
    assert len(result.remarks) == 2


@pytest.mark.slow
def test_cases_have_names_of_their_own() -> None:
    names = [case.name for case in cases()]
    assert len(set(names)) == len(names) > 1000
    assert 200 < sum(case.quick for case in cases()) < 0.4 * len(names)


def test_the_baseline_can_be_read() -> None:
    runs = corpus.read(corpus.BASELINE)
    assert len(runs) == 3
    design = runs[0]["rows"]["designs: 107 by mpcc"]
    assert design["status"] == "converged"
    assert "design" in design["keys"]
    assert design["value"] < design["numbers"]["objective_initial"]


@pytest.mark.slow
def test_a_run_has_no_faults_against_itself(tmp_path, capsys):
    file = tmp_path / "frozen.json.gz"
    only = ["--only", "6.1 4 weighted by", "--jobs", "1"]
    assert corpus.main([*only, "--freeze", str(file)]) == 0
    assert corpus.main([*only, "--rows", str(file), "--against", str(file)]) == 0
    assert "0 faults" in capsys.readouterr().out
    runs = corpus.read(file)
    runs[0]["rows"]["examples: 6.1 4 weighted by joint"]["status"] = "crashed"
    corpus.write(tmp_path / "worse.json.gz", runs)
    assert corpus.main([*only, "--rows", str(tmp_path / "worse.json.gz"), "--against", str(file)]) == 1
    assert "6.1 4 weighted by joint: status converged (success) -> crashed" in capsys.readouterr().out
