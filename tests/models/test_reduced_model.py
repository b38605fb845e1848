"""Energies, objectives, Lagrangians: derivatives in all unknowns and in the outer variables alone."""

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy.sparse as sp

import rmesh_nlp as rm
from rmesh_nlp.contact import active_set, system
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.fem.objectives import ENERGY
from rmesh_nlp.models import reduced_nlp as module
from rmesh_nlp.models import second_derivatives
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.models.reduced_model import ReducedEnergy, ReducedObjective
from rmesh_nlp.models.reduced_nlp import STIFF, reduced_nlp
from support.curved import CURVES, HOLE, disc, plate
from support.orders import slow_but
from support.problems import no_move_limits
from support.reduced import CONTACTS, OTHERS, QUADRATIC, bumpy, membrane_over_a_bump, of_order_2, reduced
from support.taylor import difference_order, taylor_order

BENT_LOAD = (lambda x, y: x * y, lambda x, y: ca.sin(x))


def with_exact(problem: rm.ContactProblem) -> rm.ContactProblem:
    """With some smooth solution, whose traction does not vanish at x = 0, where nodes of 6.3 do not touch."""
    if problem.exact is not None:
        return problem
    value = [lambda x, y: -1e-3 * (x + 1) * y, lambda x, y: -1e-2 * (x * x + y)][: problem.components]
    smooth = rm.ExactSolution(lambda x, y: ca.vertcat(*(component(x, y) for component in value)), 0.0)
    return replace(problem, exact=smooth)


OBJECTIVES = [
    ("6.1", "error-energy"),
    ("6.1", "contact"),
    ("6.3", "contact"),
    ("6.3", "energy + 0.1*quality"),
    ("6.3, order 2", "error-energy"),
    ("sloped, stick and slip", "error-l2"),
    ("curved foundation, stick and slip", "energy"),
]
"""Each objective, and each kind of contact."""


def order_at_random(function: Any, n: int, seed: int, size: float) -> float:
    rng = np.random.default_rng(seed)
    q, d = size * rng.uniform(-1, 1, n), rng.uniform(-1, 1, n)
    assert not np.any(function(q).weak)
    return taylor_order(function, q, d)


def test_solves_are_counted_warm_or_cold_and_that_of_the_given_mesh_when_it_is_first_asked_for(monkeypatch):
    def counts(energy: ReducedEnergy) -> tuple[int, int, int]:
        return energy.contact_solves, energy.cold_solves, energy.factorisations

    outer = rm.Outer.of(rm.EXAMPLES["6.3"]((4, 2)))
    energy, zero, given = outer.energy, np.zeros(outer.n), outer.contact.given
    assert counts(energy) == (0, 0, 0)
    assert energy(zero).equilibrium is given
    assert counts(energy) == (1, 1, given.iterations)
    q = np.random.default_rng(0).uniform(-0.3, 0.3, outer.n)
    with monkeypatch.context() as patch:
        patch.setattr(active_set, "first_set", lambda _: pytest.fail("it begins anew"))
        first = energy(q)
        assert energy(q.copy()) is first
        q *= 0.5  # the point that is remembered has positions of its own
        second = energy(q)
    cold = ContactSolver(outer.problem).solve(energy.relocation.nodes(q))
    iterations = [state.iterations for state in (given, first.equilibrium, second.equilibrium)]
    assert counts(energy) == (3, 1, sum(iterations))
    assert second.value == pytest.approx(cold.energy, rel=1e-10)
    assert not np.any(second.weak)
    assert energy(zero).equilibrium is given
    assert counts(energy)[:2] == (3, 1)
    later = outer.minimising(outer.objective).energy  # knows it, and is asked for another point before
    later(q + 0.1)
    later(zero)
    assert counts(later)[:2] == (2, 2)


GEOMETRIES = ("gaps along edges", "two foundations", "graph, no normal varies", "two obstacles at a node")
PROBLEMS = {
    **CONTACTS,
    "along a circle": lambda: plate({"hole": HOLE}, delta=0.4, load=BENT_LOAD),
    "along a parametrised curve": lambda: plate({"hole": CURVES["parametrised"]}, delta=0.4, load=BENT_LOAD),
    **{name: OTHERS[name] for name in GEOMETRIES},
    **QUADRATIC,
}
KINDS = "6.1", "curved foundation, stick and slip", "along a parametrised curve", "gaps along edges"
KINDS += "6.3, order 2", "two obstacles at a node, order 2"


