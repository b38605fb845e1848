"""The soak of losses, a few rounds; in full it runs by hand."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import soak_losses


@pytest.mark.slow
def test_kills_and_short_writes_lose_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--kills", "1", "--short-writes", "1", "--solves", "4", "--jobs", "1", "--longest", "5"]
    soak_losses.main([*arguments, "--seed", "5"])
    assert capsys.readouterr().out.startswith("nothing lost, nothing doubled: ")


def test_a_lost_or_doubled_row_is_found_out(tmp_path: Path) -> None:
    line = json.dumps({"key": "a", "success": True})
    path = tmp_path / "records.jsonl"
    path.write_text(f"{line}\n{line[:9]}")
    known = soak_losses.rows(tmp_path)
    assert known == {"a": line}
    path.write_text(f"{line}\n{line}\n")
    with pytest.raises(AssertionError, match="doubled: a"):
        soak_losses.rows(tmp_path)
    path.write_text(line.replace("true", "false") + "\n")
    with pytest.raises(AssertionError, match="lost"):
        soak_losses.survive(known, tmp_path)
