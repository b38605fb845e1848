import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.mapping import MeshMap, Mobility
from rmesh_nlp.meshes.curves import Circle, Curve
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.models.levels import accepted, coarsened
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.models.second_derivatives import Curvature
from rmesh_nlp.problem import ContactProblem, Motion, ProblemError, signed_areas
from rmesh_nlp.problem.contact_problem import locally_refined, refined
from rmesh_nlp.solving.solution import Solution
from rmesh_nlp.solving.verification import verify_gradient
from support.curved import CURVES, HOLE, disc, plate, spline_of_the_hole
from support.formulations import auto, joint, mpcc, nested

ARC = Circle((0.0, 1.0), 1.0)


def off(problem: ContactProblem, mesh: object, name: str, circle: Circle) -> float:
    nodes = problem.boundary_nodes((name,))
    away = np.asarray(mesh.p)[:, nodes] - np.array(circle.centre)[:, None]  # type: ignore[attr-defined]
    return float(np.max(np.abs(np.hypot(*away) - circle.radius)))


def moved(problem: ContactProblem, solution: Solution, name: str) -> float:
    nodes = problem.boundary_nodes((name,))
    return float(np.max(np.abs(np.asarray(solution.mesh.p)[:, nodes] - problem.mesh.p[:, nodes])))


@pytest.mark.parametrize(
    "curve",
    [*CURVES.values(), pytest.param(spline_of_the_hole(), marks=pytest.mark.slow)],
    ids=lambda c: type(c).__name__,
)
def test_the_gradient_has_rate_2_where_nodes_slide_along_a_curve(curve: Curve) -> None:
    load = (lambda x, y: x * y, lambda x, y: ca.sin(x))
    problem = plate({"hole": curve}, delta=0.4, load=load)
    hole = problem.boundary_nodes(("hole",))
    assert np.all(MeshMap.of(problem).mobility[hole] == Mobility.SLIDING)
    assert np.min(verify_gradient(problem).orders) > 1.99


def test_second_derivatives_are_those_of_the_gradient() -> None:
    load = (lambda x, y: x * y, lambda x, y: ca.sin(x))
    energy = ReducedEnergy(relocation(plate({"hole": HOLE}, delta=0.4, load=load)))
    rng = np.random.default_rng(1)
    q, d = rng.uniform(-0.3, 0.3, (2, energy.relocation.n_q))
    product, step = Curvature(energy).at(energy(q))(d), 1e-4
    difference = (energy(q + step * d).gradient - energy(q - step * d).gradient) / (2 * step)
    np.testing.assert_allclose(product, difference, atol=1e-6 * np.max(np.abs(difference)))


def test_moves_are_found_again_from_positions() -> None:
    free = MeshMap.of(plate({"hole": HOLE}, delta=1.0))
    q = np.random.default_rng(0).uniform(-1, 1, free.n)
    np.testing.assert_allclose(free.q_of(free.positions.values(q)), q, atol=1e-12)


def test_a_box_is_measured_along_the_curve() -> None:
    problem = plate({"hole": HOLE}, delta=0.3)
    free = MeshMap.of(problem)
    hole = problem.boundary_nodes(("hole",))
    at_bound = free.positions.values(np.ones(free.n))[:, hole] - 5
    turn = np.angle(
        np.exp(1j * (np.arctan2(*at_bound[::-1]) - np.arctan2(*(problem.mesh.p[:, hole] - 5)[::-1])))
    )
    np.testing.assert_allclose(2.5 * turn, 0.3)


@pytest.mark.slow
def test_strategies_agree_on_the_circle_and_gain_more_than_with_the_hole_held() -> None:
    problem, held = plate({"hole": HOLE}, delta=0.15), plate(delta=0.15)
    found = [strategy.solve(problem) for strategy in (joint, nested, mpcc)]
    without = joint.solve(held)
    for solution in found:
        assert solution.status.value == "converged"
        assert off(problem, solution.mesh, "hole", HOLE) < 1e-12
        assert solution.gain_audited > 1.1 * without.gain_audited
        np.testing.assert_allclose(solution.energy, found[0].energy, rtol=1e-8)
    assert moved(problem, found[0], "hole") > 0.05
    assert moved(held, without, "hole") == 0


@pytest.mark.slow
def test_auto_slides_along_the_arc_of_a_disc() -> None:
    problem = disc({"arc": ARC})
    solution = auto.solve(problem)
    assert solution.success
    assert off(problem, solution.mesh, "arc", ARC) < 1e-12
    assert moved(problem, solution, "arc") > 1e-3
    assert solution.record()["error_reduction"]["factor"] > 1.35


def test_no_map_is_taken_where_an_arc_cuts_through_its_triangle() -> None:
    problem = plate({"hole": HOLE})
    energy = ReducedEnergy(relocation(problem, parse_objective("energy + shape-size")))
    facet = int(problem.mesh.boundaries["hole"][0])
    ends, element = problem.mesh.facets[:, facet], problem.mesh.f2t[0, facet]
    inner = int(np.setdiff1d(problem.triangles[:, element], ends)[0])
    nodes = np.array(problem.mesh.p)
    nodes[:, inner] = 0.98 * nodes[:, ends].mean(axis=1) + 0.02 * nodes[:, inner]
    q = energy.relocation.mesh_map.q_of(nodes)
    assert np.min(signed_areas(energy.relocation.nodes(q), problem.triangles)) > 0
    assert not energy.is_defined(q)
    assert energy.is_defined(accepted(energy, q)[0])


def test_refined_and_coarsened_meshes_have_their_nodes_on_the_curve() -> None:
    problem = plate({"hole": HOLE}, h=1.2)
    fine, local = refined(problem), locally_refined(problem, np.arange(40))
    coarse = coarsened(problem, 30)
    assert coarse is not None
    for other in (fine, local, coarse):
        assert off(other, other.mesh, "hole", HOLE) < 1e-12
    assert coarse.boundary_nodes(("hole",)).size < problem.boundary_nodes(("hole",)).size
    polygon = refined(problem, polygon=True)
    assert signed_areas(polygon.mesh.p, polygon.triangles).sum() == pytest.approx(
        signed_areas(problem.mesh.p, problem.triangles).sum(), rel=1e-13
    )


def test_nodes_that_are_nearly_on_the_curve_are_put_onto_it_and_others_refused() -> None:
    nearly = plate({"hole": Circle((5.0, 5.0), 2.5 + 1e-7)})
    assert off(nearly, nearly.mesh, "hole", Circle((5.0, 5.0), 2.5 + 1e-7)) < 1e-12
    with pytest.raises(ProblemError, match="off its curve"):
        plate({"hole": Circle((5.0, 5.0), 2.4)})
    with pytest.raises(ProblemError, match="no boundary named 'rim'"):
        plate({"rim": HOLE})
    with pytest.raises(ValueError, match="must be a Circle"):
        Motion(None, curves={"hole": (5.0, 5.0, 2.5)})  # type: ignore[dict-item]


def test_pinned_beats_a_curve_and_ends_of_an_arc_stay() -> None:
    problem = disc({"arc": ARC})
    mobility = MeshMap.of(problem).mobility
    arc = problem.boundary_nodes(("arc",))
    assert np.sum(mobility[arc] == Mobility.PINNED) == 2
    still = ContactProblem(
        problem.mesh,
        problem.law,
        problem.dirichlet,
        problem.obstacle,
        Motion(None, pinned=("arc",), curves={"arc": ARC}),
    )
    assert np.all(MeshMap.of(still).mobility[arc] == Mobility.PINNED)
    assert ContactSolver(still).solve(still.mesh.p).energy > 0
