"""The continuous energy of admissible displacements: closed forms, no penetration, how far nodes keep off."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.assessment.admissible import Admissible, Continuous, admissible
from rmesh_nlp.assessment.measures import residuals
from rmesh_nlp.contact.active_set import solve
from rmesh_nlp.contact.penetration import penetrations
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.standoff import FINE, LATTICES, SAMPLES, Cells, cells_of
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes import named
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.contact_problem import locally_refined, refined
from support.orders import ORDERS
from support.rules import coarsen
from truth.draws import aimed

LAW = rm.PlaneStrain.from_young(1000.0, 0.3)
BUMP = rm.Obstacle.interior(lambda x, y: -0.05 + 0.08 * ca.exp(-((x - 0.5) ** 2 + (y - 0.5) ** 2) / 0.0009))
WAVES = rm.Obstacle.graph("bottom", lambda x, y: -0.02 + 0.004 * np.sin(24 * np.pi * x))
PEAK = rm.Obstacle.graph("bottom", lambda x, y: -0.02 + 0.01 * np.exp(-(((x - 0.8) / 0.01) ** 2)))
FLAT = rm.Obstacle.graph("bottom", -0.02)
SIDES = ("left", "right", "top", "bottom")


def block(obstacle: rm.Obstacle | tuple[rm.Obstacle, ...], n: int = 3) -> rm.ContactProblem:
    return rm.ContactProblem(
        rectangle(4 * n, n, x=(0, 2)), LAW, ("left",), obstacle, tractions=(rm.Traction("top", (6.0, -10.0)),)
    )


def standoff(found: Admissible) -> np.ndarray:
    offset = found.system.offset
    return Continuous(found.continuous.parts, found.body.nodes).system(np.zeros(offset.size)).offset - offset


def deepest(found: Admissible) -> float:
    parts = penetrations(found.continuous.space, found.body.nodes, found.displacement)
    return max(part.depth for part in parts)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(("name", "n"), [("6.1", 4), ("6.2", (6, 3)), ("6.3", (6, 3))])
def test_on_flat_foundations_it_is_the_energy_by_an_accurate_rule(name: str, n: object, order: int) -> None:
    """At order 2 it is less where contact ends within an edge, as it does on Examples 6.1 and 6.2."""
    problem = replace(rm.EXAMPLES[name](n=n), order=order)
    exact = ContactSolver(problem.with_rule(25)).solve(problem.mesh.p)
    found = admissible(problem, start=exact.active)
    assert 0 <= found.doubt < 1e-6
    if order == 2 and name != "6.3":
        assert 1e-5 < (exact.energy - found.energy) / abs(exact.energy) < 1e-3
    else:
        assert found.energy == pytest.approx(exact.energy, rel=1e-9)
        assert np.max(np.abs(standoff(found))) < 1e-15
    if problem.exact is not None:
        assert found.energy > problem.exact.energy


def test_what_jumps_along_a_line_leaves_no_doubt() -> None:
    jump = rm.Obstacle.graph("bottom", 0.0, friction=lambda x, y: ca.if_else(x > 1.9, 0.8, 0.2))
    step = lambda x, y: ca.if_else(x + 0.3 * y > 0.77, -3.0, 0.0)  # noqa: E731
    load = replace(block(jump), law=rm.PlaneStrain.from_young(1000.0, 0.3, (0.0, step)))
    assert admissible(load).doubt < 1e-12


def waves(phase: float) -> rm.ContactProblem:
    load = rm.Traction("top", (lambda x, y: 1 + 3 * ca.sin(40 * x + phase),))
    return rm.ContactProblem(rectangle(12, 6, x=(0, 2)), rm.Laplace(0.0), ("bottom",), tractions=load)


def test_what_coarse_rules_miss_is_within_the_doubt(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of loads, of the strain energy of a ring that no load acts on, and of friction."""
    held = rm.Dirichlet("left", (0.01, None)), rm.Dirichlet("bottom", (None, 0.0))
    ring = rm.ContactProblem(rectangle(2, 2, x=(0.1, 1.1)), rm.Axisymmetric(1.2, 0.8), held)
    rough = rm.Obstacle.graph("bottom", 0.0, friction=lambda x, y: 1 + ca.sin(60 * x))
    slid = rm.ContactProblem(rectangle(4, 1), LAW, (rm.Dirichlet("top", (0.1, -0.01)),), rough)
    problems = [ring, slid, *(waves(phase) for phase in (0.0, 1.5, 3.0, 4.5))]
    least = [admissible(problem).energy for problem in problems]
    coarsen(monkeypatch)
    found = [admissible(problem) for problem in problems]
    assert all(abs(one.energy - exact) <= one.doubt for one, exact in zip(found, least, strict=True))
    assert any(one.energy < exact - 0.03 for one, exact in zip(found, least, strict=True))


