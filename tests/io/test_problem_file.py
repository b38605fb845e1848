"""Problem files: what they mean, and one line that names file, key, value and what was expected."""

import pickle
import re
import sys
from collections import Counter
from contextlib import nullcontext
from pathlib import Path
from random import Random

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.cli.preparing import solve_options
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.expressions import Expression
from rmesh_nlp.io.problem_file import load_problem, template
from rmesh_nlp.io.problem_messages import ProblemFileError, unquoted
from rmesh_nlp.io.problem_schema import ProblemTable
from rmesh_nlp.mapping import MeshMap, Mobility
from rmesh_nlp.problem import Elastic, Place
from support.orders import slow_but
from support.problem_files import DESIGN, FILES, PLATE, SCALAR, VALID

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

SMALL = 'mesh = { shape = "rectangle", nx = 2, ny = 2 }\n'
LAW = 'material = { law = "laplace", source = 1 }\n'
MISTAKES = [
    pytest.param(base, row[0], row[1], row[2:], id=f"{base}: {row[1][:60]!r}")
    for base, rows in tomllib.loads(Path(__file__).with_name("problem_mistakes.toml").read_text()).items()
    for row in rows
]


@pytest.fixture
def write(tmp_path):
    def written(text):
        (tmp_path / "my.toml").write_text(text)
        return tmp_path / "my.toml"

    return written


@pytest.mark.parametrize(
    ("kinds", "law"),
    [
        (["CAX3"], "Axisymmetric"),
        (["cps3", "T2D2"], "PlaneStress"),
        (["CPE3"], "PlaneStrain"),
        (["S3"], None),
    ],
)
def test_elements_of_abaqus_say_the_law(kinds, law, write, tmp_path) -> None:
    nodes = "*NODE\n1, 1, 0\n2, 2, 0\n3, 2, 1\n*ELEMENT, TYPE="
    blocks = [f"{kind}, ELSET=E{i}\n{i}, 1, 2{', 3' * (i == 1)}\n" for i, kind in enumerate(kinds, 1)]
    (tmp_path / "a.inp").write_text(nodes + "*ELEMENT, TYPE=".join(blocks) + "*NSET, NSET=low\n1, 2\n")
    path = write(
        'mesh = { file = "a.inp" }\nmaterial = { young = 1, poisson = 0.3 }\ndirichlet = { low = [0, 0] }'
    )
    with nullcontext() if law else pytest.raises(ProblemFileError, match="law is missing: laplace, "):
        assert type(load_problem(path).laws[0]).__name__ == law


def test_file_means_what_python_means(write):
    ours = load_problem(write(VALID))
    mesh = rm.shapes.rectangle(8, 3, x=(0, 4))
    middle, edge = mesh.p[:, mesh.t].mean(axis=1), mesh.p[:, mesh.facets].mean(axis=1)
    load = np.flatnonzero((edge[1] == 1) & (edge[0] > 2))
    mesh = mesh.with_boundaries({"load": load}).with_subdomains(
        {"hard": middle[0] > 2, "soft": middle[0] < 2}
    )
    theirs = rm.ContactProblem(
        mesh=mesh,
        law={
            "hard": rm.PlaneStrain.from_young(2.2e4, 0.3, (0.0, lambda x, y: -20 * x)),
            "soft": rm.PlaneStrain(1.15e4, 0.83e4),
        },
        dirichlet=("left", rm.Dirichlet("right", (None, 0.0))),
        obstacle=rm.Obstacle.graph("bottom", lambda x, y: -0.01 * x**2, friction=lambda x, y: 10 + x),
        motion=rm.Motion(rm.Relative(0.3), pinned=("top", 0), min_area_fraction=0.02),
        tractions=(rm.Traction("load", (0.0, Expression("-30*sin(pi*x/4)"))),),
        quadrature=4,
    )
    energies = [ContactSolver(one).given.energy for one in (ours, theirs)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-13)
    assert (ours.motion, ours.obstacles[0].gap) == (theirs.motion, "node")


