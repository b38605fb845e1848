"""What is chosen for a problem, the cascade behind it, and that the record says so."""

import math
import signal
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from support.problems import no_boxes

from support.formulations import auto, auto_cascade, nested
from rmesh_nlp.contact.model import ContactModel
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import (
    ContactProblem,
    Dirichlet,
    Laplace,
    Motion,
    Obstacle,
    PlaneStrain,
    Traction,
    signed_areas,
)
from rmesh_nlp.programs.acceptance import _continuous, accepted
from rmesh_nlp.programs.cascade import cascade
from rmesh_nlp.programs.cascade_settings import CascadeSettings
from rmesh_nlp.solving.step import Step


@pytest.mark.slow
def test_large_moves_of_example_61_and_what_the_record_says_of_them() -> None:
    problem = no_boxes(EXAMPLES["6.1"](n=16))
    seen = []
    solution = auto.solve(problem, on_step=seen.append)
    row = solution.record()
    exact = problem.exact.energy
    error = [row["energy_initial_audited"] - exact, row["energy_audited"] - exact]
    # boxes of a fifth of an edge give 1.6 times less
    assert error[0] / error[1] > 5
    assert row["chosen_by"] == "auto"
    assert "81, 289 nodes" in row["chosen"]
    assert (row["formulation"], row["outer"], row["quadrature"]) == ("nested", "newton", 6)
    assert [level["nodes"] for level in row["cascade"]] == [81, 289]
    assert row["cascade"][1]["energy"] < row["cascade"][1]["prolonged"] < row["energy_initial"]
    assert row["status"] == "converged"
    assert row["stationarity_residual"] <= 1e-6
    assert row["stationary_for"].startswith("the energy with shape-size weighted 0.003")
    own, finish = (part["iterations"] for part in (row["cascade"][1], row["finish"]))
    assert finish > 0
    assert row["iterations"] == row["cascade"][0]["iterations"] + own + finish
    assert [step.q is None for step in seen].count(False) == own + 1 + finish + 1
    assert np.all(signed_areas(solution.mesh.p, problem.triangles) > 0)


@pytest.mark.slow
def test_what_a_prolonged_map_is_worth_before_any_iteration() -> None:
    problem = replace(no_boxes(EXAMPLES["6.1"](n=32)), quadrature=6)
    finest = cascade(problem, CascadeSettings(brief=1)).levels[-1]
    given = ContactModel(problem).solve(problem.mesh.p).energy
    assert given - finest.prolonged > 0.6 * (given - problem.exact.energy)


@pytest.mark.parametrize(
    ("motion", "chosen"),
    [
        (Motion(0.02), "joint: nodes have boxes"),
        pytest.param(Motion(None, min_angle=20.0), "joint, regularised", marks=pytest.mark.slow),
    ],
)
def test_joint_is_chosen_where_constraints_must_hold(motion: Motion, chosen: str) -> None:
    solution = auto.solve(replace(EXAMPLES["6.1"](n=4), motion=motion))
    assert solution.formulation == "joint"
    assert solution.record()["chosen"].startswith(chosen)


@pytest.mark.slow
def test_other_objectives_and_meshes_that_cannot_move() -> None:
    problem = EXAMPLES["6.1"](n=3)
    assert auto.solve(problem, objective="error-l2").record()["chosen"].startswith("nested")
    names = ("left", "bottom", "top", "contact")
    inside = tuple(int(node) for node in problem.mesh.interior_nodes())
    still = auto.solve(replace(problem, motion=Motion(None, pinned=(*names, *inside))))
    assert still.record()["chosen"] == "nested: no node can move"


@pytest.mark.slow
def test_a_seed_starts_elsewhere_without_a_cascade() -> None:
    row = auto.solve(no_boxes(EXAMPLES["6.1"](n=4)), seed=1).record()
    assert row["start"] == "random"
    assert row["gain_audited"] > 0


@pytest.mark.slow
def test_the_rule_is_raised_until_the_audit_confirms_the_gain() -> None:
    source = Laplace(lambda x, y: 200 * ca.sin(17 * x) * ca.cos(19 * y))
    problem = ContactProblem(rectangle(8, 8), source, ("left", "right"), motion=Motion(None))
    row = auto.solve(problem).record()
    assert row["rules"][0] == 6
    assert row["rules"][-1] == row["quadrature"]
    assert row["gain_audited"] > 0
    assert abs(row["gain"] - row["gain_audited"]) <= 0.01 * row["gain_audited"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 5, 8])
def test_random_problems_without_boxes_improve(seed: int) -> None:
    row = auto.solve(no_boxes(random_problem(seed))).record()
    assert row["gain_audited"] > 0
    assert row["min_area_ratio"] > 0
    assert row["contact_solves"] <= 200


@pytest.mark.parametrize("bad", [{"regularisation": 0}, {"distortion": "oval"}, {"brief": 0}, {"speed": 1}])
def test_bad_settings_are_refused(bad: dict) -> None:
    with pytest.raises(BadInputError):
        auto.solve(no_boxes(EXAMPLES["6.1"](n=4)), settings=bad)