def test_doubts_of_loads_up_and_down_do_not_cancel(monkeypatch: pytest.MonkeyPatch) -> None:
    coarsen(monkeypatch)

    def doubt(left: float, right: float) -> float:
        wave = lambda x, y: ca.sin(48 * x) ** 2 * ca.if_else(x < np.pi / 4, left, right)  # noqa: E731
        load = rm.Traction("top", (wave,))
        mesh = rectangle(12, 1, x=(0, np.pi / 2), y=(0, 0.2))
        return admissible(rm.ContactProblem(mesh, rm.Laplace(0.0), ("bottom",), tractions=load)).doubt

    assert doubt(1.0, 0.0) > 0.001
    assert doubt(1.0, -1.0) > 1.5 * doubt(1.0, 0.0)


def test_gaps_of_order_2_hold_between_the_nodes_and_no_more() -> None:
    """Where contact ends within an edge, coefficients that are not negative keep off farther than needed."""
    problem = replace(block(rm.Obstacle.graph("bottom", -0.02), n=1), order=2)
    by_coefficients, found = ContactSolver(problem).given, admissible(problem)
    assert 0 < np.sum(by_coefficients.active.touching) < by_coefficients.active.touching.size
    assert deepest(found) < 1e-10
    assert found.energy < by_coefficients.energy - 5e-5


def test_nodes_come_closer_at_order_2_where_the_gap_bends_differently_after_each_step() -> None:
    """Beside a kink that the load presses on, the gap between points falls by the second derivative."""
    kinks = (1.4339, 0.0087, 0.0295), (1.7111, 0.00704, 0.01407), (0.9298, 0.01925, 0.01485)
    for place, depth, slope in kinks:
        height = partial(lambda a, b, c, x, y: -b - c * ca.fabs(x - a), place, depth, slope)
        here = Continuous(replace(block(rm.Obstacle.graph("bottom", height), n=1), order=2))
        found = here.solve()
        assert deepest(found) < 1e-10
        assert found.energy < solve(here.system(here.first_standoff())).energy - 1e-5


