from __future__ import annotations

import errno
import json
import math
import os
import warnings

import numpy as np
import pytest

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.records import REQUIRED, DamagedRecordsWarning, parse_json, read_record, to_json
from rmesh_nlp.io.results import HISTORY_FIELDS, Results, read_results
from support.reporting import failed_61, fixed_61, joint_61


def test_records_come_back_as_they_were_appended(tmp_path):
    results = Results(tmp_path)
    for record in (fixed_61(), joint_61()):
        results.append(record)
    assert results.read() == [fixed_61(), joint_61()]


def test_what_is_not_finite_becomes_null_and_numpy_becomes_plain():
    row = {"a": math.nan, "b": [np.inf, np.float64(1.5)], "c": {"d": np.arange(2)}, "e": np.int64(3)}
    assert json.loads(to_json(row)) == {"a": None, "b": [None, 1.5], "c": {"d": [0, 1]}, "e": 3}


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


@pytest.mark.parametrize("content", ["", "\n", '{"example": "6.1", "form'])
def test_a_folder_whose_first_solve_has_not_ended_is_an_empty_run(tmp_path, content):
    (tmp_path / "records.jsonl").write_text(content)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DamagedRecordsWarning)
        assert read_results(tmp_path) == []


HOSTILE = {
    "a number beyond floats": ('"energy"', "1" + "0" * 400),
    "a number of 5000 digits": ('"energy"', "7" * 5000),
    "a float beyond floats": ('"energy"', "1e999"),
    "not a number": ('"energy"', "NaN"),
    "half a character": ('"message"', r'"\ud800"'),
    "half a character in a name": (r'"\ud800"', "1"),
    "a list for a key": ('"key"', "[1]"),
    "a key that leads out": ('"key"', '"../../esc"'),
    "an absolute key": ('"key"', '"/abs"'),
    "a key with a zero": ('"key"', r'"a\u0000b"'),
    "a list for a relaxation": ('"relaxation"', "[1]"),
    "a text for a value": ('"objective_value"', '"<svg>"'),
    "a number for nodes": ('"biactive_nodes"', "3"),
    "a list for a rule": ('"quadrature"', "[[]]"),
    "a time before its beginning": ('"wall_time_s"', "-1"),
    "depth": ('"deep"', "[" * 100_000 + "]" * 100_000),
}


@pytest.mark.parametrize(("name", "value"), HOSTILE.values(), ids=HOSTILE.keys())
def test_hostile_entries_are_one_line_not_a_traceback(name, value):
    text = to_json(fixed_61())[:-1] + f", {name}: {value}}}"
    with pytest.raises(BadInputError, match="here is not") as caught:
        read_record(text, "here")
    assert len(str(caught.value)) < 300
    assert "\n" not in str(caught.value)


def test_entries_of_others_are_let_through():
    assert read_record(to_json(fixed_61(mine={"a": [1]}, other="x")), "here")["mine"] == {"a": [1]}


def test_json_of_ours_survives_half_characters():
    assert parse_json(to_json({"a": "x\ud800y"}), "here") == {"a": "x?y"}


HEAD = ",".join(HISTORY_FIELDS) + "\n"
GARBAGE = {
    "text for a number": HEAD + "0,abc,,,,,\n",
    "too few cells": HEAD + "0,1\n",
    "too many cells": HEAD + "1," * 99 + "\n",
    "another head": "a,b\n1,2\n",
    "nothing": "",
    "zeros": "\0\0\0",
    "bytes": "\udcff\udcfe",
}


@pytest.mark.parametrize("content", GARBAGE.values(), ids=GARBAGE.keys())
def test_a_history_that_is_none_is_named(tmp_path, content):
    results = Results(tmp_path)
    result = results.result(fixed_61(key="one"))
    result.history.parent.mkdir()
    result.history.write_bytes(content.encode(errors="surrogateescape"))
    with pytest.raises(BadInputError, match=r"one\.csv is no history"):
        result.steps()


def test_a_short_write_is_an_error_and_leaves_the_file_as_it_was(tmp_path, monkeypatch):
    """A full disk takes some bytes without an error and refuses the next."""
    results = Results(tmp_path)
    results.append(fixed_61())
    before, write, taken = (tmp_path / "records.jsonl").read_bytes(), os.write, []

    def full(descriptor, data):
        if taken:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        taken.append(write(descriptor, data[:100]))
        return taken[0]

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(OSError, match="No space left"):
        results.append(joint_61())
    monkeypatch.undo()
    assert taken == [100]
    assert (tmp_path / "records.jsonl").read_bytes() == before
    results.append(joint_61())
    assert results.read() == [fixed_61(), joint_61()]


def test_a_damaged_line_is_set_aside_before_the_next_row_is_glued_to_it(tmp_path):
    results, path = Results(tmp_path), tmp_path / "records.jsonl"
    results.append(fixed_61())
    with path.open("a") as file:
        file.write('{"example": "cut')
    with pytest.warns(DamagedRecordsWarning):
        results.append(joint_61())
    assert results.read() == [fixed_61(), joint_61()]
    assert (tmp_path / "records-damaged.txt").read_text() == '{"example": "cut\n'
