"""Folders that are written: nothing of the user's is touched, nothing is left where nothing came of it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from rmesh_nlp.cli import app as cli
from rmesh_nlp.io.files import folder_lock
from rmesh_nlp.io.records import to_json
from rmesh_nlp.io.results import Results, read_results
from rmesh_nlp.study.comparison import plan_comparison, run


@pytest.mark.slow
def test_two_runs_beside_files_of_the_user_s(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    mine = {"figures/mine.png": "p", "notes.md": "n", "previous/thesis.txt": "t"}
    for name, text in mine.items():
        Path(name).parent.mkdir(exist_ok=True)
        Path(name).write_text(text)
    arguments = ["compare", "6.1", "--formulations", "fixed", "--n", "3", "--out", "."]
    for _ in range(3):
        assert cli.run(arguments) == 0
    assert {name: Path(name).read_text() for name in mine} == mine
    rows = [Path(name, "records.jsonl").read_text() for name in (".", "previous-2", "previous-3")]
    assert len(set(rows)) == 3  # their times differ
    assert Path("previous-3/figures/6.1-3-grid.png").exists()
    Path("records.jsonl").unlink()
    Path("records.jsonl").write_text("my own records")
    Path(".rmesh-files").unlink()
    assert cli.run(arguments) == 2
    assert "records.jsonl exists and rmesh did not write it" in capsys.readouterr().err
    assert Path("records.jsonl").read_text() == "my own records"


def test_a_locked_folder_is_one_line_and_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with folder_lock(tmp_path):
        assert cli.run(["compare", "6.1", "--n", "3", "--out", str(tmp_path)]) == 2
        assert cli.run(["solve", "6.1", "--n", "3", "--out", str(tmp_path)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert all("being written by another rmesh" in line for line in lines)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["/abs/path", "../../esc"])
def test_a_problem_s_name_does_not_lead_out_of_the_folder(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    work = tmp_path / "a" / "b"
    work.mkdir(parents=True)
    monkeypatch.chdir(work)
    assert cli.run(["new", "my.toml"]) == 0
    text = Path("my.toml").read_text().replace('name = "my"', f'name = "{name}"').replace("nx = 16", "nx = 4")
    Path("my.toml").write_text(text)
    assert cli.run(["solve", "my.toml", "-f", "fixed"]) in (0, 1)
    assert sorted(path.name for path in work.iterdir()) == ["my.toml", "results"]
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert len(list(Path("results").iterdir())) == 1


@pytest.mark.slow
def test_figures_of_a_foreign_folder_stay_inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    inside = tmp_path / "in"
    (case,) = plan_comparison(["6.1"], ["fixed"], n=3)
    list(run([case], Results(inside)))
    (row,) = (result.record for result in read_results(inside))
    (inside / "records.jsonl").write_text(to_json({**row, "example": "../../../esc"}) + "\n")
    assert cli.run(["figures", str(inside)]) == 0
    assert {path.suffix for path in (inside / "figures").iterdir()} == {".png", ".pdf"}
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


def test_an_interrupted_solve_of_a_file_leaves_no_empty_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.run(["new", "my.toml"]) == 0

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("rmesh_nlp.cli.solving.perform", interrupt)
    assert cli.run(["solve", "my.toml", "--out", "out"]) == 130
    assert "nothing was written" in capsys.readouterr().err
    assert not Path("out").exists()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("locked").mkdir(mode=0o500)
    assert cli.run(["solve", "6.1", "--n", "3", "--out", "locked"]) == 2
    assert "locked" in capsys.readouterr().err
