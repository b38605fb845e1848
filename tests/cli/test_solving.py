"""``rmesh solve`` and ``rmesh compare`` on examples: what is written, printed and returned."""

import errno
import json
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pandas as pd
import pytest

from rmesh_nlp.cli.solving import does_not_apply
from rmesh_nlp.io.records import REQUIRED, to_json
from rmesh_nlp.study.runner import Done
from support.planted import plant, raising
from support.reporting import fixed_61


def record(folder: str = "one") -> dict[str, Any]:
    return dict(json.loads(Path(folder, "record.json").read_text()))


@pytest.mark.slow
def test_solve_writes_record_solution_and_history(rmesh) -> None:
    typed = "solve 6.1 --formulation joint --n 2 --delta 0.05 --quadrature 6 --order 2"
    said = rmesh(f"{typed} --out one --json")
    assert said.code == 0
    row = record()
    assert json.loads(said.out) == row
    assert set(REQUIRED) <= set(row)
    assert (row["example"], row["formulation"], row["n"], row["order"]) == ("6.1", "joint", "2", 2)
    assert row["unknowns"] == 2 + 2 + 4 + 4  # at vertices and at horizontal, vertical and diagonal edges
    assert row["delta"] == [0.05, 0.05]
    assert row["energy"] < row["energy_initial"]
    assert row["gain"] == pytest.approx(row["energy_initial"] - row["energy"])
    mesh = meshio.read("one/solution.vtu")
    assert {block.type for block in mesh.cells} == {"triangle6"}
    assert {"displacement", "initial_position", "pressure"} <= set(mesh.point_data)
    assert mesh.point_data["displacement"].max() == pytest.approx(row["u_max"])
    moved = np.abs(mesh.points - mesh.point_data["initial_position"])
    assert 0.01 < moved.max() <= 0.05 * (1 + 1e-12)
    energies = np.loadtxt("one/history.csv", delimiter=",", skiprows=1, usecols=1)
    assert energies[-1] == pytest.approx(row["energy"], abs=1e-6)


def test_without_a_folder_the_solve_names_its_own(rmesh) -> None:
    said = rmesh("solve 6.3 -f fixed --n 4x2 --delta 0.2,0.1")
    folder = Path("results/6.3-4x2-fixed")
    assert record(str(folder))["delta"] == [0.2, 0.1]
    assert meshio.read(folder / "solution.vtu").point_data["displacement"].shape == (15, 2)
    assert said.code == 0
    *contact, last = said.out.splitlines()
    assert last == f"wrote {folder}: record.json, solution.vtu, history.csv"
    assert contact[0].startswith("contact: normal force ")
    assert said.err.startswith("6.3 fixed: converged, audited J = ")


@pytest.mark.slow
def test_a_second_solve_with_a_safe_discretisation_is_told(rmesh) -> None:
    said = rmesh("solve 6.1 --n 3 --delta 0.2 -f joint --out .")
    safe = json.loads(Path("record.json").read_text())["safe"]
    assert f"note: {safe}" in said.out.splitlines()


def test_a_solve_that_raises_is_recorded_and_exit_code_1(rmesh, monkeypatch: pytest.MonkeyPatch) -> None:
    said = rmesh("solve 6.3 -f fixed --n 4x2 --out one")
    assert said.code == 0
    (warning,) = record()["warnings"]
    assert f"warning: {warning}" in said.out.splitlines()
    plant(monkeypatch, fixed=raising(RuntimeError("singular")))
    said = rmesh("solve 6.1 -f fixed --n 3 --out one")
    assert said.code == 1
    assert (record()["status"], record()["message"]) == ("failed", "RuntimeError: singular")
    assert "RuntimeError: singular" in said.err
    assert [path.name for path in Path("one").glob("[!.]*")] == ["record.json"]  # no stale solution


def test_a_solve_is_recorded_though_the_disk_is_full(rmesh, monkeypatch: pytest.MonkeyPatch) -> None:
    def save(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", "solution.vtu")

    monkeypatch.setattr(Done, "save", save)
    said = rmesh("solve 6.3 -f fixed --n 4x2 --out one")
    assert said.err.endswith("rmesh: error: solution.vtu: No space left on device\n")
    assert said.code == 2
    assert record()["status"] == "converged"
    assert Path("one/record.json").read_text().startswith('{\n  "')  # for people


@pytest.mark.slow
def test_a_limit_of_iterations_is_exit_code_0_if_the_mesh_is_better(rmesh) -> None:
    assert rmesh("solve 6.1 -f joint --n 2 --quadrature 6 --max-iterations 2 --out one").code == 0
    assert (record()["status"], record()["success"]) == ("iteration_limit", True)
    assert Path("one/solution.vtu").exists()


@pytest.mark.slow
def test_compare_writes_everything_and_table_and_figures_remake_it(rmesh) -> None:
    said, out = rmesh("compare 6.1 --formulations fixed,joint --n 3 --quadrature 6 --out all"), Path("all")
    assert said.code == 0
    assert [line.split(":")[0] for line in said.err.splitlines()[:2]] == ["6.1 fixed", "6.1 joint"]
    assert len((out / "records.jsonl").read_text().splitlines()) == 2
    made = [out / name for name in ("table.md", "table.tex", "table.csv")]
    made += sorted((out / "figures").iterdir())
    assert {path.suffix for path in (out / "figures").iterdir()} == {".png"}
    for path in made:
        path.unlink()
    assert rmesh("table all")[:2] == (0, said.out)
    assert rmesh("figures all").code == 0
    assert all(path.stat().st_size > 0 for path in made)
    assert rmesh("table all --verbose").out == (out / "table.md").read_text()
    assert rmesh("figures all --format pdf").code == 0
    assert {path.suffix for path in (out / "figures").iterdir()} == {".png", ".pdf"}
    said = rmesh("figures all --format jpeg")
    assert (said.code, "unknown format 'jpeg'" in said.err) == (2, True)


def test_rows_of_several_orders_and_rules_are_exported(rmesh) -> None:
    pytest.importorskip("pyarrow")
    given = fixed_61(key="a", order=1), fixed_61(key="b", order=2, quadrature=8)
    Path("records.jsonl").write_text("".join(to_json(row) + "\n" for row in given))
    assert rmesh("export . --parquet rows.parquet").code == 0
    rows = pd.read_parquet("rows.parquet")
    assert rows["order"].tolist() == [1, 2]
    assert rows["quadrature"].tolist() == ["midpoint", "8"]


def test_refusing_the_only_objective_is_no_success(rmesh) -> None:
    assert not does_not_apply({"status": "refused", "objective": "energy"})
    assert not does_not_apply({"status": "converged", "objective": "error-l2"})
    assert does_not_apply({"status": "refused", "objective": "error-l2"})
    assert rmesh("compare 6.1 --n 4 --formulations joint -q --no-figures --objective error-l2").code == 1
    assert rmesh("figures results")[::2] == (0, "no figures of results: no solve has a solution\n")


def test_the_solution_alone_is_a_row_without_success(rmesh) -> None:
    assert rmesh("solve 6.1 --n 4 -f fixed --no-audit --out one").code == 1
    assert json.loads(Path("one/record.json").read_text())["status"] == "unaudited"