ABOVE = rm.Obstacle("top", (0.0, -1.0), lambda x, y: 0.01 + 0.004 * np.sin(16 * np.pi * x))


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(
    ("obstacles", "load"),
    [
        (replace(PEAK, friction=2.0), rm.Traction("top", (6.0, -10.0))),
        ((WAVES, ABOVE), rm.Traction("right", (-400.0, 100.0))),
    ],
    ids=["friction", "two foundations"],
)
def test_what_presses_between_nodes_balances_the_load_and_friction_keeps_its_bound(obstacles, load, order):
    """Normals are the same everywhere on each, so what points press is shared among nodes exactly."""
    found = admissible(replace(block(obstacles), tractions=(load,), order=order))
    system, state = found.system, found.state
    assert np.any(standoff(found) > 1e-12)
    for part in found.continuous.space.contact_sets:
        assert np.max(state.normal_force[part.rows]) > 1
    # the stiffness of the springs, a million times that of the body, takes digits from what they press
    assert residuals(system, state).equilibrium < 1e-6
    if np.any(system.frictional):
        assert np.all(np.abs(state.tangential_force) <= system.slip_bound * (1 + 1e-9))
        slides = state.active.sliding != 0
        assert np.any(slides)
        slipped = -system.slip_bound[slides] * state.active.sliding[slides]
        np.testing.assert_allclose(state.tangential_force[slides], slipped)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(
    "obstacle", [WAVES, PEAK, rm.Obstacle.circle("bottom", (1.0, -0.52), 0.5)], ids=["waves", "peak", "disc"]
)
def test_nothing_passes_between_the_nodes(obstacle: rm.Obstacle, order: int) -> None:
    problem = replace(block(obstacle), order=order)
    found = admissible(problem)
    assert found.status is rm.Status.CONVERGED
    assert np.sum(found.state.active.touching) >= 1
    assert deepest(found) < 1e-10
    model = ContactSolver(problem)
    at_nodes = model.displacement.values(model.solve(problem.mesh.p).u)
    assert deepest(replace(found, displacement=at_nodes)) > 1e-5
    # and no farther off than need be: somewhere the gap closes
    lower = replace(found, displacement=found.displacement - np.array([[0.0], [1e-4]]))
    assert deepest(lower) > 1e-5
    for _ in range(3 - order):
        problem = refined(problem)
    assert found.energy > admissible(problem).energy


@pytest.mark.parametrize("order", ORDERS)
def test_a_bump_narrower_than_the_triangles_is_seen_inside_them(order: int) -> None:
    mesh = rectangle(7, 7, x=(0, 1.1))  # no node at the top of the bump, at no middle of an edge either
    problem = rm.ContactProblem(mesh, rm.Laplace(-1.0), SIDES, BUMP, order=order)
    found = admissible(problem)
    assert deepest(found) < 1e-10
    assert ContactSolver(problem).solve(problem.mesh.p).energy < found.energy - 1e-3


@pytest.mark.slow
def test_triangles_that_are_held_as_a_whole_are_cut_where_the_foundation_rises() -> None:
    hill = rm.Obstacle.interior(
        lambda x, y: -0.02 + 0.1 * ca.exp(-((x - 0.15) ** 2 + (y - 0.15) ** 2) / 0.002)
    )
    problem = rm.ContactProblem(rectangle(2, 2, diagonal="falling"), rm.Laplace(0.0), SIDES, hill)
    found = admissible(problem)
    assert found.problem.mesh.t.shape[1] > problem.mesh.t.shape[1]
    assert found.status is rm.Status.CONVERGED
    assert deepest(found) < 1e-3
    assert found.energy > 0
    above = replace(problem, dirichlet=tuple(rm.Dirichlet(side, 0.2) for side in SIDES))
    assert admissible(above).problem is above
    quadratic = replace(problem, order=2)  # its edge inside the square has a free node
    found = admissible(quadratic)
    assert found.problem is quadratic
    assert deepest(found) == 0


def ring_on_a_shaft(n: int, order: int) -> tuple[rm.ContactProblem, float]:
    """1 < r < 2 on a rigid shaft that is too thick for it, on n x 2n squares, and its energy."""
    flat = rectangle(n, 2 * n)
    r, angle = 1 + flat.p[0], np.pi / 2 * flat.p[1]
    mesh = type(flat)(np.stack([r * np.cos(angle), r * np.sin(angle)]), flat.t)
    sides = {
        "inner": lambda p: np.hypot(*p) < 1 + 0.2 / n,
        "outer": lambda p: np.hypot(*p) > 2 - 0.2 / n,
        "bottom": lambda p: p[1] < 1e-9,
        "left": lambda p: p[0] < 1e-9,
    }
    law, overlap = rm.PlaneStrain(1.2, 0.8), 0.01
    problem = rm.ContactProblem(
        named(mesh, sides),
        law,
        (rm.Dirichlet("bottom", (None, 0.0)), rm.Dirichlet("left", (0.0, None))),
        rm.Obstacle.circle("inner", (0.0, 0.0), 1 + overlap),
        rm.Motion(None, curves={"inner": rm.Circle((0.0, 0.0), 1.0), "outer": rm.Circle((0.0, 0.0), 2.0)}),
        order=order,
    )
    # u_r = A r + B / r, with no stress at r = 2
    lam, mu = law.lame_lambda, law.lame_mu
    A = overlap / (1 + 4 * (lam + mu) / mu)
    pressure = 2 * mu * (overlap - A) - 2 * (lam + mu) * A
    return problem, np.pi / 4 * pressure * overlap


