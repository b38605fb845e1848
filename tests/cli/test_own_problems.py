"""Problem files on the command line: checked, solved, drawn, compared with refinements of their meshes."""

import json
import re
import shutil
import signal
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from matplotlib import image

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.io.export import write_mesh
from rmesh_nlp.io.problem_file import load_problem
from rmesh_nlp.meshes.reading import read_mesh
from rmesh_nlp.solving import assess as assessing
from rmesh_nlp.solving import driver
from rmesh_nlp.solving.assessment import Assessment
from support.designs import FILE

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
height = "-0.002*x"
gap = "edge"
[[contact]]
boundary = "right"
line = { point = [2.005, 0], normal = [-1, 0] }
"""


CONDITIONS = BLOCK[BLOCK.index("[material]") :]


@pytest.fixture
def block(rmesh) -> Path:
    path = Path("block.toml").absolute()
    path.write_text(BLOCK)
    return path


def record() -> dict[str, Any]:
    return dict(json.loads(Path("one/record.json").read_text()))


def rows() -> list[dict[str, Any]]:
    return [json.loads(line) for line in Path("c/records.jsonl").read_text().splitlines()]


@pytest.mark.slow
def test_check_says_what_it_doubts(rmesh, block: Path) -> None:
    assert "is its sign right?" not in rmesh("check block.toml").out
    block.write_text(BLOCK.replace("[0, -10]", "[0, 10]").replace('left = "symmetry"', "left = [0, 0]"))
    said = rmesh("check block.toml --picture roles.pdf")
    assert said.code == 0
    assert "doubt" in said.out
    assert "is its sign right?" in said.out
    assert Path("roles.pdf").stat().st_size > 10_000
    assert block.with_suffix(".png").stat().st_size > 10_000  # of the first check


@pytest.mark.slow
def test_template_of_two_bodies_is_in_order_and_solves(rmesh) -> None:
    assert rmesh("new two.toml --two-bodies").code == 0
    said = " ".join(rmesh("check two.toml").out.split())
    assert "is in order" in said
    assert "17 pairs of nodes, 0 apart, on joint" in said
    assert "not drawn" not in said
    assert rmesh("solve two.toml --no-figures --out one").code == 0
    assert record()["contact"]["joint"]["normal_force"] == pytest.approx(100, rel=1e-6)


@pytest.mark.slow
def test_a_body_that_the_load_pulls_off_is_bad_input(rmesh, block: Path) -> None:
    block.write_text(BLOCK.replace("[0, -10]", "[0, 10]"))
    said = rmesh("check block.toml")
    assert said.code == 2
    assert "the load does not press it on them" in said.err
    rows = rmesh("compare block.toml --formulations fixed --out c")
    assert (rows.code, rows.out.count("| refused |")) == (1, 3)  # and no picture of anything


@pytest.mark.parametrize("command", ["check", "solve"])
@pytest.mark.parametrize(
    ("solve", "named"),
    [
        ('formulation = "<svg>"', "solve.formulation = '<svg>': unknown formulation '<svg>'"),
        ('formulation = "mpcc"\nipopt_exact = { tol = "a" }', "tol = 'a' here"),
        ('start = "foo"', "solve.start = 'foo': unknown start 'foo': choose from given, "),
        ('objective = "fit(none.csv)"', "none.csv: cannot be read"),
        ('objective = "mean(foo, -uy)"', "unknown boundary 'foo': choose from "),
        ('objective = "error-l2"', "the objective 'error-l2' needs an exact or reference solution"),
        ('objective = "mean(top, -uy)"\nformulation = "joint"', "joint minimises the energy only"),
        ('objective = "mean(top, -uy)"\nstart = "joint"', "joint minimises the energy only"),
    ],
)
def test_check_refuses_what_solve_would_refuse(rmesh, block, command, solve, named):
    block.write_text(f"{BLOCK}[solve]\n{solve}\n")
    said = rmesh(f"{command} block.toml")
    error = said.err.strip()  # older versions of rich end a progress bar by an empty line
    assert (said.code, error.count("\n")) == (2, 0)
    assert error.startswith("rmesh: error: block.toml: ")
    assert named in error


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2])
def test_figures_are_drawn_again_without_the_problem_file(rmesh, block: Path, order: int) -> None:
    assert rmesh(f"solve block.toml --order {order} --seed 3 --out one").code == 0
    assert (record()["order"], record()["seed"]) == (order, 3)
    assert Path("one/iterations/iterations.pvd").exists()
    assert set(read_mesh(Path("one/mesh.msh")).boundaries) == {"left", "right", "bottom", "top"}
    drawn = sorted(path.name for path in Path("one/figures").iterdir())
    first = {name: image.imread(f"one/figures/{name}.png") for name in ("limits", "mesh")}
    shutil.rmtree("one/figures")
    block.unlink()
    Path("one/problem.toml").write_text("what it names may be gone too")
    assert rmesh("figures one").code == 0
    assert sorted(path.name for path in Path("one/figures").iterdir()) == drawn
    for name, picture in first.items():
        assert (image.imread(f"one/figures/{name}.png") == picture).all()
    assert rmesh("figures one --columns 1").code == 0
    assert image.imread("one/figures/mesh.png").shape[1] < first["mesh"].shape[1]


@pytest.mark.slow
@pytest.mark.usefixtures("block")
def test_ctrl_c_during_the_audit_or_while_figures_are_drawn_keeps_the_solution(rmesh, monkeypatch) -> None:
    def press(*_: object) -> None:
        raise KeyboardInterrupt

    def assess(*args: Any, **options: Any) -> Assessment:
        signal.raise_signal(signal.SIGINT)
        return assessing.assess(*args, **options)

    with monkeypatch.context() as patch:
        patch.setattr(driver, "assess", assess)
        said = rmesh("solve block.toml --out one")
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert (said.code, record()["status"]) == (130, "interrupted")
    assert "the best mesh so far is kept in one" in said.err
    assert (record()["gain_audited"], record()["success"]) == (None, False)
    assert record()["energy"] < record()["energy_initial"]
    with monkeypatch.context() as patch:
        patch.setattr("rmesh_nlp.cli.reporting.pictures", press)
        said = rmesh("solve block.toml --out one")
    assert (said.code, record()["success"]) == (130, True)
    assert "all but the figures is kept in one; rmesh figures one draws them" in said.err
    assert rmesh("figures one").code == 0
    assert Path("one/figures/mesh.png").exists()


@pytest.mark.slow
def test_check_says_what_to_do_about_missing_names(rmesh, block: Path) -> None:
    points, triangles = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], [[0, 1, 2], [0, 2, 3]]
    meshio.Mesh(points, [("triangle", triangles)]).write("body.vtk")
    block.write_text(f'[mesh]\nfile = "body.vtk"\n{CONDITIONS}')
    said = rmesh("check block.toml")
    assert said.code == 2
    assert "the mesh names none: name groups in gmsh" in said.err


@pytest.mark.slow
def test_advise_predicts_nothing_from_a_mesh_that_is_too_coarse(rmesh, block: Path) -> None:
    """On 12 nodes the second derivatives are others than on the refinement."""
    block.write_text(BLOCK.replace("nx = 6\nny = 3", "nx = 3\nny = 2"))
    said = rmesh("advise block.toml --json")
    assert said.code == 0
    found = json.loads(said.out)
    assert (found["attainable_factor"], found["remeshing_factor"]) == (None, None)
    assert found["recommended"] == "refine"
    assert found["predicted_factor"] > 1


PRESSED = """
mesh = { shape = "rectangle", nx = 2, ny = 2, x = [-1, 1] }
material = { law = "plane-strain", young = 1000, poisson = 0.0 }
dirichlet = { top = [0, -0.01] }
contact = { boundary = "bottom", height = 0, friction = 0.5 }
motion = { delta = { relative = 0.3 } }
"""


@pytest.mark.usefixtures("estimates_unasked")
@pytest.mark.slow
def test_a_pressed_block_has_nothing_to_gain(rmesh) -> None:
    """Its displacement is linear: all energies agree up to rounding."""
    Path("flat.toml").write_text(PRESSED)
    said = rmesh("compare flat.toml --formulations joint --no-figures --out c")
    assert "flat: no formulation gained on the given mesh." in said.out
    assert said.err.count("(gain 0, 0 %)") == 3
    solved = rmesh("solve flat.toml -f joint --no-figures --out one")
    assert re.search(r"audited gain +0 \(0 %\)", solved.out)
    assert re.search(r"normal force +20 \+- \S+ estimated", solved.out)
    assert not re.search(r"\de-1\d |-0\.00", said.out + said.err + solved.err)


def test_remesh_writes_a_mesh_with_the_names_of_the_file_but_never_over_its_own(rmesh, block: Path) -> None:
    said = rmesh("remesh block.toml --nodes 40 --out better.msh")
    assert said.code == 0
    assert "wrote better.msh" in said.out
    made = read_mesh(Path("better.msh"))
    assert abs(made.p.shape[1] - 40) <= 3
    assert {"left", "right", "top", "bottom"} <= set(made.boundaries)
    assert np.ptp(made.p, axis=1) == pytest.approx(np.ptp(load_problem(block).mesh.p, axis=1))
    write_mesh(load_problem(block).mesh, "own.msh")
    given = Path("own.msh").read_bytes()
    block.write_text(f'[mesh]\nfile = "own.msh"\n{CONDITIONS}')
    said = rmesh(f"remesh block.toml --out {Path('own.msh').absolute()}")
    assert (said.code, "this is the mesh of block.toml" in said.err) == (2, True)
    assert Path("own.msh").read_bytes() == given


FITTED = f"""{FILE}
[tractions]
right = [30, 0]
[solve]
formulation = "FORMULATION"
objective = "1e6*fit(measured.csv)"
[[constraints]]
value = "fit(measured.csv)"
bounds = [-inf, 1.0]
"""


@pytest.mark.parametrize("formulation", ["nested", pytest.param("mpcc", marks=pytest.mark.slow)])
def test_measurements_are_beside_the_problem_file(rmesh, formulation: str) -> None:
    folder = Path("data")
    folder.mkdir()
    path = folder / "fitted.toml"
    path.write_text(FITTED.replace("FORMULATION", formulation))
    true = ContactSolver(load_problem(path).at_design({"E": 1.3}))
    columns = np.vstack([true.problem.mesh.p, true.displacement.values(true.given.u)]).T[-2:]
    np.savetxt(folder / "measured.csv", columns, delimiter=",", header="x,y,ux,uy", comments="")
    assert rmesh(f"solve {path} --out one --no-figures").code == 0
    assert record()["design"]["E"] == pytest.approx(1.3, rel=1e-5)
    (folder / "measured.csv").unlink()
    said = rmesh(f"solve {path} --out one")
    assert said.code == 2
    assert "data/measured.csv: cannot be read" in said.err


DESIGN = f"""{FILE}
[design.shapes]
bow = {{ boundary = "bottom", motion = ["0", "x*(4-x)/4"], bounds = [-0.02, 0.03] }}
[[constraints]]
value = "max-pressure(bottom)"
bounds = [-inf, 40.0]
[solve]
objective = "square(resultant(bottom) - 30)"
"""


@pytest.mark.slow
def test_a_design_from_its_file_to_tables_and_figures(rmesh) -> None:
    Path("d.toml").write_text(DESIGN)
    assert "constraint max-pressure(bottom)" in rmesh("check d.toml").out
    assert rmesh("solve d.toml --out one").code == 0
    drawn = {path.name for path in Path("one/figures").iterdir()}
    assert {"design.png", "pressure.png", "mesh.png"} <= drawn
    shutil.rmtree("one/figures")
    assert rmesh("figures one").code == 0
    assert {path.name for path in Path("one/figures").iterdir()} == drawn
    assert set(record()["design"]) == {"E", "h", "bow"}
    said = rmesh("compare d.toml --formulations fixed,nested,joint --out c")
    assert said.code == 0  # joint refuses the objective: a dash
    assert [row["objective"] for row in rows()] == ["square(resultant(bottom) - 30)"] * 3
    assert "J given" not in said.out
    assert "| bow  | -0.02 to 0.03 |" in said.out
    assert any(path.name.endswith("-design.png") for path in Path("c/figures").iterdir())
    assert rmesh("report c").code == 0


@pytest.mark.slow
def test_tool_is_pressed_step_by_step(rmesh) -> None:
    """What a step leaves out stays: the line, its friction, and what the body is held by."""
    Path("my.toml").write_text("""
mesh = { shape = "rectangle", nx = 8, ny = 4, x = [0, 2] }
material = { law = "plane-strain", young = 1000, poisson = 0.3 }
dirichlet = { bottom = [0, 0] }
[contact]
boundary = "top"
line = { point = [0, 1], normal = [0, -1] }
coulomb = 0.5
force = [0, -2]
[[steps]]
tools = { top = [0, -4] }
[[steps]]
tractions = { right = [0.3, 0] }
""")
    said = rmesh("solve my.toml --no-figures --out one")
    assert said.code == 0
    assert "top: tangential force" in said.out
    forces = [step["top"]["normal_force"] for step in record()["steps"]]
    assert forces == pytest.approx([2.0, 4.0, 4.0])
    assert record()["steps"][-1]["top"]["force_x"] < -1e-3  # it opposes the pull
    Path("my.toml").write_text(Path("my.toml").read_text().replace("top = [0, -4]", "left = [0, -4]"))
    said = rmesh("check my.toml")
    assert said.code == 2
    assert "steps[1].tools = {'left': [0, -4]}: no tool under a force meets 'left'" in said.err
