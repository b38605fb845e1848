"""The scripts on small meshes."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


@pytest.fixture(autouse=True)
def scripts_are_modules(monkeypatch: pytest.MonkeyPatch) -> None:
    # also in the processes that a benchmark starts
    monkeypatch.syspath_prepend(str(SCRIPTS))


def script(name: str) -> ModuleType:
    return importlib.import_module(name)


@pytest.mark.slow
def test_a_study_then_its_tables_and_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study = str(tmp_path / "study")
    arguments = ["6.1", "--sizes", "7", "8", "--formulations", "fixed", "joint", "--out", study]
    compare = script("compare_strategies").main
    assert compare(arguments) == 0
    first = capsys.readouterr()
    assert "| 6.1, n = 7, fixed |" in first.out
    assert "| 6.1, n = 8, joint |" in first.out
    assert compare(arguments) == 0  # nothing is solved again: the times are the same
    assert capsys.readouterr().out == first.out

    assert script("make_tables").main([study]) == 0
    rows = capsys.readouterr().out.splitlines()
    assert [row.split()[-1] for row in rows[1:]] == ["0.0", "1.0", "0.0", "1.0"]

    assert script("make_figures").main([study, "--out", str(tmp_path / "drawn")]) == 0
    for path in capsys.readouterr().out.splitlines():
        assert Path(path).parent == tmp_path / "drawn"
        assert Path(path).stat().st_size > 0


@pytest.mark.parametrize("name", ["make_tables", "make_figures"])
def test_a_missing_folder_is_exit_code_2(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        script(name).main(["nowhere"])
    assert stop.value.code == 2
    assert "'nowhere' is not a folder" in capsys.readouterr().err


def test_a_study_of_an_unknown_example_is_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        script("compare_strategies").main(["6.9", "--out", str(tmp_path / "study")])
    assert stop.value.code == 2
    assert "6.9" in capsys.readouterr().err
    assert not (tmp_path / "study").exists()
