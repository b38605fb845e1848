"""Descents with a distortion, the first-order residual, and multipliers of bounds."""

from dataclasses import replace

import numpy as np
import pytest

import rmesh_nlp as rm
from formulations.nested import Nested
from rmesh_nlp.assessment.admissible import admissible
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.discretisation import discretise
from rmesh_nlp.fem.assembly import element_values
from rmesh_nlp.fem.distortion import distortion
from rmesh_nlp.fem.fields import Fields, constant_field
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.mapping import Mobility
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.models.descent import KEPT, longest_valid, node_widths
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.models.regularisation import gain_estimate, regularised, weights
from rmesh_nlp.models.residual import OuterResidual, Released, released, size_of
from rmesh_nlp.solving.parts import Step
from support.contact_geometry import block_sliding_on_a_circle
from support.curved import HOLE, plate
from support.problems import no_move_limits, sloped_block
from support.reduced import free_membrane, with_distortion


def test_distortions_of_a_stretched_mesh_by_hand() -> None:
    problem = free_membrane()
    a, b = 2.0, 0.25  # along x and y: |A|^2 = a^2 + b^2, det A = a b
    parts, positions = discretise(problem), constant_field(problem.mesh.p * np.array([[a], [b]]))
    stretched = Fields(parts.space, positions, parts.displacement, parts.slip)
    shape, size = (a**2 + b**2) / (2 * a * b) - 1, (a * b + 1 / (a * b) - 2) / 2
    elastic = (a**2 + b**2 + a**-2 + b**-2) / 4 - 1
    for name, value in {"quality": shape, "shape-size": shape + size, "elastic": elastic}.items():
        (found,) = element_values(distortion(name, stretched))(np.zeros(0))
        assert found.sum() == pytest.approx(value)


def test_widths_are_heights_in_units_of_the_outer_variables() -> None:
    for legs, problem in ((1 / 4, rm.EXAMPLES["6.1"](n=4)), (1 / 8, rm.EXAMPLES["6.1"](n=8))):
        rel = relocation(replace(problem, motion=rm.Motion(None)))
        # right isosceles triangles, moves in units of the shortest edge: all heights are alike
        np.testing.assert_allclose(node_widths(rel, np.zeros(rel.parts.n_q)), np.sqrt(0.5))
        limited = relocation(replace(problem, motion=rm.Motion((0.02, 0.01))))
        width = node_widths(limited, np.zeros(limited.parts.n_q))
        index = limited.parts.mesh_map.positions.index
        height = legs * np.sqrt(0.5)
        np.testing.assert_allclose(width[index[0][index[0] >= 0]], height / 0.02)
        np.testing.assert_allclose(width[index[1][index[1] >= 0]], height / 0.01)


@pytest.mark.parametrize("length", [1e-3, 1.0, 50.0])
def test_steps_are_cut_where_an_element_would_lose_most_of_its_area(length: float) -> None:
    rel = relocation(free_membrane(), parse_objective("energy + 0.1*quality"))
    q, step = np.random.default_rng(5).uniform(-1, 1, (2, rel.parts.n_q)) * [[0.1], [length]]
    part = longest_valid(rel, q, step)
    areas = [
        signed_areas(rel.nodes(q + t * step), rel.parts.problem.triangles) for t in np.linspace(0, part, 20)
    ]
    ratios = np.min(areas / areas[0], axis=1)
    assert min(ratios) >= KEPT - 1e-9
    # cut no more than it must be
    assert part == 1.0 or ratios[-1] == pytest.approx(KEPT, rel=1e-6)
    assert (part == 1.0) == (length < 1e-2)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "size"), [("6.1", 3), ("6.1", 5), ("6.2", (6, 3)), ("6.3", (6, 3))])
def test_nested_ends_at_a_minimum_with_a_distortion(name: str, size: int | tuple[int, int]) -> None:
    energy = with_distortion(replace(no_move_limits(rm.EXAMPLES[name](n=size)), quadrature=6))
    outer, steps = rm.Outer.of(energy.relocation.parts.problem, energy.relocation.objective), list[Step]()
    start = np.zeros(outer.n)
    end = Nested().run(outer, start, rm.Monitor(on_step=steps.append))
    assert end.status is rm.Status.CONVERGED
    assert outer.residual(energy(end.q)) <= 1e-6
    assert steps[-1].iteration == len(steps) - 1
    assert energy(end.q).value < energy(start).value
    # a minimum, not only a stationary point: no direction has negative curvature
    matrix = energy.hessian(energy(end.q))(np.eye(end.q.size))
    eigenvalues = np.linalg.eigvalsh((matrix + matrix.T) / 2)
    assert eigenvalues.min() > -1e-6 * eigenvalues.max()


