"""What a solution says of itself: its record and its summary."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.assessment.error_reduction import ErrorReduction
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.optimize.budget import Limits
from rmesh_nlp.optimize.status import NOT_STATIONARY_YET, Status
from rmesh_nlp.problem import Constraint, Motion
from rmesh_nlp.solving.first_order import FirstOrder
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Work
from rmesh_nlp.solving.refinement import ReducedError
from rmesh_nlp.solving.solution import Solution
from rmesh_nlp.solving.summary import gain_in_words
from rmesh_nlp.study.progress import summary as one_line
from support.conclusions import compared, with_energies
from support.designs import BOW, LIMITED, E, block
from support.endings import Own
from support.formulations import fixed, joint, nested


@pytest.fixture(scope="module")
def solution() -> Solution:
    return joint.solve(EXAMPLES["6.2"]((4, 2)))


def test_record_counts_unknowns_at_edges() -> None:
    record = fixed.solve(EXAMPLES["6.2"]((4, 2), order=2)).record()
    assert (record["order"], record["nodes"], record["unknowns"]) == (2, 15, 2 * (4 * 3 + 12 + 8 + 8))


def test_figures_are_those_of_the_solution(solution: Solution) -> None:
    assessment = solution.assessment
    made = replace(
        solution, build_time_s=1.0, solve_time_s=20.0, audit_time_s=300.0, seed=5,
        details=(Own(np.float64(2.5)),), limits=Limits(iterations=9),
        assessment=replace(
            assessment,
            given=with_energies(assessment.given, -1.0, -2.0),
            final=with_energies(assessment.final, -1.5, -2.25, penetration=0.5),
            first_order=replace(assessment.first_order, residual=float("nan")),
            solver_status=Status.STALLED,
        ),
    )  # fmt: skip
    record = made.record()
    assert (record["wall_time_s"], record["gain"], record["gain_audited"]) == (321.0, 0.5, 0.25)
    assert [record[f"{name}_time_s"] for name in ("build", "solve", "audit")] == [1.0, 20.0, 300.0]
    assert (record["u_min"], record["u_max"]) == (made.displacement.min(), made.displacement.max())
    assert (record["nodes"], record["triangles"]) == (made.mesh.p.shape[1], made.mesh.t.shape[1])
    assert (record["order"], record["unknowns"]) == (1, 2 * 4 * 3)  # held on the left
    assert (record["energy_audited"], record["penetration"]) == (-2.25, 0.5)
    assert record["stationarity_residual"] is None
    assert (record["seed"], record["own"], type(record["own"])) == (5, 2.5, float)
    assert (record["status"], record["solver_status"]) == (solution.status.value, "stalled")
    assert record["limits"] == {"iterations": 9}
    rows = dict(made.summary())
    assert rows["audited gain"].endswith("(12.5 %)")
    assert rows["iterations, contact solves"] == f"{made.iterations}, {made.contact_solves}"
    motion = np.linalg.norm(made.mesh.p - made.problem.mesh.p, axis=0).max()
    assert float(rows["largest motion"]) == pytest.approx(motion, rel=1e-3)
    pulls = solution.multipliers
    for by, what, rate in (("move limits", "nodes", pulls.limit), ("areas", "elements", pulls.area)):
        assert rows[f"limited by {by}"] == f"{np.sum(rate > 0)} {what}, largest {rate.max():.6g}"
    unknown = replace(made, assessment=replace(made.assessment, first_order=FirstOrder()))
    assert "limited by move limits" not in dict(unknown.summary())
    assert "error reduction" not in rows
    reduction = ErrorReduction((0.3, 0.4), (0.1, 0.2), 2.0, 3.0, "refinement", 15, 7)
    fell = replace(made, reduced_error=ReducedError(reduction))
    assert dict(fell.summary())["error reduction"] == fell.error_reduction.text()
    assert fell.record()["error_reduction"] == fell.error_reduction.record()
    assert replace(made, certificate_remark="no").record()["certificate_remark"] == "no"


def test_a_design_is_recorded_with_its_start_its_bounds_and_what_is_constrained() -> None:
    twice = (*LIMITED, Constraint("body(ux**2)", (1e-9, np.inf)))
    problem = replace(block(E, BOW, constraints=twice), motion=Motion(0))
    made = nested.solve(problem, objective="mean(right, uy**2)")
    record = made.record()
    assert record["design"] == made.design
    assert record["design_initial"] == {"E": 1.0, "bow": 0.0}
    assert record["design_bounds"] == {"E": [0.5, 2.0], "bow": [-0.05, 0.05]}
    found = record["constraints"]
    assert set(found) == {str(one.value) for one in LIMITED}
    strain = found["body(ux**2)"]
    assert (strain["lower"], strain["upper"]) == (1e-9, 1e-4)
    peak = found["max-pressure(bottom)"]
    assert (peak["lower"], peak["upper"]) == (None, 200.0)
    assert peak["value"] == pytest.approx(made.pressure.max(), rel=1e-9)
    there = Outer.of(made.problem, "body(ux**2)")
    assert strain["value"] == pytest.approx(there.function(np.zeros(there.n)).value, rel=1e-6)
    rows = dict(made.summary())
    assert rows["objective"] == "mean(right, uy**2)"
    assert rows["objective at the start"] == f"{record['objective_initial']:.6g}"
    assert rows["design variable E"] == f"{made.design['E']:.6g} from 1, bounds 0.5 to 2"
    assert rows["constraint max-pressure(bottom)"] == f"{peak['value']:.6g}, at most 200"
    assert "audited energy" not in rows  # energies of different designs do not compare


def test_a_violated_constraint_is_named() -> None:
    problem = replace(block(E, constraints=(Constraint("area", (5.0, 6.0)),)), motion=Motion(0))
    found = fixed.solve(problem, objective="mean(right, uy)")
    assert found.status is Status.VIOLATED
    assert found.message.endswith("area = 4, 5 to 6")
    assert found.constraints["area"].violation == pytest.approx(1 / 6)


def test_a_variable_at_its_bound_is_said_to_be_there(solution: Solution) -> None:
    designed = block(E, BOW)
    for value, words in (
        (2.0, "2, at its bound, from 1"),
        (1.99, "1.99 from 1"),
    ):
        found = solution.assessment
        final = replace(found.final, design={"E": value})
        rows = dict(replace(solution, assessment=replace(found, final=final, designed=designed)).summary())
        assert rows["design variable E"] == f"{words}, bounds 0.5 to 2"
        assert "design variable bow" not in rows  # a level of an epigraph has no row either


def test_success_says_what_it_lacks(solution: Solution) -> None:
    early = Status.ITERATION_LIMIT
    ends = [
        compared(),
        compared(early, stationary=False),
        compared(contact=early),
    ]
    made = [replace(solution, assessment=end) for end in ends]
    words = [dict(one.summary())["success"] for one in made]
    assert words == ["yes", f"yes: {NOT_STATIONARY_YET}", "no"]
    lines = [one_line(one.record()) for one in made]
    assert [line.endswith(NOT_STATIONARY_YET) for line in lines] == [False, True, False]
    assert lines[2].endswith(early.message)


def test_gains_have_a_part_where_there_is_something_to_be_a_part_of() -> None:
    assert gain_in_words(0.5, -2.0).endswith("(25 %)")
    assert "%" not in gain_in_words(0.5, 0.0)


def test_work_is_summed_over_all_outer_problems() -> None:
    monitor, outer = Monitor(), Outer.of(EXAMPLES["6.2"]((4, 2)))
    monitor.work += Work(kkt_factorisations=7)
    for other in (outer, outer.near(), Outer.of(outer.problem)):  # a start that is near is no other problem
        monitor.tracked(other).energy(np.zeros(outer.n))
    assert monitor.spent.contact_solves == outer.energy.contact_solves + 1
    assert monitor.spent.kkt_factorisations == 7