@pytest.mark.parametrize("name", slow_but(PROBLEMS, *KINDS))
def test_both_derivatives_of_the_energy(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    energy, rng = reduced(PROBLEMS[name]()), np.random.default_rng(1)
    assert order_at_random(energy, energy.relocation.parts.n_q, 1, 0.6) >= 1.9
    q, d, other = rng.uniform(-1, 1, (3, energy.relocation.parts.n_q)) * [[0.3], [1], [1]]
    hessian = energy.hessian(energy(q))
    product = hessian(d)
    assert difference_order(lambda x: energy(x).gradient, product, q, d, 2e-3) > 1.9
    assert other @ product == pytest.approx(d @ hessian(other), rel=1e-9)
    assert np.all(hessian.diagonal() > 0)
    # one by one, in columns, or all at once
    both = hessian(np.column_stack([d, other]))
    monkeypatch.setattr(second_derivatives, "DENSE", 0)
    alone = energy.hessian(energy(q))
    size = np.max(np.abs(both))
    np.testing.assert_allclose(both, np.column_stack([alone(d), alone(other)]), atol=1e-10 * size)
    np.testing.assert_allclose(both[:, 0], product, atol=1e-10 * size)
    # the same as a Schur complement of a sparse matrix
    blocks = hessian.outer, hessian.mixed, hessian.stiffness
    outer, mixed, stiffness = (block.toarray() for block in blocks)
    schur = outer - mixed.T @ np.linalg.solve(stiffness, mixed)
    np.testing.assert_allclose(schur @ d, product, atol=1e-9 * np.max(np.abs(schur)))
    assert np.linalg.eigvalsh(stiffness).min() > 0


@pytest.mark.slow
@pytest.mark.parametrize(("name", "objective"), OBJECTIVES)
def test_both_derivatives_of_objectives(name: str, objective: str) -> None:
    """By the adjoint, which for the energy are those of the reduced energy."""
    energy, rng = reduced(with_exact((CONTACTS | QUADRATIC)[name]())), np.random.default_rng(1)
    function = ReducedObjective(energy, parse_objective(objective))
    assert order_at_random(function, energy.relocation.parts.n_q, 1, 0.5) >= 1.9
    q, d = rng.uniform(-1, 1, (2, energy.relocation.parts.n_q)) * [[0.3], [1]]
    here = function(q)
    hessian = function.hessian(here)
    assert difference_order(lambda x: function(x).gradient, hessian(d), q, d, 2e-3) > 1.9
    if objective == "energy":
        envelope = energy(q)
        assert (envelope.is_energy, here.is_energy) == (True, False)
        assert here.value == pytest.approx(envelope.value, rel=1e-12)
        for found, known in ((here.gradient, envelope.gradient), (hessian(d), energy.hessian(envelope)(d))):
            np.testing.assert_allclose(found, known, atol=1e-9 * np.max(np.abs(known)))


@pytest.mark.parametrize(
    "name", slow_but(["6.1", "sloped, stick and slip", "two obstacles at a node"], "sloped, stick and slip")
)
def test_factors_of_the_contact_solve_serve_other_objectives(name, monkeypatch):
    outer, rng = rm.Outer.of((CONTACTS | OTHERS)[name]()), np.random.default_rng(1)
    conditions, point = outer.conditions, outer.energy.solved(0.2 * rng.uniform(-1, 1, outer.n))
    monkeypatch.setattr(system, "factorised", lambda _: pytest.fail("a second factorisation"))
    at = conditions.at(point)
    right = rng.uniform(-1, 1, (at.equations.size, 2))
    linearised = at.jacobian[at.equations][:, outer.n :]
    for matrix, transposed in ((linearised, False), (linearised.T, True)):
        np.testing.assert_allclose(matrix @ at.solve(right, transposed), right, atol=1e-10)


def large_limits() -> rm.ContactProblem:
    return rm.EXAMPLES["6.2"]((6, 3), (0.6, 0.3))


def with_angles() -> rm.ContactProblem:
    return replace(rm.EXAMPLES["6.1"](4, 0.1), motion=rm.Motion(0.1, min_angle=30.0))


@pytest.mark.parametrize(
    "make",
    [
        *(large_limits, with_angles, CONTACTS["sloped, stick and slip"], OTHERS["two foundations"]),
        *map(of_order_2, (large_limits, CONTACTS["sloped, stick and slip"], disc)),
    ],
)
def test_a_contact_solution_is_a_kkt_point_with_the_contact_forces_as_multipliers(make) -> None:
    energy = ReducedEnergy(ContactSolver(make()), ENERGY)
    rel, nlp = energy.relocation, energy.relocation.nlp
    point = energy(0.2 * np.random.default_rng(0).uniform(-1, 1, rel.parts.n_q))
    x = energy.unknowns(point.q, point.equilibrium.u)
    value, gradient = (part.full().ravel() for part in nlp.derivatives.grad_f(x, []))
    g, jacobian = (part.full() for part in nlp.derivatives.jac_g(x, []))
    assert value[0] == pytest.approx(point.equilibrium.energy, rel=1e-10)
    # minimised over u and s alone; the multipliers of slips share the friction bound
    lam = np.zeros(rel.rows.size)
    lam[rel.rows["gaps"]] = point.equilibrium.normal_force
    if rel.parts.n_s:
        bound = point.system.slip_bound[rel.parts.friction_rows]
        tau = point.equilibrium.tangential_force[rel.parts.friction_rows]
        lam[rel.rows["minus"]], lam[rel.rows["plus"]] = (bound - tau) / 2, (bound + tau) / 2
    residual = gradient - jacobian.T @ lam
    scale = np.max(np.abs(jacobian.T @ lam)) or np.max(np.abs(gradient))
    np.testing.assert_allclose(residual[rel.parts.n_q :], 0, atol=1e-9 * scale)
    np.testing.assert_allclose(residual[: rel.parts.n_q], point.gradient, atol=1e-9 * scale)
    rows = g.ravel()[: rel.parts.pairs.size]
    assert rows.min() > -1e-9
    np.testing.assert_allclose(rows * lam[: rows.size], 0, atol=1e-9 * scale)


def test_a_distortion_stands_in_the_place_of_area_constraints_but_not_of_angles() -> None:
    problem, barrier = no_move_limits(rm.EXAMPLES["6.1"](4)), parse_objective("energy + 0.1*quality")
    angles = replace(problem, motion=replace(problem.motion, min_angle=10))
    n = problem.mesh.t.shape[1]
    found = [relocation(problem), relocation(problem, barrier), relocation(angles, barrier)]
    assert [rel.n_valid for rel in found] == [n, 0, 4 * n]
    with pytest.raises(ValueError, match="error-l2"):  # no term in the positions alone
        relocation(problem, parse_objective("error-l2 + 0.1*quality"))


@pytest.mark.parametrize("make", [large_limits, with_angles])
def test_element_constraints_have_their_derivatives(make) -> None:
    rel, rng = relocation(make()), np.random.default_rng(2)
    rows, (q, d) = rel.validity, 0.2 * rng.uniform(-1, 1, (2, rel.parts.n_q))
    multipliers = rng.random(rel.n_valid)
    there, here, before = (rows.at(q + t * d) for t in (1.0, 0.0, -1.0))
    # the rows are quadratic: these differences are exact
    np.testing.assert_allclose((there.slack - before.slack) / 2, here.jacobian @ d, atol=1e-12)
    change = (there.jacobian - before.jacobian).T @ multipliers / 2
    np.testing.assert_allclose(change, rows.hessian(q, multipliers) @ d, atol=1e-12)


ENERGIES = {
    "6.1, areas": lambda: rm.EXAMPLES["6.1"](3, 0.9),
    "6.2, gaps that move": lambda: rm.EXAMPLES["6.2"]((6, 3), (1.0, 0.5)),
    "6.3, friction": lambda: rm.EXAMPLES["6.3"]((6, 3), (1.0, 0.5)),
    "gaps along edges": lambda: bumpy(0.0),
    "gaps along edges, friction": lambda: bumpy(0.3),
}
ENERGIES |= {f"{name}, order 2": of_order_2(make) for name, make in ENERGIES.items()}
ENERGIES["bump, order 2"] = lambda: replace(membrane_over_a_bump(), motion=rm.Motion(None), order=2)


def whole(upper: ca.DM) -> Array:
    found = upper.full()
    assert np.all(np.tril(found, -1) == 0)
    return found + np.triu(found, 1).T


def test_derivatives_are_those_of_the_lagrangian() -> None:
    function = rm.Outer.of(replace(rm.EXAMPLES["6.1"](3), order=2), "error-l2").function
    nlp, rng = reduced_nlp(function), np.random.default_rng(4)
    derivatives, n = nlp.derivatives, nlp.n_x
    q, d = rng.uniform(-1, 1, (2, n)) * [[0.02], [1]]
    lam_f, lam_g = 1.5, rng.uniform(-1, 0, nlp.n_g)
    assert float(derivatives.grad_f(q, [])[0]) == pytest.approx(function(q).value)

    def gradient(x: Array) -> Array:
        slope = derivatives.grad_f(x, [])[1].full().ravel()
        return lam_f * slope + derivatives.jac_g(x, [])[1].T.full() @ lam_g

    product = whole(derivatives.hess_lag(q, [], lam_f, lam_g)) @ d
    assert difference_order(gradient, product, q, d, 1e-3) == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize(
    "name", slow_but(ENERGIES, "6.1, areas", "gaps along edges, friction", "6.3, friction, order 2")
)
def test_the_schur_complement_in_q_is_the_dense_hessian(name: str) -> None:
    function = rm.Outer.of(ENERGIES[name]()).energy
    larger, n, rng = reduced_nlp(function), function.relocation.parts.n_q, np.random.default_rng(7)
    q, lam_g = 0.02 * rng.uniform(-1, 1, n), rng.uniform(-1, 0, larger.n_g)
    curvature = function.hessian(function(q))(np.eye(n))
    areas = function.relocation.validity.hessian(q, lam_g).toarray() if lam_g.size else 0.0
    for factor in (1.5, 0.0):
        matrix = whole(larger.derivatives.hess_lag(np.append(q, np.zeros(larger.n_x - n)), [], factor, lam_g))
        corner, expected = matrix[n:, n:], factor * curvature + areas
        schur = matrix[:n, :n] - matrix[:n, n:] @ np.linalg.solve(corner, matrix[n:, :n])
        np.testing.assert_allclose(schur, expected, atol=1e-9 * np.max(np.abs(expected)))
        # definite, and so stiff that a shift of the size of q's block does not change the complement
        assert np.linalg.eigvalsh(corner)[0] > 0
        np.testing.assert_allclose(np.diag(corner), STIFF * np.max(np.abs(matrix[:n, :n])), rtol=1e-9)


def test_entries_outside_the_pattern_are_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        module, "_pattern", lambda rel: sp.csc_array(sp.eye_array(rel.parts.n_q + rel.parts.n_u))
    )
    larger = reduced_nlp(rm.Outer.of(bumpy(0.0)).energy)
    with pytest.raises(RuntimeError, match="outside its pattern"):
        larger.derivatives.hess_lag(np.zeros(larger.n_x), [], 1.0, np.zeros(larger.n_g))


