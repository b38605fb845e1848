"""The soak scripts, a few rounds each; in full they run by hand."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


@pytest.mark.slow
def test_kills_and_short_writes_lose_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(SCRIPTS))
    importlib.import_module("soak_files").main(["--kills", "1", "--short-writes", "1", "--seed", "5"])
    assert "nothing lost, nothing doubled: 1 kill" in capsys.readouterr().out


@pytest.mark.slow
def test_a_study_that_is_killed_has_every_row_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(SCRIPTS))
    arguments = ["--solves", "4", "--kills", "1", "--jobs", "1", "--longest", "5"]
    importlib.import_module("soak_study").main(arguments)
    assert "4 rows of 4 solves, none lost, none doubled" in capsys.readouterr().out
