"""Formulations that take one: what runs, from where, which end is the outcome, and what the record tells."""

import signal
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import rmesh_nlp as rm
from formulations.multistart import MultiStart
from formulations.remeshed import Remeshed
from formulations.schedule import Schedule
from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.models.regularisation import regularised
from rmesh_nlp.models.remeshing import Solved, metric_start
from rmesh_nlp.problem import ContactProblem, Laplace, Motion, Obstacle, Relative
from rmesh_nlp.solving.assess import assess
from rmesh_nlp.solving.outcome import Outcome, continuous_energy
from support.endings import Ends
from support.solved import solve_once


@pytest.fixture(scope="module")
def problem() -> ContactProblem:
    return ContactProblem(
        rectangle(2, 2), Laplace(1.0), ("left",), Obstacle("right", (1.0,), 0.1), Motion(Relative(0.2))
    )


class Script:
    """A formulation that ends at given parts of a descent, one after the other, and notes where it began."""

    def __init__(self, *parts: float, stop: int = -1, tracks: bool = False) -> None:
        self.parts, self.stop, self.tracks = list(parts), stop, tracks
        self.begun: list[tuple[rm.Outer, Array]] = []
        self.ends: list[Outcome] = []

    @property
    def formulation(self) -> Ends:
        return Ends(self)

    def __call__(self, outer: rm.Outer, q: Array, monitor: rm.Monitor) -> Outcome:
        self.begun.append((outer, q))
        if len(self.begun) == self.stop:
            raise KeyboardInterrupt
        slope = outer.energy(np.zeros(outer.n)).gradient
        end = -self.parts.pop(0) * slope / np.max(np.abs(slope))
        if self.tracks:
            monitor.track(outer).exact(len(self.begun), end)
        self.ends.append(Outcome(outer, end, rm.Status.CONVERGED, details={"own": len(self.ends)}))
        return self.ends[-1]


class TestMultiStart:
    """It ends at parts 0.1, 50 (which inverts elements), 0.4 and 0.2 of a descent."""

    def made(
        self, problem: ContactProblem, objective: str = "energy", parts: Any = (0.1, 50.0, 0.4, 0.2)
    ) -> tuple[Script, Outcome, rm.Outer]:
        script, outer = Script(*parts), rm.Outer.of(problem, objective)
        found = rm.Monitor().run(MultiStart(script.formulation, len(parts) - 1), outer, np.zeros(outer.n))
        return script, found, outer

    @pytest.mark.slow
    def test_the_best_is_the_valid_end_of_least_continuous_energy(self, problem: ContactProblem) -> None:
        script, found, outer = self.made(problem)
        np.testing.assert_array_equal(found.q, script.ends[2].q)
        for (_, begun), seed in zip(script.begun, (None, 1, 2, 3), strict=True):
            np.testing.assert_array_equal(begun, outer.variables(seed=seed))
        energies = [continuous_energy(end) for end in script.ends]
        assert np.isnan(energies[1])
        assert found.details == {
            "own": 2,
            "start_seeds": (None, 1, 2, 3),
            "start_energies": tuple(None if np.isnan(energy) else energy for energy in energies),
            "start_spread": np.nanmax(energies) - np.nanmin(energies),
        }

    @pytest.mark.slow
    def test_of_another_objective_the_best_has_its_least_value(self, problem: ContactProblem) -> None:
        script, found, outer = self.made(problem, "body(-u)")
        values = [outer.function(end.q).value for end in script.ends if outer.is_valid(end.q)]
        assert found.details["start_values"] == (values[0], None, *values[1:])
        assert outer.function(found.q).value == min(values)
        script, found, outer = self.made(problem, "body(u)")  # a descent of the energy raises this one
        np.testing.assert_array_equal(found.q, script.ends[0].q)

    def test_without_a_valid_end_it_is_the_first(self, problem: ContactProblem) -> None:
        script, found, _ = self.made(problem, parts=(50.0, 60.0))
        np.testing.assert_array_equal(found.q, script.ends[0].q)
        starts = {"start_seeds": (None, 1), "start_energies": (None, None), "start_spread": None}
        assert found.details == {"own": 0, **starts}

    def test_an_interrupted_start_is_the_last_and_is_said(self, problem: ContactProblem) -> None:
        script = Script(0.3, 0.1, 0.1, stop=2)
        solution = solve_once(problem, MultiStart(script.formulation, 5))
        assert len(script.begun) == 2
        assert (solution.status, solution.success) == (rm.Status.INTERRUPTED, True)
        assert solution.record()["start_seeds"] == [None, 1]
        np.testing.assert_allclose(solution.mesh.p, script.ends[0].outer.nodes(script.ends[0].q))


