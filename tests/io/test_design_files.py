"""Design variables, shapes and constraints in problem files."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.io.problem_file import load_problem
from rmesh_nlp.problem import Elastic, Shape
from support.problem_files import DESIGN


def written(folder: Path, *edits: tuple[str, str]) -> Path:
    text = DESIGN
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
