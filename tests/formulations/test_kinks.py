"""Descents that meet a kink go on from there, and what both formulations end at is judged alike."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import rmesh_nlp as rm
from formulations import kinks
from formulations import nested as module
from formulations.kinks import CREEPING, EXACT_FINISH, WINDOW, Zigzag
from formulations.nested import Nested
from rmesh_nlp.meshes import named
from rmesh_nlp.models.residual import OuterResidual
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.outer import Outer
from support.endings import ended
from support.solved import example, solved

LEAK = "boundary(seal, 1.2*(y + uy) - y)"


def seal() -> ContactProblem:
    """A block whose lower edge may be cut in the middle; at the best edge it touches there without force."""
    mesh = named(rm.shapes.rectangle(8, 2, x=(0, 2)), {"seal": lambda x: (x[1] == 0) & (abs(x[0] - 1) < 0.5)})
    moves = (mesh.p[1] == 0) & (abs(mesh.p[0] - 1) < 0.5)
    free, pinned = (tuple(int(node) for node in np.flatnonzero(which)) for which in (moves, ~moves))
    return rm.ContactProblem(
        mesh=mesh,
        law=rm.PlaneStrain.from_young(1000.0, 0.3),
        dirichlet=(rm.Dirichlet("left", (0.0, None)),),
        obstacle=rm.Obstacle.graph("bottom", 0.0),
        motion=rm.Motion((1e-6, 0.02), pinned=pinned, free=free),
        tractions=(rm.Traction("top", (0.0, -10.0)),),
    )


def test_nested_settles_on_a_kink_where_mpcc_ends_and_both_are_labelled_alike() -> None:
    nested, mpcc = (rm.solve(seal(), name, objective=LEAK) for name in ("nested", "mpcc"))
    rows = [solution.record() for solution in (nested, mpcc)]
    for solution, row in zip((nested, mpcc), rows, strict=True):
        assert (solution.status, row["stationarity"]) == (Status.CONVERGED, "S")
        assert row["label"] == "S (3 biactive pairs, B-stationary)"
        assert (row["b_stationary"], row["biactive"], row["descent_rate"]) == (True, 3, 0.0)
        assert len(row["biactive_nodes"]) == 3
        # the gradient with the contact set held is that of one side
        assert solution.stationarity_residual > 1e-2
    assert rows[0]["objective_value"] == pytest.approx(rows[1]["objective_value"], rel=1e-8)
    assert rows[0]["outer"].endswith(f", then {EXACT_FINISH}")
    assert 0 < rows[0]["kkt_factorisations"] < rows[1]["kkt_factorisations"]
    assert nested.history[-1].objective == pytest.approx(rows[0]["objective_value"], rel=1e-12)
    iterations = [step.iteration for step in nested.history]
    assert iterations == sorted(iterations)


def test_a_finish_that_raises_the_objective_or_fails_is_not_taken_and_the_descent_that_is_left_is_said(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "finished", lambda outer, point, monitor: (None, 7))
    solution = rm.solve(seal(), "nested", objective=LEAK)
    row = solution.record()
    assert (solution.success, solution.status) == (True, Status.STALLED)
    assert (EXACT_FINISH in row["outer"], row["b_stationary"]) == (False, False)
    if row["biactive"]:
        assert row["descent_rate"] < -1e-6


def test_a_finish_that_leaves_a_descent_is_followed_by_a_sharper_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kinks, "FINISH", {**kinks.FINISH, "max_iter": 1})
    solution = rm.solve(seal(), "nested", objective=LEAK)
    assert solution.status is Status.CONVERGED
    assert solution.record()["outer"] == f"newton, then {EXACT_FINISH}"


@pytest.mark.parametrize("formulation", [Nested(iterations=3), Nested(enough=0.1)])
def test_an_end_that_was_asked_for_is_the_end(formulation: Nested) -> None:
    solution = rm.solve(seal(), formulation, objective=LEAK)
    assert solution.success
    assert solution.record()["outer"] == "newton"


def test_for_the_energy_there_is_no_kink() -> None:
    row = rm.solve(example("6.3", (4, 2)), "nested").record()
    assert (row["stationarity"], row["outer"]) == ("KKT", "newton")
    assert not {"descent_rate", "label"} & row.keys()


def test_a_residual_whose_multipliers_were_fitted_badly_is_no_proof_against_a_claim(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem, objective = example("6.1", 3, 6), "error-l2"
    outer = Outer.of(problem, objective)
    q = outer.variables(np.asarray(solved("nested", "6.1", 3, 6, objective=objective).mesh.p))
    monkeypatch.setattr(OuterResidual, "__call__", lambda *_: 1.0)
    for claim in (Status.CONVERGED, Status.STALLED):
        found = ended(outer, q, claim)
        assert (found.status, found.first_order.label.b_stationary) == (claim, claim is Status.CONVERGED)
    given = ended(outer, np.zeros(outer.n))  # what is claimed is looked at
    assert (given.status, given.first_order.stationarity) == (Status.NOT_STATIONARY, "none")


def _point(contact: int) -> SimpleNamespace:
    active = SimpleNamespace(key=lambda: bytes([contact]))
    return SimpleNamespace(equilibrium=SimpleNamespace(active=active))


@pytest.mark.parametrize(("changes", "part"), [(True, 0.5), (True, 2.0), (False, 0.5)])
def test_a_descent_zigzags_if_contact_changes_and_hardly_anything_is_gained(
    changes: bool, part: float
) -> None:
    tell, gain = Zigzag(), part * CREEPING / WINDOW
    said = [tell(_point(0), 0.0, 1.0)]
    said += [tell(_point(k % 2 if changes else 0), 0.0, -gain * k) for k in range(1, 2 * WINDOW)]
    assert not any(said[: WINDOW + 1])
    assert any(said) == (changes and part < 1)


@pytest.mark.parametrize("falls", [True, False])
def test_a_descent_that_does_not_reach_the_constraints_zigzags_too(falls: bool) -> None:
    tell = Zigzag()
    violations = [1.0 / (1 + k) if falls else 1.0 + k % 2 for k in range(2 * WINDOW)]
    # the objective falls all the while: that is no progress
    said = [tell(_point(k % 2), violation, -float(k)) for k, violation in enumerate(violations)]
    assert any(said) == (not falls)
