"""The energy NLP: its Lagrangian, its parts, and element constraints."""

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.models.energy_nlp import ElementConstraints, relocation, with_lower_rule
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.problem import ContactProblem, Motion
from rmesh_nlp.solving.outer import Outer
from support.problems import no_boxes, sloped_block


def large_limits() -> ContactProblem:
    return EXAMPLES["6.2"]((12, 6), (0.3, 0.15))


def with_angles() -> ContactProblem:
    return replace(EXAMPLES["6.1"](6, 0.08), motion=Motion(0.08, min_angle=30.0))


@pytest.mark.parametrize("make", [large_limits, sloped_block, with_angles])
def test_a_contact_solution_is_a_kkt_point_with_the_contact_forces_as_multipliers(make) -> None:
    rel = relocation(make())
    q = 0.2 * np.random.default_rng(0).uniform(-1, 1, rel.n_q)
    point = ReducedEnergy(rel, ContactSolver(rel.discretisation))(q)
    x = ReducedEnergy(rel, ContactSolver(rel.discretisation)).point(q, point.equilibrium)
    nlp = rel.nlp
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
    nlp = rel.nlp
    assert [part.shape[0] for part in nlp.parts.values()] == [rel.n_q, rel.n_u, rel.n_s]
    np.testing.assert_array_equal(nlp.ubx[: rel.n_q], 1)
    np.testing.assert_array_equal(nlp.lbx, -nlp.ubx)
    assert np.all(np.isinf(nlp.ubx[rel.n_q :]))
    np.testing.assert_array_equal(nlp.lbg[: rel.n_contact + 2 * rel.n_s], 0)
    np.testing.assert_array_equal(nlp.lbg[-rel.n_valid :], rel.problem.motion.min_area_fraction)
    parts = rel.split(np.arange(rel.n_x))
    assert [part.size for part in parts] == [rel.n_q, rel.n_u, rel.n_s]


def test_a_distortion_stands_in_the_place_of_area_constraints_but_not_of_angles() -> None:
    problem = no_boxes(EXAMPLES["6.1"](4))
    assert relocation(problem).n_valid == problem.mesh.t.shape[1]
    assert relocation(problem, parse_objective("energy + 0.1*quality")).n_valid == 0
    angles = replace(problem, motion=replace(problem.motion, min_angle=10))
    assert relocation(angles, parse_objective("energy + 0.1*quality")).n_valid == 4 * problem.mesh.t.shape[1]


def test_other_terms_do_not_collapse() -> None:
    with pytest.raises(ValueError, match="error-l2"):
        relocation(EXAMPLES["6.1"](3), parse_objective("error-l2 + 0.1*quality"))


def test_a_lower_rule_is_that_of_the_loads_alone() -> None:
    rel = relocation(replace(EXAMPLES["6.1"](3), quadrature=6))
    lower = with_lower_rule(rel, 3)
    assert (lower.problem.rule, with_lower_rule(rel, 6)) == (3, rel)
    nodes = lower.problem.mesh.p
    energies = [ContactSolver(one.problem).solve(nodes).energy for one in (lower, relocation(lower.problem))]
    assert energies[0] == energies[1]


@pytest.mark.parametrize("make", [large_limits, with_angles])
def test_element_constraints_have_their_derivatives(make) -> None:
    rel = relocation(make())
    rows = ElementConstraints(rel)
    rng = np.random.default_rng(2)
    q, d = 0.2 * rng.uniform(-1, 1, (2, rel.n_q))
    multipliers = rng.random(rel.n_valid)
    there, here, before = (rows.at(q + t * d) for t in (1.0, 0.0, -1.0))
    # the rows are quadratic: these differences are exact
    np.testing.assert_allclose((there.slack - before.slack) / 2, here.jacobian @ d, atol=1e-12)
    change = (there.jacobian - before.jacobian).T @ multipliers / 2
    np.testing.assert_allclose(change, rows.hessian(q, multipliers) @ d, atol=1e-12)


def test_a_step_leaves_elements_a_part_of_their_slack_unless_they_have_little() -> None:
    rel = relocation(large_limits())
    rows = ElementConstraints(rel)
    far, near = (rows.at(t * np.ones(rel.n_q)) for t in (0.0, 0.0))
    np.testing.assert_allclose(far.floor, 0.01 * far.slack)
    fraction = 1 - 5e-3  # on the given mesh every element has a slack of 5e-3 then
    tight = replace(rel.problem, motion=replace(rel.problem.motion, min_area_fraction=fraction))
    near = ElementConstraints(relocation(tight)).at(np.zeros(rel.n_q))
    np.testing.assert_allclose(near.slack, 5e-3)
    np.testing.assert_allclose(near.floor, 1e-9)


def test_inverted_elements_come_back_to_their_floor() -> None:
    outer = Outer(large_limits())
    rows, n = ElementConstraints(outer.relocation), outer.relocation.n_q
    one = np.ones(n)
    q = 0.6 * np.random.default_rng(0).uniform(-1, 1, n)
    assert not outer.is_valid(q)
    back = rows.back(q, rows.at(np.zeros(n)), -one, one, one)
    assert back is not None
    assert outer.is_valid(back)
    assert np.max(np.abs(back)) <= 1
    assert np.array_equal(rows.back(back, rows.at(back), -one, one, one), back)
    wild = np.random.default_rng(0).uniform(-1, 1, n)  # too many elements to bring back
    assert rows.back(wild, rows.at(np.zeros(n)), -one, one, one) is None