@pytest.mark.slow
def test_errors_of_order_2_fall_by_the_fourth_power_of_the_width_beside_curves_too() -> None:
    """And by the second of order 1, always from above; normals turn along edges."""
    for order, least in ((1, 1.8), (2, 3.4)):
        errors = []
        for n in (2, 4):
            problem, exact = ring_on_a_shaft(n, order)
            found = admissible(problem)
            assert found.status is rm.Status.CONVERGED
            assert deepest(found) == 0
            errors.append((found.energy - exact) / exact)
        assert errors[1] > 0
        assert np.log2(errors[0] / errors[1]) > least
    assert errors[1] < 3e-4


@pytest.mark.parametrize(
    ("height", "status", "order"),
    [(-0.3, rm.Status.CONVERGED, 1), (-0.4, rm.Status.CONVERGED, 1), (-0.3, rm.Status.CONVERGED, 2)],
)
def test_where_normals_turn_along_an_edge_nothing_passes_or_it_is_said(height, status, order) -> None:
    """A disc smaller than an edge, over which the body is dragged: stand-offs must be raised."""
    disc = rm.Obstacle.circle("bottom", (1.1, height), 0.3)
    given = (rm.Dirichlet("top", (-0.3, -0.05)),)
    problem = rm.ContactProblem(rectangle(2, 1, x=(0, 2)), LAW, given, disc, order=order)
    found = admissible(problem)
    assert found.status is status
    assert (deepest(found) < 1e-9) is (status is rm.Status.CONVERGED)


RIDGE, PEAKED = (SAMPLES / 2 + 0.5) / SAMPLES, (SAMPLES * FINE / 2 + 0.5) / (SAMPLES * FINE)
"""Halfway between two points, and between two of the places between these that are looked at."""


def cells_on(problem: rm.ContactProblem) -> list[Cells]:
    space = DisplacementSpace(problem)
    return list(cells_of(Body(problem, problem.mesh.p), space, space.contact_sets[0]))


def edge(height: Callable, held: tuple[str, ...] = ("top",), length: float = 2.0, order: int = 1) -> Cells:
    """One contact edge from x = 0 to its length over a foundation -1 + height(x / length)."""
    problem = rm.ContactProblem(
        rectangle(1, 1, x=(0, length)),
        rm.PlaneStrain(1.0, 1.0),
        tuple(rm.Dirichlet(name, (0.0, 0.25)) for name in held),
        rm.Obstacle.graph("bottom", lambda x, y: -1 + height(x / length)),
        order=order,
    )
    (cells,) = cells_on(problem)
    return cells


def closed(cells: Cells) -> np.ndarray:
    """The displacement with gaps of 0 at free nodes, that which is given at others."""
    u = np.full((2, 4), 0.25)
    u[1, cells.nodes[:, 0]] = np.where(cells.rows >= 0, -cells.at_nodes, 0.25)[:, 0]
    return u


@pytest.mark.parametrize(
    ("height", "off"),
    [
        (lambda s: 0.4 * s * (1 - s), 0.1),  # a crest of 0.4 / 4 over its chord
        (lambda s: 0.3 + 0.2 * s, 0.0),
        (lambda s: -0.4 * s * (1 - s), 0.0),  # a valley
        (lambda s: 0.05 * (1 - np.cos(2 * np.pi * s)), 0.1),
        (lambda s: s * s * (1 - s), 4 / 27),  # the top lies between two samples
        (lambda s: 0.4 * np.minimum(s / RIDGE, (1 - s) / (1 - RIDGE)), 0.4),
        (lambda s: 0.4 * np.minimum(s / PEAKED, (1 - s) / (1 - PEAKED)), 0.4),
    ],
)
def test_nodes_keep_off_by_the_height_of_the_foundation_over_its_chord(height: Callable, off: float) -> None:
    cells = edge(height)
    found = cells.missing(closed(cells))
    samples = height(np.linspace(0, 1, SAMPLES * FINE + 1))  # between them it may rise by half a bend
    assert off - 1e-12 <= found[0] <= off + 1e-4 + np.max(np.abs(np.diff(samples, 2))) / 2


