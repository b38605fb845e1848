"""Where a strategy starts, what its record says, and the Taylor test that users run, by other means."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import rmesh_nlp as rm
from formulations import fixed, joint
from rmesh_nlp.contact.model import ContactModel
from rmesh_nlp.discretisation import discretise
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, Laplace, Motion, Obstacle, PlaneStrain
from rmesh_nlp.programs.reduced import ReducedEnergy
from rmesh_nlp.solution import referee as refereeing
from rmesh_nlp.solution.referee import Referee
from rmesh_nlp.solution.solution import Solution, Step, _gain, _plain, counted
from rmesh_nlp.solution.verification import TaylorTest, verify_gradient


@pytest.fixture(scope="module")
def problem() -> ContactProblem:
    return EXAMPLES["6.3"]((4, 2))


@pytest.fixture(scope="module")
def referee(problem: ContactProblem) -> Referee:
    return Referee(problem)


class TestStart:
    def test_without_a_seed_nothing_moves(self, referee: Referee) -> None:
        np.testing.assert_array_equal(referee.start(None), np.zeros(referee.relocation.n_q))

    @pytest.mark.parametrize("seed", [0, 3])
    def test_a_seed_draws_uniformly_from_the_boxes(self, referee: Referee, seed: int) -> None:
        drawn = np.random.default_rng(seed).uniform(-1, 1, referee.relocation.n_q)
        np.testing.assert_array_equal(referee.start(seed), drawn)

    def test_positions_are_met_and_cut_to_the_boxes(self, problem: ContactProblem, referee: Referee) -> None:
        free = referee.relocation.freedoms
        q = np.random.default_rng(1).uniform(-1.5, 1.5, free.n)
        start = referee.start(7, free.positions.values(q))  # a seed has then no effect
        np.testing.assert_allclose(start, np.clip(q, -1, 1), atol=1e-12)
        np.testing.assert_allclose(free.bound, 1)

    def test_moves_that_invert_elements_are_shortened(self) -> None:
        wide = Referee(ContactProblem(rectangle(3, 3), Laplace(1.0), ("left",), motion=Motion(2.0)))
        drawn = np.random.default_rng(5).uniform(-1, 1, wide.relocation.n_q)
        start = wide.start(5)
        factor = np.max(np.abs(start)) / np.max(np.abs(drawn))
        np.testing.assert_allclose(start, factor * drawn)
        assert np.log2(factor) == round(np.log2(factor)) < 0
        assert wide.is_valid(start)
        assert not wide.is_valid(2 * start)
        free = wide.relocation.freedoms
        nearer = wide.start(None, free.positions.values(drawn))
        part = np.max(np.abs(nearer)) / np.max(np.abs(drawn))
        assert wide.is_valid(nearer)
        assert not wide.is_valid(nearer / 0.95)
        assert factor <= part < 1


def test_a_function_is_stated_once_for_each_objective(referee: Referee, monkeypatch: Any) -> None:
    assert referee.function("energy") is referee.reduced
    first = referee.function("mean(top, -uy)")
    assert referee.function("mean(top, -uy)") is first
    other = referee.function("mean(top, -ux)")
    assert other is not first
    assert str(first.objective) == "mean(top, -uy)"
    assert str(other.objective) == "mean(top, -ux)"
    mixed = Referee(referee.problem, "energy + 0.1*quality")
    assert mixed.function("energy + 0.1*quality") is mixed.reduced
    assert mixed.function("energy") is not mixed.reduced


def judged(referee: Referee, q: np.ndarray, **changes: Any) -> Solution:
    common: dict[str, Any] = {"status": Status.CONVERGED, "history": [], "iterations": 4, "contact_solves": 2}
    return referee.judge("mine", q, **(common | changes))


def test_zones_and_counts_of_a_record(problem: ContactProblem) -> None:
    referee = Referee(problem)
    n = referee.relocation.n_q
    record = judged(referee, np.zeros(n)).record()
    sliding = np.count_nonzero(referee.initial.active.sliding[problem.friction_rows])
    assert (record["sliding_nodes"], record["sticking_nodes"]) == (
        sliding,
        problem.friction_rows.size - sliding,
    )
    assert record["sliding_nodes"] > 0
    assert record["referee_equilibrium_residual"] < 1e-9
    assert record["own_equilibrium_residual"] == record["referee_equilibrium_residual"]
    still = judged(referee, np.zeros(n), relocates=False).record()
    assert still["cold_contact_solves"] == 1
    assert still["contact_factorisations"] == referee.initial.iterations
    smooth = Referee(EXAMPLES["6.2"]((4, 2)))
    assert "sliding_nodes" not in judged(smooth, np.zeros(smooth.relocation.n_q)).record()


def test_own_residuals_are_those_of_the_strategy_s_state(problem: ContactProblem) -> None:
    referee = Referee(problem)
    q = np.zeros(referee.relocation.n_q)
    state = referee.reduced(q).equilibrium
    off = replace(state, u=1.01 * state.u)
    record = judged(referee, q, own=off).record()
    assert record["own_equilibrium_residual"] > 1e-3 > 1e-9 > record["referee_equilibrium_residual"]
    assert record["energy"] == pytest.approx(state.energy, rel=1e-12)
    taken = judged(referee, q, equilibrium=off)
    assert taken.status is Status.INACCURATE
    np.testing.assert_allclose(taken.displacement, referee.model.displacement.values(off.u))


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


def test_the_advised_degree_is_the_least_that_gives_the_gain(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = EXAMPLES["6.1"](3)
    referee = Referee(problem)
    q = joint.solve(problem).mesh
    nodes = np.asarray(q.p)
    gains = {}
    for degree in (*refereeing.DEGREES, 24):
        model = ContactModel(discretise(replace(problem, quadrature=degree)))
        gains[degree] = model.solve(problem.mesh.p).energy - model.solve(nodes).energy
    near = [
        d
        for d in refereeing.DEGREES
        if abs(gains[d] - gains[24]) <= 0.01 * max(map(abs, (gains[d], gains[24])))
    ]
    assert referee._advice(nodes, gains[24]) == f"Here degree {near[0]} suffices."
    assert referee._advice(nodes, 10 * gains[24]) == "Here not even degree 20 suffices."
    assert refereeing.DEGREES[-1] == 20
    assert list(refereeing.DEGREES) == sorted(refereeing.DEGREES)


def test_a_point_where_an_element_is_too_small_is_not_valid() -> None:
    problem = ContactProblem(
        rectangle(2, 2), Laplace(1.0), ("left",), motion=Motion(2.0, min_area_fraction=0.2)
    )
    referee, p = Referee(problem), problem.mesh.p
    free = referee.relocation.freedoms

    def at(height: float) -> np.ndarray:
        """The middle node moved along the side x = 1/2: the areas beside it shrink in proportion."""
        nodes = p.copy()
        nodes[1, np.argmin(np.abs(p - 0.5).sum(axis=0))] = height
        return free.q_of(nodes)

    assert referee.is_valid(at(0.5))
    ratios = {h: rm_area(problem, free.positions.values(at(h))) for h in np.linspace(0.5, 0.99, 30)}
    for h, ratio in ratios.items():
        assert referee.is_valid(at(h)) == (ratio >= 0.2 - 1e-9), (h, ratio)
    assert min(ratios.values()) < 0.2 < max(ratios.values())
    barrier = Referee(problem, "energy + 0.1*quality")
    for h, ratio in ratios.items():
        assert barrier.is_valid(at(h)) == (ratio > 0)


def rm_area(problem: ContactProblem, nodes: np.ndarray) -> float:
    def areas(points: np.ndarray) -> np.ndarray:
        (x0, y0), (x1, y1), (x2, y2) = (points[:, corner] for corner in problem.triangles)
        return (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)

    return float(np.min(areas(nodes) / areas(problem.mesh.p)))


class TestReduced:
    def test_solves_are_counted_and_the_last_point_is_remembered(self, problem: ContactProblem) -> None:
        referee = Referee(problem)
        reduced = ReducedEnergy(referee.relocation)
        q = np.random.default_rng(0).uniform(-0.3, 0.3, referee.relocation.n_q)
        counts = lambda: (reduced.contact_solves, reduced.cold_solves)  # noqa: E731
        first = reduced(q)
        assert counts() == (1, 1)
        assert reduced.factorisations == first.equilibrium.iterations
        assert reduced(q.copy()) is first
        assert counts() == (1, 1)
        second = reduced(0.5 * q)
        assert counts() == (2, 1)
        assert reduced.factorisations == first.equilibrium.iterations + second.equilibrium.iterations
        cold = ContactModel(discretise(problem)).solve(referee.relocation.nodes(0.5 * q))
        assert second.value == pytest.approx(cold.energy, rel=1e-10)
        np.testing.assert_array_equal(second.weak, np.zeros(problem.contact_nodes.size, dtype=bool))

    def test_terms_in_the_positions_are_added_and_undefined_where_an_element_is_inverted(self) -> None:
        plain, mixed = (Referee(EXAMPLES["6.1"](3), text) for text in ("energy", "energy + 0.5*quality"))
        q = np.random.default_rng(0).uniform(-0.5, 0.5, plain.relocation.n_q)
        quality = Referee(EXAMPLES["6.1"](3), "energy + 1*quality")
        weight = mixed.reduced.of_positions(q)
        assert weight == pytest.approx(0.5 * quality.reduced.of_positions(q))
        assert mixed.reduced(q).value == pytest.approx(plain.reduced(q).value + weight)
        assert plain.reduced.of_positions(q) == 0
        far = np.full(q.size, 50.0)
        assert mixed.reduced.is_defined(q)
        assert not mixed.reduced.is_defined(far) or mixed.reduced.of_positions(far) > 1e3
        function = plain.function("quality")
        assert function.is_defined(q)
        assert not function.is_defined(20 * (-1.0) ** np.arange(q.size))


class TestTaylor:
    """The order of the remainder, from halved steps."""

    def made(self, orders: list[float]) -> TaylorTest:
        n = len(orders) + 1
        return TaylorTest("mine", 1.0, 2.0, np.ones(n), np.ones(n), np.array(orders))

    def test_the_last_known_order_decides(self) -> None:
        assert self.made([1.0, 2.0, np.nan]).order == 2.0
        assert self.made([2.0, 1.0]).order == 1.0
        assert not self.made([2.0, 1.89])
        assert self.made([1.0, 1.9])
        assert self.made([np.nan, np.nan]).order == np.inf
        text = " ".join(value for _, value in self.made([2.0, 1.5]).summary())
        assert "order 2.00" in text
        assert "WRONG: order 1.50" in text
        rows = self.made([2.0, 2.0]).summary()
        assert len(rows) == 5
        assert rows[-1][1] == "right: order 2.00"
        assert "order" not in rows[1][1]

    def test_it_measures_what_it_says_inside_of_the_boxes(
        self, problem: ContactProblem, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        points: list[Any] = []
        evaluate = ReducedEnergy.__call__

        def noted(self: ReducedEnergy, q: np.ndarray) -> Any:
            points.append((q.copy(), evaluate(self, q)))
            return points[-1][1]

        monkeypatch.setattr(ReducedEnergy, "__call__", noted)
        test = verify_gradient(problem, seed=2)
        assert test
        (q, here), *others = points
        assert np.max(np.abs([point for point, _ in points])) <= 1
        assert np.max(np.abs(q)) > 0.3  # not the mesh as given
        np.testing.assert_allclose(test.steps, 1e-2 * 0.5 ** np.arange(5))
        direction = (others[0][0] - q) / test.steps[0]
        assert 0.5 < np.max(np.abs(direction)) <= 1
        for (point, found), step, remainder in zip(others, test.steps, test.remainders, strict=True):
            np.testing.assert_allclose(point, q + step * direction, atol=1e-12)
            exact = abs(found.value - here.value - step * here.gradient @ direction)
            assert remainder == pytest.approx(exact, rel=1e-6, abs=1e-15)
        np.testing.assert_allclose(test.orders, np.log2(test.remainders[:-1] / test.remainders[1:]))
        assert test.slope == pytest.approx(here.gradient @ direction)
        assert (test.value, test.objective) == (here.value, "energy")
        again, other = verify_gradient(problem, seed=2), verify_gradient(problem, seed=3)
        assert again.value == test.value != other.value

    def test_a_wrong_gradient_is_of_first_order(
        self, problem: ContactProblem, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        gradient = ReducedEnergy.gradient
        monkeypatch.setattr(ReducedEnergy, "gradient", lambda *arguments: 1.01 * gradient(*arguments))
        test = verify_gradient(problem)
        assert test.order == pytest.approx(1, abs=0.1)
        assert not test.passed

    def test_rounding_says_nothing(self) -> None:
        """The position of a node is linear: its remainders are rounding, and no order is known."""
        problem = ContactProblem(rectangle(3, 3), Laplace(1.0), ("left",), motion=Motion(0.05))
        node = int(np.argmin(np.abs(problem.mesh.p - 1 / 3).sum(axis=0)))
        test = verify_gradient(problem, rm.quantities.nodal([node], lambda X, u: X[0, 0] + 3.0))
        assert np.all(np.isnan(test.orders))
        assert test.order == np.inf
        assert test

    def test_nothing_that_moves_is_refused(self) -> None:
        problem = ContactProblem(rectangle(1, 1), Laplace(1.0), ("left",), motion=Motion(0.05))
        with pytest.raises(ValueError, match="no node of .* may move"):
            verify_gradient(problem)


class TestRecord:
    @pytest.fixture(scope="class")
    def solution(self) -> Solution:
        return joint.solve(EXAMPLES["6.2"]((4, 2)))

    def test_figures_are_those_of_the_solution(self, solution: Solution) -> None:
        made = replace(
            solution, build_time_s=1.0, solve_time_s=20.0, audit_time_s=300.0, energy_initial=-1.0,
            energy=-1.5,
            energy_initial_audited=-2.0, audit=replace(solution.audit, energy_audited=-2.25), detail="More.",
            stationarity_residual=float("nan"), seed=5, extra={"mine": np.float64(2.5)},
        )  # fmt: skip
        record = made.record()
        assert (record["wall_time_s"], record["gain"], record["gain_audited"]) == (321.0, 0.5, 0.25)
        assert (record["u_min"], record["u_max"]) == (made.displacement.min(), made.displacement.max())
        assert (record["nodes"], record["triangles"]) == (made.mesh.p.shape[1], made.mesh.t.shape[1])
        assert record["stationarity_residual"] is None
        assert (record["seed"], record["mine"], type(record["mine"])) == (5, 2.5, float)
        assert record["message"].endswith(" More.")
        rows = dict(made.summary())
        assert rows["audited gain"].endswith("(12.5 %)")
        assert rows["success"] == ("yes" if made.success else "no")
        assert rows["iterations, contact solves"] == f"{made.iterations}, {made.contact_solves}"
        motion = np.linalg.norm(made.mesh.p - made.problem.mesh.p, axis=0).max()
        assert float(rows["largest motion"]) == pytest.approx(motion, rel=1e-3)
        boxes = np.sum(solution.multipliers.box > 0)
        assert rows["limited by boxes"].startswith(f"{boxes} nodes, largest ")
        areas = np.sum(solution.multipliers.area > 0)
        assert rows["limited by areas"].startswith(f"{areas} elements")
        assert "limited by boxes" not in dict(replace(made, multipliers=None).summary())
        assert "worth it?" not in rows
        assert dict(replace(made, extra={"worth": {"text": "yes"}}).summary())["worth it?"] == "yes"

    def test_gains_have_a_part_where_there_is_something_to_be_a_part_of(self) -> None:
        assert _gain(0.5, -2.0).endswith("(25 %)")
        assert "%" not in _gain(0.5, 0.0)

    def test_histories_are_plain_and_keep_an_infinite_t(self) -> None:
        step = Step(3, -1.0, float("inf"), 0.0, float("nan"), 7, 0.25, np.ones(2))
        solution = SimpleNamespace(history=(step, replace(step, t=float("nan"))))
        first, second = Solution.history_rows(solution)  # type: ignore[arg-type]
        assert "q" not in first
        assert first["t"] == float("inf")
        assert second["t"] is None
        assert (first["iteration"], first["energy"], first["dual_residual"]) == (3, -1.0, None)
        assert (first["objective"], first["product"], first["biactive"], first["stationarity"]) == (None,) * 4

    def test_work_is_summed_where_all_counted_it(self) -> None:
        one = SimpleNamespace(extra={"cold_contact_solves": 1, "contact_factorisations": 5})
        two = SimpleNamespace(extra={"cold_contact_solves": 2, "kkt_factorisations": 7})
        assert counted([one, two]) == {"cold_contact_solves": 3}  # type: ignore[list-item]
        assert counted([one]) == one.extra  # type: ignore[list-item]

    @pytest.mark.parametrize(
        ("value", "plain"),
        [(np.int64(3), 3), (np.bool_(True), True), (np.nan, None), (-np.inf, None), ("x", "x"), (0.5, 0.5)],
    )
    def test_values_become_plain(self, value: Any, plain: Any) -> None:
        assert _plain(value) == plain
        assert type(_plain(value)) is type(plain)
