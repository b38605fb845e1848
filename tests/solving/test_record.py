"""What a solution says of itself: fields, record, summary; Taylor tests and the terms of Theorem 4.1."""

import pickle
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rmesh_nlp as rm
from gallery import signorini
from rmesh_nlp.assessment.contact_results import ContactResult
from rmesh_nlp.assessment.error_reduction import ErrorReduction
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.io.records import read_record, to_json
from rmesh_nlp.optimize.status import NOT_STATIONARY_YET, Status
from rmesh_nlp.problem import Constraint, ContactProblem, Laplace, Motion
from rmesh_nlp.solving.entries import ENTRIES
from rmesh_nlp.solving.entry import KNOWN
from rmesh_nlp.solving.first_order import FirstOrder
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Bounds, Certificate, Step, Trace, Work, plain
from rmesh_nlp.solving.refinement import ReducedError
from rmesh_nlp.solving.relocated import Relocated
from rmesh_nlp.solving.summary import contact_rows, summary
from rmesh_nlp.solving.verification import TaylorTest, error_terms, verify_gradient
from rmesh_nlp.study.progress import summary as one_line
from support.conclusions import compared, with_energies
from support.contact_geometry import block_between_two_foundations
from support.designs import BOW, LIMITED, E, block, largest_mean
from support.formulations import fixed, nested
from support.orders import ORDERS
from support.sliding import sliding_block
from support.solved import solved


@pytest.fixture(scope="module")
def solution() -> rm.Solution:
    return solved("joint", "6.2", (4, 2))


def test_record_and_table_are_of_what_was_found_alone(solution: rm.Solution) -> None:
    """They stand above it: what a solve found has neither."""
    found = Relocated(**{name: value for name, value in vars(solution).items() if name != "error_terms"})
    assert (found.given, found.final) == (solution.assessment.given, solution.assessment.final)
    assert summary(found) == solution.summary()
    assert not hasattr(found, "record")
    assert len(found.history) == len(found.trace.steps) > found.trace.iterations


