"""Data of edges and elements by hand: moments, doubts, remainders, constants of the oscillation term."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.special import jn_zeros
from skfem import MeshTri

import rmesh_nlp as rm
from rmesh_nlp.certificate.conditions import conditions_of
from rmesh_nlp.certificate.integrals import Loads, body_forces, integrals
from rmesh_nlp.certificate.oscillation import POINCARE, korn, oscillation
from rmesh_nlp.certificate.skeleton import Skeleton, same_domain, skeleton_of
from rmesh_nlp.meshes.arrays import from_arrays
from rmesh_nlp.problem import ContactProblem, Dirichlet, Laplace, Motion, Obstacle, PlaneStrain, Traction
from rmesh_nlp.problem.coefficients import Coefficient
from support.certificates import distorted
from support.rules import coarsen

JUMP = lambda x, y: ca.if_else(x > 0.37, 1.0, 0.0)  # noqa: E731
ROOT = lambda x, y: ca.sqrt(x)  # noqa: E731
HIDDEN = lambda x, y: ca.if_else(ca.sin(9 * x) > 0.5, 1.0, 0.0)  # noqa: E731
"""It jumps at zeros of a function that is no polynomial."""


def plate(**changes) -> ContactProblem:
    """Four by two squares of side 1/2 over (0, 2) x (0, 1)."""
    settings = {
        "mesh": rm.shapes.rectangle(4, 2, x=(0, 2)),
        "law": PlaneStrain(3.0, 2.0, (0.0, lambda x, y: 6 * x * x)),
        "dirichlet": (Dirichlet("left", (0.0, lambda x, y: 0.1 * y)),),
        "obstacle": Obstacle("bottom", (0.0, 1.0), lambda x, y: 0.5 * x, friction=lambda x, y: 1 + x),
        "tractions": (Traction("top", (2.0, lambda x, y: 4 * x * x)),),
    }
    return ContactProblem(**{**settings, **changes})


def part_named(mesh: MeshTri) -> MeshTri:
    """With the middle of its bottom as a boundary of its own."""
    return mesh.with_boundaries({"part": lambda x: np.isclose(x[1], 0) & (abs(x[0] - 1) < 0.5)})


def on(problem: ContactProblem, nodes=None) -> Skeleton:
    return skeleton_of(problem, problem.mesh.p if nodes is None else nodes)


def test_what_jumps_is_integrated_part_by_part() -> None:
    square = ContactProblem(rm.shapes.rectangle(1, 1), Laplace(1.0), ("left",))
    bottom = on(square), square.mesh.boundaries["bottom"], 2
    wave = integrals(lambda x, y: ca.sin(14 * x), *bottom)
    assert np.sum(wave.moments) == pytest.approx((1 - np.cos(14)) / 14, rel=1e-9)
    jump = integrals(JUMP, *bottom)
    assert jump.moments[:, 0] == pytest.approx([0.63**2 / 2, (1 - 0.37**2) / 2])
    assert jump.is_certain
    assert not integrals(HIDDEN, *bottom).is_certain


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        (
            lambda f: {"dirichlet": Dirichlet("left", (0.0, lambda x, y: f(y, x)))},
            "the displacement given on 'left'",
        ),
        (lambda f: {"obstacle": Obstacle("bottom", (0.0, 1.0), f)}, "the obstacle on 'bottom'"),
        (lambda f: {"obstacle": Obstacle("bottom", (0.0, 1.0), friction=f)}, "the obstacle on 'bottom'"),
        (lambda f: {"tractions": Traction("top", (0.0, f))}, "component 2 of a load"),
    ],
)
def test_what_is_undefined_between_points_of_the_check_is_named(changes, named: str) -> None:
    """A function with 0/0 where only the certificate looks."""
    gap = lambda x, y: ca.if_else(ca.fabs(x - 0.2) < 0.02, ca.log(-1), 1.0)  # noqa: E731
    problem = plate(**changes(gap))
    with pytest.raises(rm.BadInputError, match=f"^{named}: the function is nan at"):
        conditions_of(problem, on(problem))


def test_a_friction_bound_is_not_exceeded_where_it_is_low_between_samples() -> None:
    """Samples of the edge from 0.5 to 1 are a 64th apart; its bound rises from 0.1 to 0.3 along a 500th."""
    low = lambda x, y: 0.1 + 100 * (x - 0.703)  # noqa: E731
    dip = lambda x, y: ca.if_else(x > 0.703, ca.if_else(x < 0.705, low(x, y), 1.0), 1.0)  # noqa: E731
    problem = plate(obstacle=Obstacle("bottom", (0.0, 1.0), 0.1, friction=dip))
    conditions = conditions_of(problem, on(problem))
    middle = problem.mesh.p[0, problem.mesh.facets[:, conditions.contact]].mean(axis=0)
    assert conditions.is_certain
    for x, bound in ((0.25, 1.0), (0.75, 0.1), (1.25, 1.0)):
        assert conditions.friction[:, np.isclose(middle, x)].ravel() == pytest.approx([bound, bound])


@pytest.mark.parametrize(
    "changes",
    [
        {"obstacle": Obstacle("bottom", (0.0, 1.0), lambda x, y: 0.1 + 0.01 * HIDDEN(x, y))},
        {"obstacle": Obstacle("bottom", (0.0, 1.0), 0.1, friction=lambda x, y: 1 + HIDDEN(x, y))},
        {"dirichlet": (Dirichlet("left", (0.0, lambda x, y: 0.1 * HIDDEN(y, x))),)},
        {"tractions": (Traction("top", (0.0, HIDDEN)),)},
        # between the points at which they are looked at
        {"obstacle": Obstacle("bottom", (0.0, 1.0), lambda x, y: 0.1 - ca.exp(-1e10 * (x - 0.703) ** 2))},
        {"obstacle": Obstacle("bottom", (0.0, 1.0), lambda x, y: ca.fmin(0.1, 1e5 * ca.fabs(x - 0.703)))},
        {"obstacle": Obstacle("bottom", (0.0, 1.0), lambda x, y: 0.1 * (ca.fabs(x - 0.703) > 1e-12))},
        {"obstacle": Obstacle("bottom", (0.0, 1.0), 0.1, lambda x, y: 1.1 + ca.atan2(-1e-30, x - 0.703) / 3)},
        {"dirichlet": (Dirichlet("left", (0.0, lambda x, y: ca.exp(-1e10 * (y - 0.703) ** 2))),)},
    ],
    ids=["gap", "friction", "support", "traction", "needle", "ridge", "spike", "cut", "given needle"],
)
def test_where_one_coefficient_may_jump_at_an_unknown_place_nothing_is_certain(changes) -> None:
    assert conditions_of(plate(), on(plate())).is_certain
    problem = plate(**changes)
    assert not conditions_of(problem, on(problem)).is_certain


def test_a_given_component_is_as_doubtful_whatever_is_given_beside_it(monkeypatch) -> None:
    coarsen(monkeypatch)
    rough = lambda x, y: ca.sqrt(y)  # noqa: E731
    ways = [(Dirichlet("left", values),) for values in ((rough, None), (rough, 0.0), (0.0, rough))]
    problems = [plate(dirichlet=way) for way in ways]
    doubts = [conditions_of(problem, on(problem)).given_doubt for problem in problems]
    assert doubts[0] > 1e-4
    assert doubts == pytest.approx([doubts[0]] * 3)


def test_data_on_edges_by_hand() -> None:
    problem = plate()
    skeleton = on(problem)
    found = conditions_of(problem, skeleton)
    length, sides = 0.5, problem.mesh.boundaries
    x = skeleton.nodes[:, skeleton.ends]
    assert found.given_error < 1e-12
    assert np.all(np.any(skeleton.edges[:, skeleton.owner] == np.arange(skeleton.owner.size), axis=0))
    # 4 x^2 leaves 4 h^2 (s^2 - s + 1/6), whose square has the mean 1/180
    wanted = np.where(np.isin(np.arange(x.shape[2]), sides["top"]), 4 * length**2 * np.sqrt(length / 180), 0)
    np.testing.assert_allclose(found.traction.remainder, wanted, atol=1e-7)
    a, b = x[0][:, found.contact]
    np.testing.assert_allclose(found.friction, 1 + np.stack([a, b]))
    s = np.linspace(0, 1, 257)  # between the samples too
    along = np.stack([1 - s, s]).T
    # a bound that bends is not exceeded, nor by far
    for shape in (lambda x: x * x, lambda x: x * (1 - x), lambda x: 300 * (x / 2) ** 20):
        rough = replace(problem.obstacles[0], friction=lambda x, y, shape=shape: 3 + shape(x))
        excess = along @ conditions_of(plate(obstacle=rough), skeleton).friction
        excess -= 3 + shape(along @ np.stack([a, b]))
        assert np.max(excess) <= 1e-10 * 3
        assert np.min(np.max(excess, axis=0)) > -1e-2
    # edges whose displacement is given along the normal are not in contact
    named = part_named(problem.mesh)
    for given, gone in (((0.0, None), []), ((None, 0.0), named.boundaries["part"])):
        rollers = plate(mesh=named, dirichlet=("left", Dirichlet("part", given)))
        wanted = np.setdiff1d(sides["bottom"], gone)
        np.testing.assert_array_equal(conditions_of(rollers, skeleton).contact, wanted)
    bent = conditions_of(plate(dirichlet=(Dirichlet("left", (0.0, lambda x, y: y * y)),)), skeleton)
    largest = (4 * 0.75**2 / 2 + 1) / 6  # the moment of y^2 at y = 1 by Simpson's rule
    assert np.max(np.abs(bent.given)) == pytest.approx(largest)
    assert bent.given_error == pytest.approx(0.5**2 / 4 / largest)  # to its chord


def triangle(*corners: tuple[float, float]) -> Skeleton:
    mesh = from_arrays(corners, [[0, 1, 2]], {"side": [[0, 1]]})
    return on(ContactProblem(mesh, Laplace(1.0), ("side",)))


def test_constants_of_the_oscillation_are_those_of_the_literature() -> None:
    assert 0 <= POINCARE * jn_zeros(1, 1)[0] - 1 < 1e-5  # never below 1 / j_11
    equilateral = triangle((0, 0), (1, 0), (0.5, np.sqrt(3) / 2))
    # rho / R is 1 / 2 and, for sides 3, 4, 5, 1 / sqrt(10): the farthest vertex is (0, 4), the centre (1, 1)
    for one, square in ((equilateral, 1 / 4), (triangle((0, 0), (3, 0), (0, 4)), 1 / 10)):
        assert korn(one)[0] == pytest.approx(np.sqrt(4 / square * (1 + np.sqrt(1 - square))))
    # h / j |f| + h sqrt(|e| / |T| (1 / j^2 + 1 / j)) |g|, times the constant of the energy
    area, only = np.sqrt(3) / 4, np.array([0.0, 5.0, 0.0])
    edge = np.sqrt((POINCARE**2 + POINCARE) / area)
    wide = on(equilateral.body.problem, 3 * equilateral.nodes)
    for one, load, edges, constant, wanted in (
        (equilateral, 2.0, only, 7.0, 7 * (2 * POINCARE + 5 * edge)),
        (wide, 2.0, 0 * only, 7.0, 42 * POINCARE),
        (wide, 0.0, only, 1.0, 5 * edge * np.sqrt(3)),
    ):
        found = oscillation(one, np.array([load]), edges, np.array([constant]))
        assert found[0] == pytest.approx(wanted)


def test_the_domain_is_the_same_unless_its_boundary_moves() -> None:
    problem = plate(motion=Motion(0.1))
    inside = distorted(problem.mesh, 0.3, 0).p
    assert same_domain(problem, inside)
    for name, by in (("right", (0.01, 0.0)), ("top", (0.0, 1e-6))):
        moved = inside.copy()
        moved[:, np.unique(problem.mesh.facets[:, problem.mesh.boundaries[name]])] += np.array(by)[:, None]
        assert not same_domain(problem, moved)
    slid, top = inside.copy(), problem.mesh.facets[:, problem.mesh.boundaries["top"]]
    slid[0, np.setdiff1d(np.unique(top), np.flatnonzero(np.isin(inside[0], (0.0, 2.0))))] += 0.01
    assert same_domain(problem, slid)


@pytest.mark.parametrize("ends", [[1.5], [0.5, 1.5]])
@pytest.mark.parametrize("role", ["obstacle", "dirichlet", "tractions", "no role"])
def test_parts_of_the_boundary_may_not_slide_where_they_are_in_use(role: str, ends: list[float]) -> None:
    """One end of a named part slides along a straight side, or both, so that its length stays."""
    mesh = part_named(plate().mesh)
    kinds = {"obstacle": Obstacle, "dirichlet": Dirichlet, "tractions": Traction}
    given = {"obstacle": (0.0, 1.0), "dirichlet": (0.0, 0.0), "tractions": (1.0, 0.0)}
    uses = {"obstacle": [], "dirichlet": [Dirichlet("left", (0.0, 0.0))], "tractions": []}
    if role in uses:
        uses[role].append(kinds[role]("part", given[role]))
    if role != "obstacle":  # another one is no replacement
        uses["obstacle"].append(Obstacle("right", (-1.0, 0.0)))
    problem = plate(mesh=mesh, **{name: tuple(parts) for name, parts in uses.items()})
    nodes = mesh.p.copy()
    nodes[0, np.isin(nodes[0], ends) & (nodes[1] == 0)] += 0.05
    assert same_domain(problem, nodes) is (role == "no role")


def test_loads_count_all_components_and_displacements_elsewhere() -> None:
    def of(*load: Coefficient) -> Loads:
        problem = ContactProblem(rm.shapes.rectangle(2, 2), PlaneStrain(1.0, 1.0, load), "left")
        return body_forces(problem, skeleton_of(problem, problem.mesh.p))

    f, g = (lambda x, y: ca.sin(3 * x)), (lambda x, y: ca.cos(4 * y))
    both, parts = of(f, g), (of(f, 0.0), of(0.0, g))
    np.testing.assert_allclose(both.remainder**2, sum(part.remainder**2 for part in parts))
    doubted, u = replace(both, doubt=np.ones_like(both.doubt)), np.zeros((2, 9))
    u[0, 4] = 3.0  # of the least energy, a displacement may be as large anywhere
    assert doubted.doubtful_work(u) >= 6 * 3.0 * np.sum(both.measure)