def test_beside_a_held_node_the_free_one_makes_up_for_it() -> None:
    """The held end is 1/4 above its place, the other one must give the rest: max (a - N_j G_j) / N_i."""
    height, s = (lambda s: 12 * s * (1 - s) ** 2), np.linspace(0, 1, 4001)[1:]
    wanted = np.max((height(s) - (1 - s) * 1.25) / s)
    cells = edge(height, ("left",))
    assert cells.missing(closed(cells))[0] == pytest.approx(wanted, rel=2e-3)


def test_a_foundation_can_be_raised_up_to_what_is_held_at_nodes_and_between_them() -> None:
    """Held nodes are 1.25 above a foundation with a crest of 0.1 beside the left one."""
    mesh = rectangle(2, 1, x=(0, 2)).with_boundaries({"part": lambda x: (x[1] == 0) & (x[0] < 1)})
    foundation = rm.Obstacle.graph("bottom", lambda x, y: -1 + 0.4 * x * (1 - x))
    for held, room in (("part", 1.15), ("left", 1.25)):
        own = Continuous(rm.ContactProblem(mesh, LAW, (rm.Dirichlet(held, (0.0, 0.25)),), foundation))
        (contact,) = own.space.contact_sets
        for by in (room - 0.01, room + 0.01):
            for height in (by, lambda x, y, by=by: by + 0 * x):
                found = own.shifted(contact, height).is_open
                assert found == (by < room)


@pytest.mark.parametrize(("held", "top", "count"), [(SIDES, 0.1, 1), (SIDES, -0.1, 0), (SIDES[:1], 0.1, 0)])
def test_out_of_reach_are_triangles_that_are_held_at_all_nodes(held: tuple, top: float, count: int) -> None:
    """A hill about a triangle at a corner, whose nodes are given, and one with the node in the middle."""
    hill = rm.Obstacle.interior(lambda x, y: top - 3 * ((x - 0.85) ** 2 + (y - 0.15) ** 2))
    (cells,) = cells_on(rm.ContactProblem(rectangle(2, 2, diagonal="rising"), rm.Laplace(0.0), held, hill))
    assert cells.unreachable(np.zeros((1, 9))).size == count


def test_gaps_below_a_tool_are_raised_by_the_body_alone() -> None:
    tool = rm.Obstacle("top", (0.0, -1.0), 0.0, force=(0.0, -1.0))
    mesh = rectangle(2, 1)
    on = Continuous(rm.ContactProblem(mesh, LAW, ("bottom",), tool))
    moved = on.field.values(on._raising @ np.ones(on.space.contact_nodes.size)) - on.given
    assert moved[1].tolist() == [*np.where(mesh.p[1] == 1, -1.0, 0.0), 0.0]


def test_between_points_a_parabola_is_lower_by_its_bend() -> None:
    """Of a gap (s - r)^2 whose least value lies between two points nothing below zero is overlooked."""
    cells, at = edge(lambda s: 0 * s, order=2), RIDGE
    u = np.zeros((2, 9))
    u[1, cells.nodes[:, 0]] = np.array([at**2, (1 - at) ** 2, -at * (1 - at)]) - 1.0
    assert np.min(cells.gaps(u)) == pytest.approx(0.0, abs=1e-12)
    assert np.min(cells.gaps(u) + cells.dips(u)) > 1e-5