def test_figures_are_those_of_the_solution(solution: rm.Solution) -> None:
    assessment = solution.assessment
    made = replace(
        solution, seed=5,
        trace=replace(solution.trace, build_time_s=1.0, solve_time_s=20.0, audit_time_s=300.0),
        details={"own": np.float64(2.5)}, limits=rm.Limits(iterations=9),
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
    assert rows["iterations, contact solves"] == f"{made.trace.iterations}, {made.trace.work.contact_solves}"
    motion = np.linalg.norm(made.mesh.p - made.problem.mesh.p, axis=0).max()
    assert float(rows["largest motion"]) == pytest.approx(motion, rel=1e-3)
    pulls = solution.multipliers
    for by, what, rate in (("move limits", "nodes", pulls.limit), ("areas", "elements", pulls.area)):
        assert rows[f"limited by {by}"] == f"{np.sum(rate > 0)} {what}, largest {rate.max():.6g}"
    same = replace(
        made,
        assessment=replace(
            assessment,
            given=with_energies(assessment.given, 0.1, 0.1),
            final=with_energies(assessment.final, 0.1 - 1.4e-17, 0.1 + 1.4e-17),
        ),
    )
    assert [same.record()[name] for name in ("gain", "gain_audited")] == [0.0, 0.0]
    assert dict(same.summary())["audited gain"] == "0 (0 %)"
    assert "(gain 0, 0 %)" in one_line(same.record())
    unknown = replace(made, assessment=replace(made.assessment, first_order=FirstOrder()))
    assert "limited by move limits" not in dict(unknown.summary())
    assert "error reduction" not in rows
    reduction = ErrorReduction((0.3, 0.4), (0.1, 0.2), 2.0, 3.0, "refinement", 15, 7)
    fell = replace(made, reduced_error=ReducedError(reduction))
    assert dict(fell.summary())["error reduction"] == fell.error_reduction.text()
    assert fell.record()["error_reduction"] == plain(fell.error_reduction.record())
    assert replace(made, certificate_remark="no").record()["certificate_remark"] == "no"


@pytest.mark.slow
def test_a_design_is_recorded_with_its_start_its_bounds_and_what_is_constrained() -> None:
    twice = (*LIMITED, Constraint("body(ux**2)", (1e-9, np.inf)))
    problem = replace(block(E, BOW, constraints=twice, n=(3, 1)), motion=Motion(0))
    made = nested.solve(problem, objective="mean(right, uy**2)", limits={"iterations": 1})
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
    assert peak["value"] == pytest.approx(largest_mean(made.problem), rel=1e-6)
    there = Outer.of(made.problem, "body(ux**2)")
    assert strain["value"] == pytest.approx(there.function(np.zeros(there.n)).value, rel=1e-6)
    rows = dict(made.summary())
    assert rows["objective"] == "mean(right, uy**2)"
    assert rows["objective at the start"] == f"{record['objective_initial']:.6g}"
    assert rows["design variable E"] == f"{made.design['E']:.6g} from 1, bounds 0.5 to 2"
    assert rows["constraint max-pressure(bottom)"] == f"{peak['value']:.6g}, at most 200"
    assert "audited energy" not in rows  # energies of different designs do not compare


def test_a_violated_constraint_is_named() -> None:
    problem = replace(block(E, constraints=(Constraint("area", (5.0, 6.0)),), n=(4, 1)), motion=Motion(0))
    found = fixed.solve(problem, objective="mean(right, uy)")
    assert found.status is Status.VIOLATED
    assert found.message.endswith("area = 4, 5 to 6")
    assert found.constraints["area"].violation == pytest.approx(1 / 6)


def test_a_variable_at_its_bound_is_said_to_be_there(solution: rm.Solution) -> None:
    designed = block(E, BOW)
    for value, words in ((2.0, "2, at its bound, from 1"), (1.99, "1.99 from 1")):
        found = solution.assessment
        final = replace(found.final, design={"E": value})
        rows = dict(replace(solution, assessment=replace(found, final=final, designed=designed)).summary())
        assert rows["design variable E"] == f"{words}, bounds 0.5 to 2"
        assert "design variable bow" not in rows  # a level of an epigraph has no row either


def test_success_says_what_it_lacks(solution: rm.Solution) -> None:
    early = Status.ITERATION_LIMIT
    ends = [compared(), compared(early, stationary=False), compared(contact=early)]
    made = [replace(solution, assessment=end) for end in ends]
    words = [dict(one.summary())["success"] for one in made]
    assert words == ["yes", f"yes: {NOT_STATIONARY_YET}", "no"]
    lines = [one_line(one.record()) for one in made]
    assert [line.endswith(NOT_STATIONARY_YET) for line in lines] == [False, True, False]
    assert lines[2].endswith(early.message)


def test_work_is_summed_over_all_outer_problems() -> None:
    monitor, outer = rm.Monitor(), Outer.of(rm.EXAMPLES["6.2"]((4, 2)))
    monitor.work += Work(kkt_factorisations=7)
    for other in (outer, outer.near(), Outer.of(outer.problem)):  # a start that is near is no other problem
        monitor.tracked(other).energy(np.zeros(outer.n))
    assert monitor.spent.contact_solves == outer.energy.contact_solves + 1
    assert monitor.spent.kkt_factorisations == 7


NAN = float("nan")


def test_values_become_plain() -> None:
    given = [np.int64(3), np.bool_(True), NAN, np.float64(-np.inf), "x", 0.5]
    expected = [3, True, None, None, "x", 0.5]
    assert [plain(value) for value in given] == expected
    assert [type(plain(value)) for value in given] == [type(value) for value in expected]


def test_work_is_added_up_and_what_was_not_counted_is_not_in_the_record(solution: rm.Solution) -> None:
    total = Work(1, 1, 5) + Work(2, 3, 0, 7)
    assert total == Work(3, 4, 5, 7) + Work()
    assert vars(total).items() <= replace(solution, trace=Trace(work=total)).record().items()
    row = replace(solution, trace=Trace(work=Work(8, 0, 1))).record()
    assert (row["contact_solves"], row["contact_factorisations"]) == (8, 1)
    assert not row.keys() & {"cold_contact_solves", "kkt_factorisations"}


def test_histories_are_plain_and_keep_an_infinite_t() -> None:
    step = Step(3, -1.0, float("inf"), 0.0, NAN, 7, 0.25, np.ones(2), product=0.5)
    row = step.row()
    assert (row["t"], row["dual_residual"], row["objective"], row["product"]) == (np.inf, None, None, 0.5)
    assert replace(step, t=NAN).row()["t"] is None
    assert replace(step, design={"E": 2.0}).row() == step.row() | {"design.E": 2.0}
    assert "q=" not in repr(step)  # thousands of numbers


CERTIFIED = Certificate(
    lower=-3.0, upper=-2.0, gaps=(2.0, 0.5), error_bound_initial=2.0, error_bound=1.0, relative_initial=0.5,
    relative=0.125, guaranteed_lower=True, guaranteed_upper=True, guaranteed_initial=True, why="because",
    local=np.zeros(1), local_initial=np.zeros(1), field=np.zeros((2, 1)), residual=0.0,
    bounds={"resultant(bottom)": Bounds(2.0, 2.5, float("inf"), True)},
)  # fmt: skip
GUARANTEES = ("guaranteed_lower", "guaranteed_upper", "guaranteed_initial")


@pytest.mark.parametrize("lacks", [None, *GUARANTEES])
def test_a_certificate_tells_its_bounds_and_whether_they_are_ones(lacks: str | None) -> None:
    found = CERTIFIED if lacks is None else replace(CERTIFIED, **{lacks: False})
    word = "at most" if lacks is None else "estimated at"
    assert found.sentence == f"error in the energy norm {word} 50 % before, 12.5 % after"
    assert found.sentences == ["resultant(bottom) at least 2, guaranteed (computed: 2.5)"]
    doubtful = {name: of._replace(guaranteed=False) for name, of in found.bounds.items()}
    assert "at least 2, estimated (" in replace(found, bounds=doubtful).sentences[0]
    claim = ErrorReduction((1, 2), (1, 2), 1, 2, "refinement", 9, 3)
    proved = found.of_reduction(claim)
    if lacks is None:
        assert (proved.source, proved.factor) == ("certified", 4.0)
        assert (proved.error_initial, proved.error) == ((1.5, 2.0), (0.0, 0.5))
    else:
        assert proved == claim


@pytest.mark.parametrize(
    ("upper", "proved", "disproved"), [(-3.5, True, True), (-3.5, False, False), (-3.0, True, False)]
)
def test_an_energy_below_a_proven_bound_is_not_admissible(upper, proved, disproved) -> None:
    found = replace(CERTIFIED, upper=upper, guaranteed_lower=proved)
    assert found.is_disproved is disproved
    assert ("-3.5 lies below the proven bound -3," in found.sentence) is disproved


ROOT = Path(__file__).parents[2]
SOLVES: dict[str, tuple[str, Any, dict[str, Any]]] = {
    "fixed": ("6.1", 3, {"certify": True}),
    "mpcc": ("6.1", 2, {"objective": "error-l2", "limits": rm.Limits(iterations=5)}),
    "nested": ("6.3", (2, 2), {"starts": 1}),
    "auto": ("6.2", (2, 2), {}),
}


@pytest.mark.usefixtures("estimates_unasked")
@pytest.mark.parametrize("formulation", SOLVES)
def test_every_entry_of_a_record_is_declared_and_of_its_type(formulation: str) -> None:
    example, size, options = SOLVES[formulation]
    record = rm.solve(rm.EXAMPLES[example](size), formulation, **options).record()
    assert set(record) <= set(ENTRIES)
    always = {name for name, entry in ENTRIES.items() if entry.of is not None and entry.presence is not KNOWN}
    assert always <= set(record)
    assert read_record(to_json(record), "here")["formulation"] == record["formulation"]


@pytest.mark.usefixtures("estimates_unasked")
def test_contact_results_have_the_units_of_the_problem() -> None:
    def labels(example: str) -> list[str]:
        problem = replace(rm.EXAMPLES[example]((2, 2)), units=rm.Units("mm", "N"))
        return [label for label, _ in contact_rows(fixed.solve(problem))]

    units = {"normal force": "N/mm", "peak pressure": "N/mm²", "contact length": "mm"}
    units["force on the body"] = "N/mm"
    assert labels("6.2") == [*(f"contact: {name} [{unit}]" for name, unit in units.items()), "energy"]
    assert labels("6.1")[0] == "contact: normal force"  # as in its figures


def test_results_of_all_contact_boundaries_are_sums_and_the_largest_pressure() -> None:
    solution = fixed.solve(block_between_two_foundations(1))
    both = {"a": ContactResult(1.0, 2.0, 3.0, 4.0), "b": ContactResult(5.0, 6.0, 1.0, 8.0)}

    def found(contact: dict[str, ContactResult]) -> list[Any]:
        final = replace(solution.assessment.final, contact=contact)
        record = replace(solution, assessment=replace(solution.assessment, final=final)).record()
        return [record.get(name) for name in ("resultant", "peak_pressure", "contact_length")]

    assert found(both) == [6.0, 3.0, 12.0]
    assert found({}) == [None] * 3


def test_a_solution_can_be_pickled_with_its_factors_and_its_audit() -> None:
    found = fixed.solve(rm.EXAMPLES["6.3"]((16, 8)))  # too large for dense factors
    again = pickle.loads(pickle.dumps(found))
    assert again.record() == found.record()
    assert again.final.continuous.continuous.solve().energy == pytest.approx(found.energy_audited, rel=1e-9)


def test_the_pages_have_the_declared_entries_and_all_public_names(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [str(ROOT / "scripts"), *sys.path])
    import records_page

    for path, write in records_page.WRITTEN.items():
        text = path.read_text()
        assert text == write(text), "run python scripts/records_page.py"
    public = set(rm.__all__) - {"__version__"}
    assert public <= set(re.findall(r"`rm\.(\w+)`", records_page.NAMES.read_text()))


@pytest.mark.parametrize("order", ORDERS)
def test_fields_are_values_at_the_points_of_nodes_and_approach_the_solution(order: int) -> None:
    """The exact one touches for x < 0 with the pressure 3/2 sqrt(-x).

    No node is at 0, so that contact ends within an edge.
    """
    errors = []
    for n in (4, 9):
        problem = replace(signorini.problem(n), order=order)
        solution, space = fixed.solve(problem), DisplacementSpace(problem)
        assert solution.success
        x, y = space.points(np.asarray(solution.mesh.p))
        wanted = np.array([float(signorini.exact(*at)) for at in zip(x, y, strict=True)])
        assert solution.displacement.shape == (1, space.n_nodes)
        assert solution.final.pressure.shape == solution.final.tangential_stress.shape == (space.n_nodes,)
        off = np.abs(solution.displacement[0] - wanted)
        given = (np.abs(x) > 1 - 1e-9) | (y > 1 - 1e-9)
        assert np.max(off[given]) < 1e-12  # at middles of edges as at vertices
        assert np.min(solution.final.pressure) >= 0
        # of the edge in which contact ends half the force goes to the vertex beyond, linear from there on
        assert not np.any(solution.final.pressure[(y > 0) | (x > 3 / (2 * n + 1) - 1e-9)])
        # away from the end of contact
        contact = (y == 0) & (x > -1 + 1e-9) & (x < -0.25)
        force = np.abs(solution.final.pressure - 1.5 * np.sqrt(np.abs(x)))
        errors.append((np.max(off), np.max(force[contact])))
    assert np.all(np.array(errors[1]) < np.array(errors[0]) / 2.5)
    assert errors[1][1] < (0.005, 0.006)[order - 1]  # of order 2 forces are shared by whole edges


def total(terms: dict[str, float]) -> float:
    return terms["I1"] + terms["I2"] + terms["I3"]


def taylor_test(orders: list[float]) -> TaylorTest:
    n = len(orders) + 1
    return TaylorTest("mine", 1.0, 2.0, np.ones(n), np.ones(n), np.array(orders))


def test_the_last_known_order_of_a_taylor_test_decides() -> None:
    for orders, order in (([1.0, 2.0, np.nan], 2.0), ([2.0, 1.0], 1.0), ([np.nan, np.nan], np.inf)):
        assert taylor_test(orders).order == order
    assert [bool(taylor_test(orders)) for orders in ([2.0, 1.89], [1.0, 1.9])] == [False, True]
    values = [value.strip() for _, value in taylor_test([2.0, 1.5]).summary()]
    assert values == ["2", "1.00e+00", "1.00e+00 order 2.00", "1.00e+00 order 1.50", "WRONG: order 1.50"]
    assert taylor_test([1.0, 2.0]).summary()[-1][1] == "right: order 2.00"


def test_rounding_says_nothing_of_a_gradient() -> None:
    """The position of a node is linear: its remainders are rounding, and no order is known."""
    problem = ContactProblem(rm.shapes.rectangle(3, 3), Laplace(1.0), ("left",), motion=Motion(0.05))
    node = int(np.argmin(np.abs(problem.mesh.p - 1 / 3).sum(axis=0)))
    test = verify_gradient(problem, rm.quantities.nodal([node], lambda X, u: X[0, 0] + 3.0))
    assert np.all(np.isnan(test.orders))
    assert test.order == np.inf
    assert test


def test_nothing_that_moves_is_refused() -> None:
    problem = ContactProblem(rm.shapes.rectangle(1, 1), Laplace(1.0), ("left",), motion=Motion(0.05))
    with pytest.raises(ValueError, match="may move: there is no gradient"):
        verify_gradient(problem)


@pytest.mark.slow
@pytest.mark.parametrize("order", ORDERS)
def test_with_friction_the_third_term_closes_the_sum(order: int) -> None:
    found = []
    for n in (4, 8):
        problem = replace(sliding_block(n), order=order)
        terms = error_terms(problem, problem.mesh.p)
        assert min(terms["I1"], terms["I3"]) > 0  # on these grids nodes slide where the exact solution sticks
        assert terms["I2"] >= -1e-12
        # loads and displacement are polynomials on the elements, so rules are exact and nothing is left over
        assert total(terms) == pytest.approx(terms["energy_above_exact"], rel=1e-9)
        assert total(terms) - terms["I3"] != pytest.approx(terms["energy_above_exact"], rel=1e-6)
        found.append(terms)
    assert total(found[1]) < 0.5 * total(found[0])


def test_the_terms_sum_to_the_energy_above_the_exact_one_whatever_the_rule() -> None:
    one, two = (rm.EXAMPLES["6.1"](4).with_rule(rule) for rule in (1, 8))
    terms = error_terms(one, one.mesh.p)
    assert terms == error_terms(two, two.mesh.p)
    assert terms["I3"] == 0
    assert min(terms["I1"], terms["I2"]) > 0
    assert total(terms) == pytest.approx(terms["energy_above_exact"], rel=1e-5)  # but for the load by a rule


def test_a_record_has_the_terms_and_their_time_and_a_broken_mesh_has_none(monkeypatch):
    found = solved("fixed", "6.1", 4)
    record, terms = found.record(), error_terms(found.problem, found.mesh.p)
    assert record.items() >= terms.items()
    assert found.record()["audit_time_s"] == record["audit_time_s"] > found.trace.audit_time_s
    assert record["wall_time_s"] - found.trace.wall_time_s == pytest.approx(
        record["audit_time_s"] - found.trace.audit_time_s
    )
    monkeypatch.setattr("rmesh_nlp.solving.relocated.error_terms", lambda *_: pytest.fail("it was evaluated"))
    inverted = replace(found.assessment.final, min_area_ratio=0.0)
    broken = replace(found, assessment=replace(found.assessment, final=inverted))
    assert broken.record()["status"] == "invalid_mesh"


def test_without_an_exact_solution_there_are_no_terms() -> None:
    problem = rm.EXAMPLES["6.2"]((6, 4))
    assert error_terms(problem, problem.mesh.p) == {}
