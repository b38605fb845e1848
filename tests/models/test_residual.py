"""The first-order residual of the outer problem, in histories and in records, and multipliers of bounds."""

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.mapping import Mobility
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.models.residual import OuterResidual, Released, released, size_of
from rmesh_nlp.problem import ContactProblem, Dirichlet, Laplace, Motion
from rmesh_nlp.solving.outer import Outer
from support.contact_geometry import block_sliding_on_a_circle
from support.curved import HOLE, plate
from support.problems import sloped_block


@pytest.mark.parametrize("n", [3, 6])
def test_relative_residual_is_one_on_given_mesh_and_less_where_bounds_hold_back(n: int) -> None:
    outer = Outer.of(EXAMPLES["6.1"](n))
    point = outer.energy(np.zeros(outer.n))
    residual = outer.residual
    assert residual(point) == pytest.approx(1.0)
    assert residual.unit == pytest.approx(np.max(np.abs(point.gradient)))
    # |q - clip(q - g / unit)|, component by component
    q, g = np.zeros(outer.n), np.zeros(outer.n)
    q[:3], g[:3] = (1.0, -1.0, 0.75), (-3.0 * residual.unit, 0.5 * residual.unit, -residual.unit)
    assert residual.at(q, g) == pytest.approx(0.25)
    g[0] *= -1
    assert residual.at(q, g) == pytest.approx(2.0)
    assert residual.at(q, np.full(q.size, np.nan)) == np.inf


def test_the_unit_has_a_floor_in_units_of_the_objective() -> None:
    outer = Outer.of(EXAMPLES["6.2"]((4, 2)))
    point = outer.energy(np.zeros(outer.n))
    still = replace(point, gradient=0 * point.gradient)
    strain = 0.5 * point.equilibrium.u @ (point.system.stiffness @ point.equilibrium.u)
    assert size_of(still) == pytest.approx(max(strain, abs(point.value)))
    assert size_of(replace(still, is_energy=False, value=-2.0)) == 2.0
    assert OuterResidual(outer.energy, still).unit == pytest.approx(1e-6 * size_of(still))


