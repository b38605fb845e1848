"""Where a formulation starts, what its record says, and the Taylor test that users run, by other means."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.models.reduced_model import ReducedPoint
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, Laplace, Motion, Obstacle, PlaneStrain
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import entries
from support.endings import ended
from support.formulations import fixed, joint


@pytest.fixture(scope="module")
def problem() -> ContactProblem:
    return EXAMPLES["6.3"]((4, 2))


@pytest.fixture(scope="module")
def outer(problem: ContactProblem) -> Outer:
    return Outer(problem)


class TestStart:
    def test_without_a_seed_nothing_moves(self, outer: Outer) -> None:
        np.testing.assert_array_equal(outer.variables(), np.zeros(outer.relocation.n_q))

    @pytest.mark.parametrize("seed", [0, 3])
    def test_a_seed_draws_uniformly_from_the_move_limits(self, outer: Outer, seed: int) -> None:
        drawn = np.random.default_rng(seed).uniform(-1, 1, outer.relocation.n_q)
        np.testing.assert_array_equal(outer.variables(seed=seed), drawn)

    def test_positions_are_cut_to_the_move_limits(self, problem: ContactProblem, outer: Outer) -> None:
        free = outer.relocation.mesh_map
        q = np.random.default_rng(1).uniform(-1.5, 1.5, free.n)
        start = outer.variables(free.positions.values(q), 7)  # a seed has then no effect
        np.testing.assert_allclose(start, np.clip(q, -1, 1), atol=1e-12)
        np.testing.assert_allclose(free.bound, 1)

    def test_moves_that_invert_elements_are_shortened(self) -> None:
        wide = Outer(ContactProblem(rectangle(3, 3), Laplace(1.0), ("left",), motion=Motion(2.0)))
        drawn = np.random.default_rng(5).uniform(-1, 1, wide.relocation.n_q)
        start = wide.variables(seed=5)
        factor = np.max(np.abs(start)) / np.max(np.abs(drawn))
        np.testing.assert_allclose(start, factor * drawn)
        assert np.log2(factor) == round(np.log2(factor)) < 0
        assert wide.is_valid(start)
        assert not wide.is_valid(2 * start)
        free = wide.relocation.mesh_map
        nearer = wide.variables(free.positions.values(drawn))
        part = np.max(np.abs(nearer)) / np.max(np.abs(drawn))
        assert wide.is_valid(nearer)
        assert not wide.is_valid(nearer / 0.95)
        assert factor <= part < 1


def test_an_objective_is_built_once_and_shares_the_contact_model(outer: Outer) -> None:
    assert outer.function is outer.energy
    other = outer.minimising(parse_objective("mean(top, -uy)"))
    assert other.function is other.function is not other.energy
    assert str(other.function.objective) == "mean(top, -uy)"
    assert outer.function is outer.energy
    mixed = outer.minimising(parse_objective("energy + 0.1*quality"))
    assert mixed.function is mixed.energy is not outer.energy
    assert mixed.contact is other.contact is outer.contact
    assert not parse_objective("2*energy + 0.1*quality").collapses  # of another inner problem


def test_zones_and_counts_of_a_record(problem: ContactProblem) -> None:
    outer = Outer(problem)
    n = outer.relocation.n_q
    found = ended(outer, np.zeros(n))
    record = entries(found.findings)
    sliding = np.count_nonzero(outer.given.active.sliding[problem.friction_rows])
    assert (record["sliding_nodes"], record["sticking_nodes"]) == (
        sliding,
        problem.friction_rows.size - sliding,
    )
    assert record["sliding_nodes"] > 0
    assert record["assessed_equilibrium_residual"] < 1e-9
    assert record["own_equilibrium_residual"] == record["assessed_equilibrium_residual"]
    still = fixed.solve(problem).record()
    assert still["cold_contact_solves"] == 1
    assert still["contact_factorisations"] == outer.given.iterations
    smooth = Outer(EXAMPLES["6.2"]((4, 2)))
    assert ended(smooth, np.zeros(smooth.n)).findings.sliding_nodes is None


def test_own_residuals_are_those_of_the_formulation_s_state(problem: ContactProblem) -> None:
    outer = Outer(problem)
    q = np.zeros(outer.relocation.n_q)
    state = outer.energy(q).equilibrium
    off = replace(state, u=1.01 * state.u)
    found = ended(outer, q, own=off)
    measured = found.findings
    assert measured.own_equilibrium_residual > 1e-3 > 1e-9 > measured.assessed_equilibrium_residual
    assert found.energy == pytest.approx(state.energy, rel=1e-12)
    taken = ended(outer, q, own=off, decides=True)
    assert taken.status is Status.INACCURATE
    np.testing.assert_allclose(taken.displacement, outer.contact.displacement.values(off.u))


def test_pressures_carry_the_weight_of_the_block() -> None:
    law = PlaneStrain(0.0, 50.0, body_force=(0.0, -4.0))
    sides = (rm.Dirichlet("left", (0.0, None)), rm.Dirichlet("right", (0.0, None)))
    floor = Obstacle("bottom", (0.0, 1.0), 0.0)
    block = ContactProblem(rectangle(3, 2, x=(0, 2)), law, sides, floor, Motion(0.01))
    solution, x = fixed.solve(block), block.mesh.p[0]
    nodes = np.flatnonzero(block.mesh.p[1] == 0)
    nodes = nodes[np.argsort(x[nodes])]
    weights = np.convolve(np.diff(x[nodes]), [0.5, 0.5])  # half of the edges beside each node
    assert weights @ solution.pressure[nodes] == pytest.approx(8.0)
    assert not np.any(np.delete(solution.pressure, nodes))
    assert not np.any(solution.tangential_stress)


def test_rounding_is_relative_to_parts_of_the_energy_that_cancel() -> None:
    """Weight and lift: the strain energy is larger than their sum."""
    sides = (rm.Dirichlet("top", (0.0, 0.1)), rm.Dirichlet("bottom", (0.0, 0.0)))
    lifted = ContactProblem(rectangle(3, 2), PlaneStrain(0.3, 0.4, (0.0, -2.0)), sides, motion=Motion(0.05))
    outer = Outer(lifted)
    system, state = outer.contact.system(lifted.mesh.p), outer.given
    strain = 0.5 * float(state.u @ (system.stiffness @ state.u))
    found = ended(outer, np.zeros(outer.n))
    assert 0 < strain < 1
    assert abs(state.energy) < 0.2 * strain
    assert found.measured is not None
    assert found.measured.size == pytest.approx(strain, rel=1e-9)


def test_a_point_where_an_element_is_too_small_is_not_valid() -> None:
    problem = ContactProblem(
        rectangle(2, 2), Laplace(1.0), ("left",), motion=Motion(2.0, min_area_fraction=0.2)
    )
    outer, p = Outer(problem), problem.mesh.p
    free = outer.relocation.mesh_map

    def at(height: float) -> np.ndarray:
        """The middle node moved along the side x = 1/2: the areas beside it shrink in proportion."""
        nodes = p.copy()
        nodes[1, np.argmin(np.abs(p - 0.5).sum(axis=0))] = height
        return free.q_of(nodes)

    assert outer.is_valid(at(0.5))
    ratios = {h: rm_area(problem, free.positions.values(at(h))) for h in np.linspace(0.5, 0.99, 30)}
    for h, ratio in ratios.items():
        assert outer.is_valid(at(h)) == (ratio >= 0.2 - 1e-9), (h, ratio)
    assert min(ratios.values()) < 0.2 < max(ratios.values())
    barrier = Outer(problem, "energy + 0.1*quality")
    for h, ratio in ratios.items():
        assert barrier.is_valid(at(h)) == (ratio > 0)


def rm_area(problem: ContactProblem, nodes: np.ndarray) -> float:
    def areas(points: np.ndarray) -> np.ndarray:
        (x0, y0), (x1, y1), (x2, y2) = (points[:, corner] for corner in problem.triangles)
        return (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)

    return float(np.min(areas(nodes) / areas(problem.mesh.p)))


@pytest.mark.parametrize("label", ["S", "B", "M", None])
@pytest.mark.parametrize("weak", [(True, False), (False, True), (False, False)])
def test_a_label_proves_stationarity_where_some_node_is_weak(
    problem: ContactProblem, label: str | None, weak: tuple[bool, bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mesh as given is not stationary by its residual."""
    outer = Outer(problem)
    monkeypatch.setattr(ReducedPoint, "weak", property(lambda point: np.array(weak)))
    found = ended(outer, np.zeros(outer.n), label=label)
    proved = label in ("S", "B") and any(weak)
    assert found.status is (Status.CONVERGED if proved else Status.NOT_STATIONARY)
    assert found.stationarity == (label or "")


