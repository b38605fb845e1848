"""Folders of results and their records: rows of studies, histories, and files that are half there."""

from __future__ import annotations

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
from rmesh_nlp.io.records import (
    REQUIRED,
    DamagedRecordsWarning,
    damaged_last_line,
    parse_json,
    read_lines,
    read_record,
    to_json,
)
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
    write_single,
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


def test_single_solve_is_recorded_though_the_disk_is_full(tmp_path):
    known = single_result(tmp_path, fixed_61())

    def save(places: Any) -> None:
        assert (places.vtu, places.history) == (known.vtu, known.history)
        raise OSError("no space left on device")

    with pytest.raises(OSError, match="no space"):
        write_single(tmp_path, fixed_61(), save)
    text = (tmp_path / RECORD).read_text()
    assert json.loads(text) == fixed_61()
    assert text.startswith('{\n  "')  # for people
    assert text.endswith("}\n")


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


def test_damaged_line_is_moved_away_before_the_next_row(tmp_path):
    results, path = Results(tmp_path), tmp_path / RECORDS
    results.append(fixed_61(key="a"))
    whole, half = path.read_bytes(), '{"half' + "x" * 99
    results.mend()
    assert not (tmp_path / "records-damaged.txt").exists()
    for mend in (results.mend, results.mend, lambda: results.append(joint_61())):
        path.write_bytes(path.read_bytes() + half.encode())
        with pytest.warns(DamagedRecordsWarning, match=r'is moved to .*"halfx{34}[^x]'):  # its start
            mend()
        assert path.read_bytes().startswith(whole)
    assert results.read() == [fixed_61(key="a"), joint_61()]
    assert (tmp_path / "records-damaged.txt").read_text() == f"{half}\n" * 3
    assert "records-damaged.txt" in results.manifest.names()


def test_rows_of_one_key_become_one_and_nothing_is_written_without_need(tmp_path):
    results = Results(tmp_path)
    rows = [fixed_61(), fixed_61(), failed_61(key="b"), failed_61(key="b", message="later")]
    for row in rows[:3]:
        results.append(row)
    before = (tmp_path / RECORDS).stat().st_mtime_ns
    assert results.repaired() == rows[:3]
    assert (tmp_path / RECORDS).stat().st_mtime_ns == before
    results.append(rows[3])
    assert results.repaired() == results.read() == [rows[0], rows[1], rows[3]]
    good = fixed_61(key="b")
    for row in (good, failed_61(key="b")):  # the last success counts
        results.append(row)
    assert results.repaired() == results.read() == [rows[0], rows[1], good]


@pytest.mark.parametrize("content", ["", "\n", '{"example": "6.1", "form'])
def test_folder_whose_first_solve_has_not_ended_is_an_empty_run(tmp_path, content):
    (tmp_path / "records.jsonl").write_text(content)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DamagedRecordsWarning)
        assert read_results(tmp_path) == []


def test_short_write_is_an_error_and_leaves_the_file_as_it_was(tmp_path, monkeypatch):
    """A full disk takes some bytes without an error and refuses the next."""
    results = Results(tmp_path)
    results.append(fixed_61())
    before, write, taken = (tmp_path / "records.jsonl").read_bytes(), os.write, []

    def full(descriptor: int, data: bytes) -> int:
        if taken:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        taken.append(write(descriptor, data[:100]))
        return taken[0]

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(OSError, match=r"No space left.*records"):
        results.append(joint_61())
    with pytest.raises(OSError, match=r"No space left.*new"):
        append_whole(tmp_path / "new", "x")
    monkeypatch.undo()
    assert not (tmp_path / "new").exists()
    assert taken == [100]
    assert (tmp_path / "records.jsonl").read_bytes() == before
    results.append(joint_61())
    assert results.read() == [fixed_61(), joint_61()]


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
    ],
)
def test_end_of_the_whole_lines_is_found(tmp_path, content, kept, damaged):
    path = tmp_path / "records.jsonl"
    path.write_bytes(content)
    assert damaged_last_line(path) == (kept, damaged)
    path.unlink()
    assert damaged_last_line(path) == (0, b"")
