"""Where a formulation starts, and what is assessed of where it ended, by other means."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.models.reduced_model import ReducedPoint
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, Laplace, Motion, PlaneStrain
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outer import Outer
from support.endings import ended
from support.solved import solved


@pytest.fixture(scope="module")
def outer() -> Outer:
    return Outer.of(EXAMPLES["6.3"]((4, 2)))


@pytest.mark.parametrize("step", [-1e-3, 1e-3])
def test_of_an_all_at_once_solver_the_last_iterate_is_kept_only_if_it_is_below_the_start(outer, step) -> None:
    start, track = np.zeros(outer.n), Monitor().track(outer)
    gradient = outer.energy(start).gradient
    q = step * gradient / np.max(np.abs(gradient))
    track(1, np.append(q, np.zeros(outer.relocation.parts.n_u)), 0.0, np.zeros(0))
    np.testing.assert_array_equal(track.best(start), q if step < 0 else start)


def test_an_iterate_whose_elements_are_inverted_is_never_kept() -> None:
    wide = Outer.of(ContactProblem(rectangle(3, 3), Laplace(1.0), ("left",), motion=Motion(2.0)))
    start, track = np.zeros(wide.n), Monitor().track(wide)
    folded = np.random.default_rng(5).uniform(-1, 1, wide.n)
    assert not wide.is_valid(folded)
    here = wide.energy(start)
    for iteration, (q, value) in enumerate([(start, here.value), (folded, here.value - 1.0)]):
        track.exact(iteration, q, replace(here, value=value))
    np.testing.assert_array_equal(track.best(folded), start)


def area_ratio(problem: ContactProblem, nodes: np.ndarray) -> float:
    """The least one, by the shoelace formula."""

    def areas(points: np.ndarray) -> np.ndarray:
        (x0, y0), (x1, y1), (x2, y2) = (points[:, corner] for corner in problem.triangles)
        return (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)

    return float(np.min(areas(nodes) / areas(problem.mesh.p)))


class TestStart:
    def test_it_is_the_mesh_as_given_or_drawn_uniformly_from_the_move_limits(self, outer: Outer) -> None:
        np.testing.assert_array_equal(outer.variables(), np.zeros(outer.n))
        for seed in (0, 3):
            drawn = np.random.default_rng(seed).uniform(-1, 1, outer.n)
            np.testing.assert_array_equal(outer.variables(seed=seed), drawn)

    def test_positions_are_cut_to_the_move_limits(self, outer: Outer) -> None:
        q = np.random.default_rng(1).uniform(-1.5, 1.5, outer.n)
        start = outer.variables(outer.nodes(q), 7)  # a seed has then no effect
        np.testing.assert_allclose(start, np.clip(q, -1, 1), atol=1e-12)
        np.testing.assert_allclose(outer.discretisation.mesh_map.upper, 1)

    def test_what_inverts_elements_is_shortened(self) -> None:
        wide = Outer.of(ContactProblem(rectangle(3, 3), Laplace(1.0), ("left",), motion=Motion(2.0)))
        drawn = np.random.default_rng(5).uniform(-1, 1, wide.n)
        starts = wide.variables(seed=5), wide.variables(wide.nodes(drawn))
        parts = [np.max(np.abs(start)) / np.max(np.abs(drawn)) for start in starts]
        for start, part, factor in zip(starts, parts, (0.5, 0.95), strict=True):
            np.testing.assert_allclose(start, part * drawn, atol=1e-12)
            assert wide.is_valid(start)
            assert not wide.is_valid(start / factor)
        assert parts[0] <= parts[1] < 1

    def test_a_point_where_an_element_is_too_small_is_not_valid(self) -> None:
        motion = Motion(2.0, min_area_fraction=0.2)
        problem = ContactProblem(rectangle(2, 2), Laplace(1.0), ("left",), motion=motion)
        outer, barrier, found = Outer.of(problem), Outer.of(problem, "energy + 0.1*quality"), []
        for height in np.linspace(0.5, 0.99, 30):  # of the middle node: areas beside it shrink in proportion
            nodes = problem.mesh.p.copy()
            nodes[1, np.argmin(np.abs(problem.mesh.p - 0.5).sum(axis=0))] = height
            q, ratio = outer.relocation.parts.mesh_map.q_of(nodes), area_ratio(problem, nodes)
            assert outer.is_valid(q) == (ratio >= 0.2 - 1e-9), (height, ratio)
            assert barrier.is_valid(q) == (ratio > 0)
            found.append(ratio)
        assert min(found) < 0.2 < max(found)


class TestAssessment:
    def test_zones_residuals_and_counts_of_a_record(self, outer: Outer) -> None:
        found = ended(outer, np.zeros(outer.n))
        rows = outer.discretisation.friction_rows
        sliding = np.count_nonzero(outer.contact.given.active.sliding[rows])
        assert found.final.sliding_nodes == sliding > 0
        assert found.final.sticking_nodes == rows.size - sliding
        assert found.own_residuals == found.final.residuals
        assert max(vars(found.own_residuals).values()) < 1e-9
        still = solved("fixed", "6.3", (4, 2)).record()
        assert still["cold_contact_solves"] == 1
        assert still["contact_factorisations"] == outer.contact.given.iterations
        smooth = Outer.of(EXAMPLES["6.2"]((4, 2)))
        assert ended(smooth, np.zeros(smooth.n)).final.sliding_nodes is None

    def test_own_residuals_are_those_of_the_formulation_s_state(self, outer: Outer) -> None:
        q = np.zeros(outer.n)
        state = outer.energy(q).equilibrium
        off = replace(state, u=1.01 * state.u, normal_force=-state.normal_force)
        found = ended(outer, q, own=off)
        assert found.own_residuals.equilibrium > 1e-3
        assert found.own_residuals.complementarity > 1e-3
        assert found.final.residuals.equilibrium < 1e-9
        assert found.final.energy == pytest.approx(state.energy, rel=1e-12)
        assert found.status is Status.INACCURATE
        assert ended(outer, q, Status.STALLED, own=off).status is Status.STALLED

    def test_rounding_is_relative_to_parts_of_the_energy_that_cancel(self) -> None:
        """Weight and lift: the strain energy is larger than their sum."""
        sides, law = (rm.Dirichlet("top", (0.0, 0.1)), rm.Dirichlet("bottom", (0.0, 0.0))), (0.3, 0.4)
        lifted = ContactProblem(rectangle(3, 2), PlaneStrain(*law, (0.0, -2.0)), sides, motion=Motion(0.05))
        outer = Outer.of(lifted)
        system, state = outer.contact.system(lifted.mesh.p), outer.contact.given
        strain = 0.5 * float(state.u @ (system.stiffness @ state.u))
        assert 0 < strain < 1
        assert abs(state.energy) < 0.2 * strain
        assert ended(outer, np.zeros(outer.n)).final.size == pytest.approx(strain, rel=1e-9)

    @pytest.mark.parametrize(
        ("label", "weak"),
        [*((label, (False, True)) for label in ("S", "B", "M", None)), ("S", (False, False))],
    )
    def test_a_label_proves_stationarity_where_some_node_is_weak(self, outer, label, weak, monkeypatch):
        """The mesh as given is not stationary by its residual."""
        monkeypatch.setattr(ReducedPoint, "weak", property(lambda point: np.array(weak)))
        found = ended(outer, np.zeros(outer.n), label=label)
        proved = label in ("S", "B") and any(weak)
        assert found.status is (Status.CONVERGED if proved else Status.NOT_STATIONARY)
        assert found.first_order.stationarity == (label or "")

    @pytest.mark.parametrize(("weight", "improved"), [(1e-9, True), (1e6, False)])
    def test_a_distortion_counts_in_what_has_improved(self, outer, weight, improved) -> None:
        """A mesh of lower energy is distorted: whether it is better depends on the weight."""
        lower, there = solved("joint", "6.3", (4, 2)), Outer.of(outer.problem, f"energy + {weight}*quality")
        found = ended(there, there.variables(lower.mesh.p))
        assert found.gain_audited > 0
        assert found.success == improved

    def test_gains_and_areas_are_those_of_the_given_and_the_last_mesh_by_one_rule_each(self) -> None:
        problem = EXAMPLES["6.2"]((4, 2))
        given, moved = (solved(name, "6.2", (4, 2)) for name in ("fixed", "joint"))
        accurate = given.energy_audited - moved.energy_audited
        assert moved.gain_audited == pytest.approx(accurate, rel=1e-9)
        assert given.gain == given.gain_audited == 0
        ratio = area_ratio(problem, moved.mesh.p)
        assert ratio < 0.99
        assert moved.assessment.final.min_area_ratio == pytest.approx(ratio, rel=1e-12)
