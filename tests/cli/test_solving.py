"""``rmesh solve`` and ``rmesh compare`` on examples: what is written, printed and returned."""

from __future__ import annotations

import json
from pathlib import Path

import meshio
import numpy as np
import pytest

from rmesh_nlp.cli import app as cli
from rmesh_nlp.cli.solving import does_not_apply
from rmesh_nlp.io.records import REQUIRED
from rmesh_nlp.io.results import read_results
from support.planted import plant, raising

QUICKLY = ("--quiet", "--no-figures")


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def run(*arguments: str) -> int:
    return cli.run(list(arguments))


def test_solve_writes_record_solution_and_history(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = "--formulation joint --n 4 --delta 0.05 --quadrature 6 --out one --json"
    assert run("solve", "6.1", *arguments.split()) == 0
    record = json.loads(Path("one/record.json").read_text())
    assert json.loads(capsys.readouterr().out) == record
    assert set(REQUIRED) <= set(record)
    assert (record["example"], record["formulation"], record["n"]) == ("6.1", "joint", "4")
    assert record["delta"] == [0.05, 0.05]
    assert record["energy"] < record["energy_initial"]
    assert record["gain"] == pytest.approx(record["energy_initial"] - record["energy"])
    mesh = meshio.read("one/solution.vtu")
    assert {block.type for block in mesh.cells} == {"triangle"}
    assert {"displacement", "initial_position", "pressure"} <= set(mesh.point_data)
    assert mesh.point_data["displacement"].max() == pytest.approx(record["u_max"])
    moved = np.abs(mesh.points - mesh.point_data["initial_position"])
    assert 0.01 < moved.max() <= 0.05 * (1 + 1e-12)
    energies = np.loadtxt("one/history.csv", delimiter=",", skiprows=1, usecols=1)
    assert energies[-1] == pytest.approx(record["energy"], abs=1e-6)


def test_without_a_folder_the_solve_names_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("solve", "6.3", "-f", "fixed", "--n", "4x2", "--delta", "0.2,0.1") == 0
    folder = Path("results/6.3-4x2-fixed")
    assert json.loads((folder / "record.json").read_text())["delta"] == [0.2, 0.1]
    assert meshio.read(folder / "solution.vtu").point_data["displacement"].shape == (15, 2)
    names = ", ".join(str(folder / name) for name in ("record.json", "solution.vtu", "history.csv"))
    printed = capsys.readouterr()
    assert printed.out == f"wrote {names}\n"
    assert printed.err.startswith("6.3 fixed: converged, audited J = ")


def test_a_solve_that_raises_is_recorded_and_exit_code_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("solve", "6.1", "-f", "fixed", "--n", "3", "--out", "one") == 0
    plant(monkeypatch, fixed=raising(RuntimeError("singular")))
    assert run("solve", "6.1", "-f", "fixed", "--n", "3", "--out", "one") == 1
    record = json.loads(Path("one/record.json").read_text())
    assert (record["status"], record["message"]) == ("failed", "RuntimeError: singular")
    assert "RuntimeError: singular" in capsys.readouterr().err
    assert [path.name for path in Path("one").glob("[!.]*")] == ["record.json"]  # no stale solution


def test_a_limit_of_iterations_is_exit_code_0_if_the_mesh_is_better() -> None:
    limited = ("--max-iterations", "2", "--out", "one")
    assert run("solve", "6.1", "-f", "joint", "--n", "3", "--quadrature", "6", *limited) == 0
    record = json.loads(Path("one/record.json").read_text())
    assert (record["status"], record["success"]) == ("iteration_limit", True)
    assert Path("one/solution.vtu").exists()


@pytest.mark.slow
def test_compare_writes_everything_and_table_and_figures_remake_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    arguments = "compare 6.1 --formulations fixed,joint --n 3 --quadrature 6 --out all"
    assert run(*arguments.split()) == 0
    out = Path("all")
    printed = capsys.readouterr()
    assert (out / "table.md").read_text().startswith(f"{printed.out}\n## Details\n")
    assert [line.split(":")[0] for line in printed.err.splitlines()[:2]] == ["6.1 fixed", "6.1 joint"]
    assert len((out / "records.jsonl").read_text().splitlines()) == 2
    made = [out / name for name in ("table.md", "table.tex", "table.csv")]
    made += sorted((out / "figures").iterdir())
    assert {path.suffix for path in (out / "figures").iterdir()} == {".png", ".pdf"}
    for path in made:
        path.unlink()
    assert run("table", "all") == 0
    assert run("figures", "all") == 0
    assert all(path.stat().st_size > 0 for path in made)
    assert capsys.readouterr().out == printed.out
    assert run("table", "all", "--verbose") == 0
    assert capsys.readouterr().out == (out / "table.md").read_text()


@pytest.mark.slow
def test_commands_of_results_take_a_single_solve_and_what_a_killed_one_left() -> None:
    assert run("solve", "6.1", "-f", "fixed", "--n", "3", "--out", "one") == 0
    left = Path("one/figures/.rmesh-writing-x/half.png")
    for command, made in (
        ("table", "table.md"),
        ("figures", "figures/6.1-3-grid.png"),
        ("report", "report.html"),
    ):
        left.parent.mkdir(parents=True)
        left.write_text("x")
        assert run(command, "one") == 0
        assert Path("one", made).exists()
        assert not left.parent.exists()


@pytest.mark.slow
def test_an_objective_that_joint_refuses_is_a_dash_and_no_failure() -> None:
    typed = "compare 6.1 --n 4 --quadrature 6 --formulations joint,nested --out both"
    arguments = [*typed.split(), *QUICKLY]
    assert run(*arguments, "--objective", "energy", "--objective", "error-l2") == 0
    rows = [result.record for result in read_results(Path("both"))]
    assert [does_not_apply(row) for row in rows] == [False, False, True, False]
    assert (rows[2]["status"], rows[2]["success"], rows[2]["energy"]) == ("refused", False, None)
    assert "error-l2" in rows[2]["message"]
    table = Path("both/table.md").read_text()
    assert rows[2]["message"] in table
    assert "| nested, error-l2 |" in table
    assert all(row["I1"] + row["I2"] > 0 for row in rows if row["success"])


def test_refusing_the_only_objective_is_no_success() -> None:
    arguments = ["compare", "6.1", "--n", "4", "--formulations", "joint", *QUICKLY, "--out", "one"]
    assert run(*arguments, "--objective", "error-l2") == 1


@pytest.mark.slow
def test_seeds_and_objectives_join_what_is_there() -> None:
    typed = "compare 6.1 --n 3 --quadrature 6 --out all"
    arguments = [*typed.split(), *QUICKLY, "--formulations"]
    assert run(*arguments, "joint", "--seed", "1", "--seed", "2,3") == 0
    assert "## Several starts" in Path("all/table.md").read_text()
    assert run(*arguments, "nested", "--objective", "error-l2", "--resume") == 0
    rows = [result.record for result in read_results(Path("all"))]
    assert [row["seed"] for row in rows] == [1, 2, 3, None]
    assert [row["objective"] for row in rows] == ["energy"] * 3 + ["error-l2"]
    assert not Path("all/previous").exists()
    assert not Path("all/figures").exists()  # as asked
