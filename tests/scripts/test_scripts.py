"""The comparison that users copy, on small meshes."""

from __future__ import annotations

from pathlib import Path

import pytest

import compare_formulations


@pytest.mark.slow
def test_a_study_with_its_tables_and_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["6.1", "--sizes", "7", "8", "--formulations", "fixed", "joint", "--out", str(tmp_path)]
    assert compare_formulations.main(arguments) == 0
    rows = capsys.readouterr().out.splitlines()
    assert [row.split()[-1] for row in rows[1:]] == ["0.0", "1.0", "0.0", "1.0"]
    kept = (tmp_path / "records.jsonl").read_text()
    assert "| 6.1, n = 8, joint |" in (tmp_path / "table.md").read_text()
    assert any((tmp_path / "figures").iterdir())
    assert compare_formulations.main(arguments) == 0  # nothing is solved again
    assert (tmp_path / "records.jsonl").read_text() == kept


def test_a_study_of_an_unknown_example_is_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        compare_formulations.main(["6.9", "--out", str(tmp_path / "study")])
    assert stop.value.code == 2
    assert "6.9" in capsys.readouterr().err
    assert not (tmp_path / "study").exists()
