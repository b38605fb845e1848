"""Folders that are written: nothing of the user's is touched, nothing is left where nothing came of it."""

import os
import re
from pathlib import Path

import pandas as pd
import pytest
from matplotlib.figure import Figure

from rmesh_nlp.cli import reporting
from rmesh_nlp.io.folder import Manifest, folder_lock
from rmesh_nlp.io.records import to_json
from rmesh_nlp.io.results import Results, read_results
from rmesh_nlp.study.comparison import plan_comparison, run
from support.planted import plant, raising
from support.problem_files import SCALAR
from support.reporting import joint_62


@pytest.mark.slow
def test_runs_beside_files_of_the_user_s_set_each_other_aside(rmesh) -> None:
    mine = {"solutions/mine.vtu": "s", "notes.md": "n", "previous/thesis.txt": "t", "previous-2": "a file"}
    for name, text in mine.items():
        Path(name).parent.mkdir(exist_ok=True)
        Path(name).write_text(text)
    command = "compare 6.1 --formulations fixed --n 3 --no-figures -q --out ."
    for _ in range(2):
        assert rmesh(command).code == 0
    assert {name: Path(name).read_text() for name in mine} == mine
    rows = [Path(name, "records.jsonl").read_text() for name in (".", "previous-3")]
    assert len(set(rows)) == 2  # their times differ
    assert len(list(Path("previous-3/solutions").glob("*.vtu"))) == 1
    assert rmesh("solve 6.1 -f fixed --n 3 --out .").code == 0
    assert Path("previous-4/records.jsonl").read_text() == rows[0]
    assert len(read_results(Path())) == 1
    Path("records.jsonl").write_text("my own records")
    Path(".rmesh-files").unlink()
    said = rmesh(command)
    assert said.code == 2
    assert "records.jsonl exists and rmesh did not write it" in said.err
    assert Path("records.jsonl").read_text() == "my own records"


def names_in(folder: str) -> set[str]:
    return {path.name for path in Path(folder).glob("[!.]*")}


@pytest.mark.slow
def test_a_solve_leaves_nothing_of_an_earlier_one(rmesh, monkeypatch) -> None:
    Path("my.toml").write_text(SCALAR)
    monkeypatch.setattr(reporting, "pictures", lambda *_: [("mesh", Figure(figsize=(1, 1)))])
    assert rmesh("solve my.toml -f fixed --out one").code == 0
    killed = Path("one/figures/.rmesh-writing-x")
    for command in ("table one", "figures one"):
        killed.mkdir()
        assert rmesh(command).code == 0
        assert not killed.exists()
    assert Path("one/figures/mesh.png").exists()
    Manifest(Path("one")).claim("report.html")
    for name in ("report.html", "mine.msh"):
        Path("one", name).write_text("m")
    said = rmesh("solve 6.1 -f fixed --n 3 --out one")
    assert said.out.splitlines()[-1] == "wrote one: record.json, solution.vtu, history.csv"
    assert names_in("one") == {"record.json", "solution.vtu", "history.csv", "mine.msh"}
    # the mesh and the problem of an earlier solve may be those of the next one
    assert rmesh("solve my.toml -f fixed --no-figures --out one").code == 0
    file = Path("one/problem.toml")
    text = file.read_text().replace('shape = "rectangle"\nnx = 4\nny = 4', 'file = "mesh.msh"')
    mesh = Path("one/mesh.msh").read_bytes()
    file.write_text(text)
    said = rmesh("solve one/problem.toml -f fixed --no-figures --out one")
    assert said.code == 0, said.err
    last = said.out.splitlines()[-1].removeprefix("wrote one: ").split(", ")
    assert {*last} == names_in("one") - {"mine.msh"}
    # the problem is kept as it was given, with the mesh file that it names
    assert file.read_text() == text
    assert Path("one/given-mesh.msh").read_bytes() == mesh
    plant(monkeypatch, fixed=raising(RuntimeError("singular")))
    assert rmesh("solve one/problem.toml -f fixed --out one").code == 1
    assert names_in("one") == {"record.json", "problem.toml", "given-mesh.msh", "mine.msh"}


