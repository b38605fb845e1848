"""The bracket holds the least energy; what is not guaranteed is said."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import null_space

from rmesh_nlp.certificate import bracket as module
from rmesh_nlp.certificate.bracket import Bracket, bracket, edge_residual, refined_bracket
from rmesh_nlp.certificate.conditions import NotCertifiableError, conditions_of
from rmesh_nlp.certificate.integrals import integrals, loads
from rmesh_nlp.certificate.johnson_mercier import equilibrated_stress
from rmesh_nlp.certificate.oscillation import korn
from rmesh_nlp.certificate.skeleton import skeleton_of
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.paper import EXACT_ENERGY_61
from rmesh_nlp.examples.random_problems import Frame, random_problem
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import (
    ContactProblem,
    Dirichlet,
    Laplace,
    Motion,
    Obstacle,
    PlaneStrain,
    Traction,
)
from rmesh_nlp.solving.certify import certify
from support.certificates import distorted, guess_on
from support.formulations import fixed, joint

TURNED = Frame(np.array([[0.8, -0.6], [0.6, 0.8]]), np.array([1.0, -2.0]))


def bracket_of(problem: ContactProblem) -> Bracket:
    return bracket(problem, problem.mesh.p, guess_on(problem))


@pytest.mark.parametrize("n", [4, pytest.param(8, marks=pytest.mark.slow)])
def test_exact_energy_of_61_is_inside_before_and_after(n):
    problem = EXAMPLES["6.1"](n)
    for strategy in (fixed, joint):
        found = certify(strategy.solve(problem))
        assert found.guaranteed_lower
        assert found.guaranteed_upper
        assert found.lower <= EXACT_ENERGY_61 <= found.upper
    assert found.error_bound < found.error_bound_initial


@pytest.mark.parametrize("kind", ["scalar", "membrane", "elastic", "rough"])
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (5, 9))])
def test_bounds_of_random_problems_hold_on_finer_meshes(kind, seed):
    """The lower bound of a coarse, distorted mesh lies below the energy of a fine one, and close to it."""
    frame = {"frame": TURNED} if kind in ("elastic", "rough") and seed else {}
    coarse = random_problem(seed, kind=kind, **frame)
    coarse = replace(coarse, mesh=distorted(coarse.mesh, 0.2, seed))
    fine = replace(coarse, mesh=coarse.mesh.refined(2))
    rough, close = bracket_of(coarse), bracket_of(fine)
    assert rough.guaranteed_lower
    assert close.guaranteed_lower
    assert rough.residual < 1e-10
    assert rough.lower <= close.upper
    assert close.upper - close.lower < 0.25 * (rough.upper - rough.lower)
    assert np.sum(rough.local) == pytest.approx(rough.upper - rough.lower, rel=1e-6)
    if rough.guaranteed_upper:  # else contact may work on a gap that is negative between the nodes
        assert np.all(rough.local > -1e-12)


def test_bracket_does_not_depend_on_the_frame():
    one, other = (
        bracket_of(random_problem(3, kind="rough", frame=f)) for f in (Frame(np.eye(2), np.zeros(2)), TURNED)
    )
    assert other.upper == pytest.approx(one.upper, rel=1e-9)
    # the Newton steps that improve the contact forces stop at a part of the gain
    assert other.lower == pytest.approx(one.lower, abs=1e-4 * (one.upper - one.lower))


def test_any_contact_forces_give_a_bound_and_better_ones_a_better_bound():
    problem = random_problem(0, kind="rough")
    guess = guess_on(problem)
    wild = replace(guess, pressure=-7 + 100 * np.random.default_rng(0).random(guess.pressure.shape))
    as_given = bracket(problem, problem.mesh.p, wild, products=0)
    improved = bracket(problem, problem.mesh.p, wild)
    assert as_given.guaranteed_lower
    assert as_given.lower < improved.lower <= bracket_of(problem).upper


def block(**changes) -> ContactProblem:
    mesh = rectangle(6, 3, x=(0, 2))
    settings = {
        "mesh": mesh,
        "law": PlaneStrain(10.0, 8.0, (0.0, -1.0)),
        "dirichlet": ("left",),
        "obstacle": Obstacle("bottom", (0.0, 1.0), friction=0.1),
        "tractions": (Traction("top", (0.0, -0.5)),),
    }
    return ContactProblem(**{**settings, **changes})


def test_plain_data_are_guaranteed_on_both_sides():
    found = bracket_of(block())
    assert found.why == ()
    assert found.guaranteed_lower
    assert found.guaranteed_upper


def test_a_curved_foundation_leaves_the_lower_bound_alone():
    """Nodes obey a gap that the edges between them violate: only the lower bound is guaranteed."""
    curved = Obstacle("bottom", (0.0, 1.0), lambda x, y: 0.02 * (x - 1) ** 2)
    found = bracket_of(block(obstacle=curved))
    assert found.guaranteed_lower
    assert not found.guaranteed_upper
    assert "between" in " ".join(found.why)
    hollow = Obstacle("bottom", (0.0, 1.0), lambda x, y: 0.02 * (1 - (x - 1) ** 2))
    assert bracket_of(block(obstacle=hollow)).guaranteed_upper


def test_a_gap_is_not_called_safe_for_what_lies_between_the_points_where_it_is_looked_at():
    """It touches zero at two neighbouring points of an edge, and is negative amid them."""
    valley = Obstacle("bottom", (0.0, 1.0), lambda x, y: (3 * x - 16.5 / 32) ** 2 - 1 / 64**2)
    problem = block(obstacle=valley)
    found = bracket(problem, problem.mesh.p, guess_on(problem, np.zeros(problem.mesh.p.shape)))
    assert not found.guaranteed_upper


def test_friction_of_the_field_is_nowhere_above_its_bound():
    bound = lambda x, y: 0.2 + 5 * (x - 1 / 6) ** 2  # noqa: E731
    problem = block(obstacle=Obstacle("bottom", (0.0, 1.0), friction=bound))
    skeleton = skeleton_of(problem, problem.mesh.p)
    conditions = conditions_of(problem, skeleton)
    ends = skeleton.nodes[0, skeleton.ends[:, conditions.contact]]
    for s in np.linspace(0, 1, 33):
        linear, x = ((1 - s) * part[0] + s * part[1] for part in (conditions.friction, ends))
        assert np.all(linear <= bound(x, 0.0) + 1e-12)
    assert np.max(conditions.friction) > 1


def test_bounds_scale_with_moduli_and_loads():
    def of(unit: float) -> Bracket:
        load = (lambda x, y: unit * ca.sin(9 * x), lambda x, y: -unit * x * y)
        tractions = (Traction("top", (0.0, -0.5 * unit)),)
        return bracket_of(
            block(law=PlaneStrain(10.0 * unit, 8.0 * unit, load), tractions=tractions, obstacle=())
        )

    one, large = of(1.0), of(100.0)
    assert large.lower == pytest.approx(100 * one.lower, rel=1e-8)
    assert large.upper == pytest.approx(100 * one.upper, rel=1e-8)


def test_curved_given_displacements_leave_the_lower_bound_alone():
    bent = Dirichlet("left", (0.0, lambda x, y: 0.1 * y**2))
    found = bracket_of(block(dirichlet=(bent,), obstacle=Obstacle("bottom", (0.0, 1.0), 1.0)))
    assert found.guaranteed_lower
    assert not found.guaranteed_upper


def test_a_traction_that_jumps_inside_edges_is_flagged():
    jump = Traction("top", (0.0, lambda x, y: ca.if_else(x > 0.77, -0.5, 0.0)))
    assert not bracket_of(block(tractions=jump)).guaranteed_lower


def test_a_load_that_jumps_inside_elements_is_flagged():
    jump = PlaneStrain(10.0, 8.0, (0.0, lambda x, y: ca.if_else(x + 0.3 * y > 0.77, -3.0, 0.0)))
    found = bracket_of(block(law=jump))
    assert not found.guaranteed_lower
    # what the rules disagree by is between the bounds, beside what the elements add
    assert found.upper - found.lower > np.sum(found.local) + 1e-5
    assert "quadrature" in " ".join(found.why)


def test_roller_and_oblique_supports():
    """A component may be given where the other is in contact, unless the normal is oblique."""
    roller = (Dirichlet("left", (0.0, None)), Dirichlet("right", (None, 0.0)))
    assert bracket_of(block(dirichlet=roller)).guaranteed_lower
    both = (Dirichlet("left", (0.0, 0.0)), Dirichlet("bottom", (0.0, None)))
    assert bracket_of(block(dirichlet=both)).guaranteed_lower
    oblique = Obstacle.line("bottom", (0.0, -0.1), (0.1, 1.0))
    with pytest.raises(NotCertifiableError, match="oblique"):
        bracket_of(block(dirichlet=both, obstacle=oblique))


def test_two_foundations():
    wall = Obstacle("right", (-1.0, 0.0), 0.001)
    problem = block(obstacle=(Obstacle("bottom"), wall))
    found, fine = bracket_of(problem), bracket_of(replace(problem, mesh=problem.mesh.refined(2)))
    assert found.why == ()
    assert found.lower <= fine.lower <= fine.upper <= found.upper
    assert fine.upper - fine.lower < 0.3 * (found.upper - found.lower)


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
            assert found.residual < 1e-10 or not found.guaranteed_lower


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"obstacle": Obstacle.circle("bottom", (1.0, -5.0), 5.0)}, "turns along an edge"),
        ({"obstacle": (Obstacle("bottom"), Obstacle("bottom", (0.6, 0.8)))}, "two obstacles"),
        ({"dirichlet": (Dirichlet("left", (0.0, None)),)}, "only contact holds"),
    ],
)
def test_what_cannot_be_certified_is_said(changes, reason):
    problem = block(**changes)
    with pytest.raises(NotCertifiableError, match=reason):
        bracket(problem, problem.mesh.p, guess_on(problem, np.zeros(problem.mesh.p.shape)))


def test_equilibrium_is_checked_and_can_fail():
    problem = block()
    guess, skeleton = guess_on(problem), skeleton_of(problem, problem.mesh.p)
    conditions = conditions_of(problem, skeleton)
    field = equilibrated_stress(problem, skeleton, conditions, loads(problem, skeleton), guess, 20)
    assert edge_residual(skeleton, conditions, field) < 1e-11
    spoilt = field.forces.copy()
    spoilt[3, 5] *= 1.01
    assert edge_residual(skeleton, conditions, replace(field, forces=spoilt)) > 1e-6
    pulled = replace(field.balance, pressure=field.balance.pressure - np.max(field.balance.pressure))
    assert edge_residual(skeleton, conditions, replace(field, balance=pulled)) > 1e-6
    rough = replace(field.balance, friction=field.balance.friction + 1.0)
    assert edge_residual(skeleton, conditions, replace(field, balance=rough)) > 1e-6
    slippery = replace(conditions, friction=0 * conditions.friction)
    assert edge_residual(skeleton, slippery, field) > 1e-6


def test_without_its_oscillation_term_a_bound_would_be_wrong(monkeypatch):
    """A source with no linear part on any element still does work: only the oscillation term knows."""
    mesh = rectangle(1, 1)
    powers = [(i, j) for i in range(4) for j in range(4 - i)]
    moments = [integrals(lambda x, y, p=p: x ** p[0] * y ** p[1], mesh.p[:, mesh.t]).moments for p in powers]
    weights = null_space(np.array([m.ravel() for m in moments]).T)[:, 0] * 1e3
    source = Laplace(lambda x, y: sum(w * x**i * y**j for w, (i, j) in zip(weights, powers, strict=True)))
    sides = tuple(Dirichlet(side, (0.0,)) for side in ("left", "right"))
    problem = ContactProblem(mesh, source, sides)
    fine = bracket_of(replace(problem, mesh=problem.mesh.refined(4)))
    assert bracket_of(problem).lower <= fine.upper
    monkeypatch.setattr(module, "oscillation", lambda skeleton, *_: np.zeros(skeleton.areas.size))
    assert bracket_of(problem).lower > fine.upper


def test_a_load_that_varies_within_elements_works_on_what_the_field_does_there():
    """Without the product of oscillation and variation the bound would be above the least energy."""
    sides = ("left", "right", "top", "bottom")
    source = Laplace(lambda x, y: ca.sin(2 * ca.pi * x) * ca.sin(2 * ca.pi * y))
    found = bracket_of(ContactProblem(rectangle(3, 3), source, sides))
    assert found.guaranteed_lower
    assert found.lower <= -1 / (64 * np.pi**2) <= found.upper  # an eigenfunction


def test_korn_constant_is_that_of_the_literature_and_not_too_small():
    """Rayleigh quotients of polynomials without mean rotation stay below the constant."""
    skeleton = skeleton_of(block(), distorted(block().mesh, 0.3, 4).p)
    rng = np.random.default_rng(1)
    for _ in range(50):
        a = rng.normal(size=(2, 3))  # a quadratic displacement: its gradient at barycentric corners is linear
        x = skeleton.nodes[:, skeleton.triangles] - skeleton.centres[:, None]
        slope = np.array(
            [[2 * a[i, 0] * x[0] + a[i, 1] * x[1], a[i, 1] * x[0] + 2 * a[i, 2] * x[1]] for i in range(2)]
        )
        strain = (slope + slope.transpose(1, 0, 2, 3)) / 2
        mass = (np.ones((3, 3)) + np.eye(3)) / 12
        norms = [np.einsum("ijke,kl,ijle->e", g, mass, g) for g in (slope, strain)]
        assert np.all(norms[0] <= korn(skeleton) ** 2 * norms[1])


def test_a_changed_domain_keeps_its_own_bounds():
    mesh = rectangle(4, 2, x=(0, 2))
    problem = block(mesh=mesh, motion=Motion((0.05, 0.05), free=("right",)))
    found = certify(joint.solve(problem))
    assert found.guaranteed_lower
    assert found.lower <= found.upper


@pytest.mark.parametrize(
    "kind",
    ["scalar", "elastic", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("membrane", "rough"))],
)
def test_a_finer_equilibration_bounds_the_same_displacement_more_closely(kind):
    problem = random_problem(4, kind=kind)
    nodes, guess = np.asarray(problem.mesh.p), guess_on(problem)
    plain, finer = (refined_bracket(problem, nodes, guess, refinements) for refinements in (0, 1))
    assert finer.upper == pytest.approx(plain.upper, rel=1e-9)
    assert finer.guaranteed_lower
    assert plain.lower < finer.lower <= finer.upper
    fine = replace(problem, mesh=problem.mesh.refined(2))
    assert finer.lower <= bracket_of(fine).upper
    # what the children of an element add is counted for it: far from where the two differ they agree
    assert finer.local.shape == plain.local.shape
    assert np.sum(finer.local) == pytest.approx(finer.upper - finer.lower, rel=1e-6)
    assert np.corrcoef(finer.local, plain.local)[0, 1] > 0.8
    assert finer.field.shape == plain.field.shape
    assert np.corrcoef(finer.field.ravel(), plain.field.ravel())[0, 1] > 0.9
    assert refined_bracket(problem, nodes, guess).lower == finer.lower
