"""A planned solve becomes one row: its own, or that of its failure."""

from dataclasses import replace

import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.io.records import REQUIRED
from rmesh_nlp.io.results import Results
from rmesh_nlp.io.vtu import fields_of, read_vtu
from rmesh_nlp.study import runner
from rmesh_nlp.study.plan import PlannedSolve, planned
from rmesh_nlp.study.runner import Done, perform
from support.planted import plant, raising


@pytest.fixture(scope="module")
def one():
    return planned(rm.EXAMPLES["6.3"]((2, 2)), "fixed")


def test_fields_survive_the_file_and_a_failure_removes_them(one, tmp_path):
    done = perform(one)
    assert done.solution is not None
    places = Results(tmp_path).result(done.row)
    done.save(places)
    written, read = fields_of(done.solution), read_vtu(places.vtu)
    assert (read.triangles == written.triangles).all()
    for one, other in ((read.given, written.given), (read.final, written.final)):
        for name in ("nodes", "displacement", "pressure", "friction_bound", "gap", "stress"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)
        assert one.friction_bound[np.isfinite(one.gap)].min() == 10
        (feet,) = one.feet.values()
        assert np.nanmax(np.abs(feet[1])) == 0
        np.testing.assert_array_equal(feet, other.feet["contact"])
    assert len(places.steps()) == 1
    for _ in range(2):  # nothing to remove is no error
        Done(done.row).save(places)
        assert not places.vtu.exists()
        assert not places.history.exists()


@pytest.mark.slow
@pytest.mark.parametrize("formulation", ["nested", "joint", "mpcc"])
def test_the_history_has_the_first_order_residual(formulation, tmp_path):
    """It starts at one, that of the mesh as given, and ends at that of the mesh of the solution."""
    done = perform(planned(rm.EXAMPLES["6.3"]((4, 2)), formulation))
    places = Results(tmp_path).result(done.row)
    done.save(places)
    steps = [*places.steps()["stationarity"]]
    assert np.all(np.isfinite(steps))
    assert steps == pytest.approx([step.stationarity for step in done.solution.history])
    outer = rm.Outer.of(done.solution.problem)
    q = outer.relocation.parts.mesh_map.q_of(np.asarray(done.solution.mesh.p))
    assert steps[0] == pytest.approx(1, rel=0.1)  # mpcc has the forces of its first relaxation there
    assert steps[-1] == pytest.approx(outer.residual(outer.energy(q)), abs=1e-5)
    assert steps[-1] <= 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("count", [3, 2])
def test_repeats_are_bare_and_their_times_medians_with_a_range(one, count, monkeypatch):
    """Those after an interrupted run are left out."""
    runs, honest = [], runner.driver.solve

    def solve(*given, **options):
        solution, k = honest(*given, **options), len(runs)
        runs.append(options["certify"])
        seconds = {"build_time_s": [3.0, 1.0, 2.0][k], "solve_time_s": 1.0, "contact_time_s": float("nan")}
        trace = replace(solution.trace, **seconds)
        return replace(solution, is_interrupted=k + 1 == count < 3, trace=trace)

    monkeypatch.setattr(runner.driver, "solve", solve)
    row = perform(replace(one, certify=True, repeats=3)).row
    assert runs == [True, False, False][:count]
    if count < 3:
        assert row["status"] == "interrupted"
        return
    assert (row["build_time_s"], row["build_time_range_s"], row["repeats"]) == (2.0, [1.0, 3.0], 3)
    assert row["first_cost_s"] == 3.0 + 1.0
    assert "contact_time_range_s" not in row  # which no run has


@pytest.mark.parametrize(
    ("error", "status", "message"),
    [
        (ValueError("not\n this"), "refused", "not this"),
        (ValueError(), "refused", "ValueError"),
        (ZeroDivisionError("by zero"), "failed", "ZeroDivisionError: by zero"),
    ],
)
def test_an_exception_is_a_row(one, error, status, message, monkeypatch):
    plant(monkeypatch, fixed=raising(error))
    solve = replace(one, options={"seed": 3, "objective": "error-l2"}, repeats=2)
    done = perform(solve)
    row = done.row
    assert done.solution is None
    assert (row["status"], row["success"], row["message"]) == (status, False, message)
    assert (row["seed"], row["objective"], row["stationarity"], row["energy"]) == (3, "error-l2", "", None)
    assert 0 <= row["wall_time_s"] < 60
    assert row["versions"]["python"]
    assert {name: row[name] for name in solve.identity} == solve.identity


def test_a_problem_that_cannot_be_built_is_a_row():
    row = perform(PlannedSolve({"kind": "dream"}, "x", "f", "9", "v", "fixed")).row
    assert (row["status"], row["message"]) == ("failed", "ValueError: unknown kind of problem 'dream'")
    assert set(REQUIRED) <= set(row)
    assert (row["example"], row["family"], row["n"], row["variant"], row["repeat"]) == ("x", "f", "9", "v", 0)