def test_rules_of_motion_reach_the_problem_also_at_their_bounds(write):
    rules = """\
dirichlet = { left = 0 }
contact = { boundary = "bottom", gap = "edge", offset = 0.2 }
[motion]
delta = 0.1
pinned = ["top"]
slides = [3]
free = ["right"]
tied = [[4, 7]]
min_angle = 7
"""
    problem = load_problem(write(SMALL + LAW + rules))
    assert problem.obstacles == (rm.Obstacle("bottom", (1.0,), 0.2, gap="edge"),)
    assert problem.motion == rm.Motion(
        0.1, pinned=("top",), slides=(3,), free=("right",), tied=((4, 7),), min_angle=7
    )
    motion = "[motion]\nmin_angle = 0\nmin_area_fraction = 0.99\n"
    for rule in (1, 50):
        text = f"quadrature = {rule}\n{SMALL}{LAW}dirichlet = {{ left = 0 }}\n{motion}"
        load_problem(write(f"{text}[solve]\nregularisation = [1, 0]\nremesh = true"))


LEFT_FIXED = VALID.replace('right = ["free", 0.0]\n', "")
FOUNDATIONS = {
    "offset = 0.2\nnormal = [3, 4]": rm.Obstacle("bottom", (0.6, 0.8), 0.2),
    "line = { point = [1, -2], normal = [3, 4] }": rm.Obstacle.line("bottom", (1, -2), (3, 4)),
    "circle = { centre = [1, -3], radius = 2 }": rm.Obstacle.circle("bottom", (1, -3), 2),
    "circle = { centre = [1.1, -0.3], radius = 9, inside = true }": rm.Obstacle.circle(
        "bottom", (1.1, -0.3), 9, inside=True
    ),
    "points = [[0, -0.5], [1, -0.1], [2, -0.4]]": rm.Obstacle.graph(
        "bottom", lambda x, y: -0.1 - 0.4 * abs(x - 1) + (x > 1) * 0.1 * (x - 1)
    ),
    'curve = "7*(y + 0.2 - 0.1*x**2)"': rm.Obstacle.curve("bottom", lambda x, y: y + 0.2 - 0.1 * x**2),
}


@pytest.mark.parametrize(("text", "expected"), FOUNDATIONS.items())
def test_every_foundation_has_its_gap_and_normal(write, text, expected):
    (read,) = load_problem(write(LEFT_FIXED.replace('height = "-0.01*x**2"', text))).obstacles
    points = np.array([[0.3, 1.0, 1.7], [0.0, 0.4, -0.05]])
    np.testing.assert_allclose(read.distances(points), expected.distances(points), atol=1e-14)
    np.testing.assert_allclose(read.normals(points), expected.normals(points), atol=1e-14)
    assert read.friction(2.0, 0.0) == 12.0


@pytest.mark.parametrize("more", ["force = [0, -3], move = 'y'", "displacement = [0, -0.1]"])
def test_a_tool_in_a_file_is_one_in_python(write, more):
    law = 'material = { law = "plane-strain", young = 1, poisson = 0.3 }\ndirichlet = { bottom = [0, 0] }\n'
    text = f"contact = {{ boundary = 'top', normal = [0, -1], {more} }}"
    (read,) = load_problem(write(SMALL + law + text)).obstacles
    tool = {"force": (0.0, -3.0), "move": "y"} if "force" in more else {"displacement": (0.0, -0.1)}
    assert read == rm.Obstacle("top", (0.0, -1.0), **tool)


def test_symmetry_units_and_point_loads(write):
    more = '[units]\nlength = "mm"\nforce = "N"\n[[point_loads]]\nat = [2, 1]\nforce = [3, -7]\n'
    problem = load_problem(write(VALID.replace('[0, "0*y"]', '"symmetry"') + more))
    assert problem.supports[0] == rm.Dirichlet("left", (0.0, None))
    assert problem.units.stress == "N/mm²"
    (load,) = problem.point_loads
    assert (problem.mesh.p[:, load.node].tolist(), load.force) == ([2.0, 1.0], (3.0, -7.0))


