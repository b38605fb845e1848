import json
import re
from pathlib import Path

import numpy as np
import pytest

from rmesh_nlp.cli import app as cli
from rmesh_nlp.expressions import Expression
from rmesh_nlp.io.problem_file import load_problem
from rmesh_nlp.io.problem_messages import ProblemFileError
from rmesh_nlp.meshes import read_mesh
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import (
    ContactProblem,
    Dirichlet,
    Motion,
    Obstacle,
    PlaneStrain,
    Relative,
    Traction,
)
from support import problem_edits
from support.formulations import fixed, joint
from support.problem_files import BROKEN, SCALAR, VALID, Edit


def write(folder: Path, text: str) -> Path:
    path = folder / "my.toml"
    path.write_text(text)
    return path


def test_a_file_states_what_python_states(tmp_path: Path) -> None:
    ours = load_problem(write(tmp_path, VALID))
    mesh = rectangle(8, 3, x=(0, 4))
    middle, edge = mesh.p[:, mesh.t].mean(axis=1), mesh.p[:, mesh.facets].mean(axis=1)
    load = np.flatnonzero((edge[1] == 1) & (edge[0] > 2))
    mesh = mesh.with_boundaries({"load": load}).with_subdomains(
        {"hard": middle[0] > 2, "soft": middle[0] < 2}
    )
    theirs = ContactProblem(
        mesh=mesh,
        law={
            "hard": PlaneStrain.from_young(2.2e4, 0.3, (0.0, lambda x, y: -20 * x)),
            "soft": PlaneStrain(1.15e4, 0.83e4),
        },
        dirichlet=("left", Dirichlet("right", (None, 0.0))),
        obstacle=Obstacle.graph("bottom", lambda x, y: -0.01 * x**2, friction=lambda x, y: 10 + x),
        motion=Motion(Relative(0.3), pinned=("top", 0), min_area_fraction=0.02),
        tractions=(Traction("load", (0.0, Expression("-30*sin(pi*x/4)"))),),
        quadrature=4,
    )
    assert fixed.solve(ours).energy == pytest.approx(fixed.solve(theirs).energy, rel=1e-13)
    assert (ours.motion, ours.obstacles[0].gap) == (theirs.motion, "node")


def test_a_scalar_problem_with_an_obstacle_in_the_interior(tmp_path: Path) -> None:
    problem = load_problem(write(tmp_path, SCALAR))
    solution = joint.solve(problem)
    assert solution.success
    assert solution.energy < solution.energy_initial
    assert problem.motion.delta is None


def test_a_constant_expression_is_a_number(tmp_path: Path) -> None:
    problem = load_problem(write(tmp_path, SCALAR.replace("left = 0", 'left = "2*sin(pi/6) - 1 + 0*y"')))
    assert problem.supports[0].value == (pytest.approx(0.0, abs=1e-15),)
    with pytest.raises(ProblemFileError, match=r"dirichlet.left = '1/0': '1 / 0' is not a finite number"):
        load_problem(write(tmp_path, SCALAR.replace("left = 0", 'left = "1/0"')))


@pytest.mark.parametrize(("edit", "message"), BROKEN)
def test_a_broken_file_has_a_one_line_error(tmp_path: Path, edit: Edit, message: str) -> None:
    old, new = edit
    assert old in VALID
    path = write(tmp_path, VALID.replace(old, new, 1))
    with pytest.raises(ProblemFileError) as caught:
        load_problem(path)
    lines = caught.value.lines
    assert any(message in line for line in lines), lines
    for line in lines:
        assert line.startswith(f"{path}: ")
        assert "\n" not in line
        assert "Traceback" not in line


def test_a_missing_file_and_a_mesh_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ProblemFileError, match="cannot be read: No such file"):
        load_problem(tmp_path / "no.toml")
    text = '[mesh]\nfile = "body.msh"\n[material]\nlaw = "laplace"\n[dirichlet]\nleft = 0\n'
    (tmp_path / "body.msh").write_text("$MeshFormat\nnonsense\n")
    with pytest.raises(ProblemFileError, match=r"mesh.file = 'body.msh': .* cannot be read as a mesh"):
        load_problem(write(tmp_path, text))


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os')",
        "x.real",
        "[x]",
        "lambda: 1",
        "'a'",
        "True",
        "1j",
        "f'{x}'",
        "sin(*[x])",
        "x if y else 1",
        "x in y",
        "x @ y",
        "x; y",
        "",
        "(" * 500,
        "-" * 5000 + "x",
        "sin(x=1)",
        "x := 1",
        "9" * 999,
        "x\0",
        "sin",
    ],
)
def test_nothing_but_the_whitelist_is_let_through(text: str) -> None:
    with pytest.raises(ValueError, match=r"not allowed|not an expression|too long|unknown"):
        Expression(text)


