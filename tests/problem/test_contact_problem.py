"""A contact problem as a whole: refinement keeps it, its description fits a screen, mistakes are named."""

from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from formulations.refined import prolong
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import (
    ContactProblem,
    Dirichlet,
    Laplace,
    Motion,
    Obstacle,
    ProblemError,
    Relative,
    Traction,
)
from rmesh_nlp.problem.conditions import symmetric
from rmesh_nlp.problem.contact_problem import locally_refined, refined
from rmesh_nlp.problem.motion import BY_BARRIER
from support.formulations import fixed, joint, mpcc


def test_problem_is_frozen_and_one_condition_may_stand_alone() -> None:
    problem = ContactProblem(rectangle(2, 2), Laplace(1.0), "left", tractions=Traction("right", 2.0))
    assert problem.dirichlet == ("left",)
    assert problem.tractions == (Traction("right", (2.0,)),)
    with pytest.raises(FrozenInstanceError):
        problem.name = "other"  # type: ignore[misc]


@pytest.mark.parametrize(
    ("change", "part", "message"),
    [
        ({"dirichlet": 3}, "dirichlet", "dirichlet must be names of boundaries or Dirichlet, got 3"),
        ({"motion": None}, "motion", "motion must be Motion, got None"),
        ({"dirichlet": ("left", Dirichlet("bottom", (1.0,)))}, "dirichlet", "is 1 at node 0, where another"),
        ({"obstacle": Obstacle("left", (1.0,))}, "obstacle", "no node of the contact set is free"),
        ({"obstacle": Obstacle("left", (1.0,), -0.1)}, "obstacle", "makes its gap -0.1"),
        ({"obstacle": Obstacle("right", (0.6, 0.8))}, "obstacle", "needs 1 values"),
        ({"law": {}, "dirichlet": ()}, "dirichlet", "the energy has no minimum"),
        ({"motion": Motion(0.1, pinned=(9,))}, "motion", "names node 9; nodes run from 0 to 8"),
        ({"dirichlet": (Dirichlet("left", (None,)),)}, "dirichlet", "can still move as a rigid body"),
    ],
)  # fmt: skip
def test_contradictions_name_their_part(change: dict, part: str, message: str) -> None:
    given = {"mesh": rectangle(2, 2), "law": Laplace(1.0), "dirichlet": ("left",)} | change
    with pytest.raises(ProblemError, match=message) as caught:
        ContactProblem(**given)
    assert caught.value.part == part


def boundary_lengths(problem: ContactProblem) -> dict[str, float]:
    mesh = problem.mesh
    ends = {name: mesh.p[:, mesh.facets[:, facets]] for name, facets in mesh.boundaries.items()}
    return {name: float(np.hypot(*(p[:, 0] - p[:, 1])).sum()) for name, p in ends.items()}


def test_refined_meshes_keep_boundaries_and_move_limits() -> None:
    problem = replace(EXAMPLES["6.3"]((4, 2)), motion=Motion(Relative(0.3)))
    whole, part = refined(problem), locally_refined(problem, np.array([0, 5]))
    assert whole.motion.delta == Relative(0.6)
    assert part.motion.delta == Relative(0.3)
    assert whole.mesh.t.shape[1] == 4 * problem.mesh.t.shape[1]
    np.testing.assert_array_equal(part.mesh.p[:, : problem.mesh.p.shape[1]], problem.mesh.p)
    lengths = [boundary_lengths(p) for p in (problem, whole, part)]
    assert lengths[1] == pytest.approx(lengths[0])
    assert lengths[2] == pytest.approx(lengths[0])
    for one in (whole, part):
        assert signed_areas(one.mesh.p, one.triangles).sum() == pytest.approx(4.0)


def test_boundary_on_an_axis_of_symmetry_stays_on_it() -> None:
    mesh = rectangle(2, 2)
    assert symmetric(mesh, "left") == Dirichlet("left", (0.0, None))
    assert symmetric(mesh, "bottom") == Dirichlet("bottom", (None, 0.0))
    assert symmetric(mesh, "bottom", 1) == Dirichlet("bottom", (None,))
    turned = replace(mesh, doflocs=np.array([[0.8, -0.6], [0.6, 0.8]]) @ mesh.p)
    with pytest.raises(ValueError, match="not parallel to an axis"):
        symmetric(turned, "left")


@pytest.mark.parametrize(
    ("motion", "text"),
    [
        (Motion(0.1), "delta 0.1 x 0.1, areas at least 0.01 of the given ones"),
        (Motion(None), f"no move limits, areas at least 0.01 of the given ones ({BY_BARRIER})"),
        (
            Motion(Relative(0.2), min_angle=5, pinned="top", tied=((1, 2),)),
            "delta 0.2 of the shortest edge, areas at least 0.01 of the given ones, "
            "angles at least 5 degrees; pinned: top; 1 nodes tied",
        ),
    ],
)
def test_summary_describes_the_motion(motion: Motion, text: str) -> None:
    problem = ContactProblem(rectangle(2, 2), Laplace(1.0), ("left",), motion=motion)
    assert dict(problem.summary())["motion"] == text


def test_what_is_printed_fits_a_screen() -> None:
    problem = EXAMPLES["6.3"]((4, 2))
    for thing in (problem, fixed.solve(problem), mpcc.build(problem)):
        lines = repr(thing).splitlines()
        assert len(lines) <= 40
        assert max(map(len, lines)) <= 120
    assert "16 triangles" in repr(problem)
    assert dict(problem.summary())["contact"] == "4 nodes on contact, normal (0, 1), friction bound 10"
    assert f"{problem.contact_nodes.size * 3} complementarity pairs" in repr(mpcc.build(problem))


def test_prolonged_relocation_keeps_the_displacement_of_the_coarse_mesh() -> None:
    problem = replace(EXAMPLES["6.3"]((4, 2)), motion=Motion(Relative(0.3)))
    coarse = joint.solve(problem)
    finer = refined(problem)
    nodes = prolong(problem, coarse.mesh.p, finer)
    start = fixed.solve(replace(finer, mesh=replace(finer.mesh, doflocs=nodes)))
    # the coarse P1 functions are among the fine ones on the prolonged mesh, contact is imposed at more nodes
    assert start.energy < coarse.energy
    with pytest.raises(ValueError, match="not the uniform refinement"):
        prolong(problem, coarse.mesh.p, problem)