@pytest.mark.parametrize(("weight", "improved"), [(1e-9, True), (1e6, False)])
def test_a_distortion_counts_in_what_has_improved(
    problem: ContactProblem, weight: float, improved: bool
) -> None:
    """Moves that lower the energy distort the elements: whether that is better depends on the weight."""
    lower = joint.solve(problem)
    outer = Outer(problem, f"energy + {weight}*quality")
    found = ended(outer, outer.variables(lower.mesh.p))
    assert found.measured is not None
    assert found.measured.gain_audited > 0
    assert found.success == improved


def test_the_least_area_ratio_is_that_of_the_shoelace_formula() -> None:
    solution = joint.solve(EXAMPLES["6.1"](4))
    areas = []
    for mesh in (solution.problem.mesh.p, solution.mesh.p):
        (x0, y0), (x1, y1), (x2, y2) = (mesh[:, corner] for corner in solution.problem.mesh.t)
        areas.append(np.abs((x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)) / 2)
    given, moved = areas
    assert np.min(moved / given) < 0.99
    assert solution.audit.min_area_ratio == pytest.approx(np.min(moved / given), rel=1e-12)


def test_gains_are_differences_to_the_given_mesh_by_one_rule_each() -> None:
    problem = EXAMPLES["6.2"]((4, 2))
    given, moved = fixed.solve(problem), joint.solve(problem)
    assert moved.gain == pytest.approx(given.energy - moved.energy, rel=1e-9)
    accurate = given.audit.energy_audited - moved.audit.energy_audited
    assert moved.gain_audited == pytest.approx(accurate, rel=1e-9)
    assert given.gain == given.gain_audited == 0


def test_a_mesh_that_cannot_be_solved_on_is_neither_valid_nor_improved() -> None:
    outer = Outer(EXAMPLES["6.1"](3))
    found = ended(outer, np.full(outer.n, 10.0))
    assert found.status is Status.INVALID_MESH
    assert (found.valid, found.improved, found.success) == (False, False, False)