def test_expressions_mean_what_they_say() -> None:
    points = np.array([[0.0, 0.3, 1.0], [2.0, 0.5, -1.0]])
    x, y = points
    chosen = np.where((x < 0.5) & (y <= 1), np.hypot(x, y), -np.maximum(x, y))
    for text, expected in [
        ("sin(2*pi*x)*y - x**2/3", np.sin(2 * np.pi * x) * y - x**2 / 3),
        ("where(x < 0.5 and not y > 1, hypot(x, y), -max(x, y))", chosen),
        ("0 < x <= 1", (x > 0) & (x <= 1)),
        ("x == 0.1 + 0.2 or y != 0.5", (x == 0.3) | (y != 0.5)),
    ]:  # fmt: skip
        np.testing.assert_allclose(Expression(text).on(points), expected, atol=1e-15)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("where(x > 0, 1/0, 1)", "1 / 0"),
        ("x*log(0)", "log(0)"),
        ("y + sqrt(2 - 3)", "sqrt(2 - 3)"),
        ("where(x > 0, x/(2 - 2), 1)", "x / (2 - 2)"),
        ("9**9**9**9", "9 ** 9 ** 9"),  # at once: whole numbers are floats
    ],
)
def test_a_part_that_is_finite_nowhere_is_refused_by_name(text: str, part: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=rf"'{re.escape(part)}' is not a finite number"):
        Expression(text)
    # a where of which one branch has a pole elsewhere is a function like any other
    assert np.all(np.isfinite(Expression("where(x > 0, 1/(x + 1), 1)").on(np.array([[0.5, -1.0], [0, 0]]))))
    with pytest.raises(ProblemFileError, match=re.escape(part)):
        load_problem(write(tmp_path, SCALAR.replace("left = 0", f'left = "{text}"')))


@pytest.mark.slow
def test_the_command_line_reads_problem_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / "mine.toml", tmp_path / "out"
    assert cli.run(["new", str(path)]) == 0
    assert cli.run(["new", str(path)]) == 2
    assert cli.run(["check", str(path), "--picture", str(tmp_path / "roles.pdf")]) == 0
    assert (tmp_path / "roles.pdf").exists()
    assert cli.run(["solve", str(path), "--seed", "3", "--out", str(out)]) == 0
    assert json.loads((out / "record.json").read_text())["seed"] == 3
    assert (out / "iterations" / "iterations.pvd").exists()
    assert set(read_mesh(out / "mesh.msh").boundaries) == {"left", "right", "bottom", "top", "load"}
    capsys.readouterr()
    assert cli.run(["solve", str(path), "-f", "fixed", "--seed", "1", "--out", str(out)]) == 2
    assert "'fixed' takes no seed" in capsys.readouterr().err
    path.write_text(path.read_text().replace("nx = 16", "nx = 0").replace("left =", "lft ="))
    capsys.readouterr()
    assert cli.run(["check", str(path)]) == 2
    assert cli.run(["solve", str(path), "--n", "8"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        f"rmesh: error: {path}: mesh.nx = 0: expected a whole number from 1 to 10000",
        f"rmesh: error: --n 8 is for the examples: write it into {path}",
    ]


@pytest.mark.slow
def test_random_edits_never_end_in_a_traceback() -> None:
    counts = problem_edits.run(edits=60, seed=7)
    assert set(counts) == {"valid", "refused"}
    assert min(counts.values()) > 5


@pytest.mark.slow
def test_starts_and_levels_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    size = ["--n", "4", "--quadrature", "6", "--delta", "0.05", "--out", str(tmp_path)]
    assert cli.run(["solve", "6.1", "--starts", "2", *size]) == 0
    record = json.loads((tmp_path / "record.json").read_text())
    assert record["start_seeds"] == [None, 1, 2]
    assert record["energy_audited"] == min(record["start_energies"])
    assert cli.run(["solve", "6.1", "--levels", "1", *size]) == 0
    assert json.loads((tmp_path / "record.json").read_text())["triangles"] == 4 * 32
    capsys.readouterr()
    assert cli.run(["solve", "6.1", "--levels", "1", "--starts", "1", *size]) == 2
    assert "starts cannot be combined with levels" in capsys.readouterr().err
    assert cli.run(["solve", "6.1", "--formulation", "fixed", "--starts", "1", *size]) == 2


def test_rules_of_motion_reach_the_problem(tmp_path: Path) -> None:
    path = tmp_path / "rules.toml"
    path.write_text(
        """
mesh = { shape = "rectangle", nx = 2, ny = 2 }
material = { law = "laplace", source = 1 }
dirichlet = { left = 0 }
contact = { boundary = "bottom", gap = "edge" }
[motion]
delta = 0.1
pinned = ["top"]
slides = [3]
free = ["right"]
tied = [[4, 7]]
min_angle = 7
"""
    )
    problem = load_problem(path)
    assert problem.obstacles[0].gap == "edge"
    motion = problem.motion
    assert (motion.pinned, motion.slides, motion.free) == (("top",), (3,), ("right",))
    assert motion.tied == ((4, 7),)
    assert motion.min_angle == 7
    assert motion.delta == (0.1, 0.1)
