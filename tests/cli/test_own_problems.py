"""Problem files on the command line: compared with refinements of their meshes, warned of."""

import json
from pathlib import Path

import pytest

from rmesh_nlp.cli import app as cli

BLOCK = """
[mesh]
shape = "rectangle"
nx = 6
ny = 3
x = [0, 2]
[material]
law = "plane-strain"
young = 1000
poisson = 0.3
[dirichlet]
left = "symmetry"
[tractions]
top = [0, -10]
[[contact]]
boundary = "bottom"
circle = { centre = [0, -5.001], radius = 5 }
[[contact]]
boundary = "right"
line = { point = [2.005, 0], normal = [-1, 0] }
"""


@pytest.fixture
def block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "block.toml"
    path.write_text(BLOCK)
    return path


@pytest.mark.slow
def test_own_problems_are_compared_with_refinements(block: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["compare", str(block), "--formulations", "fixed,joint", "--out", "c"]) in (0, 1)
    rows = [json.loads(line) for line in Path("c/records.jsonl").read_text().splitlines()]
    assert [row["formulation"] for row in rows] == ["fixed", "joint", "fixed", "fixed"]
    nodes = [row["nodes"] for row in rows]
    assert nodes == [28, 28, 91, 325]
    energies = [row["energy"] for row in rows]
    assert energies[0] > energies[2] > energies[3]
    table = capsys.readouterr().out
    assert "## Relocation against uniform refinement: block" in table
    assert "block: one uniform refinement (91 nodes) gains" in table


def test_settings_of_examples_do_not_go_to_files(block: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["compare", str(block), "--n", "4", "--out", "c"]) == 2
    assert "write them into the files" in capsys.readouterr().err
    assert cli.run(["compare", str(block), str(block), "other.toml"]) == 2


def test_check_says_what_it_doubts(block: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["check", str(block)]) == 0
    block.write_text(BLOCK.replace("[0, -10]", "[0, 10]").replace('left = "symmetry"', "left = [0, 0]"))
    capsys.readouterr()
    assert cli.run(["check", str(block)]) == 0
    said = capsys.readouterr().out
    assert "doubt" in said
    assert "is its sign right?" in said
    assert block.with_suffix(".png").stat().st_size > 10_000


def test_a_body_that_the_load_pulls_off_is_bad_input(block: Path, capsys: pytest.CaptureFixture[str]) -> None:
    block.write_text(BLOCK.replace("[0, -10]", "[0, 10]"))
    assert cli.run(["check", str(block)]) == 2
    assert "the load does not press it on them" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("solve", "message"),
    [
        ('formulation = "<svg>"', "solve.formulation: unknown formulation '<svg>'"),
        ('objective = "energie"', "solve.objective: unknown objective 'energie'"),
        ('formulation = "fixed"\nflips = true', "the formulation 'fixed' takes no flips"),
    ],
)
def test_check_refuses_what_solve_would_refuse(
    solve: str, message: str, block: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    block.write_text(f"{BLOCK}[solve]\n{solve}\n")
    for command in (["check", str(block)], ["solve", str(block)]):
        assert cli.run(command) == 2
        assert message in " ".join(capsys.readouterr().err.split())