def test_a_wave_that_cancels_a_kink_hides_nothing() -> None:
    """Of gaps that are 0 at the kink, between two slopes; found by a search of 3,000 random ones."""
    at, kink, k = 8.68690879 / 512, 0.13354679, 17.55682798

    def height(s, slope):
        wave = np.sin(k * s + at) - np.sin(k * at + at) - k * np.cos(k * at + at) * (s - at)
        return 1.36721479 * wave - kink * np.abs(s - at) - slope * (s - at)

    for slope in kink * np.linspace(-1, 1, 7):
        cells = edge(partial(height, slope=slope))
        u = np.full((2, 4), -1.0)
        near = np.argmin(np.abs(cells.points[0, 0] / 2 - at))
        assert np.min(cells.gaps(u)[0, near - 2 : near + 3]) <= 1e-12


def test_points_share_friction_among_the_nodes_of_an_edge_as_the_integral_does() -> None:
    """So that what sticks keeps the bound of its node."""
    cells = edge(lambda s: 0 * s, order=2)
    np.testing.assert_allclose(cells.shares @ cells.measures(block(FLAT))[0], 2 / 3, rtol=1e-12)


def test_in_triangles_a_paraboloid_is_looked_at_between_samples_too() -> None:
    """-r^2 about a point of no lattice: the node opposite keeps off by its height over the plane."""
    middle = np.array([0.31, 0.27])
    hill = rm.Obstacle.interior(lambda x, y: -1 - (x - middle[0]) ** 2 - (y - middle[1]) ** 2)
    problem = rm.ContactProblem(rectangle(1, 1, diagonal="falling"), rm.Laplace(0.0), ("right",), hill)
    (cells,) = cells_on(problem)
    corner = 0 if np.all(np.min(cells.points[:, 0], axis=1) < 0.01) else 1  # the triangle at the origin
    gaps = cells.gaps(np.zeros((1, 4)))[corner]
    exact = 1 + np.sum((cells.points[:, corner] - middle[:, None]) ** 2, axis=0)
    assert np.all(gaps <= exact)
    assert np.min(gaps) <= 1.0  # not above the least gap, which no sample has
    assert np.min(gaps) > 1 - 1e-3


@pytest.mark.parametrize("bent", ["foundation", "displacement"])
@pytest.mark.parametrize(
    ("gap", "least"),
    [
        (lambda x, y: 2 - (x + 1 / 48) * y, 2 - (49 / 96) ** 2),  # on the third side, halfway between samples
        (lambda x, y: 1 + (x - 1 / 144) ** 2 + (y - 1 / 144) ** 2 + (x + y - 1 / 72) ** 2, 1.0),
    ],
)
def test_in_triangles_nothing_below_the_gaps_about_their_points_is_overlooked(gap, least, bent):
    """A saddle, straight along two sides, and a bowl whose least gap is amid three samples."""
    height = (lambda x, y: -gap(x, y)) if bent == "foundation" else -1.0
    problem = rm.ContactProblem(
        rectangle(1, 1, diagonal="falling"),
        rm.Laplace(0.0),
        ("right",),
        rm.Obstacle.interior(height),
        order=2,
    )
    space, (cells,) = DisplacementSpace(problem), cells_on(problem)
    u = np.zeros((1, space.n_nodes))
    if bent == "displacement":
        u = space.coefficients(gap(*space.points(problem.mesh.p))[None] - 1)
    corner = 0 if np.all(np.min(cells.points[:, 0], axis=1) < 0.01) else 1
    assert least - 1e-3 < np.min(cells.gaps(u)[corner]) <= least + 1e-12


@pytest.mark.parametrize("slope", [-0.95, 0.95])
@pytest.mark.parametrize("part", [0.05, 0.3])
def test_a_kink_beside_an_end_is_not_overlooked(part: float, slope: float) -> None:
    """Of gaps 1 + |s - a| + slope s, with no point between the kink at a and the end."""
    a = part / (SAMPLES * FINE)
    for place in (a, 1 - a):
        cells = edge(lambda s, place=place: -ca.fabs(s - place))
        u = np.zeros((2, 4))
        u[1, cells.nodes[:, 0]] = 0.0, slope
        assert -2 / SAMPLES < np.min(cells.gaps(u)) - (1 + slope * place) <= 1e-12
    a = part / LATTICES[0]
    roof = rm.Obstacle.interior(lambda x, y: -1 - ca.fabs(x - a))
    problem = rm.ContactProblem(rectangle(1, 1, diagonal="falling"), rm.Laplace(0.0), ("right",), roof)
    (cells,) = cells_on(problem)
    corner = np.argmin(np.mean(cells.points[0], axis=1))
    gap = np.min(cells.gaps(slope * problem.mesh.p[:1])[corner])
    assert -2 / LATTICES[0] < gap - (1 + slope * a) <= 1e-12


