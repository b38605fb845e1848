"""Folders of results and their records: rows of studies, histories, and files that are half there."""

import errno
import json
import math
import os
import warnings
from typing import Any

import numpy as np
import pytest

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.folder import Manifest, append_whole
from rmesh_nlp.io.records import REQUIRED, DamagedRecordsWarning, parse_json, read_lines, read_record, to_json
from rmesh_nlp.io.results import (
    HISTORY,
    RECORD,
    RECORDS,
    Results,
    read_results,
    read_rows,
    row_files,
    single_result,
    write_history,
)
from support.reporting import failed_61, fixed_61, joint_61

ROW = to_json(fixed_61(key="a")) + "\n"


def fill(folder, files):
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def lines(*rows):
    return "".join(to_json(row) + "\n" for row in rows)


def test_of_rows_of_a_study_with_one_key_the_latest_success_counts_else_the_latest(tmp_path):
    fine, broken = fixed_61, failed_61
    files = [
        [fine(key="a", gain=1.0), broken(key="b", message="one"), broken(key="c", message="one")],
        [fine(key="a", gain=2.0), broken(key="b", message="two"), fine(key="c", gain=3.0)],
        [broken(key="a"), fine(key="c", gain=4.0)],
    ]
    fill(tmp_path, {f"rows/records-{k}.jsonl": lines(*rows) for k, rows in enumerate(files)})
    assert len(row_files(tmp_path)) == 3
    rows = read_rows(tmp_path)
    assert [(row["key"], row["gain"], row.get("message")) for row in rows] == [
        ("a", 2.0, None),
        ("b", None, "two"),
        ("c", 4.0, None),
    ]
    assert [result.record for result in read_results(tmp_path)] == rows


def test_which_of_several_records_a_folder_is_read_from(tmp_path):
    def read(name, files, claimed=()):
        fill(tmp_path / name, {**files, "mine": ""})
        if claimed:
            Manifest(tmp_path / name).claim(*claimed)
        found = [(one.record["key"], one.vtu, one.history) for one in read_results(tmp_path / name)]
        return [(key, *(str(path.relative_to(tmp_path / name)) for path in paths)) for key, *paths in found]

    single = ("a", "solution.vtu", "history.csv")
    assert read("single", {RECORD: ROW}) == [single]
    several = {RECORD: ROW, RECORDS: lines(joint_61(key="b"))}
    assert read("several", several) == [("b", "solutions/b.vtu", "solutions/b.csv")]
    # a comparison is noted, but only the record of a single solve is there
    assert read("both", {RECORD: ROW}, [RECORDS]) == [single]
    assert read("noted", {}, [RECORDS]) == []


def test_history_comes_back_and_unknown_values_are_nan(tmp_path):
    result = single_result(tmp_path, fixed_61())
    assert result.steps().empty
    assert {*result.steps()} == {*HISTORY}
    rows: list[dict[str, Any]] = [dict.fromkeys(HISTORY, 1.5), dict.fromkeys(HISTORY)]
    rows[1]["t"] = float("inf")
    write_history(result.history, rows)
    first, second = result.steps().to_dict("records")
    assert first == dict.fromkeys(HISTORY, 1.5)
    assert second["t"] == np.inf
    assert np.all(np.isnan([value for name, value in second.items() if name != "t"]))
    write_history(result.history, [{**rows[0], "design.E": 2.5}])
    assert result.steps().to_dict("records") == [dict.fromkeys(HISTORY, 1.5) | {"design.E": 2.5}]
    head = ",".join(HISTORY).encode()
    for content in (head + b"\n0,abc,,,,,\n", b"a,b\n1,2\n", b"", b"\xff\xfe"):
        result.history.write_bytes(content)
        with pytest.raises(BadInputError, match=r"history\.csv is no history"):
            result.steps()


def test_of_rows_of_a_comparison_with_one_key_the_latest_success_counts_too(tmp_path):
    rows = [
        fixed_61(),
        fixed_61(),
        failed_61(key="b"),
        fixed_61(key="b"),
        failed_61(key="b", message="later"),
    ]
    results = Results(tmp_path)
    results.write(rows)
    assert results.read() == [rows[0], rows[1], rows[3]]  # those without a key are apart
    assert Manifest(tmp_path).names() == [RECORDS]


