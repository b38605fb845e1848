"""Records: what is written comes back, mistakes and damaged lines are found, old names are read."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.records import (
    REQUIRED,
    DamagedRecordsWarning,
    damaged_last_line,
    parse_json,
    read_lines,
    read_record,
    to_json,
)
from support.reporting import failed_61, fixed_61


def test_json_is_strict_and_plain():
    row = {
        "a": math.nan,
        "b": [np.inf, np.float64(1.5)],
        "c": {"d": np.arange(2)},
        "e": np.int64(3),
        "f": "x\ud800y",
    }
    assert parse_json(to_json(row), "here") == {
        "a": None, "b": [None, 1.5], "c": {"d": [0, 1]}, "e": 3, "f": "x?y"
    }  # fmt: skip
    assert json.loads(to_json(fixed_61(), indent=2)) == fixed_61()


@pytest.mark.parametrize("name", REQUIRED)
def test_every_required_entry_is_asked_for(name):
    record = fixed_61()
    del record[name]
    with pytest.raises(BadInputError, match=f"it has no '{name}'"):
        read_record(to_json(record), "here")


WRONG = [
    ("energy", True), ("energy", None), ("u_min", None), ("contact_time_s", "x"), ("wall_time_s", -1.0),
    ("iterations", 4.5), ("seed", True), ("success", 1), ("example", None), ("n", 8), ("delta", "x"),
    ("delta", [1.0]), ("delta", [1.0, True]), ("delta", {"absolute": 1.0}), ("key", [1]), ("key", "a\0b"),
    ("key", "../../esc"), ("relaxation", [1]), ("objective_value", "<svg>"), ("biactive_nodes", 3),
    ("quadrature", [[]]), ("guaranteed_lower", "yes"), ("nodes", 1.5),
]  # fmt: skip


@pytest.mark.parametrize(("name", "value"), WRONG)
def test_entry_of_the_wrong_kind_is_named_in_one_line(name, value):
    with pytest.raises(BadInputError, match=rf"^here is not a record: '{name}' [^\n]*$") as caught:
        read_record(to_json(fixed_61(**{name: value})), "here")
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize("delta", [None, [0.1, 0.2], {"relative": 0.3}])
def test_every_kind_of_delta_is_read(delta):
    assert read_record(to_json(fixed_61(delta=delta)), "here")["delta"] == delta


def test_failed_solve_may_have_no_figures():
    assert read_record(to_json(failed_61()), "here") == failed_61()


HOSTILE = {
    "a number beyond floats": ('"energy"', "1" + "0" * 400),
    "a float beyond floats": ('"energy"', "1e999"),
    "the least whole number that is too large": ('"energy"', str(2**63)),
    "not a number": ('"energy"', "NaN"),
    "an unpaired surrogate": ('"message"', r'"\ud800"'),
    "depth": ('"deep"', "[" * 100_000 + "]" * 100_000),
}


@pytest.mark.parametrize(("name", "value"), HOSTILE.values(), ids=HOSTILE.keys())
def test_hostile_json_is_one_line_not_a_traceback(name, value):
    text = to_json(fixed_61())[:-1] + f", {name}: {value}}}"
    with pytest.raises(BadInputError, match=r"^here is not JSON that can be read: [^\n]*$") as caught:
        read_record(text, "here")
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("nonsense", "line 2 is not JSON"),
        ("[1, 2]", "line 2 is not a record: it holds list"),
        ('{"example": "6.1"}', "line 2 is not a record: it has no 'formulation'"),
    ],
)
def test_broken_line_is_named_with_file_and_number(tmp_path, line, message):
    path = tmp_path / "records.jsonl"
    path.write_text(f"{to_json(fixed_61())}\n{line}\n")
    with pytest.raises(BadInputError, match=message) as caught:
        read_lines(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("content", "kept", "damaged"),
    [
        (b"\n", 1, b""),
        (b'{"a": 1}\n', 9, b""),
        (b'{"a": 1}', 0, b'{"a": 1}'),  # no end: the next row would be glued to it
        (b'{"a": 1}\n{"b"\n', 9, b'{"b"\n'),
        (b'{"a": 1}\ngarbage\n', 17, b""),  # whole lines of others are for the reader to name
        (b'{"a"\n', 5, b""),  # the only line: a file of something else
        (b'{"a": 1}\n{"b": \xff}\n', 9, b'{"b": \xff}\n'),
        (b"x" * 5000 + b"\n" + b'{"b": 2}\n', 5010, b""),
        (b"x" * 5000 + b"\n" + b'{"b"' + b" " * 40000 + b"\n", 5001, b'{"b"' + b" " * 40000 + b"\n"),
        (b'{"a": 1}\n{"n": 1' + b"0" * 5000 + b"}\n", 9 + 5008 + 1, b""),  # JSON that the reader refuses
    ],
)
def test_end_of_the_whole_lines_is_found(tmp_path, content, kept, damaged):
    path = tmp_path / "records.jsonl"
    path.write_bytes(content)
    assert damaged_last_line(path) == (kept, damaged)
    path.unlink()
    assert damaged_last_line(path) == (0, b"")


def test_start_of_a_damaged_line_is_shown(tmp_path):
    path = tmp_path / "records.jsonl"
    path.write_text(to_json(fixed_61()) + '\n{"example": "' + "x" * 100)
    with pytest.warns(DamagedRecordsWarning) as caught:
        assert len(read_lines(path)) == 1
    message = str(caught[0].message)
    assert '{"example": "' + "x" * 27 in message
    assert "x" * 28 not in message
    assert caught[0].filename == __file__  # where it was read