@pytest.mark.slow
def test_a_schedule_goes_on_from_the_last_end_and_counts_all_weights(problem: ContactProblem) -> None:
    free, steps = replace(problem, motion=Motion(None)), []
    script = Script(0.01, 0.02, 0.03, tracks=True)
    formulation = Schedule(script.formulation, (1.0, 0.1, 0.0))
    solution = solve_once(free, formulation, on_step=steps.append)
    assert not np.any(script.begun[0][1])
    for before, (_, q) in zip(script.ends, script.begun[1:], strict=False):
        np.testing.assert_array_equal(q, before.q)
    gain, texts = solution.record()["gain_estimate"], [outer.objective.text for outer, _ in script.begun]
    wanted = [regularised(gain, weight, "shape-size").text for weight in (1.0, 0.1, 0.0)]
    assert texts == wanted
    assert wanted[-1] == solution.objective == "energy"
    assert solution.trace.iterations == steps[-1].iteration == 1 + 2 + 3
    spent = sum(outer.energy.contact_solves for outer, _ in script.begun)
    assert solution.trace.work.contact_solves == spent + 2 == 8  # two for the estimate of what can be gained


def pressed(*_: Any) -> Any:
    signal.raise_signal(signal.SIGINT)


@pytest.fixture(scope="module")
def given() -> ContactProblem:
    return replace(rm.EXAMPLES["6.1"](n=4), motion=Motion(None), quadrature=6)


class TestRemeshed:
    @pytest.mark.slow
    def test_the_inner_formulation_runs_on_the_new_mesh_and_energies_are_of_the_given_one(self, given):
        script = Script(0.001)
        solution = solve_once(given, Remeshed(script.formulation, 27))
        ((outer, q),) = script.begun
        row, nodes = solution.record(), outer.problem.mesh.p.shape[1]
        assert (outer.is_near, np.any(q)) == (True, False)
        assert abs(nodes - 27) <= 2
        counts, energies = row["remeshed_nodes"], row["remeshed_energies"]
        assert solution.trace.work.contact_solves == len(counts)  # the script counts none
        assert counts[-1] == nodes or min(energies) < energies[-1]
        np.testing.assert_array_equal(solution.final.before, outer.problem.mesh.p)
        assert solution.energy_initial == pytest.approx(rm.Outer.of(given).contact.given.energy, rel=1e-12)
        assert solution.assessment.gain_audited > 0
        assert solution.problem.mesh.boundaries.keys() == given.mesh.boundaries.keys()

    @pytest.mark.slow
    def test_ctrl_c_keeps_the_new_mesh(self, given: ContactProblem) -> None:
        inner = Ends(lambda outer, q, monitor: monitor.track(outer).exact(1, q) or pressed())
        solution = rm.solve(given, Remeshed(inner))
        assert (solution.status, solution.success) == (rm.Status.INTERRUPTED, True)
        assert solution.assessment.gain_audited > 0

    @pytest.mark.slow
    def test_gain_and_audit_are_those_of_all_rounds(self, given: ContactProblem, monkeypatch) -> None:
        """From the mesh as given to one that suits the solution, whose energy is lower."""
        first = rm.Outer.of(given)
        made = metric_start(Solved(first.contact, first.contact.given), 25).solved.problem
        there = rm.Outer.of(made)
        found = assess(first, Outcome(there, there.variables(), rm.Status.CONVERGED))
        before, after = first.initial.energy, there.initial.energy
        assert (found.success, found.gain > 0) == (True, True)
        assert found.gain == pytest.approx(first.contact.given.energy - there.contact.given.energy, rel=1e-9)
        assert found.gain_audited == pytest.approx(before - after, rel=1e-9)
        for rise, status in ((-1e-6, rm.Status.STALLED), (1e-3, rm.Status.EXPLOITED)):
            again, raised = rm.Outer.of(made), replace(there.initial, energy=before + rise)
            ends = {id(first): first.initial, id(again): raised}
            monkeypatch.setattr(rm.Outer, "continuous", lambda outer, _, ends=ends: ends[id(outer)])
            assert assess(first, Outcome(again, again.variables(), rm.Status.STALLED)).status is status

    def test_without_mmgpy_it_says_what_to_install(self, given, monkeypatch) -> None:
        monkeypatch.setattr("formulations.remeshed.is_available", lambda: False)
        with pytest.raises(rm.BadInputError, match=r"pip install 'rmesh-nlp\[remesh\]'"):
            rm.solve(given, Remeshed(Script().formulation))


@pytest.mark.parametrize(
    ("name", "changed", "options", "words"),
    [
        ("joint", {}, {"starts": 2, "seed": 0}, "cannot be combined"),
        # what belongs to the given mesh
        ("nested", {"motion": Motion(0.1)}, {"remesh": True}, "move limits in units of length"),
        ("nested", {}, {"remesh": True, "objective": "quality"}, "not 'quality'"),
        *(
            ("nested", {}, {"remesh": True, **other}, f"combined with {next(iter(other))}")
            for other in ({"starts": 2}, {"seed": 0}, {"start": "given"})
        ),
        *(
            ("nested", {}, {"remesh": nodes}, "number of nodes from 3 to")
            for nodes in (2, 7.5, "many", 10**12)
        ),
    ],
)
def test_what_does_not_go_together(given, name, changed, options, words) -> None:
    with pytest.raises(rm.BadInputError, match=words):
        rm.solve(replace(given, **changed), name, **options)
