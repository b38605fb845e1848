"""The command line: what it writes, what it refuses, and that Ctrl-C keeps what is done."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import meshio
import numpy as np
import pytest

from rmesh_nlp import __version__
from rmesh_nlp.cli import app as cli
from rmesh_nlp.cli import work
from rmesh_nlp.io.records import REQUIRED
from support.planted import plant, raising

HEAVY = {"casadi", "matplotlib", "pandas", "skfem", "scipy", "meshio", "numpy"}


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def run(*arguments: str) -> int:
    return cli.run(list(arguments))


def test_solve_writes_record_solution_and_history() -> None:
    arguments = "--formulation joint --n 4 --delta 0.05 --quadrature 6 --out one"
    assert run("solve", "6.1", *arguments.split()) == 0
    record = json.loads(Path("one/record.json").read_text())
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


def test_two_components_and_two_deltas() -> None:
    code = run("solve", "6.3", "-f", "fixed", "--n", "4x2", "--delta", "0.2,0.1", "--out", "one")
    assert code == 0
    assert json.loads(Path("one/record.json").read_text())["delta"] == [0.2, 0.1]
    assert meshio.read("one/solution.vtu").point_data["displacement"].shape == (15, 2)


def test_without_a_folder_the_solve_names_its_own() -> None:
    assert run("solve", "6.1", "-f", "fixed", "--n", "3") == 0
    assert Path("results/6.1-3-fixed/record.json").exists()


@pytest.mark.slow
def test_options_reach_the_formulation() -> None:
    arguments = ("--objective", "error-l2", "--relaxation", "lin-fukushima", "--seed", "3")
    run("solve", "6.1", "-f", "mpcc", "--n", "2", "--quadrature", "5", *arguments, "--out", "one")
    record = json.loads(Path("one/record.json").read_text())
    assert record["objective"] == "error-l2"
    assert record["relaxation"] == "lin-fukushima"
    assert record["seed"] == 3
    assert record["quadrature"] == 5


@pytest.mark.slow
def test_compare_writes_everything_and_table_and_figures_remake_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    arguments = "--formulations fixed,joint --n 3 --quadrature 6 --out all"
    assert run("compare", "6.1", *arguments.split()) == 0
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


def test_a_solve_that_raises_is_recorded_and_exit_code_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("solve", "6.1", "-f", "fixed", "--n", "3", "--out", "one") == 0
    plant(monkeypatch, fixed=raising(RuntimeError("singular")))
    capsys.readouterr()
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


BAD = {
    "unknown example": (["solve", "6.4"], "6.4"),
    "unknown formulation": (["solve", "6.1", "-f", "jiont"], "did you mean joint"),
    "unknown formulation in a list": (["compare", "--formulations", "fixed,nestde"], "nestde"),
    "empty name": (["compare", "--formulations", "fixed,,joint"], "fixed,,joint"),
    "size zero": (["solve", "6.1", "--n", "0"], "'0'"),
    "fractional size": (["solve", "6.1", "--n", "8.5"], "8.5"),
    "odd columns": (["solve", "6.2", "--n", "7x6"], "7"),
    "negative delta": (["solve", "6.1", "--delta", "-1"], "-1"),
    "delta nan": (["solve", "6.1", "--delta", "nan"], "nan"),
    "three deltas": (["solve", "6.1", "--delta", "1,2,3"], "1,2,3"),
    "negative seed": (["solve", "6.1", "--seed", "-1"], "-1"),
    "quadrature": (["solve", "6.1", "--quadrature", "0"], "'0'"),
    "objective": (["solve", "6.1", "--objective", "energie"], "energie"),
    "objective refused": (["solve", "6.1", "--objective", "error-l2"], "error-l2"),
    "relaxation": (["solve", "6.1", "-f", "mpcc", "--relaxation", "scholtse"], "did you mean scholtes"),
    "outer solver": (["solve", "6.1", "-f", "nested", "--outer", "newtn"], "did you mean newton"),
    "outer solver not taken": (["solve", "6.1", "-f", "joint", "--outer", "newton"], "--outer newton"),
    "option not taken": (
        ["solve", "6.1", "-f", "joint", "--relaxation", "scholtes"],
        "--relaxation scholtes",
    ),
    "unknown option": (["solve", "6.1", "--fast"], "--fast"),
    "unknown command": (["slove", "6.1"], "slove"),
    "missing argument": (["solve"], "EXAMPLE"),
    "missing folder": (["table", "nowhere"], "nowhere"),
    "empty folder": (["figures", "."], "records.jsonl"),
    "folder is a file": (["solve", "6.1", "--n", "3", "--out", "file"], "file"),
    "folder below a file": (["compare", "6.1", "--n", "3", "--out", "file/x"], "file/x"),
}


@pytest.mark.parametrize(("arguments", "named"), BAD.values(), ids=BAD.keys())
def test_bad_input_is_one_line_and_exit_code_2(
    arguments: list[str], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("file").write_text("not a folder")
    assert run(*arguments) == 2
    printed = capsys.readouterr()
    lines = [line for line in printed.err.splitlines() if line]
    assert len(lines) == 1
    assert lines[0].startswith("rmesh: error: ")
    assert named in lines[0]
    assert printed.out == ""
    assert sorted(path.name for path in Path().iterdir()) == ["file"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission(capsys: pytest.CaptureFixture[str]) -> None:
    Path("locked").mkdir(mode=0o500)
    assert run("solve", "6.1", "--n", "3", "--out", "locked") == 2
    assert "locked" in capsys.readouterr().err


def test_help_has_examples_and_version_is_the_package_s(capsys: pytest.CaptureFixture[str]) -> None:
    for command in ("solve", "compare", "table", "figures"):
        assert run(command, "--help") == 0
        assert f"  rmesh {command} " in capsys.readouterr().out
    assert run("--version") == 0
    assert capsys.readouterr().out == f"rmesh {__version__}\n"


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys; from rmesh_nlp.cli import app; app.run(['solve', '--help']); "
        f"print(sorted({HEAVY} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_an_interruption_is_said_when_there_is_nothing_to_keep(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(work, "commands", interrupted)
    assert run("table", "results") == 130
    assert capsys.readouterr().err == "rmesh: interrupted\n"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize("formulation", ["joint", "nested", "mpcc"])
def test_interrupt_keeps_finished_rows(formulation: str) -> None:
    """CasADi swallows Ctrl-C, and mpcc would go on with its next program."""
    arguments = ["compare", "6.1", "--formulations", f"fixed,{formulation}", "--n", "40", "--out", "cut"]
    with subprocess.Popen(
        [sys.executable, "-c", "from rmesh_nlp.cli.app import main; main()", *arguments],
        stderr=subprocess.PIPE,
        text=True,
        # a test run in the background of a script ignores SIGINT, and so would its children
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as process:
        assert process.stderr is not None
        assert "6.1 fixed: converged" in process.stderr.readline()  # the other solve begins now
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        sent = time.monotonic()
        assert process.wait(timeout=20) == 130
        assert time.monotonic() - sent < 10
        assert "1 of 2 solves are kept in cut" in process.stderr.read()
    first, *rest = map(json.loads, Path("cut/records.jsonl").read_text().splitlines())
    assert first["formulation"] == "fixed"
    # the other one has a row if it had a valid mesh to keep by then
    assert all(row["status"] == "interrupted" for row in rest)
    assert run("table", "cut") == 0
