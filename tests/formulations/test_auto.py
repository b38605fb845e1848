"""What is chosen for a problem, the cascade of meshes behind it, what Ctrl-C keeps, and the record of it."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rmesh_nlp as rm
from formulations import cascade as module
from formulations.auto import DEGREE, Auto
from formulations.cascade import Cascade
from formulations.fixed import Fixed
from formulations.joint import Joint
from formulations.nested import Nested
from formulations.schedule import Schedule
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.meshes.shapes import plate_with_hole, rectangle
from rmesh_nlp.models.levels import coarsened
from rmesh_nlp.models.regularisation import gain_estimate
from rmesh_nlp.solving.parts import Step
from rmesh_nlp.solving.summary import summary
from support.formulations import auto
from support.problems import no_move_limits


def free(n: int) -> rm.ContactProblem:
    return no_move_limits(rm.EXAMPLES["6.1"](n=n))


@pytest.mark.slow
def test_relocation_without_move_limits_and_what_the_record_and_the_steps_say_of_it() -> None:
    problem = free(16)
    seen: list[Step] = []
    solution = auto.solve(problem, on_step=seen.append, **{"iterations": 20})
    row, exact = solution.record(), problem.exact.energy
    # move limits of a fifth of an edge give 1.6 times less
    assert row["energy_initial_audited"] - exact > 5 * (row["energy_audited"] - exact)
    assert row["chosen_by"] == "auto"
    assert "81, 289 nodes" in row["chosen"]
    assert (row["formulation"], row["outer"], row["quadrature"]) == ("cascade", "newton", DEGREE)
    assert [level["nodes"] for level in row["cascade"]] == [81, 289]
    own = row["cascade"][1]["iterations"]
    assert row["iterations"] == row["cascade"][0]["iterations"] + own
    assert [step.q is None for step in seen].count(False) == own + 1
    assert np.all(signed_areas(solution.mesh.p, problem.triangles) > 0)
    assert all(math.isfinite(step.dual_residual) for step in seen)
    assert seen[0].dual_residual == pytest.approx(1.0)  # the mesh as given
    # by the measure of records, and of the mesh that the step is on
    assert seen[-1].dual_residual == pytest.approx(solution.assessment.first_order.residual, rel=1e-6)
    assert seen[-1].energy_given == pytest.approx(solution.energy_initial)


def square(n: int, motion: rm.Motion, **parts: Any) -> rm.ContactProblem:
    return rm.ContactProblem(rectangle(n, n), rm.Laplace(1.0), ("left", "right"), motion=motion, **parts)


INSIDE = tuple(square(3, rm.Motion()).mesh.interior_nodes().tolist())
STILL = rm.Motion(None, pinned=("left", "bottom", "top", "right", *INSIDE))
BODY = rm.ContactProblem(
    rectangle(6, 3, x=(0, 2)),
    rm.PlaneStrain(1.0, 1.0),
    "left",
    rm.Obstacle.curve("bottom", lambda x, y: y + 0.05 * (x - 1) ** 2),
    rm.Motion(None),
)
RINGS = rm.read_problem(Path(__file__).parents[2] / "docs" / "parts" / "rings.toml")
FREE_RINGS = replace(
    RINGS,
    obstacle=tuple(replace(part, coulomb=0.0) for part in RINGS.obstacles),
    motion=replace(RINGS.motion, delta=None),
)


def pin(radius: float, order: int) -> rm.ContactProblem:
    """A plate with a round hole of radius 1 that touches a pin at its right end."""
    plate = plate_with_hole(0.45, size=4, radius=1)
    return rm.ContactProblem(
        plate, rm.PlaneStrain(1.0, 1.0), "left", rm.Obstacle.circle("hole", (3 - radius, 2), radius),
        rm.Motion(None, curves={"hole": rm.Circle((2, 2), 1)}), order=order,
    )  # fmt: skip


# the gap of a membrane says nothing of its outline
ROUND = replace(pin(0.99, 2), law=rm.Laplace(1.0), obstacle=rm.Obstacle("hole", (1.0,)), dirichlet="left")


@pytest.mark.parametrize(
    ("problem", "objective", "chosen", "why"),
    [
        (square(3, rm.Motion(0.02)), "energy", Joint, "joint: nodes have move limits"),
        # on 1,156 nodes: the time of joint grows like the square of their number
        (square(33, rm.Motion(0.001)), "energy", Nested, "nested, newton: nodes have move limits"),
        (square(3, STILL), "energy", Nested, "nested: no node can move"),
        (square(3, rm.Motion(0.02)), "body(u)", Nested, "nested: the objective is not the energy"),
        (square(3, rm.Motion(None, min_angle=20.0)), "energy", Schedule, "joint, regularised"),
        (square(3, rm.Motion(None)), "energy", Cascade, "cascade: relocation without move limits"),
        (BODY, "energy", Cascade, "gaps along edges: a foundation is curved"),
        (pin(0.99, 2), "energy", Fixed, "fixed: nodes on arcs that fit what they touch"),
        (pin(0.99, 1), "energy", Cascade, "gaps along edges: a foundation is curved"),
        (pin(0.5, 2), "energy", Cascade, "gaps along edges: a foundation is curved"),
        (replace(BODY, order=2), "energy", Cascade, "gaps along edges: a foundation is curved"),
        (ROUND, "energy", Cascade, "cascade"),
        (FREE_RINGS, "energy", Fixed, "fixed: nodes on arcs that fit what they touch"),
    ],
)
def test_the_formulation_that_is_chosen_and_why(problem, objective, chosen, why):
    choice = Auto().choose(problem, parse_objective(objective))
    assert type(choice.formulation) is chosen
    assert why in choice.why
    for part in choice.problem.obstacles:
        assert part.gap == ("node" if part.other or problem.components == 1 else "edge")


@pytest.mark.slow
def test_a_seed_starts_elsewhere_without_a_cascade() -> None:
    row = auto.solve(free(2), seed=1).record()
    assert row["start"] == "random"
    assert row["chosen"].startswith("nested, newton: relocation from the start")
    assert row["gain_audited"] > 0


@pytest.mark.usefixtures("estimates_unasked")
def test_with_coulomb_friction_the_given_mesh_is_solved_and_an_objective_is_named() -> None:
    example = rm.EXAMPLES["6.3"]((4, 2))
    rough = replace(example, obstacle=replace(example.obstacle, friction=0.0, coulomb=0.3))
    solution = rm.solve(rough)
    assert solution.success
    assert not np.any(solution.mesh.p != rough.mesh.p)
    assert solution.chosen.startswith("fixed: with Coulomb friction")
    assert "'mean(load, -uy)'" in solution.chosen
    said = dict(summary(solution))["contact: normal force [N/m]"]
    assert f"(computed {solution.record()['resultant']:.6g})" in said


def accurate(n: int) -> rm.ContactProblem:
    return replace(free(n), quadrature=8)


@pytest.mark.slow
def test_levels_have_the_weight_of_their_error_and_add_up() -> None:
    problem = accurate(6)
    solution = rm.solve(problem, Cascade(coarsest=12, iterations=6))
    row, (coarse, fine) = solution.record(), solution.record()["cascade"]
    assert [level["nodes"] for level in (coarse, fine)] == [16, 49]
    assert [level["triangles"] for level in (coarse, fine)] == [18, 72]
    # the error falls like the number of nodes
    coarser = coarsened(problem, 12)
    assert coarser is not None
    error = gain_estimate(ContactSolver(coarser)) * 16 / 49
    assert row["gain_estimate"] == pytest.approx(error)
    assert row["regularisation_weight"] == pytest.approx(0.003 * error)
    assert row["iterations"] == coarse["iterations"] + fine["iterations"] <= 5 * 6
    assert 0 < coarse["contact_solves"] + fine["contact_solves"] <= row["contact_solves"]
    assert fine["energy"] == pytest.approx(solution.energy)
    assert solution.energy < solution.energy_initial


@pytest.mark.slow
def test_a_map_that_folds_triangles_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    def folded(*given: Any) -> np.ndarray:
        return np.random.default_rng(0).uniform(-9, 9, given[-1].n_q)

    monkeypatch.setattr(module, "prolonged", folded)
    assert rm.solve(accurate(6), coarsest=12, iterations=2).record()["gain_audited"] > 0


@pytest.mark.slow
def test_a_limit_on_a_coarse_mesh_takes_its_map_to_the_given_one() -> None:
    problem = accurate(6)
    solution = rm.solve(problem, Cascade(coarsest=12), limits=rm.Limits(iterations=2))
    row = solution.record()
    assert (solution.status, row["valid"]) == (rm.Status.ITERATION_LIMIT, True)
    assert [level["nodes"] for level in row["cascade"]] == [16]
    assert np.min(signed_areas(solution.mesh.p, problem.triangles)) > 0
    assert solution.assessment.gain_audited > 0


@pytest.mark.slow
def test_from_its_end_newton_comes_to_a_stationary_point_in_as_few_solves() -> None:
    """A factorisation near the end: without any 8 to 19 times as many contact solves were taken."""
    problem = accurate(16)
    first = rm.solve(problem, "cascade")
    solution = rm.solve(problem, start=first)
    assert first.status is not solution.status is rm.Status.CONVERGED
    assert solution.assessment.first_order.residual <= 1e-6
    assert solution.trace.work.contact_solves <= 2 * first.trace.work.contact_solves
    assert solution.energy_audited < first.energy_audited


@pytest.mark.slow
def test_meshes_that_are_not_nested_gain_as_much_as_their_neighbours() -> None:
    """Error times nodes, in the mean: single ones differ by a tenth between sizes and processors."""
    products = []
    for n in range(12, 18):
        problem = accurate(n)
        error = rm.solve(problem, "cascade").energy_audited - problem.exact.energy
        products.append(error * problem.mesh.p.shape[1])
    assert np.mean(products[1::2]) < 1.1 * np.mean(products[::2])
