"""Design variables, shapes and constraints in problem files."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.io.problem_file import load_problem
from rmesh_nlp.io.problem_messages import ProblemFileError
from rmesh_nlp.problem import Elastic, Shape

FILE = """
[mesh]
shape = "rectangle"
nx = 6
ny = 3
x = [0.0, 4.0]
y = [0.0, 1.0]
[material]
law = "plane-strain"
young = "20000*E"
poisson = 0.3
body_force = ["load*x", 0.0]
[dirichlet]
top = [0.0, 0.0]
[contact]
boundary = "bottom"
height = "h0 + 0.01*x"
coulomb = "F"
[tractions]
right = ["20*load", 0.0]
[design]
E = { start = 1.0, bounds = [0.5, 2.0] }
F = { start = 0.1, bounds = [0.0, 0.5] }
h0 = { start = 0.02, bounds = [-0.02, 0.04] }
load = { start = 1.0, bounds = [0.5, 2.0] }
[design.shapes]
bow = { boundary = "bottom", motion = ["0", "x*(4-x)/4"], bounds = [-0.02, 0.03] }
[[constraints]]
value = "boundary(bottom, uy)"
bounds = [0.01, inf]
[[constraints]]
value = "max-pressure(bottom)"
bounds = [-inf, 900.0]
"""


def written(folder: Path, *edits: tuple[str, str]) -> Path:
    text = FILE
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    (folder / "my.toml").write_text(text)
    return folder / "my.toml"


def test_names_of_the_design_stand_in_expressions(tmp_path: Path) -> None:
    problem = load_problem(written(tmp_path))
    assert problem.start == {"E": 1.0, "F": 0.1, "h0": 0.02, "load": 1.0, "bow": 0.0}
    assert [shape.name for shape in problem.shapes] == ["bow"]
    assert isinstance(problem.shapes[0], Shape)
    assert [one.bounds for one in problem.constraints] == [(0.01, np.inf), (-np.inf, 900.0)]
    assert problem.motion.is_fixed  # a design alone
    at = problem.at_design({"E": 2.0, "F": 0.25, "load": 0.5, "h0": 0.0, "bow": 0.02})
    law = at.law
    assert isinstance(law, Elastic)
    assert law.lame_mu == pytest.approx(40000 / 2.6)
    assert at.tractions[0].value[0] == pytest.approx(10.0)
    assert at.obstacles[0].coulomb == 0.25
    force = law.body_force[0]
    assert callable(force)
    assert float(force(ca.DM(3.0), ca.DM(0.0))) == pytest.approx(1.5)
    middle = np.flatnonzero((problem.mesh.p[1] == 0) & (problem.mesh.p[0] == 2))
    assert at.mesh.p[1, middle] == pytest.approx(0.02)


def test_motion_is_as_stated_beside_a_design(tmp_path: Path) -> None:
    problem = load_problem(written(tmp_path, ("[design]", "[motion]\ndelta = 0.05\n[design]")))
    assert problem.motion.delta == (0.05, 0.05)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"20000*E"', '"20000*Em"', "material.young = '20000*Em': unknown name 'Em', did you mean 'E'?"),
        ('"20000*E"', '"20000*x*E"', "expected a number or an expression of design variables alone"),
        ('coulomb = "F"', 'coulomb = "G"', "contact.coulomb = 'G': unknown name 'G'"),
        ("h0 = { start = 0.02,", "h0 = { start = 0.2,", "'h0' starts at 0.2, which is not within its bounds"),
        ("h0 = { start = 0.02,", "h0 = { begin = 0.02,", "design.h0.begin = 0.02: unknown key"),
        (
            "[design.shapes]",
            "x = { start = 1.0, bounds = [0.5, 2.0] }\n[design.shapes]",
            "a design variable needs a name of its own such as 'h0', got 'x'",
        ),
        ('{ boundary = "bottom"', '{ boundary = "botom"', "did you mean 'bottom'?"),
        ('"boundary(bottom, uy)"', '"boundary(bottom)"', "constraints[1] = "),
        ("bounds = [0.01, inf]", "bounds = [inf, 0.01]", "must increase"),
        ("bounds = [-inf, 900.0]", "bounds = [1.0, 900.0]", "may be bounded from above alone"),
        ("top = [0.0, 0.0]", 'top = ["h0", 0.0]', "cannot depend on 'h0'"),
    ],
)
def test_wrong_entries_are_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(ProblemFileError) as error:
        load_problem(written(tmp_path, (old, new)))
    assert len(error.value.lines) >= 1
    assert message in str(error.value)
