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
