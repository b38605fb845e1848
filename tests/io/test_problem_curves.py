from pathlib import Path

import numpy as np
import pytest

from rmesh_nlp.io.problem_file import load_problem
from rmesh_nlp.io.problem_messages import ProblemFileError
from rmesh_nlp.mapping import MeshMap, Mobility
from rmesh_nlp.meshes.curves import Circle, Parametrised, Spline

PLATE = """\
[mesh]
shape = "plate-with-hole"
h = 2.0

[material]
law = "plane-strain"
young = 1000.0
poisson = 0.3

[dirichlet]
left = [0.0, 0.0]

[tractions]
right = [1.0, 0.0]

[motion]
delta = "none"

[curves]
hole = {}
"""


def written(folder: Path, curve: str) -> Path:
    path = folder / "plate.toml"
    path.write_text(PLATE.replace("{}", curve))
    return path


@pytest.mark.parametrize(
    ("curve", "kind"),
    [
        ("{ circle = [5, 5, 2.5] }", Circle),
        ('"circle"', Circle),
        ('"spline"', Spline),
        (
            '{ x = "5 + 2.5*cos(t)", y = "5 + 2.5*sin(t)", t = [0, 6.283185307179586], closed = true }',
            Parametrised,
        ),
    ],
)
def test_a_boundary_is_said_to_be_on_a_curve(tmp_path: Path, curve: str, kind: type) -> None:
    problem = load_problem(written(tmp_path, curve))
    assert isinstance(problem.motion.curves["hole"], kind)
    free = MeshMap.of(problem)
    hole = problem.boundary_nodes(("hole",))
    assert np.all(free.mobility[hole] == Mobility.SLIDING)
    q = 0.3 * np.random.default_rng(0).uniform(-1, 1, free.n)
    radius = np.hypot(*(free.positions.values(q)[:, hole] - 5))
    np.testing.assert_allclose(radius, 2.5, atol=1e-12 if kind is not Spline else 0.05)


@pytest.mark.parametrize(
    ("curve", "message"),
    [
        ("{ circle = [5, 5, 2.4] }", "off its curve"),
        ("{ circle = [5, 5] }", "curves.hole = {'circle': [5, 5]}: circle: expected centre and radius"),
        ("{ circle = [5, 5, -1] }", "expected centre and radius"),
        ("{ centre = [5, 5] }", "centre: unknown key"),
        ("{}", "expected circle = [cx, cy, r], spline = [[x, y], ...], or x, y and t = [from, to]"),
        ('{ x = "t" }', "expected circle"),
        ('"round"', "expected 'circle', 'spline' or a table"),
        ('{ x = "t", y = "z", t = [0, 1] }', "unknown name 'z'"),
        (
            '{ circle = [5, 5, 2.5] }\nrim = "circle"',
            "curves.rim = 'circle': expected a boundary of the mesh",
        ),
    ],
)
def test_bad_curves_are_refused_in_one_line(tmp_path: Path, curve: str, message: str) -> None:
    with pytest.raises(ProblemFileError) as error:
        load_problem(written(tmp_path, curve))
    (line,) = str(error.value).splitlines()
    assert message in line
    assert "curves" in line
