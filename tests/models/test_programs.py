"""Programs in all unknowns and in the outer variables alone: Lagrangians, Hessians, element constraints."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import scipy.sparse as sp

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.evaluation import Array
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.fem.objectives import ENERGY
from rmesh_nlp.models import reduced_nlp as module
from rmesh_nlp.models.energy_nlp import ElementConstraints, relocation
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.models.reduced_nlp import STIFF, reduced_nlp
from rmesh_nlp.models.second_derivatives import curvature_of
from rmesh_nlp.problem import ContactProblem, Motion
from rmesh_nlp.solving.outer import Outer
from support.curved import disc
from support.orders import slow_but
from support.problems import no_move_limits
from support.reduced import CONTACTS, OTHERS, bumpy, membrane_over_a_bump, of_order_2
from support.taylor import difference_order


def large_limits() -> ContactProblem:
    return EXAMPLES["6.2"]((6, 3), (0.6, 0.3))


def with_angles() -> ContactProblem:
    return replace(EXAMPLES["6.1"](4, 0.1), motion=Motion(0.1, min_angle=30.0))


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
    lam = np.zeros(rel.n_rows)
    lam[rel.gap_rows] = point.equilibrium.normal_force
    if rel.parts.n_s:
        bound = point.system.slip_bound[rel.parts.friction_rows]
        tau = point.equilibrium.tangential_force[rel.parts.friction_rows]
        lam[rel.parts.n_contact : rel.parts.n_contact + rel.parts.n_s] = (bound - tau) / 2
        lam[rel.slip_rows] = (bound + tau) / 2
    residual = gradient - jacobian.T @ lam
    scale = np.max(np.abs(jacobian.T @ lam)) or np.max(np.abs(gradient))
    np.testing.assert_allclose(residual[rel.parts.n_q :], 0, atol=1e-9 * scale)
    np.testing.assert_allclose(residual[: rel.parts.n_q], point.gradient, atol=1e-9 * scale)
    rows = g.ravel()[: rel.parts.n_contact + 2 * rel.parts.n_s]
    assert rows.min() > -1e-9
    np.testing.assert_allclose(rows * lam[: rows.size], 0, atol=1e-9 * scale)


def test_a_distortion_stands_in_the_place_of_area_constraints_but_not_of_angles() -> None:
    problem, barrier = no_move_limits(EXAMPLES["6.1"](4)), parse_objective("energy + 0.1*quality")
    angles = replace(problem, motion=replace(problem.motion, min_angle=10))
    n = problem.mesh.t.shape[1]
    found = [relocation(problem), relocation(problem, barrier), relocation(angles, barrier)]
    assert [rel.n_valid for rel in found] == [n, 0, 4 * n]
    with pytest.raises(ValueError, match="error-l2"):  # no term in the positions alone
        relocation(problem, parse_objective("error-l2 + 0.1*quality"))


@pytest.mark.parametrize("make", [large_limits, with_angles])
def test_element_constraints_have_their_derivatives(make) -> None:
    rel, rng = relocation(make()), np.random.default_rng(2)
    rows, (q, d) = ElementConstraints(rel), 0.2 * rng.uniform(-1, 1, (2, rel.parts.n_q))
    multipliers = rng.random(rel.n_valid)
    there, here, before = (rows.at(q + t * d) for t in (1.0, 0.0, -1.0))
    # the rows are quadratic: these differences are exact
    np.testing.assert_allclose((there.slack - before.slack) / 2, here.jacobian @ d, atol=1e-12)
    change = (there.jacobian - before.jacobian).T @ multipliers / 2
    np.testing.assert_allclose(change, rows.hessian(q, multipliers) @ d, atol=1e-12)


ENERGIES = {
    "6.1, areas": lambda: EXAMPLES["6.1"](3, 0.9),
    "6.2, gaps that move": lambda: EXAMPLES["6.2"]((6, 3), (1.0, 0.5)),
    "6.3, friction": lambda: EXAMPLES["6.3"]((6, 3), (1.0, 0.5)),
    "gaps along edges": lambda: bumpy(0.0),
    "gaps along edges, friction": lambda: bumpy(0.3),
}
ENERGIES |= {f"{name}, order 2": of_order_2(make) for name, make in ENERGIES.items()}
ENERGIES["bump, order 2"] = lambda: replace(membrane_over_a_bump(), motion=Motion(None), order=2)


def whole(upper: ca.DM) -> Array:
    found = upper.full()
    assert np.all(np.tril(found, -1) == 0)
    return found + np.triu(found, 1).T


@pytest.mark.parametrize("order", [1, 2])
def test_derivatives_are_those_of_the_lagrangian(order: int) -> None:
    function = Outer.of(replace(EXAMPLES["6.1"](3), order=order), "error-l2").function
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


@pytest.mark.parametrize("name", slow_but(ENERGIES, ("6.3, friction, order 2",)))
def test_the_schur_complement_in_q_is_the_dense_hessian(name: str) -> None:
    function = Outer.of(ENERGIES[name]()).energy
    larger, n, rng = reduced_nlp(function), function.relocation.parts.n_q, np.random.default_rng(7)
    q, lam_g = 0.02 * rng.uniform(-1, 1, n), rng.uniform(-1, 0, larger.n_g)
    curvature = curvature_of(function)(function(q))(np.eye(n))
    areas = function.validity.hessian(q, lam_g).toarray() if lam_g.size else 0.0
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
    larger = reduced_nlp(Outer.of(bumpy(0.0)).energy)
    with pytest.raises(RuntimeError, match="outside its pattern"):
        larger.derivatives.hess_lag(np.zeros(larger.n_x), [], 1.0, np.zeros(larger.n_g))


def test_meshes_with_inverted_elements_have_no_energy() -> None:
    outer = Outer.of(EXAMPLES["6.1"](3, 0.9))
    nlp, q = reduced_nlp(outer.energy), np.random.default_rng(0).uniform(-1, 1, outer.n)
    x = np.append(q, np.zeros(nlp.n_x - q.size))
    assert np.isnan(float(nlp.derivatives.grad_f(x, [])[0]))
