"""Problem files on the command line: checked, solved, drawn, compared with refinements of their meshes."""

import json
import os
import shutil
import signal
from pathlib import Path
from typing import Any

import meshio
import pytest
from matplotlib import image

from rmesh_nlp.cli import app as cli
from rmesh_nlp.solving import assess as assessing
from rmesh_nlp.solving import driver
from rmesh_nlp.solving.assess import Assessment

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
gap = "edge"
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_figures_are_drawn_again_without_the_problem_file(
    block: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.run(["solve", str(block), "--out", "one"]) == 0
    drawn = sorted(path.name for path in Path("one/figures").iterdir())
    first = {name: image.imread(f"one/figures/{name}.png") for name in ("limits", "mesh")}
    shutil.rmtree("one/figures")
    block.unlink()
    assert cli.run(["figures", "one"]) == 0
    assert sorted(path.name for path in Path("one/figures").iterdir()) == drawn
    for name, picture in first.items():
        assert (image.imread(f"one/figures/{name}.png") == picture).all()
    assert cli.run(["figures", "one", "--columns", "1"]) == 0
    assert image.imread("one/figures/mesh.png").shape[1] < first["mesh"].shape[1]


@pytest.mark.slow
def test_ctrl_c_while_figures_are_drawn_keeps_the_solution(
    block: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("rmesh_nlp.cli.reporting.write_pictures", interrupt)
        assert cli.run(["solve", str(block), "--out", "one"]) == 130
    assert "all but the figures is kept in one; rmesh figures one draws them" in capsys.readouterr().err
    assert json.loads(Path("one/record.json").read_text())["success"]
    assert cli.run(["figures", "one"]) == 0
    assert Path("one/figures/mesh.png").exists()


@pytest.mark.slow
def test_ctrl_c_during_the_audit_keeps_the_solution(
    block: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # it may be ignored in the background

    def assess(*args: Any, **options: Any) -> Assessment:
        os.kill(os.getpid(), signal.SIGINT)
        return assessing.assess(*args, **options)

    monkeypatch.setattr(driver, "assess", assess)
    try:
        assert cli.run(["solve", str(block), "--out", "one"]) == 130
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert "the best mesh so far is kept in one" in capsys.readouterr().err
    row = json.loads(Path("one/record.json").read_text())
    assert row["status"] == "interrupted"
    assert row["gain_audited"] > 0


def test_check_says_what_to_do_about_missing_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "my.toml"
    points, triangles = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], [[0, 1, 2], [0, 2, 3]]
    meshio.Mesh(points, [("triangle", triangles)]).write(tmp_path / "body.vtk")
    path.write_text(
        '[mesh]\nfile = "body.vtk"\n[material]\nlaw = "plane-strain"\nyoung = 1.0\npoisson = 0.3\n'
        "[dirichlet]\nleft = [0, 0]\n"
    )
    assert cli.run(["check", str(path)]) == 2
    assert "the mesh file names none: name its curves in gmsh" in capsys.readouterr().err


@pytest.mark.slow
def test_without_move_limits_a_file_asks_for_weights_and_flips(block: Path) -> None:
    text = BLOCK + "[motion]\ndelta = 'none'\n[solve]\nformulation = 'joint'\n"
    block.write_text(f"{text}regularisation = [0.1, 0.02]\nflips = true\n")
    assert cli.run(["solve", str(block), "--out", "one", "--no-figures", "-q"]) == 0
    record = json.loads(Path("one/record.json").read_text())
    assert (record["regularisation"], record["delta"]) == ([0.1, 0.02], None)
    assert "flip_rounds" in record
    assert record["gain_audited"] > 0


def test_a_schedule_of_weights_in_a_file_is_checked(block: Path, capsys: pytest.CaptureFixture[str]) -> None:
    block.write_text(f"{BLOCK}[solve]\nregularisation = [1, 0, 0.1]\n")
    assert cli.run(["solve", str(block)]) == 2
    assert "solve.regularisation = [1, 0, 0.1]: expected" in capsys.readouterr().err