def test_contact_forces_of_a_solvers_own_give_the_gradient_of_the_contact_solution(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    outer = Outer.of(block_sliding_on_a_circle())
    q = 0.1 * np.random.default_rng(0).uniform(-1, 1, outer.n)
    point, rel, residual = outer.energy(q), outer.relocation, outer.residual
    state, rows = point.equilibrium, rel.parts.friction_rows
    bound, tau = point.system.slip_bound[rows], state.tangential_force[rows]
    lam_g = -np.concatenate([state.normal_force, (bound - tau) / 2, (bound + tau) / 2, np.zeros(rel.n_valid)])
    np.testing.assert_allclose(rel.forces(lam_g)[0], state.normal_force)
    np.testing.assert_allclose(rel.forces(lam_g)[1], tau)
    assert residual.of_state(q, state.u, state.normal_force, tau) == pytest.approx(residual(point), rel=1e-9)
    monkeypatch.setattr(OuterResidual, "at", lambda self, q, gradient: (q, gradient))
    at, gradient = residual.of_state(q, state.u, state.normal_force, tau)
    np.testing.assert_array_equal(at, q)
    np.testing.assert_allclose(gradient, point.gradient, atol=1e-9 * np.max(np.abs(point.gradient)))


def test_multipliers_of_elements_with_slack_are_no_equilibrium() -> None:
    room = 1e-5
    given = EXAMPLES["6.2"]((4, 2), 0.6)
    outer = Outer.of(replace(given, motion=replace(given.motion, min_area_fraction=1 - room)))
    residual, q = outer.residual, np.zeros(outer.n)
    rows = outer.energy.validity.at(q)
    # a gradient that multipliers of the elements explain as a whole
    pull = residual.unit * rows.jacobian.T @ np.ones(rows.slack.size)
    assert residual.at(q, np.asarray(pull)) == pytest.approx(room)
    assert residual.at(q, np.zeros(q.size)) == 0
    found = released(outer.energy, q, np.asarray(pull)).multipliers
    assert found.area.shape == (given.mesh.t.shape[1],)
    areas = found.area[outer.relocation.validity.elements]
    np.testing.assert_allclose(rows.jacobian.T @ areas, pull, atol=1e-9)
    assert not np.any(found.limit)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_multiplier_of_a_move_limit_is_the_rate_per_length(sign: float) -> None:
    """Limits are 0.1 by 0.05 over slopes of 1 and 4 %: x is the side that stops nodes there."""
    outer = Outer.of(sloped_block())
    free, q, gradient = outer.relocation.parts.mesh_map, np.zeros(outer.n), np.zeros(outer.n)
    index = free.positions.index
    slanted = next(n for n in outer.problem.contact_nodes if index[0, n] == index[1, n] >= 0)
    inner = int(np.flatnonzero(free.mobility == Mobility.FREE)[0])
    q[index[0, slanted]], gradient[index[0, slanted]] = sign, -3.0 * sign
    q[index[1, inner]], gradient[index[1, inner]] = sign, -2.0 * sign
    gradient[index[0, inner]] = 7.0  # inside its limits
    found = released(outer.energy, q, gradient).multipliers.limit
    assert found[slanted] == pytest.approx(3.0 / 0.1)
    assert found[inner] == pytest.approx(2.0 / 0.05)
    assert np.count_nonzero(found) == 2
    assert not np.any(released(outer.energy, q, np.abs(gradient) * sign).multipliers.limit)  # pushed inwards


def test_a_move_limit_along_a_curve_is_a_length_of_it() -> None:
    outer = Outer.of(plate({"hole": HOLE}, delta=0.4))
    index = outer.relocation.parts.mesh_map.positions.index
    node = outer.problem.boundary_nodes(("hole",))[3]
    q, gradient = np.zeros(outer.n), np.zeros(outer.n)
    q[index[0, node]], gradient[index[0, node]] = 1.0, -2.0
    found = released(outer.energy, q, gradient).multipliers.limit
    assert found[node] == pytest.approx(2.0 / 0.4, rel=1e-6)


def test_rows_of_an_element_are_its_area_and_then_its_angles() -> None:
    problem = EXAMPLES["6.1"](3)
    outer = Outer.of(replace(problem, motion=Motion(None, min_angle=20.0)))
    validity = outer.relocation.validity
    per_element = validity.rows_per_element
    assert per_element == 4
    values = np.arange(validity.elements.size * per_element) + 1.0
    none = np.zeros(outer.n)
    found = Released(outer.relocation, none, none, none, values).multipliers
    np.testing.assert_array_equal(found.area[validity.elements], values[::4])
    np.testing.assert_array_equal(found.angle[validity.elements], values.reshape(-1, 4)[:, 1:].sum(axis=1))


def test_a_gradient_that_is_no_number_has_no_multipliers_of_elements() -> None:
    given = EXAMPLES["6.2"]((4, 2), 0.6)
    outer = Outer.of(replace(given, motion=replace(given.motion, min_area_fraction=1 - 1e-6)))
    rates = released(outer.energy, np.zeros(outer.n), np.full(outer.n, np.nan))
    assert rates.residual(1.0) == np.inf
    assert not np.any(rates.multipliers.area)


def test_energies_that_cancel_are_measured_by_their_size() -> None:
    """-u'' = -6 with u = 1 at one end and free at the other: 6 are stored, and done by the load."""
    outer = Outer.of(ContactProblem(rectangle(8, 1), Laplace(-6.0), Dirichlet("left", 1.0), motion=Motion(0)))
    point = outer.energy(np.zeros(outer.n))
    assert abs(point.value) < 0.1 < 2 < size_of(point)
