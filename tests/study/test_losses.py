"""Nothing that was finished is lost, and nothing of the user's is touched."""

from __future__ import annotations

import shutil
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rmesh_nlp.cli import app as cli
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.export import write_solution
from rmesh_nlp.io.files import folder_lock
from rmesh_nlp.io.records import DamagedRecordsWarning, to_json
from rmesh_nlp.io.results import Results, read_results
from rmesh_nlp.meshes.reading import read_file
from rmesh_nlp.study.cases import Case
from rmesh_nlp.study.comparison import plan_comparison, run, solve


@pytest.fixture
def cases() -> list[Case]:
    return plan_comparison(["6.2"], ["fixed", "joint"], n=(4, 2))  # no source: the rule cannot be exploited


def started(cases: list[Case], folder: Path) -> list[str]:
    """Formulations that are solved when the run is resumed."""
    names: list[str] = []
    list(run(cases, Results(folder), resume=True, on_start=lambda case: names.append(case.formulation)))
    return names


def test_a_second_run_in_the_same_folder_is_refused_and_loses_nothing(
    cases: list[Case], tmp_path: Path
) -> None:
    first = run(cases, Results(tmp_path))
    next(first)
    with pytest.raises(BadInputError, match="written by another"):
        next(run(cases, Results(tmp_path)))
    next(run(cases, Results(tmp_path), resume=True, locked=True))  # the caller has the lock
    assert len([*first]) == 1
    assert len(read_results(tmp_path)) == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    "spoil", ["missing", "empty", "half", "other mesh", "history", "no history", "nodes", "nan"]
)
def test_a_success_without_its_files_is_solved_again(cases: list[Case], tmp_path: Path, spoil: str) -> None:
    list(run(cases, Results(tmp_path)))
    good, _ = read_results(tmp_path)
    vtu = good.vtu.read_bytes()
    if spoil == "missing":
        good.vtu.unlink()
    elif spoil == "other mesh":
        (other,) = plan_comparison(["6.2"], ["fixed"], n=(6, 4))
        list(run([other], Results(tmp_path / "other")))
        shutil.copy(read_results(tmp_path / "other")[0].vtu, good.vtu)
    elif spoil == "history":
        good.history.write_text("garbage")
    elif spoil == "no history":
        good.history.unlink()
    elif spoil == "nodes":
        results = Results(tmp_path)
        results.replace_all(
            [row | {"nodes": row["nodes"] + 1} if row == good.record else row for row in results.read()]
        )
    elif spoil == "nan":
        solution = solve(cases[0]).solution
        assert solution is not None
        write_solution(replace(solution, displacement=np.nan * solution.displacement), good.vtu, "vtu")
    else:
        good.vtu.write_bytes(vtu[: len(vtu) // 2 if spoil == "half" else 0])
    assert started(cases, tmp_path) == ["fixed"]
    assert started(cases, tmp_path) == []
    assert sorted(result.record["formulation"] for result in read_results(tmp_path)) == ["fixed", "joint"]


def test_resume_repairs_duplicates_and_a_cut_line(cases: list[Case], tmp_path: Path) -> None:
    list(run(cases, Results(tmp_path)))
    path = tmp_path / "records.jsonl"
    whole = path.read_text()
    path.write_text(whole + whole + whole[:50])
    with pytest.warns(DamagedRecordsWarning):
        assert started(cases, tmp_path) == []
    assert sorted(path.read_text().splitlines()) == sorted(whole.splitlines())
    assert (tmp_path / "records-damaged.txt").read_text() == whole[:50] + "\n"


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


def test_what_is_in_the_way_is_found_before_anything_is_solved(cases: list[Case], tmp_path: Path) -> None:
    (tmp_path / "solutions").write_text("a file")
    with pytest.raises(BadInputError, match="solutions is a file"):
        list(run(cases, Results(tmp_path), on_start=lambda _: pytest.fail("it began to solve")))


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


def test_new_leaves_nothing_where_it_cannot_write(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["new", str(tmp_path / "nowhere" / "my.toml")]) == 2
    assert "nowhere" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_solve_of_a_file_leaves_no_empty_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.run(["new", "my.toml"]) == 0

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("rmesh_nlp.study.comparison.solve", interrupt)
    assert cli.run(["solve", "my.toml", "--out", "out"]) == 130
    assert "nothing was written" in capsys.readouterr().err
    assert not Path("out").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "content"),
    [("a.ply", "ply\nformat ascii 1.0\nelement vertex 3\n"), ("a.off", "OFF\n"), ("a.msh", "garbage")],
)
def test_a_reader_that_never_ends_is_stopped(
    tmp_path: Path, name: str, content: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rmesh_nlp.meshes.reading.SECONDS", 0.3)
    (tmp_path / name).write_text(content)
    with pytest.raises(ValueError, match="cannot be read as a mesh"):
        read_file(tmp_path / name)


@pytest.mark.slow
def test_a_reader_that_waits_for_the_processor_is_not_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rmesh_nlp.meshes.reading.SECONDS", 0.1)
    monkeypatch.setattr("meshio.read", lambda *_: time.sleep(0.3) or "a mesh")
    (tmp_path / "a.vtk").write_text("x")
    assert read_file(tmp_path / "a.vtk") == "a mesh"


def test_only_formats_of_the_extension_and_files_of_moderate_size_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.xyz").write_text("$MeshFormat")
    with pytest.raises(ValueError, match=r"the extension '\.xyz' is none of"):
        read_file(tmp_path / "a.xyz")
    monkeypatch.setattr("rmesh_nlp.meshes.reading.LARGEST_FILE", 5)
    (tmp_path / "a.vtk").write_text("too long")
    with pytest.raises(ValueError, match="has 8 bytes"):
        read_file(tmp_path / "a.vtk")