@pytest.mark.slow
def test_the_gain_is_estimated_well_where_the_error_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a refined mesh, or by interpolation where none can be solved."""
    problem = replace(no_move_limits(rm.EXAMPLES["6.1"](n=16)), quadrature=8)
    solver = ContactSolver(problem)
    error = admissible(solver.discretisation).energy - problem.exact.energy
    assert gain_estimate(solver) == pytest.approx(error, rel=0.1)
    monkeypatch.setattr("rmesh_nlp.models.regularisation._refined", lambda given: None)
    assert 0.5 * error < gain_estimate(ContactSolver(problem)) < 2 * error


@pytest.mark.parametrize("bad", [-1.0, float("nan"), (), (0.0, 1.0), "much", (1.0, None), float("inf")])
def test_bad_weights_are_refused(bad: object) -> None:
    with pytest.raises(rm.BadInputError, match="regularisation"):
        weights(bad)  # type: ignore[arg-type]


def test_weights_and_objectives() -> None:
    assert (weights(0.01), weights((1, 0.1, 0)), weights("1, 0.1")) == ((0.01,), (1.0, 0.1, 0.0), (1.0, 0.1))
    assert regularised(2.0, 0, "quality").is_energy
    assert regularised(2.0, 0.1, "quality").text == "energy + 0.2*quality"
    with pytest.raises(rm.BadInputError, match="oval"):
        regularised(2.0, 0.1, "oval")


def test_relative_residual_is_one_on_given_mesh_and_less_where_bounds_hold_back() -> None:
    outer = rm.Outer.of(rm.EXAMPLES["6.1"](3))
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
    outer = rm.Outer.of(rm.EXAMPLES["6.2"]((4, 2)))
    point = outer.energy(np.zeros(outer.n))
    still = replace(point, gradient=0 * point.gradient)
    strain = 0.5 * point.equilibrium.u @ (point.system.stiffness @ point.equilibrium.u)
    assert size_of(still) == pytest.approx(max(strain, abs(point.value)))
    assert size_of(replace(still, is_energy=False, value=-2.0)) == 2.0
    assert OuterResidual(outer.energy, still).unit == pytest.approx(1e-6 * size_of(still))


def test_contact_forces_of_a_solvers_own_give_the_gradient_of_the_contact_solution(monkeypatch):
    outer = rm.Outer.of(block_sliding_on_a_circle())
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


def tight(room: float) -> rm.Outer:
    """Elements of Example 6.2 that may lose this part of their area."""
    given = rm.EXAMPLES["6.2"]((4, 2), 0.6)
    return rm.Outer.of(replace(given, motion=replace(given.motion, min_area_fraction=1 - room)))


def test_multipliers_of_elements_with_slack_are_no_equilibrium() -> None:
    room = 1e-5
    outer = tight(room)
    residual, q = outer.residual, np.zeros(outer.n)
    rows = outer.relocation.validity.at(q)
    # a gradient that multipliers of the elements explain as a whole
    pull = residual.unit * rows.jacobian.T @ np.ones(rows.slack.size)
    assert residual.at(q, np.asarray(pull)) == pytest.approx(room)
    assert residual.at(q, np.zeros(q.size)) == 0
    found = released(outer.energy, q, np.asarray(pull)).multipliers
    assert found.area.shape == (outer.problem.mesh.t.shape[1],)
    areas = found.area[outer.relocation.validity.elements]
    np.testing.assert_allclose(rows.jacobian.T @ areas, pull, atol=1e-9)
    assert not np.any(found.limit)


def test_an_element_beyond_its_least_area_has_no_slack_left() -> None:
    outer = tight(1e-6)
    q = 0.3 * np.random.default_rng(0).uniform(-1, 1, outer.n)
    assert np.min(outer.relocation.validity.at(q).slack) < 0
    assert np.min(released(outer.energy, q, np.zeros(outer.n)).slack) == 0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_multiplier_of_a_move_limit_is_the_rate_per_length(sign: float) -> None:
    """Limits are 0.1 by 0.05 over slopes of 1 and 4 %: x is the side that stops nodes there."""
    outer = rm.Outer.of(sloped_block())
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
    outer = rm.Outer.of(plate({"hole": HOLE}, delta=0.4))
    index = outer.relocation.parts.mesh_map.positions.index
    node = outer.problem.boundary_nodes("hole")[3]
    q, gradient = np.zeros(outer.n), np.zeros(outer.n)
    q[index[0, node]], gradient[index[0, node]] = 1.0, -2.0
    found = released(outer.energy, q, gradient).multipliers.limit
    assert found[node] == pytest.approx(2.0 / 0.4, rel=1e-6)


def test_rows_of_an_element_are_its_area_and_then_its_angles() -> None:
    problem = rm.EXAMPLES["6.1"](3)
    outer = rm.Outer.of(replace(problem, motion=rm.Motion(None, min_angle=20.0)))
    validity = outer.relocation.validity
    per_element = len(validity.group.rows)
    assert per_element == 4
    values = np.arange(validity.elements.size * per_element) + 1.0
    none = np.zeros(outer.n)
    found = Released(outer.relocation, none, none, none, values).multipliers
    np.testing.assert_array_equal(found.area[validity.elements], values[::4])
    np.testing.assert_array_equal(found.angle[validity.elements], values.reshape(-1, 4)[:, 1:].sum(axis=1))


def test_a_gradient_that_is_no_number_has_no_multipliers_of_elements() -> None:
    outer = tight(1e-6)
    rates = released(outer.energy, np.zeros(outer.n), np.full(outer.n, np.nan))
    assert rates.residual(1.0) == np.inf
    assert not np.any(rates.multipliers.area)