def test_energy_has_the_digits_of_its_strains_however_far_the_body_moves() -> None:
    """A square that falls by 1000 and is then compressed by 1e-4: E (1e-4)^2 / 2, E = 1 in plane stress."""
    problem = rm.ContactProblem(
        mesh=rm.shapes.rectangle(4, 4),
        law=rm.PlaneStress.from_young(1.0, 0.3),
        dirichlet=(rm.Dirichlet("left", (0.0, None)), rm.Dirichlet("top", (None, -1000.0001))),
        obstacle=rm.Obstacle.line("bottom", point=(0.0, -1000.0), normal=(0.0, 1.0)),
        order=2,
    )
    outer = rm.Outer.of(problem, ENERGY)
    values = [outer.function(0.02 * q).value for q in np.random.default_rng(0).uniform(-1, 1, (3, outer.n))]
    assert values == pytest.approx([5e-9] * 3, rel=1e-6)


def test_meshes_with_inverted_elements_have_no_energy() -> None:
    outer = rm.Outer.of(rm.EXAMPLES["6.1"](3, 0.9))
    nlp, q = reduced_nlp(outer.energy), np.random.default_rng(0).uniform(-1, 1, outer.n)
    x = np.append(q, np.zeros(nlp.n_x - q.size))
    assert np.isnan(float(nlp.derivatives.grad_f(x, [])[0]))