@pytest.mark.slow
def test_many_moves_in_boxes_are_made_by_newton(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = EXAMPLES["6.1"](n=8)
    by_joint = auto.solve(problem).record()
    monkeypatch.setattr(auto, "MANY", 50)
    row = auto.solve(problem).record()
    assert (by_joint["formulation"], row["formulation"], row["outer"]) == ("joint", "nested", "newton")
    assert "moves are many" in row["chosen"]
    assert row["success"]
    assert row["gain_audited"] >= 0.95 * by_joint["gain_audited"]
    assert row["iterations"] < nested.solve(problem, outer="newton").iterations


def over_a_parabola(n: int) -> ContactProblem:
    """A block that is pressed on a curved foundation, which passes between the nodes of a coarse mesh."""
    return ContactProblem(
        rectangle(2 * n, n, x=(0, 2)),
        PlaneStrain.from_young(1000.0, 0.3),
        dirichlet=(Dirichlet("left", (0.0, None)),),
        tractions=(Traction("top", (0.0, -20.0)),),
        obstacle=Obstacle.curve("bottom", lambda x, y: y + 0.05 * (x - 1) ** 2),
        motion=Motion(None),
    )


@pytest.mark.slow
def test_a_coarse_map_that_gains_by_penetration_is_not_taken_whole() -> None:
    problem = over_a_parabola(12)
    result = cascade(problem, CascadeSettings(brief=1, iterations=10))
    coarse, fine = result.levels[0], result.levels[-1]
    given = ContactModel(problem).solve(problem.mesh.p).energy
    # the coarse map gains on its own mesh, and the gap holds at its nodes only
    assert coarse.energy < given
    assert fine.taken < 1
    assert fine.energy <= given


@pytest.mark.slow
def test_a_part_of_a_map_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(auto, "with_edge_gaps", lambda problem: problem)
    few = {"brief": 1, "iterations": 10, "stationary": 1}
    row = auto.solve(over_a_parabola(12), settings=few).record()
    assert "of a prolonged map a part was taken" in row["chosen"]


@pytest.mark.slow
def test_over_a_curved_foundation_gaps_hold_along_edges_and_gains_are_true() -> None:
    problem = over_a_parabola(6)
    solution = auto.solve(problem, settings={"iterations": 20, "finish": 20})
    row = solution.record()
    assert row["success"]
    assert "gaps along edges" in row["chosen"]
    assert row["penetration"] < 1e-12
    # below the energy of a much finer mesh with gaps at nodes, which is too low, no true gain can lead
    finer = ContactModel(over_a_parabola(24))
    assert finer.solve(finer.problem.mesh.p).energy < row["energy_audited"]
    assert row["energy_audited"] < row["energy_initial_audited"]


@pytest.mark.slow
def test_a_map_is_halved_until_it_lowers_the_energy() -> None:
    problem = replace(no_boxes(EXAMPLES["6.1"](n=4)), quadrature=6)
    energy = cascade(problem).energy
    zero = np.zeros(energy.relocation.n_q)
    downhill = -energy(zero).gradient
    scale = 1e-3 / np.max(np.abs(downhill))
    whole, part = accepted(energy, scale * downhill)
    assert part == 1
    np.testing.assert_array_equal(whole, scale * downhill)
    assert accepted(energy, -scale * downhill)[1] == 0
    np.testing.assert_array_equal(accepted(energy, -scale * downhill)[0], zero)
    far = scale * downhill
    while _continuous(energy, far) < _continuous(energy, zero):
        far = 1.5 * far
    taken, part = accepted(energy, far)
    assert 0 < part < 1
    np.testing.assert_array_equal(taken, part * far)
    assert _continuous(energy, taken) < _continuous(energy, zero)


@pytest.mark.slow
def test_ctrl_c_between_flips_keeps_the_flipped_mesh() -> None:
    problem = no_boxes(EXAMPLES["6.1"](n=6))
    rounds: list[Step] = []

    def press(step: Step) -> None:
        if math.isnan(step.energy_given):  # a step of the rounds of flips
            rounds.append(step)
            signal.raise_signal(signal.SIGINT)

    solution = auto.solve(problem, flips=True, on_step=press)
    assert len(rounds) == 1
    assert solution.status is Status.INTERRUPTED
    assert solution.valid
    assert solution.record()["changed_triangles"] > 0
    assert solution.energy <= rounds[0].energy + 1e-9 * abs(solution.energy)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.slow
def test_a_second_ctrl_c_between_flips_keeps_the_mesh_before_them() -> None:
    problem = no_boxes(EXAMPLES["6.1"](n=6))

    def press(step: Step) -> None:
        if math.isnan(step.energy_given):
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)

    solution = auto.solve(problem, flips=True, on_step=press)
    assert solution.status is Status.INTERRUPTED
    assert solution.valid
    assert "changed_triangles" not in solution.record()
    assert solution.record()["gain_audited"] > 0


@pytest.mark.slow
def test_ctrl_c_while_the_end_is_judged_is_heeded(monkeypatch: pytest.MonkeyPatch) -> None:
    def judge(*given, **options):
        signal.raise_signal(signal.SIGINT)
        return judged(*given, **options)

    judged = auto_cascade.Outer.judge
    monkeypatch.setattr(auto_cascade.Outer, "judge", judge)
    solution = auto.solve(no_boxes(EXAMPLES["6.1"](n=4)), flips=True)
    assert solution.status is Status.INTERRUPTED
    assert solution.valid
    assert solution.record()["gain_audited"] > 0
    assert "changed_triangles" not in solution.record()


@pytest.mark.slow
def test_steps_of_a_cascade_say_residual_gain_and_time_left() -> None:
    steps: list[Step] = []
    problem = replace(no_boxes(EXAMPLES["6.1"](n=16)), quadrature=6)
    solution = auto.solve(problem, on_step=steps.append, settings={"stationary": 1})
    last = steps[-1]
    assert all(math.isfinite(step.dual_residual) for step in steps)
    assert steps[0].dual_residual == pytest.approx(1.0)  # the mesh as given
    # by the measure of records, and of the mesh that the step is on
    assert last.dual_residual == pytest.approx(solution.stationarity_residual, rel=1e-6)
    assert last.energy_given == pytest.approx(solution.energy_initial)
    guesses = [step.seconds_left for step in steps if math.isfinite(step.seconds_left)]
    assert len(guesses) > len(steps) / 2
    assert min(guesses) >= 0
