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


def test_the_pages_take_their_tables_between_their_marks() -> None:
    module = script("update_readme")
    begin, end = "<!-- table: begin -->\n", "<!-- table: end -->\n"
    old = f"before\n{begin}stale\n{end}after\n"
    new = module.with_table(old, "# Comparison\n\n## Example 6.1\n\n| a |\n")
    assert new == f"before\n{begin}\n## Example 6.1\n\n| a |\n\n{end}after\n"
    assert module.with_table(new, "# Comparison\n\n## Example 6.1\n\n| a |\n") == new


@pytest.mark.slow
def test_the_table_of_relaxations_keeps_every_combination(tmp_path: Path) -> None:
    out = tmp_path / "relaxations"
    arguments = ["--examples", "6.1", "6.3", "--n", "4", "--objectives", "energy", "contact"]
    arguments += ["--degree", "6", "--relaxations", "scholtes", "l1-penalty", "--out", str(out)]
    assert script("table_relaxations").main(arguments) == 0
    header, _, *rows = (out / "relaxations.md").read_text().splitlines()
    assert header.startswith("| example | objective | relaxation | status |")
    # 6.3 has no exact solution for the contact objective, and no reference was asked for
    assert len(rows) == 2 * 2 + 2
    assert all("| converged |" in row for row in rows)


@pytest.mark.slow
def test_the_scaling_benchmark_reports_every_strategy(tmp_path: Path) -> None:
    benchmark = script("benchmark_scaling")
    asked = ["--sizes", "8", "--examples", "6.1", "--out", str(tmp_path)]
    assert benchmark.main(asked) == 0
    table = (tmp_path / "scaling.md").read_text()
    rows = [row for row in table.splitlines() if row.startswith("| 8 |")]
    assert [row.split("|")[2].strip() for row in rows] == list(benchmark.STRATEGIES)
    assert (tmp_path / "scaling.png").stat().st_size > 0
    # what is there is not run again
    before = (tmp_path / "scaling.json").stat().st_mtime_ns
    assert benchmark.main(asked) == 0
    assert (tmp_path / "scaling.json").stat().st_mtime_ns == before


@pytest.mark.slow
def test_a_strategy_that_fails_or_hangs_is_a_row_of_the_scaling_benchmark() -> None:
    benchmark = script("benchmark_scaling")
    unknown = benchmark.isolated(benchmark.Case("6.1", 4, "no such strategy"), limit=60)
    assert unknown.status.startswith("KeyError")
    slow = benchmark.isolated(benchmark.Case("6.1", 64, "joint"), limit=0.1)
    assert slow.status == "stopped after 0 s"
    assert "| - |" in benchmark.markdown([unknown, slow])


@pytest.mark.slow
def test_the_assembly_benchmark_compares_the_same_program(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["benchmark_assembly.py", "--n", "4"])
    script("benchmark_assembly").main()
    row = capsys.readouterr().out.splitlines()[1].split()
    assert row[5] == row[9]  # one energy, once with assembled and once with automatic derivatives


def test_the_contact_benchmark_counts_the_active_sets(capsys: pytest.CaptureFixture[str]) -> None:
    script("benchmark_contact").main(["--n", "8"])
    rows = [line.split() for line in capsys.readouterr().out.splitlines()[2:]]
    assert [row[:2] for row in rows] == [["6.1", "8"], ["6.3", "8"]]
    for row in rows:
        sets, whole, assembling, plain = int(row[3]), *map(float, row[4:7])
        assert 1 <= sets <= 8
        assert whole > assembling
        assert float(row[8]) == pytest.approx(whole / (sets * plain), rel=0.1)  # of rounded figures