def test_scalar_problem_with_an_obstacle_in_the_interior_and_an_order(write):
    problem = load_problem(write(SCALAR.replace("left = 0", 'left = "2*sin(pi/6) - 1 + 0*y"')))
    assert problem.motion == rm.Motion(None, min_angle=5)
    assert problem.obstacle.boundary is Place.INTERIOR
    assert problem.obstacle.distances(problem.mesh.p) == pytest.approx(0.1)
    assert problem.supports[0].value == (pytest.approx(0.0, abs=1e-15),)  # a constant is a number
    path = write(SCALAR)
    assert [load_problem(path, order).order for order in (None, 1, 2)] == [1, 1, 2]
    path = write(f"order = 2\n{SCALAR}")
    assert [load_problem(path, order).order for order in (None, 1, 2)] == [2, 1, 2]
    assert ("displacements", "quadratic on each triangle") in load_problem(path).summary()


@pytest.mark.parametrize(
    ("curve", "kind"),
    [
        ("{ circle = [5, 5, 2.5] }", rm.Circle),
        ('"circle"', rm.Circle),
        ('"spline"', rm.Spline),
        (
            '{ x = "5 + 2.5*cos(t)", y = "5 + 2.5*sin(t)", t = [0, 6.283185307179586], closed = true }',
            rm.Parametrised,
        ),
    ],
)
def test_nodes_slide_along_the_curve_of_their_boundary(write, curve, kind):
    problem = load_problem(write(PLATE.replace('"circle"', curve)))
    assert isinstance(problem.motion.curves["hole"], kind)
    free, hole = MeshMap.of(problem), problem.boundary_nodes("hole")
    assert np.all(free.mobility[hole] == Mobility.SLIDING)
    q = 0.3 * np.random.default_rng(0).uniform(-1, 1, free.n)
    radius = np.hypot(*(free.positions.values(q)[:, hole] - 5))
    np.testing.assert_allclose(radius, 2.5, atol=1e-12 if kind is not rm.Spline else 0.05)


def read(path: Path) -> None:
    """All that is checked before a solve."""
    load_problem(path)
    solve_options(path, None, {})


def refused(path: Path) -> list[str]:
    """The lines of the error without the name of the file, with which each begins."""
    with pytest.raises(rm.BadInputError) as caught:
        read(path)
    lines = str(caught.value).split("\n")
    assert all(line.startswith(f"{path}: ") for line in lines)
    return [line.removeprefix(f"{path}: ").replace(f"{path.parent}/", "") for line in lines]


@pytest.mark.parametrize(("base", "old", "new", "expected"), MISTAKES)
def test_a_mistake_is_answered_by_one_line_per_error(write, base, old, new, expected):
    assert old in FILES[base]
    lines = refused(write(FILES[base].replace(old, new, 1)))
    assert len(lines) == len(expected)
    for line, said in zip(lines, expected, strict=True):
        assert line == said or (said.endswith("...") and line.startswith(said.removesuffix("...")))


def test_of_many_errors_the_first_are_said_and_how_many_more_there_are(write):
    lines = refused(write(VALID + "".join(f"[table{k}]\n" for k in range(3000))))
    assert lines[0] == "table0 = {}: unknown key: choose from " + ", ".join(ProblemTable.model_fields)
    assert len(lines) == 11
    assert lines[-1] == "and 2990 more errors"


def test_missing_file_and_unreadable_mesh(write, tmp_path):
    with pytest.raises(ProblemFileError, match="cannot be read: No such file"):
        load_problem(tmp_path / "no.toml")
    path = write('mesh = { file = "body.msh" }\ndirichlet = { left = 0 }\n' + LAW)
    (tmp_path / "body.msh").write_text("$MeshFormat\nnonsense\n")
    (line,) = refused(path)
    assert line.startswith("mesh.file = 'body.msh': body.msh: cannot be read: is damaged")


@pytest.mark.parametrize(
    "line",
    [
        f"[{'.'.join('a' * 1500)}]",
        f"{'.'.join('a' * 1500)} = 1",
        f"a = {'[' * 1500}{']' * 1500}",
        f"a = {'{a = ' * 1500}1{'}' * 1500}",
        f"a = {'[' * 21}{']' * 21}",
    ],
    ids=["header", "key", "lists", "tables", "little"],
)
def test_deep_nesting_is_one_line(write, line):
    path = write(f'name = "x"\n{line}\n')
    assert refused(path) == ["tables and lists are nested more than 20 deep"]