@pytest.mark.parametrize("command", ["compare", "solve"])
def test_a_locked_folder_is_one_line_and_exit_code_2(rmesh, command: str) -> None:
    with folder_lock(Path()):
        said = rmesh(f"{command} 6.1 --n 3 --out .")
    assert said.code == 2
    (line,) = said.err.splitlines()
    assert "being written by another rmesh" in line
    assert list(Path().iterdir()) == []


@pytest.mark.parametrize(
    ("command", "name", "said"),
    [
        ("compare 6.1 --n 3", "figures", "figures is a file, where a folder is to be written"),
        ("solve my.toml", "figures", "figures is a file, where a folder is to be written"),
        ("solve my.toml", "problem.toml", "problem.toml exists and rmesh did not write it"),
    ],
)
def test_what_is_in_the_way_is_seen_before_a_solve(rmesh, command: str, name: str, said: str) -> None:
    Path("my.toml").write_text(SCALAR)
    Path("out").mkdir()
    Path("out", name).write_text("mine")
    answer = rmesh(f"{command} --out out")
    assert (answer.code, answer.err.count("\n")) == (2, 1)
    assert said in answer.err
    assert [path.name for path in Path("out").iterdir()] == [name]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["/abs/path", "../../esc"])
def test_a_problem_s_name_does_not_lead_out_of_the_folder(rmesh, name, tmp_path, monkeypatch) -> None:
    work = tmp_path / "a" / "b"
    work.mkdir(parents=True)
    monkeypatch.chdir(work)
    Path("my.toml").write_text(f'name = "{name}"\n{SCALAR}')
    assert rmesh("solve my.toml -f fixed").code == 0
    assert sorted(path.name for path in work.iterdir()) == ["my.toml", "results"]
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert len(list(Path("results").iterdir())) == 1


@pytest.mark.slow
def test_figures_of_a_foreign_folder_stay_inside(rmesh) -> None:
    inside = Path("in")
    list(run(plan_comparison(["6.1"], ["fixed"], n=3), Results(inside)))
    (row,) = (result.record for result in read_results(inside))
    (inside / "records.jsonl").write_text(to_json({**row, "example": "../../../esc"}) + "\n")
    assert rmesh("figures in").code == 0
    assert {path.suffix for path in (inside / "figures").iterdir()} == {".png"}
    assert [path.name for path in Path().iterdir()] == ["in"]


def test_an_interrupted_solve_of_a_file_leaves_no_empty_folder(rmesh, monkeypatch) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    Path("my.toml").write_text(SCALAR)
    monkeypatch.setattr("rmesh_nlp.cli.solving.perform", interrupt)
    said = rmesh("solve my.toml --out out")
    assert said.code == 130
    assert "nothing was written" in said.err
    assert not Path("out").exists()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission(rmesh) -> None:
    Path("locked").mkdir(mode=0o500)
    said = rmesh("solve 6.1 --n 3 --out locked")
    assert said.code == 2
    assert "locked" in said.err


@pytest.mark.slow
@pytest.mark.parametrize("study", [{}, {"variant": "joint", "family": "slabs"}])
def test_the_unit_of_cost_is_that_of_the_problem_in_all_outputs(rmesh, study):
    """Solves of 0.08 s from two starts beside contact solves of 2 and 6 ms: 20 of the median."""
    times = {1: 0.002, 2: 0.006}
    rows = [joint_62(key=f"{s}", seed=s, contact_time_s=time, **study) for s, time in times.items()]
    Path("records.jsonl").write_text("".join(to_json(row) + "\n" for row in rows))
    assert rmesh("table .").code == rmesh("report .").code == 0
    table = pd.read_csv("table.csv")
    assert [*table["time_contact_solves"], *table["contact_time_s"]] == pytest.approx([20, 20, 0.004, 0.004])
    for name in ("table.md", "report.html"):
        text = Path(name).read_text()
        cells = re.findall(r"[|>]\s*(13.3|20|40)\s*[|<]", text[text.index("cost [contact solves]") :])
        assert {*cells} == {"20"}, name
