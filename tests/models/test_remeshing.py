"""The metric start: number of nodes, what is carried over, curves, least angles, rounds."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.mapping import MeshMap, Mobility
from rmesh_nlp.mapping.validity import least_angles
from rmesh_nlp.meshes import named
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.models import remeshing
from rmesh_nlp.models.remeshing import (
    EXACT,
    ROUNDS,
    MetricStart,
    Solved,
    metric_start,
    remeshed_problem,
    sagitta,
)
from rmesh_nlp.optimize.budget import StoppedError
from rmesh_nlp.problem import NO_CONTACT
from rmesh_nlp.problem.body import Body
from support.contact_geometry import block_between_two_foundations
from support.curved import CURVES, plate
from support.problems import energy_error, signorini

SIDES = ("left", "right", "top", "bottom")
SOURCE = rm.Laplace(lambda x, y: 50 * x * x)


def scalar(mesh: Any = None, **parts: Any) -> rm.ContactProblem:
    usual = {"law": SOURCE, "dirichlet": ("left",), "obstacle": NO_CONTACT, "motion": rm.Motion(None)}
    return rm.ContactProblem(**{"mesh": rectangle(6, 6) if mesh is None else mesh, **usual, **parts})


def remade(problem: rm.ContactProblem, nodes: int | None = None, **options: Any) -> rm.ContactProblem:
    number = problem.mesh.p.shape[1] if nodes is None else nodes
    return remeshed_problem(problem, Solved.of(problem).regions, number, **options)[0]


def count(problem: rm.ContactProblem) -> int:
    return int(problem.mesh.p.shape[1])


class TestNumberOfNodes:
    @pytest.mark.slow
    @pytest.mark.parametrize("nodes", [20, 150])
    def test_is_met_up_to_two_percent_and_so_it_is_with_the_same_ratio_of_triangles(self, nodes: int) -> None:
        problem = scalar()
        regions = Solved.of(problem).regions
        first, ratio = remeshed_problem(problem, regions, nodes)
        assert abs(count(first) - nodes) <= max(EXACT * nodes, 1)
        again, same = remeshed_problem(problem, regions, nodes, ratio)
        assert same == ratio  # of another trial it would differ
        np.testing.assert_array_equal(again.mesh.p, first.mesh.p)

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("make", "nodes", "said"),
        [
            (lambda: scalar(motion=rm.Motion(None, pinned=SIDES)), 15, "no mesh of 15 nodes of this domain"),
            (lambda: signorini(6), 4, r"mesh of \d nodes: no node of the contact set is free"),
            (lambda: plate({"hole": CURVES["circle"]}), 12, "too coarse for the curves: take more"),
            (
                lambda: replace(signorini(4), motion=rm.Motion(None, min_angle=55.0)),
                25,
                "no mesh of 25 nodes with angles of 55 degrees or more",
            ),
        ],
    )
    def test_a_mesh_that_cannot_be_says_why(self, make: Any, nodes: int, said: str) -> None:
        with pytest.raises(rm.BadInputError, match=said):
            remade(make(), nodes)


class TestCarriedOver:
    def test_domain_names_and_everything_else(self) -> None:
        problem = block_between_two_foundations()
        found = remade(replace(problem, motion=rm.Motion(None)), 120)
        assert np.abs(signed_areas(found.mesh.p, found.mesh.t)).sum() == pytest.approx(2.0)
        assert found.mesh.boundaries.keys() == problem.mesh.boundaries.keys()
        for name in ("law", "dirichlet", "obstacle", "tractions", "quadrature", "name", "units"):
            assert getattr(found, name) == getattr(problem, name)
        assert found.reference is None
        assert str(found.mesh.t.shape[1]) in found.size

    def test_rules_ties_and_loads_follow_their_nodes(self) -> None:
        mesh = rectangle(6, 6)
        places = np.array([[2, 3, 4, 2, 4, 3, 6], [2, 0, 2, 4, 4, 3, 4]]) / 6
        a, b, c, d, e, f, g = (int(np.argmin(np.hypot(*(mesh.p - at[:, None])))) for at in places.T)
        loads = (rm.PointLoad(f, (0.0, -1.0)), rm.PointLoad(g, (0.0, -2.0)))
        motion = rm.Motion(None, pinned=(a, "top"), slides=(b,), free=(c, "top"), tied=((d, e),))
        given = scalar(mesh, law=rm.PlaneStrain(1.0, 1.0), motion=motion, point_loads=loads)
        found, moves = remade(given, 60), remade(given, 60).motion
        assert (moves.pinned[1:], moves.slides[1:], moves.free[1:]) == (("top",), (), ("top",))
        numbers = moves.pinned[0], moves.slides[0], moves.free[0], *moves.tied[0]
        numbers += tuple(load.node for load in found.point_loads)
        np.testing.assert_allclose(found.mesh.p[:, numbers], places, atol=1e-14)
        kinds = [Mobility.PINNED, Mobility.SLIDING, Mobility.FREE]
        assert list(MeshMap.of(found).mobility[list(numbers[:3])]) == kinds
        assert [load.force for load in found.point_loads] == [load.force for load in loads]


class TestCurves:
    @pytest.mark.parametrize(
        ("curve", "h", "nodes"),
        [(CURVES["circle"], 1.2, 90), (CURVES["parametrised"], 2.0, 60)],
        ids=["where an arc would be too high", "on another curve"],
    )
    def test_nodes_end_on_them_and_arcs_are_no_higher_than_given(self, curve, h, nodes):
        problem = plate({"hole": curve}, h=h)
        found = remade(problem, nodes)
        rim = found.mesh.p[:, found.boundary_nodes("hole")]
        assert np.abs(curve.at(curve.nearest(rim)) - rim).max() < 1e-12
        assert sagitta(found) <= sagitta(problem) * (1 + 1e-9)
        assert Body(found, np.asarray(found.mesh.p)).is_upright()

    def test_sagitta_is_the_largest_height_of_an_arc(self) -> None:
        problem = plate({"hole": CURVES["circle"]})
        mesh = problem.mesh
        a, b = mesh.p[:, mesh.facets[:, np.asarray(mesh.boundaries["hole"])]].transpose(1, 0, 2)
        half = np.linalg.norm(a - b, axis=0).max() / 2
        assert sagitta(problem) == pytest.approx(2.5 - np.sqrt(2.5**2 - half**2))
        assert sagitta(plate()) == 0.0


@pytest.mark.slow
def test_the_least_angle_is_that_of_the_motion_or_more_and_small_if_none_is_asked_for() -> None:
    mesh = rectangle(4, 4)
    found = remade(scalar(mesh, motion=rm.Motion(None, min_angle=30.0)))
    assert least_angles(found.mesh.p, found.triangles).min() >= 30.0
    found = remade(scalar(mesh))
    assert least_angles(found.mesh.p, found.triangles).min() < 10.0


@pytest.mark.parametrize("pull", [1.0, 0.0])
def test_a_linear_displacement_gets_a_uniform_mesh(pull: float) -> None:
    problem = scalar(law=rm.Laplace(0.0), tractions=(rm.Traction("right", (pull,)),))
    solved = Solved.of(problem)
    assert solved.error == 0.0
    start = metric_start(solved, 49)
    found = start.solved.problem
    assert least_angles(found.mesh.p, found.triangles).min() > 15
    assert start.energies[-1] == pytest.approx(-(pull**2) / 2, rel=1e-9, abs=1e-12)


@pytest.mark.slow
def test_the_error_is_near_the_true_one_on_a_fine_mesh_and_that_of_all_regions() -> None:
    problem = signorini(48)
    whole = Solved.of(problem)
    assert whole.error == pytest.approx(energy_error(problem), rel=0.12)
    mesh = named(problem.mesh, {}, {"a": lambda x: x[0] < 0.5, "b": lambda x: x[0] > 0.5})
    parts = Solved.of(replace(problem, mesh=mesh, law={"a": problem.law, "b": problem.law}))
    assert len(parts.regions) == 2
    assert parts.error == pytest.approx(whole.error, rel=0.05)


@cache
def coarsest() -> Solved:
    return Solved.of(signorini(2))


class TestRounds:
    """Of a start whose meshes have given energies or fail; each begins on the mesh of the one before."""

    def start(self, monkeypatch: pytest.MonkeyPatch, ends: list[Any]) -> MetricStart:
        left, names = list(ends), ["6.1"]

        def remesh(problem: rm.ContactProblem, _: Any, size: int, *__: Any) -> Any:
            assert (problem.name, size) == (names[-1], 9)
            if isinstance(left[0], (rm.BadInputError, StoppedError)):
                raise left.pop(0)
            names.append(f"round {len(names)}")
            return replace(problem, name=names[-1]), 2.0

        def solve(problem: rm.ContactProblem) -> Solved:
            if isinstance(end := left.pop(0), Exception):
                raise end
            solved = Solved.of(problem)
            return replace(solved, state=replace(solved.state, energy=end))

        monkeypatch.setattr(remeshing, "remeshed_problem", remesh)
        monkeypatch.setattr(remeshing, "_solved", solve)
        return metric_start(coarsest(), 9)

    @pytest.mark.parametrize(
        ("energies", "best"), [([-1.0, -2.0, -2.01, -9.0], -2.01), ([-1.0, -2.0, -1.9], -2.0)]
    )
    def test_the_mesh_of_least_energy_counts(self, monkeypatch, energies, best):
        start = self.start(monkeypatch, energies)
        assert start.solved.state.energy == best
        assert start.energies == tuple(energies[:ROUNDS])
        assert start.nodes == (9,) * ROUNDS

    @pytest.mark.parametrize(
        "error", [rm.ProblemError("mesh", "not solved"), rm.BadInputError("folds"), StoppedError()]
    )
    def test_a_later_one_that_fails_is_given_up(self, monkeypatch, error):
        assert self.start(monkeypatch, [-1.0, error]).energies == (-1.0,)
        with pytest.raises(type(error), match=str(error)):
            self.start(monkeypatch, [error])

    def test_a_contact_problem_without_a_solution_is_an_error(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def unsolved(problem: rm.ContactProblem) -> Solved:
            solver = ContactSolver(problem)
            state = replace(solver.solve(problem.mesh.p), status=rm.Status.ITERATION_LIMIT)
            return Solved(solver, state)

        first = Solved.of(signorini(4))
        monkeypatch.setattr(Solved, "of", staticmethod(unsolved))
        with pytest.raises(rm.ProblemError, match="not solved on a new mesh of 2"):
            metric_start(first, 25)
