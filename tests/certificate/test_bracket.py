"""The bracket holds the least energy, closes at the rate of the order, and says what is not guaranteed."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import pytest
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTri

import rmesh_nlp as rm
from rmesh_nlp.assessment.admissible import admissible
from rmesh_nlp.certificate import NotCertifiableError, equilibration
from rmesh_nlp.certificate.bracket import AT_NODES, Bracket, bracket, edge_residual, refined_bracket, turning
from rmesh_nlp.certificate.conditions import conditions_of
from rmesh_nlp.certificate.equilibration import Guess, equilibrated
from rmesh_nlp.certificate.fields import TraceFields, element_of, law_of
from rmesh_nlp.certificate.skeleton import skeleton_of
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.examples.paper import EXACT_ENERGY_61
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.fem.bernstein import functions
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.solving.certify import certify, with_upper
from support.certificates import distorted, guess_on, of_values, proved, signorini
from support.formulations import fixed, joint
from support.frames import turned
from support.orders import ORDERS
from support.rules import HIDDEN, coarsen

TURN, SHIFT = np.array([[0.8, -0.6], [0.6, 0.8]]), np.array([1.0, -2.0])
SIDES = ("left", "right", "top", "bottom")


def bracket_of(problem: rm.ContactProblem) -> Bracket:
    return bracket(problem, problem.mesh.p, guess_on(problem))


def one_way(value: float, bound: float) -> bool:
    """Whether a bound is exact but for the contact iteration, which stops early, and not above the value."""
    return value - 2e-6 * abs(value) <= bound <= value + 1e-12 * abs(value)


def adds_up(found: Bracket, rel: float = 1e-9) -> None:
    assert np.sum(found.local) == pytest.approx(found.upper - found.lower, rel=rel)


def along_one_axis(k: float, f: float, start: float, end: float) -> float:
    """Energy of -k w'' = f with given ends: the flux is linear, as that of the elements."""
    x, weights = np.polynomial.legendre.leggauss(4)
    x = (1 + x) / 2
    slope = end - start + f / (2 * k)
    w, flux = start + slope * x - f / (2 * k) * x**2, k * slope - f * x
    return float(weights / 2 @ (flux**2 / (2 * k) - f * w))


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("end", [0.3, 0.85])
def test_the_lower_bound_is_exact_where_the_flux_is_linear(sign: float, end: float, order: int) -> None:
    """A membrane with k = 2 and f = 3 that touches its obstacle at 0.3, or ends free at 0.85, before 0.9."""
    k, f, start = 2.0, 3.0, 0.1
    gap = end if end < 0.8 else 0.9
    mesh = distorted(rectangle(3, 3), 0.2, 1)
    held = (rm.Dirichlet("left", (sign * start,)),)
    problem = rm.ContactProblem(mesh, rm.Laplace(sign * f, k), held, rm.Obstacle("right", (-sign,), gap))
    energy, found = along_one_axis(k, f, start, end), bracket_of(problem)
    assert one_way(energy, found.lower)
    assert found.why == (f"upper: {AT_NODES}",)
    assert found.upper > energy + 1e-2
    adds_up(found)
    # a traction does what the obstacle did
    pulled = replace(
        problem, obstacle=(), tractions=(rm.Traction("right", (sign * (k * (end - start) - f / 2),)),)
    )
    work = (k * (end - start) - f / 2) * end
    assert bracket_of(pulled).lower == pytest.approx(energy - work, rel=1e-12)


@pytest.mark.parametrize("slip", [0.03, -0.03, 0.0])
def test_bounds_meet_where_a_linear_displacement_slides_or_sticks(slip: float) -> None:
    """Shear carries the friction bound 0.5, or 0.3 where it sticks, on an oblique side."""
    mu, gap, bound, turn = 2.0, 0.1, 0.5, 0.6
    shear = (np.sign(slip) * bound if slip else 0.3) / mu
    Q = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    slope = Q @ np.array([[0.0, shear], [0.0, -0.4]]) @ Q.T
    shift = Q @ np.array([slip, -gap])
    flat = distorted(rectangle(3, 3), 0.2, 3)
    mesh = replace(flat, doflocs=Q @ flat.p)
    given = tuple(lambda x, y, i=i: slope[i, 0] * x + slope[i, 1] * y + shift[i] for i in range(2))
    sides = tuple(rm.Dirichlet(side, given) for side in ("left", "right", "top"))
    obstacle = rm.Obstacle("bottom", tuple(Q[:, 1]), gap, friction=bound)
    problem = rm.ContactProblem(mesh, rm.PlaneStrain(3.0, mu), sides, obstacle)
    u = slope @ mesh.p + shift[:, None]
    strain = (slope + slope.T) / 2
    energy = 3.0 * np.trace(strain) ** 2 / 2 + mu * np.sum(strain**2) + bound * abs(slip)
    pressure, friction = np.full((2, u.shape[1]), [[7.0 * 0.4], [-mu * shear]])
    found = bracket(problem, mesh.p, Guess(u, pressure, friction))
    assert found.upper == pytest.approx(energy, rel=1e-12)
    assert found.lower == pytest.approx(energy, rel=1e-12)
    assert found.why == (f"upper: {AT_NODES}",)
    assert np.max(np.abs(found.local)) < 1e-12
    assert energy * (1 - 1e-3) <= bracket_of(problem).lower <= energy * (1 + 1e-12)
    # whatever contact forces it begins with, none at all or too large ones
    for part in (0.0, 30.0):
        forces = np.full(u.shape[1], part)
        rough = bracket(problem, mesh.p, Guess(u, forces, -forces))
        assert rough.lower == pytest.approx(energy, rel=1e-10)
        assert rough.upper == pytest.approx(energy, rel=1e-10)
        adds_up(rough)


@pytest.mark.parametrize("order", ORDERS)
def test_exact_energy_of_61_is_inside_before_and_after(order: int) -> None:
    problem = rm.EXAMPLES["6.1"](4, order=order)
    for formulation in (fixed, joint):
        found = certify(formulation.solve(problem))
        assert found.guaranteed_lower
        assert found.guaranteed_upper
        assert found.lower <= EXACT_ENERGY_61 <= found.upper
    assert found.error_bound < found.error_bound_initial


def block(**changes) -> rm.ContactProblem:
    settings = {
        "mesh": rectangle(6, 3, x=(0, 2)),
        "law": rm.PlaneStrain(10.0, 8.0, (0.0, -1.0)),
        "dirichlet": ("left",),
        "obstacle": rm.Obstacle("bottom", (0.0, 1.0), friction=0.1),
        "tractions": (rm.Traction("top", (0.0, -0.5)),),
    }
    return rm.ContactProblem(**{**settings, **changes})


CIRCLES = {
    "circle": (rm.Obstacle.circle, (0.9, -2.0), 2.0),
    "hole": (partial(rm.Obstacle.circle, inside=True), (1.0, 3.0), 3.2),
}


@pytest.mark.parametrize("kind", ["membrane", "elastic", "rough", "two foundations", *CIRCLES])
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (5, 9))])
@pytest.mark.parametrize("order", ORDERS)
def test_bounds_hold_on_finer_meshes(kind, seed, order):
    """The lower bound of a coarse, distorted mesh lies below the energy of a fine one, and close to it."""
    if kind == "two foundations":
        coarse = block(obstacle=(rm.Obstacle("bottom"), rm.Obstacle("right", (-1.0, 0.0), 0.001)))
    elif kind in CIRCLES:
        make, *place = CIRCLES[kind]
        coarse = block(
            obstacle=make("bottom", *place, friction=0.1 * seed),
            dirichlet=(rm.Dirichlet("top", (0.1, -0.05)),),
        )
    else:
        coarse = random_problem(seed, kind=kind)
        coarse = turned(coarse, TURN, SHIFT) if kind in ("elastic", "rough") and seed else coarse
    coarse = replace(coarse, mesh=distorted(coarse.mesh, 0.2, seed), order=order)
    fine = replace(coarse, mesh=coarse.mesh.refined(2))
    rough, close = bracket_of(coarse), bracket_of(fine)
    assert not rough.lower_faults
    assert not close.lower_faults
    assert rough.residual < 1e-10
    assert rough.lower <= close.lower <= close.upper
    assert close.upper - close.lower < 0.3 * (rough.upper - rough.lower)
    adds_up(rough, 1e-6)
    upper = with_upper(rough, admissible(coarse))
    assert not upper.upper_faults
    assert upper.upper >= with_upper(close, admissible(fine)).upper


def bottom(gap: Callable) -> rm.Obstacle:
    return rm.Obstacle("bottom", (0.0, 1.0), gap)


def held(uy: Callable) -> tuple[rm.Dirichlet, ...]:
    return (rm.Dirichlet("left", (0.0, uy)),)


def jump(x, y) -> ca.SX:
    return ca.if_else(x + 0.3 * y > 0.77, -0.5, 0.0)


def root(x, y) -> ca.SX:
    return ca.sqrt(x)


def wavy(x, y) -> ca.SX:
    return ca.if_else(ca.sin(3 * x) > 0.5, -0.5, 0.0)


OBLIQUE = rm.Obstacle.line("bottom", (0.0, -0.1), (0.1, 1.0))
ROLLERS = (
    rm.Dirichlet("left", (0.0, None)),
    rm.Dirichlet("right", (None, 0.0)),
    rm.Dirichlet("bottom", (0.0, None)),
)


@pytest.mark.parametrize(
    ("changes", "guaranteed", "why"),
    [
        ({"obstacle": bottom(lambda x, y: 0.02 * (1 - (x - 1) ** 2))}, (True, True), ""),
        # nodes obey a gap that the edges between them violate: an admissible displacement keeps off
        ({"obstacle": bottom(lambda x, y: 0.02 * (x - 1) ** 2)}, (True, True), ""),
        ({"dirichlet": held(lambda x, y: 0.1 * y**2)}, (True, False), "not of the order"),
        # given parabolas hold everywhere at order 2, and nothing passes between the nodes
        ({"dirichlet": held(lambda x, y: 0.1 * y**2), "order": 2}, (True, True), ""),
        ({"obstacle": bottom(lambda x, y: 0.02 * (x - 1) ** 4), "order": 2}, (True, True), ""),
        ({"dirichlet": held(lambda x, y: 0.1 * y**3), "order": 2}, (True, False), "not of the order"),
        ({"tractions": rm.Traction("top", (0.0, jump))}, (True, True), ""),
        ({"law": rm.PlaneStrain(10.0, 8.0, (0.0, jump))}, (True, True), ""),
        # it is not known with certainty where
        ({"tractions": rm.Traction("top", (0.0, wavy))}, (False, False), "jumps"),
        ({"law": rm.PlaneStrain(10.0, 8.0, (0.0, wavy))}, (False, False), "jumps"),
        ({"dirichlet": ROLLERS[:2]}, (True, True), ""),
        ({"dirichlet": ("left", ROLLERS[2])}, (True, True), ""),  # it slides along what it may touch
    ],
)
def test_what_is_guaranteed_and_why_not(changes: dict[str, Any], guaranteed: tuple, why: str) -> None:
    found = proved(block(**changes))
    assert (not found.lower_faults, not found.upper_faults) == guaranteed
    assert why in " ".join(found.why)
    assert bool(found.why) is bool(why)


@pytest.mark.parametrize(
    "problem",
    [
        block(law=rm.PlaneStrain(10.0, 8.0, (0.0, lambda x, y: 6 * root(x, y)))),
        block(obstacle=bottom(lambda x, y: 0.1 * root(x, y) + 0.05)),
        block(tractions=(rm.Traction("top", (0.0, lambda x, y: 6 * root(x, y))),)),
        rm.ContactProblem(
            rectangle(3, 3),
            rm.Laplace(-5.0),
            SIDES,
            rm.Obstacle.interior(lambda x, y: 0.3 * ca.sqrt(x) - 0.4),
        ),
    ],
    ids=["load", "gap", "traction", "inside"],
)
def test_what_two_rules_disagree_by_is_between_the_bounds(problem, monkeypatch):
    coarsen(monkeypatch)
    found = bracket_of(problem)
    assert found.upper - found.lower > np.sum(found.local) + 1e-6


@pytest.mark.parametrize("hidden", HIDDEN[:6:2])
def test_what_no_rule_sees_is_found_or_leaves_no_guarantee(hidden):
    """Least energies of a membrane under hidden loads; the least one is that on a mesh with nodes there."""
    ends = np.r_[np.linspace(0, 1.5, 4), 1.99 - np.geomspace(0.1, 1e-5, 5), 1.99, 1.9905, 1.9995, 2]
    mesh, fine = rectangle(4, 2, x=(0, 2)), rectangle(ends.size - 1, 2)
    places = np.stack([np.interp(fine.p[0], np.linspace(0, 1, ends.size), ends), fine.p[1]])
    load = rm.Traction("top", (hidden,))
    problem = rm.ContactProblem(mesh, rm.Laplace(-1.0), ("bottom",), tractions=load, order=2)
    found, least = proved(problem), proved(replace(problem, mesh=replace(fine, doflocs=places)))
    assert found.why or (found.lower <= least.upper and least.lower <= found.upper)


def test_obstacles_with_ridges_along_straight_lines_are_certain() -> None:
    """The obstacle of R. H. Nochetto, K. G. Siebert, A. Veeser, Numer. Math. 95 (2003) 163-195."""

    def obstacle(x: ca.SX, y: ca.SX) -> ca.SX:
        def inside(half: float) -> ca.SX:
            return half - ca.fmax(ca.fabs(x), ca.fabs(y))

        return inside(1.0) - 2 * ca.fmax(inside(0.25), 0) - 0.2

    mesh = rectangle(4, 4, x=(-1, 1), y=(-1, 1))
    problem = rm.ContactProblem(mesh, rm.Laplace(-5.0), SIDES, rm.Obstacle.interior(obstacle))
    assert not proved(problem).why
    needle = rm.Obstacle.interior(lambda x, y: ca.fmax(-0.5, 0.3 - 1e4 * ca.fabs(x - 0.51)))
    assert proved(replace(problem, obstacle=needle)).why


def test_an_element_of_no_thickness_is_refused_or_flagged():
    """Never a bound that rounding has made."""
    for thin in (1e-3, 1e-5, 1e-8):
        mesh = rectangle(3, 3)
        p = mesh.p.copy()
        p[1, np.isclose(p[1], 2 / 3)] = 1 / 3 + thin
        problem = block(mesh=replace(mesh, doflocs=p))
        try:
            found = bracket_of(problem)
        except NotCertifiableError as error:
            assert "thin" in str(error)  # noqa: PT017
        else:
            assert found.residual < 1e-10 or found.lower_faults


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"obstacle": (rm.Obstacle("bottom"), rm.Obstacle("bottom", (0.6, 0.8)))}, "two obstacles"),
        ({"obstacle": rm.Obstacle("bottom", coulomb=0.3)}, "no energy is minimised"),
        ({"point_loads": (rm.PointLoad(9, (0.0, -1.0)),)}, "point load"),
        ({"dirichlet": ("left", ROLLERS[2]), "obstacle": OBLIQUE}, "oblique"),
    ],
)
def test_what_cannot_be_certified_is_said(changes, reason):
    problem = block(**changes)
    with pytest.raises(NotCertifiableError, match=reason):
        bracket(problem, problem.mesh.p, guess_on(problem, np.zeros(problem.mesh.p.shape)))


@pytest.mark.slow
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("held", [ROLLERS[:1], ()])
def test_body_that_contact_alone_holds_is_bounded(held, order):
    """Nothing in the bounds needs a rigid motion to cost energy."""
    under = rm.Obstacle.graph("bottom", lambda x, y: -0.01 * (x - 1) ** 2)
    beside = () if held else (rm.Obstacle.line("left", (-0.01, 0.0), (1.0, 0.0)),)
    pushed = (rm.Traction("top", (-0.1, lambda x, y: -0.5 - 0.1 * x)),)
    problem = block(dirichlet=held, obstacle=(under, *beside), tractions=pushed, order=order)
    found = certify(fixed.solve(problem))
    fine = fixed.solve(replace(rm.refined(rm.refined(problem)), order=2))
    assert found.guaranteed_lower
    assert found.guaranteed_upper
    assert found.lower <= fine.energy_audited <= found.upper
    assert found.upper - found.lower < {1: 0.3, 2: 0.03}[order] * abs(found.upper)
    weight = 2 * 1.0 + 2 * 0.5 + 0.2  # of body and traction: all of it rests on the bottom
    bounds = found.bounds["resultant(bottom)"]
    assert bounds.lower <= weight <= bounds.upper
    assert bounds.upper - bounds.lower < 2e-4 * weight


@pytest.mark.parametrize("order", ORDERS)
def test_what_polynomials_leave_of_contact_on_a_circle_is_known(order):
    """Pressure and friction on it, less their best approximation by Gauss points, and only there."""
    round_one = rm.Obstacle.circle("bottom", (1.2, -0.8), 0.8, friction=0.1)
    problem = block(obstacle=(round_one, rm.Obstacle("top", (0.0, -1.0), 0.01)), order=order, tractions=())
    skeleton = skeleton_of(problem, problem.mesh.p)
    balance = equilibrated(problem, skeleton, guess_on(problem)).balance
    conditions = balance.assembled.conditions
    found, part = turning(skeleton, conditions, balance), conditions.parts[0]
    x, weights = np.polynomial.legendre.leggauss(20)
    s, weights = (1 + x) / 2, np.sqrt(weights / 2)
    shapes = functions(order, np.stack([1 - s, s]))
    a, b = skeleton.nodes[:, skeleton.ends[:, part.edges]].transpose(1, 0, 2)
    points = a[..., None] * (1 - s) + b[..., None] * s
    normal = round_one.normals(points)
    along = (balance.pressure[:, part.place].T @ shapes, balance.friction[:, part.place].T @ shapes)
    stress = along[0] * normal + along[1] * np.stack([normal[1], -normal[0]])
    own = (stress * weights).reshape(-1, s.size).T
    left = own - (Q := np.linalg.qr((shapes * weights).T)[0]) @ (Q.T @ own)
    norm = np.sqrt(np.sum(left.T.reshape(2, -1, s.size) ** 2, axis=(0, 2)) * skeleton.lengths[part.edges])
    assert np.max(norm) > 1e-5 * np.max(np.abs(own))
    np.testing.assert_allclose(found[part.edges], norm, rtol=1e-6, atol=1e-7 * np.max(np.abs(own)))
    assert np.count_nonzero(found) <= part.edges.size


@pytest.mark.parametrize("order", ORDERS)
def test_a_field_of_no_stress_is_in_equilibrium(order: int) -> None:
    """It is the best one on few edges over a narrow foundation; what is left of its forces is rounding."""
    narrow, pressed = rm.Obstacle.circle("bottom", (0.5, -0.8), 0.8), (rm.Dirichlet("top", (0.0, -0.01)),)
    problem = rm.ContactProblem(rectangle(1, 1), rm.PlaneStrain(3.0, 2.0), pressed, narrow, order=order)
    found = bracket_of(problem)
    assert not found.lower_faults
    assert found.lower == pytest.approx(0, abs=1e-12)


def test_equilibrium_is_checked_and_can_fail():
    problem = block()
    guess, skeleton = guess_on(problem), skeleton_of(problem, problem.mesh.p)
    conditions = conditions_of(problem, skeleton)
    field = equilibrated(problem, skeleton, guess)
    assert edge_residual(skeleton, conditions, field) < 1e-11
    balance, spoilt = field.balance, field.forces.copy()
    spoilt[3, 5] *= 1.01
    turned_over = replace(balance.assembled, normals=-balance.assembled.normals)  # in balance, but it pulls
    pulled = replace(balance, pressure=-balance.pressure, assembled=turned_over)
    rough = replace(balance, friction=balance.friction + 1.0)
    for change in ({"forces": spoilt}, {"balance": pulled}, {"balance": rough}):
        assert edge_residual(skeleton, conditions, replace(field, **change)) > 1e-6
    slippery = replace(conditions, friction=0 * conditions.friction)
    # friction beyond its bound either way: along the tangent, and against it
    other_way = replace(balance.assembled, tangents=-balance.assembled.tangents)
    mirrored = replace(field, balance=replace(balance, friction=-balance.friction, assembled=other_way))
    assert edge_residual(skeleton, slippery, field) > 1e-6
    assert edge_residual(skeleton, slippery, mirrored) == edge_residual(skeleton, slippery, field)


def test_oscillation_doubts_and_imbalance_lower_the_bound_by_what_they_may_cost(monkeypatch):
    """D - sum (eta_T r_T + r_T^2 / 2), doubtful given displacements, strain times imbalance."""
    problem, name, r = block(dirichlet=held(lambda x, y: 0.1)), "rmesh_nlp.certificate.bracket.", 0.1
    field = equilibrated(problem, skeleton_of(problem, problem.mesh.p), guess_on(problem))
    first = bracket_of(problem)
    monkeypatch.setattr(name + "oscillation", lambda *_: np.full(field.variation.size, r))
    second = bracket_of(problem)
    assert first.lower - second.lower == pytest.approx(np.sum(field.variation * r + r**2 / 2))
    made = equilibration.conditions_of
    monkeypatch.setattr(equilibration, "conditions_of", lambda *of: replace(made(*of), given_doubt=0.01))
    third, reaction = bracket_of(problem), abs(field.balance.reaction_work)
    assert 1e-3 < second.lower - third.lower == pytest.approx(0.01 * reaction)
    monkeypatch.setattr(name + "edge_residual", lambda *_: 0.3)
    fourth = bracket_of(problem)
    assert third.lower - fourth.lower >= 0.3 * (np.sum(field.energy) + 0.99 * reaction)
    assert "out of equilibrium by 3.0e-01" in fourth.lower_faults[0]


def test_it_is_a_bound_where_the_contact_of_the_field_is_not_found(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, solve = block(), equilibration.solve
    best = bracket_of(problem)

    def failed(*given: Any) -> Any:
        state = solve(*given)
        return replace(state, normal_force=state.normal_force / 2, status=rm.Status.CYCLED, u=np.nan)

    monkeypatch.setattr(equilibration, "solve", failed)
    found = bracket_of(problem)
    assert not found.lower_faults
    assert found.lower < best.lower - 1e-3 * abs(best.lower)


def test_a_load_that_varies_within_elements_works_on_what_the_field_does_there():
    """Without the product of oscillation and variation the bound would be above the least energy."""
    source = rm.Laplace(lambda x, y: ca.sin(2 * ca.pi * x) * ca.sin(2 * ca.pi * y))
    found = bracket_of(rm.ContactProblem(rectangle(3, 3), source, SIDES))
    assert not found.lower_faults
    assert found.lower <= -1 / (64 * np.pi**2) <= found.upper  # an eigenfunction
    # a wave on each edge, without mean and moment there: u is cos(k x) sinh(k y)
    wave, k = rm.Traction("top", (lambda x, y: ca.cos(6 * ca.pi * x),)), 6 * np.pi
    found = bracket_of(rm.ContactProblem(rectangle(3, 3), rm.Laplace(0.0), ("bottom",), tractions=wave))
    assert found.lower <= -np.tanh(k) / (4 * k) <= found.upper


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["scalar", "elastic", "membrane", "rough"])
@pytest.mark.parametrize("order", ORDERS)
def test_a_finer_equilibration_bounds_the_same_displacement_more_closely(kind, order):
    problem = replace(random_problem(4, kind=kind), order=order)
    nodes, guess = np.asarray(problem.mesh.p), guess_on(problem)
    plain, finer = (refined_bracket(problem, nodes, guess, refinements) for refinements in (0, 1))
    assert finer.upper == pytest.approx(plain.upper, rel=1e-9)
    assert not finer.lower_faults
    assert plain.lower < finer.lower <= finer.upper
    fine = replace(problem, mesh=problem.mesh.refined(2))
    assert finer.lower <= bracket_of(fine).upper
    # what the children of an element add is counted for it: far from where the two differ they agree
    assert finer.local.shape == plain.local.shape
    adds_up(finer, 1e-6)
    assert np.corrcoef(finer.local, plain.local)[0, 1] > 0.8
    np.testing.assert_allclose(finer.field, plain.field, atol=0.5 * np.max(np.abs(plain.field)))
    assert refined_bracket(problem, nodes, guess).lower == finer.lower


@pytest.mark.parametrize(
    ("law", "order"), [(rm.PlaneStrain(3.0, 2.0), 1), (rm.Laplace(0.0, 2.0), 1), (rm.Laplace(0.0, 2.0), 2)]
)
def test_a_field_that_does_not_balance_its_load_is_noticed(
    law: rm.PlaneStrain | rm.Laplace, order: int
) -> None:
    mesh = distorted(rectangle(3, 2), 0.3, seed=1)
    problem = rm.ContactProblem(mesh, law, ("left",), order=order)
    skeleton, element, rng = skeleton_of(problem, mesh.p), element_of(problem), np.random.default_rng(0)
    functions = element.pieces.restriction.shape[2]
    load = rng.normal(size=(problem.components, functions, mesh.t.shape[1]))
    fields = TraceFields(element, skeleton, law_of(problem, skeleton), load)
    field = fields.of_traces(rng.normal(size=fields.source.shape))
    assert fields.imbalance(field, load) < 1e-12
    assert fields.imbalance(field, load * 1.01) > 1e-8
    bent = field.copy()  # in one coefficient on an edge, which no edge of a neighbour sees
    bent[-1, -1, 0] *= 1.01
    assert fields.imbalance(bent, load) > 1e-8


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    "law",
    [rm.PlaneStrain(3.0, 2.0), rm.PlaneStress(3.0, 2.0), rm.PlaneStrain(2e5, 1.0), rm.Laplace(0.0, 2.0)],
)
def test_patch(law: rm.PlaneStrain | rm.PlaneStress | rm.Laplace, order: int) -> None:
    """A displacement of the order is its own stress: bounds meet, and nothing is left to correct."""
    mesh = distorted(rectangle(3, 3), 0.25, seed=2)
    bent = (order - 1) / 10
    ux = lambda x, y: 0.3 * x - 0.2 * y + 0.1 + bent * (x * x - 3 * x * y + 2 * y * y)  # noqa: E731
    uy = lambda x, y: 0.7 * y + 0.4 * x + bent * (x * x + x * y)  # noqa: E731
    given, scalar = (ux, uy)[: len(law.load)], isinstance(law, rm.Laplace)
    if scalar:  # less the divergence of the flux
        law = replace(law, source=-2.0 * 6 * bent)
    else:  # grad div u = bent (3, -3), laplace u = bent (6, 2)
        lam, mu = law.in_plane_lambda, law.lame_mu
        law = replace(law, body_force=tuple(-bent * ((lam + mu) * a + mu * b) for a, b in ((3, 6), (-3, 2))))
    sides = tuple(rm.Dirichlet(side, given) for side in ("left", "right", "top", "bottom"))
    problem = rm.ContactProblem(mesh, law, sides, order=order)
    found = bracket(problem, mesh.p, guess_on(problem, of_values(problem, given)))
    assert not found.lower_faults
    assert not found.upper_faults
    assert found.upper - found.lower == pytest.approx(0, abs=1e-9 * abs(found.upper))
    assert np.max(found.local) <= 1e-9 * abs(found.upper)


def smooth(n: int, order: int) -> rm.ContactProblem:
    """u = sin(pi x) sin(pi y) under its source and, on the right, its traction; least energy -pi^2 / 4."""
    source = rm.Laplace(lambda x, y: 2 * np.pi**2 * ca.sin(np.pi * x) * ca.sin(np.pi * y))
    pull = rm.Traction("right", (lambda x, y: -np.pi * ca.sin(np.pi * y),))
    return rm.ContactProblem(rectangle(n, n), source, ("left", "bottom", "top"), tractions=pull, order=order)


def less_half_the_work(corners: list[complex]) -> float:
    """Least energy of the real part of z^(3/2), by the work of its fluxes along a polygon."""
    s, weights = np.polynomial.legendre.leggauss(200)
    total = 0.0
    for a, b in pairwise(corners):
        z = a + (b - a) * (1 + s) / 2
        log = np.log(np.abs(z)) + 1j * np.mod(np.angle(z), 2 * np.pi)
        # the flux out of the body is the derivative along -i (b - a)
        flux = np.real(-1j * (b - a) * 1.5 * np.exp(0.5 * log))
        total += weights / 2 @ (np.real(np.exp(1.5 * log)) * flux)
    return -total / 2


EXACT = {smooth: -(np.pi**2) / 4, signorini: less_half_the_work([1, 1 + 1j, -1 + 1j, -1])}


@pytest.mark.parametrize(
    ("make", "order", "rate"),
    [(smooth, 1, 2), (smooth, 2, 4), pytest.param(signorini, 2, 3, marks=pytest.mark.slow)],
)
def test_the_bracket_holds_the_least_energy_and_closes_at_the_rate_of_the_order(make, order, rate) -> None:
    widths = []
    for n in (4, 8):
        found = bracket_of(make(n, order))
        assert set(found.why) <= {f"upper: {AT_NODES}"}
        assert found.lower < EXACT[make] < found.upper
        assert found.upper - found.lower < 1.45 * (found.upper - EXACT[make])
        assert np.sum(found.local) == pytest.approx(found.upper - found.lower, rel=1e-4)
        assert np.all(found.local >= 0)
        widths.append(found.upper - found.lower)
    assert np.log2(widths[0] / widths[1]) > rate - 0.3


def test_what_is_left_of_a_load_by_elements_lowers_the_bound() -> None:
    """A source without moments on either triangle: zero is in equilibrium with it, and no minimiser."""
    mesh, powers = rectangle(1, 1), [(i, j) for i in range(4) for j in range(4 - i)]
    points, weights = get_quadrature(RefTri, 6)
    x, y = mesh.mapping().F(points)
    moments = [[(weights * x**i * y**j * test).sum(1) for i, j in powers] for test in (1.0, x, y)]
    own = np.linalg.svd(np.moveaxis(np.array(moments), 2, 0).reshape(6, -1))[2][-1]

    def source(x, y):
        return sum(1e3 * c * x**i * y**j for c, (i, j) in zip(own.tolist(), powers, strict=True))

    problem = rm.ContactProblem(mesh, rm.Laplace(source), SIDES)
    finer = replace(problem, order=2)
    for _ in range(3):
        finer = rm.refined(finer)
    guess = Guess(np.zeros((1, 4)), np.zeros(4), np.zeros(4))
    found, least = bracket(problem, mesh.p, guess), ContactSolver(finer).given.energy
    assert not found.lower_faults
    assert found.lower <= least < -1e-3