@pytest.mark.parametrize("content", ["", "\n", '{"example": "6.1", "form'])
def test_folder_whose_first_solve_has_not_ended_is_an_empty_run(tmp_path, content):
    (tmp_path / "records.jsonl").write_text(content)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DamagedRecordsWarning)
        assert read_results(tmp_path) == []


def test_short_write_is_an_error_and_leaves_the_file_as_it_was(tmp_path, monkeypatch):
    """A full disk takes some bytes without an error and refuses the next."""
    path = tmp_path / "rows"
    path.write_bytes(before := b"one\n")
    write, taken = os.write, []

    def full(descriptor: int, data: bytes) -> int:
        if taken:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        taken.append(write(descriptor, data[:100]))
        return taken[0]

    monkeypatch.setattr(os, "write", full)
    for name in ("rows", "new"):
        with pytest.raises(OSError, match=f"No space left.*{name}"):
            append_whole(tmp_path / name, "x" * 101)
    monkeypatch.undo()
    assert not (tmp_path / "new").exists()
    assert taken == [100]
    assert path.read_bytes() == before


def test_json_is_strict_and_plain():
    row = {"a": math.nan, "b": [np.inf, np.float64(1.5)], "c": {"d": np.arange(2)}, "f": "x\ud800y"}
    plain = {"a": None, "b": [None, 1.5], "c": {"d": [0, 1]}, "f": "x?y"}
    assert parse_json(to_json(row), "here") == plain
    assert json.loads(to_json(fixed_61(), indent=2)) == fixed_61()


def test_every_required_entry_is_asked_for_and_every_kind_of_delta_is_read():
    deltas = None, [0.1, 0.2], {"relative": 0.3}
    for record in (failed_61(), *(fixed_61(delta=delta) for delta in deltas)):
        assert read_record(to_json(record), "here") == record
    for name in REQUIRED:
        record = fixed_61()
        del record[name]
        with pytest.raises(BadInputError, match=f"it has no '{name}'"):
            read_record(to_json(record), "here")


WRONG = [
    ("energy", True), ("energy", None), ("contact_time_s", "x"), ("wall_time_s", -1.0),
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


HOSTILE = {
    "a number beyond floats": ('"energy"', "1" + "0" * 400),
    "a float beyond floats": ('"energy"', "1e999"),
    "the least whole number that is too large": ('"iterations"', str(2**63)),
    "not a number": ('"energy"', "NaN"),
    "an unpaired surrogate": ('"message"', r'"\ud800"'),
    "depth": ('"deep"', "[" * 100_000 + "]" * 100_000),
}


@pytest.mark.parametrize(("name", "value"), HOSTILE.values(), ids=HOSTILE.keys())
def test_hostile_json_is_one_line_not_a_traceback(name, value):
    text = to_json(fixed_61())[:-1] + f", {name}: {value}}}"
    said = r"^here is not (a record|JSON that can be read): [^\n]*$"
    with pytest.raises(BadInputError, match=said) as caught:
        read_record(text, "here")
    assert len(str(caught.value)) < 300


def test_broken_line_is_named_with_file_and_number(tmp_path):
    path = tmp_path / "records.jsonl"
    for line, message in (
        ("nonsense", "line 2 is not JSON"),
        ("[1, 2]", "line 2 is not a record: it holds list"),
        ('{"example": "6.1"}', "line 2 is not a record: it has no 'formulation'"),
    ):
        path.write_text(f"{to_json(fixed_61())}\n{line}\n")
        with pytest.raises(BadInputError, match=message) as caught:
            read_lines(path)
        assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    "last",  # one without an end may have been cut, though it is whole
    [ROW.encode()[:-1], b'{"b"\n', b'{"b": \xff}\n', b"\0\0\n", b'{"halfx' + b"x" * 40000 + b"\n"],
)
def test_last_line_that_was_not_written_to_its_end_is_passed_over(tmp_path, last):
    path = tmp_path / "records.jsonl"
    path.write_bytes(ROW.encode() + last)
    with pytest.warns(DamagedRecordsWarning, match=r"is passed over: .{2,42}$"):
        assert read_lines(path) == [fixed_61(key="a")]
    path.write_bytes(b'{"a"\n')  # the only line: a file of something else
    with pytest.raises(BadInputError, match="line 1 is not JSON"):
        read_lines(path)
    path.write_bytes(ROW.encode() + b"\n")
    assert len(read_lines(path)) == 1
    path.unlink()
    assert read_lines(path) == []