@pytest.mark.slow
def test_a_body_that_only_contact_holds_comes_down_where_no_point_presses_at_first() -> None:
    """Of a coarse quarter of a disc nodes keep off so far that the springs begin without any force."""
    problem = replace(aimed()[17].problem(), order=2)
    here = Continuous(problem)
    high = solve(here.system(here.first_standoff()))
    assert admissible(problem).energy < high.energy - 0.05 * abs(high.energy)


@pytest.mark.slow
@pytest.mark.parametrize("order", ORDERS)
def test_what_is_returned_is_admissible_and_its_energy_that_of_itself(order: int) -> None:
    """Refined where contact ends and beside the support, where springs leave the deepest penetration."""
    problem = replace(block(replace(FLAT, friction=4.0), n=2), order=order, motion=rm.Motion(None))
    for _ in range(3):
        corner = np.argsort(np.linalg.norm(problem.mesh.p[:, problem.mesh.t].mean(axis=1), axis=0))[:4]
        problem = locally_refined(problem, corner)
    found = admissible(problem)
    size = np.max(np.abs(found.displacement)) + 0.02
    assert min(np.min(cells.gaps(found.displacement)) for cells in found.continuous.cells) > -1e-14 * size
    own = found.continuous
    u = found.displacement.T.ravel()
    work = 0.5 * u @ (own.stiffness @ u) - own.load @ u
    assert found.energy == pytest.approx(work + own.friction(found.displacement)[0], rel=1e-13)
    np.testing.assert_allclose(own.field.values(found.state.u), found.displacement, atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("gap", [0.02, 1 / 8])
def test_friction_is_the_least_along_edges_and_not_at_nodes(gap: float, order: int) -> None:
    """On the way to the solution for friction at nodes the energy rises.

    Over the gap of 1/8, where nothing is rounded, one node sticks beside others that slide.
    """
    foundation = rm.Obstacle("bottom", (0.0, 1.0), gap, friction=8.0)
    problem = replace(block(foundation, n=1), tractions=(rm.Traction("top", (2.0, -20.0)),))
    own = Continuous(replace(problem, order=order))
    found, nodal = own.solve(), solve(own.system(np.zeros(own.space.contact_nodes.size)))
    change = own.field.values(nodal.u) - found.displacement

    def energy(part: float) -> float:
        u = found.displacement + part * change
        w = u.T.ravel()
        return float(0.5 * w @ (own.stiffness @ w) - own.load @ w + own.friction(u)[0])

    least = energy(0.0)
    assert energy(1.0) > least + 1e-5 * abs(least)
    # the search takes 128 trapezoids per edge for the integral
    assert min(energy(part) for part in (1e-3, 1e-2, 0.1)) >= least - 1e-8 * abs(least)


@pytest.mark.parametrize("order", [1, 2])
def test_given_displacements_open_the_gaps_of_edges_beside_them(order: int) -> None:
    """u = x is given at both ends, which lie over a foundation that it does not meet: the energy is 1 / 2."""
    problem = rm.ContactProblem(
        rectangle(3, 2, x=(1, 2)),
        rm.Laplace(),
        (rm.Dirichlet("left", (1.0,)), rm.Dirichlet("right", (2.0,))),
        rm.Obstacle("bottom", normal=(1.0,), offset=lambda x, y: 0.1 - x),
        order=order,
    )
    assert admissible(problem).energy == pytest.approx(0.5, rel=1e-9)