ODD = [
    "0", "-1", "1e308", "1e-308", "nan", "inf", "true", '""', '"x"', '"1/0"', '"x**x"', "[]", "[[]]", "{}",
    "[1, 2]", "[1, 2, 3]", '["a", 1]', "1979-05-27", '"none"', '"free"', "{ relative = -1 }", "9" * 30,
    '"' + "(" * 300 + '"', '"__import__(\'os\')"', '"sqrt(x-2)"', '"log(y)"', '"left"', "'''\nx\n'''",
    '"\\u0000"', "3.5", "0x10", '"l-shape"\nh = 0.5', '"polygon"', '"plane-stress"', '"laplace"',
]  # fmt: skip
BASES = (re.sub(r" +#.*", "", template(name="fuzz", file="fuzz.toml")), VALID, SCALAR)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_random_edits_never_end_in_a_traceback(write):
    """A line of a valid file is lost, doubled, another one, or has another key or value."""
    random, counts = Random(0), Counter()
    for _ in range(300):
        lines = random.choice(BASES).split("\n")
        i = random.randrange(len(lines))
        key, _, value = lines[i].partition("=")
        other, odd = random.choice(lines), random.choice(ODD)
        lines[i : i + 1] = random.choice(([], [lines[i]] * 2, [other], [f"zz = {value}"], [f"{key}= {odd}"]))
        path, said = write("\n".join(lines)), None
        try:
            load_problem(path)
        except ProblemFileError as error:
            said = error.lines
        assert said != []
        assert all(line.startswith(f"{path}: ") and len(line.splitlines()) == 1 for line in said or ())
        counts["valid" if said is None else "refused"] += 1
    assert min(counts["valid"], counts["refused"]) > 5


def test_the_line_at_which_toml_fails_is_looked_at_or_the_last_one() -> None:
    text = b"height = 0.5*x\nload = 2*y\nfriction = 3*x"
    said = unquoted(text, "Invalid value (at line 2, column 9)")
    assert "load = 2*y: expressions need quotes (line 2)" in said
    assert "line 3" in unquoted(text, "Invalid value (at end of document)")


def test_names_of_the_design_stand_in_expressions(write):
    problem = load_problem(write(DESIGN))
    assert problem.start == {"E": 1.0, "F": 0.1, "h0": 0.02, "load": 1.0, "bow": 0.0}
    assert [shape.name for shape in problem.shapes] == ["bow"]
    assert isinstance(problem.shapes[0], rm.Shape)
    assert [one.bounds for one in problem.constraints] == [(0.01, np.inf), (-np.inf, 900.0)]
    assert problem.motion.is_fixed  # a design alone
    moved = load_problem(write(DESIGN.replace("[design]", "[motion]\ndelta = 0.05\n[design]")))
    assert moved.motion.delta == (0.05, 0.05)
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
    # distortions compare with the triangles of the first design
    np.testing.assert_array_equal(at.reference, problem.mesh.p[:, problem.triangles])


@pytest.mark.parametrize("name", slow_but(FILES, "membrane", "design"))
def test_a_pickled_problem_of_a_file_has_the_same_solution(write, name):
    """CasADi pickles expressions of design variables in a context of its own only."""
    problem = load_problem(write(FILES[name]))
    with ca.global_pickle_context() if problem.design else nullcontext():
        text = pickle.dumps(problem)
    with ca.global_unpickle_context() if problem.design else nullcontext():
        copy = pickle.loads(text)
    assert ContactSolver(copy.at_design()).given.energy == ContactSolver(problem.at_design()).given.energy


def test_a_subdomain_off_the_lines_of_the_mesh_is_told(write, recwarn) -> None:
    """Its edge is a line of the mesh, or inside triangles."""
    for at, count in (("0.5", 0), ("0.6", 1)):
        text = 'mesh = { shape = "rectangle", nx = 4, ny = 4 }\ndirichlet = { left = 0 }\n'
        load_problem(write(f'{text}subdomains = {{ hard = "x > {at}" }}\n{LAW}'))
        assert sum("'hard' ends inside 8 triangles" in str(one.message) for one in recwarn) == count
