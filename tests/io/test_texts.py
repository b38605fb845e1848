"""What people read when something of theirs is wrong, and when they print a result."""

import re
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.cli import app as cli
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.expressions import Expression
from rmesh_nlp.io.problem_file import load_problem
from rmesh_nlp.io.problem_messages import ProblemFileError
from rmesh_nlp.meshes import read_mesh
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.optimize.nlp import NLP
from rmesh_nlp.optimize.solver import Solver
from rmesh_nlp.problem import ContactProblem, Laplace, Motion, Obstacle, ProblemError, where
from support.formulations import fixed, mpcc
from support.problem_files import VALID

LINES_ALONE = """$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
1
1 1 "left"
$EndPhysicalNames
$Nodes
2
1 0 0 0
2 0 1 0
$EndNodes
$Elements
1
1 1 2 1 1 1 2
$EndElements
"""


def test_a_gmsh_file_without_physical_surface_says_how_to_mend_it(tmp_path: Path) -> None:
    path = tmp_path / "lines.msh"
    path.write_text(LINES_ALONE)
    with pytest.raises(ValueError, match=r"has no triangles: gmsh saves only .* Physical Surface"):
        read_mesh(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('height = "-0.01*x**2"', "height = -0.01*x**2", 'height = "-0.01*x**2"'),
        ('load = [0, "-30*sin(pi*x/4)"]', "load = [0, -30*sin(pi*x/4)]", 'load = [0, "-30*sin(pi*x/4)"]'),
        ('friction = "10 + x"', "friction = 10 + x", 'friction = "10 + x"'),
    ],
)
def test_missing_quotes_are_named_with_their_key(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "my.toml"
    path.write_text(VALID.replace(old, new))
    with pytest.raises(ProblemFileError) as caught:
        load_problem(path)
    key = new.partition(" ")[0]
    assert f"{path}: {key} = " in str(caught.value)
    assert "expressions need quotes (line" in str(caught.value)
    assert str(caught.value).endswith(f"as in {message}")


@pytest.mark.parametrize(
    ("text", "home"),
    [
        ('source = "x"\nmesh = { shape = "rectangle", nx = 2, ny = 2 }', "belongs in [material]"),
        ('mesh = { shape = "rectangle", nx = 2, ny = 2, friction = 1 }', "belongs in [contact]"),
        ('mesh = { shape = "rectangle", nx = 2, ny = 2, quadrature = 4 }', "belongs at the top of the file"),
        ('dirichlet = "left"', "dirichlet = 'left': expected a table [dirichlet]"),
        ('contact = "bottom"', "contact = 'bottom': expected a table [contact]"),
    ],
)
def test_a_key_in_the_wrong_table_is_sent_home(tmp_path: Path, text: str, home: str) -> None:
    path = tmp_path / "p.toml"
    path.write_text(text)
    with pytest.raises(ProblemFileError, match=re.escape(home)):
        load_problem(path)


@pytest.mark.parametrize(
    "line",
    [
        f"[{'.'.join('a' * 5000)}]",
        f"{'.'.join('a' * 5000)} = 1",
        f"a = {'[' * 5000}{']' * 5000}",
        f"a = {'{a = ' * 5000}1{'}' * 5000}",
        f"a = {'[' * 21}{']' * 21}",
    ],
    ids=["header", "key", "lists", "tables", "little"],
)
def test_what_is_nested_too_deep_is_one_line_with_its_place(
    tmp_path: Path, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "my.toml"
    path.write_text(f'name = "x"\n{line}\n')
    assert cli.run(["check", str(path)]) == 2
    said = f"rmesh: error: {path}: line 2: tables and lists are nested more than 20 deep\n"
    assert capsys.readouterr().err == said


def test_a_power_is_written_with_stars() -> None:
    with pytest.raises(ValueError, match=r"powers are written with \*\*, not \^"):
        Expression("1 + x^2")


def step(x, y):
    return 1.0 if x > 0.5 else 0.0


@pytest.mark.parametrize(
    "parts",
    [
        {"law": Laplace(step)},
        {"law": Laplace(lambda x, y: max(x, y))},
        {"obstacle": Obstacle("bottom", (1.0,), step)},
    ],
)
def test_a_function_that_branches_is_told_to_use_where(parts: dict) -> None:
    base = {"mesh": rectangle(3, 3), "law": Laplace(1.0), "dirichlet": ("left",), "motion": Motion(0.05)}
    with pytest.raises(ProblemError, match=r"cannot branch on x or y.*where\(condition, a, b\)"):
        ContactProblem(**{**base, **parts})


def test_where_says_what_if_cannot() -> None:
    problem = ContactProblem(
        mesh=rectangle(4, 4),
        law=Laplace(lambda x, y: where(x > 0.5, 1.0, 0.0)),
        dirichlet=("left",),
        motion=Motion(0.05),
    )
    assert fixed.solve(problem).energy < 0


def test_functions_of_math_are_told_apart() -> None:
    import math

    with pytest.raises(ProblemError, match="not those of math"):
        ContactProblem(
            mesh=rectangle(3, 3),
            law=Laplace(lambda x, y: math.sin(x)),
            dirichlet=("left",),
            motion=Motion(0.05),
        )


@pytest.mark.filterwarnings("error")
def test_functions_of_numpy_work_without_a_word() -> None:
    problem = ContactProblem(
        mesh=rectangle(3, 3),
        law=Laplace(lambda x, y: np.sin(x) * np.sqrt(y + 0.2)),  # np.maximum and np.abs need casadi 3.8
        dirichlet=("left",),
        obstacle=Obstacle("right", (1.0,), lambda x, y: 0.1 + 0.1 * np.cos(y)),
        motion=Motion(0.05),
    )
    assert fixed.solve(problem).success


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"max_iterr": 3}, "Ipopt has no option 'max_iterr', did you mean 'max_iter'?"),
        ({"tol": 1e-8, "max_iter": "three"}, "Ipopt refuses max_iter = 'three'"),
        ({"mu_strategy": "adaptiv"}, "Ipopt refuses mu_strategy = 'adaptiv'"),
    ],
)
def test_a_wrong_option_of_ipopt_is_named(
    option: dict, message: str, capfd: pytest.CaptureFixture[str]
) -> None:
    x = ca.MX.sym("x")
    none = np.zeros(0)
    nlp = NLP(x, ca.MX(0, 1), x**2, ca.MX(0, 1), np.array([-1.0]), np.array([1.0]), none, none)
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the message is compared as a whole
        Solver(nlp, options=option)
    assert str(caught.value) == message
    assert capfd.readouterr().out == ""


def test_what_is_printed_fits_a_screen() -> None:
    problem = EXAMPLES["6.3"]((4, 2))
    for thing in (problem, fixed.solve(problem), mpcc.build(problem)):
        lines = repr(thing).splitlines()
        assert len(lines) <= 40
        assert max(map(len, lines)) <= 120
    assert "16 triangles" in repr(problem)
    assert f"{problem.contact_nodes.size * 3} complementarity pairs" in repr(mpcc.build(problem))
