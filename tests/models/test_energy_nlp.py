"""The energy NLP: its Lagrangian, its parts, and element constraints."""

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.fem.objectives import ENERGY
from rmesh_nlp.models.energy_nlp import ElementConstraints, relocation
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.problem import ContactProblem, Motion
from rmesh_nlp.solving.outer import Outer
from support.contact_geometry import block_between_two_foundations
from support.curved import disc
from support.problems import no_move_limits, renumbered, sloped_block
from support.reduced import of_order_2


def large_limits() -> ContactProblem:
    return EXAMPLES["6.2"]((12, 6), (0.3, 0.15))


def with_angles() -> ContactProblem:
    return replace(EXAMPLES["6.1"](6, 0.08), motion=Motion(0.08, min_angle=30.0))


@pytest.mark.parametrize(
    "make",
    [
        *(large_limits, sloped_block, with_angles, block_between_two_foundations),
        *map(of_order_2, (large_limits, sloped_block, disc)),
    ],
)
def test_a_contact_solution_is_a_kkt_point_with_the_contact_forces_as_multipliers(make) -> None:
    """In whatever order the displacement space numbers its nodes."""
    energy = ReducedEnergy.of(ContactSolver(renumbered(make())), ENERGY)
    rel, nlp = energy.relocation, energy.relocation.nlp
    point = energy(0.2 * np.random.default_rng(0).uniform(-1, 1, rel.n_q))
    x = energy.point(point.q, point.equilibrium)
    value, gradient = (part.full().ravel() for part in nlp.derivatives.grad_f(x, []))
    g, jacobian = (part.full() for part in nlp.derivatives.jac_g(x, []))
    assert value[0] == pytest.approx(point.equilibrium.energy, rel=1e-10)
    # minimised over u and s alone; the multipliers of slips share the friction bound
    lam = np.zeros(rel.n_rows)
    lam[rel.gap_rows] = point.equilibrium.normal_force
    if rel.n_s:
        bound = point.system.slip_bound[rel.friction_rows]
        tau = point.equilibrium.tangential_force[rel.friction_rows]
        lam[rel.n_contact : rel.n_contact + rel.n_s] = (bound - tau) / 2
        lam[rel.slip_rows] = (bound + tau) / 2
    residual = gradient - jacobian.T @ lam
    scale = np.max(np.abs(jacobian.T @ lam)) or np.max(np.abs(gradient))
    np.testing.assert_allclose(residual[rel.n_q :], 0, atol=1e-9 * scale)
    np.testing.assert_allclose(residual[: rel.n_q], point.gradient, atol=1e-9 * scale)
    rows = g.ravel()[: rel.n_contact + 2 * rel.n_s]
    assert rows.min() > -1e-9
    np.testing.assert_allclose(rows * lam[: rows.size], 0, atol=1e-9 * scale)


def test_bounds_are_move_limits_and_least_areas() -> None:
    rel = relocation(large_limits())
    nlp, sizes = rel.nlp, [rel.n_q, rel.n_u, rel.n_s]
    assert [part.shape[0] for part in nlp.parts.values()] == sizes
    assert [part.size for part in rel.split(np.arange(rel.n_x))] == sizes
    np.testing.assert_array_equal(nlp.ubx[: rel.n_q], 1)
    np.testing.assert_array_equal(nlp.lbx, -nlp.ubx)
    assert np.all(np.isinf(nlp.ubx[rel.n_q :]))
    np.testing.assert_array_equal(nlp.lbg[: rel.n_contact + 2 * rel.n_s], 0)
    np.testing.assert_array_equal(nlp.lbg[-rel.n_valid :], rel.problem.motion.min_area_fraction)


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
    rows, (q, d) = ElementConstraints(rel), 0.2 * rng.uniform(-1, 1, (2, rel.n_q))
    multipliers = rng.random(rel.n_valid)
    there, here, before = (rows.at(q + t * d) for t in (1.0, 0.0, -1.0))
    # the rows are quadratic: these differences are exact
    np.testing.assert_allclose((there.slack - before.slack) / 2, here.jacobian @ d, atol=1e-12)
    change = (there.jacobian - before.jacobian).T @ multipliers / 2
    np.testing.assert_allclose(change, rows.hessian(q, multipliers) @ d, atol=1e-12)


@pytest.mark.parametrize(("slack", "floor"), [(0.9, 0.009), (5e-3, 1e-9)])
def test_a_step_leaves_elements_a_part_of_their_slack_unless_they_have_little(slack, floor) -> None:
    motion = replace(large_limits().motion, min_area_fraction=1 - slack)
    rel = relocation(replace(large_limits(), motion=motion))
    rows = ElementConstraints(rel).at(np.zeros(rel.n_q))
    np.testing.assert_allclose(rows.slack, slack)
    np.testing.assert_allclose(rows.floor, floor)


def test_inverted_elements_come_back_to_their_floor() -> None:
    outer = Outer.of(large_limits())
    rows, one, rng = ElementConstraints(outer.relocation), np.ones(outer.n), np.random.default_rng(0)
    wild = rng.uniform(-1, 1, outer.n)
    given = rows.at(0 * one)
    assert not outer.is_valid(0.6 * wild)
    back = rows.back(0.6 * wild, given, -one, one, one)
    assert back is not None
    assert outer.is_valid(back)
    assert np.max(np.abs(back)) <= 1
    np.testing.assert_array_equal(rows.back(back, rows.at(back), -one, one, one), back)
    assert rows.back(wild, given, -one, one, one) is None  # too many elements to bring back
