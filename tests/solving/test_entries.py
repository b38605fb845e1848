"""Entries of records: every one that is written is declared, has the type it says, and stands on its page."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

import rmesh_nlp as rm
from rmesh_nlp.io.records import FIELDS, read_record, to_json
from rmesh_nlp.solving.entries import ENTRIES
from rmesh_nlp.solving.entry import KNOWN

ROOT = Path(__file__).parents[2]
SOLVES: dict[str, dict[str, Any]] = {
    "fixed": {"certify": True},
    "joint": {},
    "mpcc": {"objective": "error-l2", "limits": rm.Limits(iterations=30)},
    "nested": {"starts": 1},
    "auto": {},
}


@pytest.mark.parametrize("formulation", SOLVES)
def test_every_entry_of_a_record_is_declared_and_of_its_type(formulation: str) -> None:
    record = rm.solve(rm.EXAMPLES["6.1"](4), formulation, **SOLVES[formulation]).record()
    assert set(record) <= set(ENTRIES)
    always = {name for name, entry in ENTRIES.items() if entry.of is not None and entry.presence is not KNOWN}
    assert always <= set(record)
    assert read_record(to_json(record), "here")["formulation"] == record["formulation"]


def test_every_entry_has_a_meaning_and_a_type() -> None:
    assert all(entry.meaning.endswith(".") for entry in ENTRIES.values())
    assert set(FIELDS) == set(ENTRIES)


def test_the_page_of_records_has_the_declared_entries(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [str(ROOT / "scripts"), *sys.path])
    import records_page

    text = records_page.PAGE.read_text()
    assert text == records_page.page(text), "run python scripts/records_page.py"
