from __future__ import annotations

import json
import math

import numpy as np
import pytest
from support.reporting import failed_61, fixed_61, joint_61

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.results import REQUIRED, Results, read_record, read_results, to_json


def test_records_come_back_as_they_were_appended(tmp_path):
    results = Results(tmp_path)
    for record in (fixed_61(), joint_61()):
        results.append(record)
    assert results.read() == [fixed_61(), joint_61()]


def test_what_is_not_finite_becomes_null_and_numpy_becomes_plain():
    row = {"a": math.nan, "b": [np.inf, np.float64(1.5)], "c": {"d": np.arange(2)}, "e": np.int64(3)}
    assert json.loads(to_json(row)) == {"a": None, "b": [None, 1.5], "c": {"d": [0, 1]}, "e": 3}


def test_a_last_line_cut_off_is_passed_over(tmp_path):
    results = Results(tmp_path)
    results.append(fixed_61())
    with (tmp_path / "records.jsonl").open("a") as file:
        file.write('{"example": "6.1", "form')
    assert results.read() == [fixed_61()]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("nonsense", "line 2 is not JSON"),
        ("[1, 2]", "line 2 is not a record: it holds list"),
        ('{"example": "6.1"}', "line 2 is not a record: it has no 'formulation'"),
    ],
)
def test_a_broken_line_is_named_with_file_and_number(tmp_path, line, message):
    path = tmp_path / "records.jsonl"
    path.write_text(f"{to_json(fixed_61())}\n{line}\n")
    with pytest.raises(BadInputError, match=message) as caught:
        read_results(tmp_path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("name", REQUIRED)
def test_every_required_entry_is_asked_for(name):
    record = fixed_61()
    del record[name]
    with pytest.raises(BadInputError, match=f"it has no '{name}'"):
        read_record(to_json(record), "here")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("energy", "abc"),
        ("energy", True),
        ("energy", None),
        ("u_min", None),
        ("contact_time_s", None),
        ("contact_time_s", "x"),
        ("wall_time_s", [1]),
        ("iterations", 4.5),
        ("seed", "a"),
        ("success", "yes"),
        ("example", None),
        ("n", 8),
        ("delta", "x"),
        ("delta", [1.0]),
        ("delta", 3),
        ("delta", {"absolute": 1.0}),
    ],
)
def test_an_entry_of_the_wrong_kind_is_named(name, value):
    with pytest.raises(BadInputError, match=f"here is not a record: '{name}'"):
        read_record(to_json(fixed_61(**{name: value})), "here")


@pytest.mark.parametrize("delta", [None, [0.1, 0.2], {"relative": 0.3}])
def test_every_kind_of_delta_is_read(delta):
    assert read_record(to_json(fixed_61(delta=delta)), "here")["delta"] == delta


def test_a_failed_solve_may_have_no_figures():
    assert read_record(to_json(failed_61()), "here") == failed_61()


def test_a_folder_without_records_is_named(tmp_path):
    with pytest.raises(BadInputError, match=r"holds neither records\.jsonl nor record\.json"):
        read_results(tmp_path)
    with pytest.raises(BadInputError, match="is not a folder"):
        read_results(tmp_path / "nowhere")
    (tmp_path / "records.jsonl").write_text("")
    with pytest.raises(BadInputError, match="holds no records"):
        read_results(tmp_path)


def test_an_earlier_run_is_set_aside_not_lost(tmp_path):
    results = Results(tmp_path)
    results.append(fixed_61())
    results.set_aside()
    assert not (tmp_path / "records.jsonl").exists()
    assert Results(tmp_path / "previous").read() == [fixed_61()]
