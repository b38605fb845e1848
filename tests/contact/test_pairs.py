"""Two bodies, or the two sides of an interface, that touch at pairs of nodes."""

from typing import Any

import numpy as np
import pytest
from skfem import MeshTri

import rmesh_nlp as rm
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.errors import ProblemError
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.meshes import from_arrays
from rmesh_nlp.models.reduced_model import ReducedObjective
from rmesh_nlp.problem import locally_refined
from rmesh_nlp.solving.outer import Outer
from support.bodies import STEEL, pressed, stacked


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("count", [2, 3])
def test_uniform_pressure_passes_through_blocks_exactly(order: int, count: int) -> None:
    problem = pressed(stacked(count), order=order)
    solution = rm.solve(problem, "fixed")
    assert solution.status.value == "converged"
    strain = 5.0 / 1000 * np.array([0.3 * 1.3, -(1 - 0.09)])
    u, p = solution.displacement, problem.mesh.p
    np.testing.assert_allclose(u[:, : p.shape[1]], strain[:, None] * p, atol=1e-12 * np.max(np.abs(u)))
    assert solution.energy_audited == pytest.approx(-0.5 * 5 * 2 * count * 5 / 1000 * 0.91, rel=1e-12)
    for k in range(1, count):
        contact = solution.contact[f"bottom-{k}"]
        assert contact["normal_force"] == pytest.approx(10, rel=1e-12)
        assert contact["force_y"] == pytest.approx(10, rel=1e-12)
        assert contact["peak_pressure"] == pytest.approx(5, rel=1e-12)


def cracked(load: float, order: int) -> rm.ContactProblem:
    """The square (-1, 1)^2 with an interface from (-0.5, 0) to the right side, pulled or pressed."""
    grid = MeshTri.init_tensor(*2 * [np.linspace(-1, 1, 13)])
    p = grid.p[:, grid.facets]
    line = np.flatnonzero(np.all(np.isclose(p[1], 0) & (p[0] > -0.51), axis=0))
    sides = {"low": lambda x: np.isclose(x[1], -1), "high": lambda x: np.isclose(x[1], 1)}
    mesh = grid.with_boundaries(sides | {"joint": line})
    pull, joint = rm.Traction("high", (0.0, load)), rm.Obstacle.interface("joint")
    return rm.ContactProblem(mesh, STEEL, "low", joint, tractions=pull, order=order)


@pytest.mark.parametrize("order", [1, 2])
def test_interface_opens_but_for_its_end_inside_the_body(order: int) -> None:
    problem = cracked(1.0, order)
    assert problem.mesh.p.shape[1] == 13**2 + 9  # 10 nodes are on the line, one of them its end
    solver = ContactSolver(problem)
    (part,), u = solver.discretisation.space.contact_sets, solver.displacement.values(solver.given.u)
    own, others = part.carriers[:, :9]
    opening = (u[1, own] - u[1, others])[np.argsort(problem.mesh.p[0, own])]
    assert np.all(np.diff(opening, prepend=0) > 0)


def test_pressed_interface_without_friction_is_that_of_a_whole_body_where_it_would_not_slip() -> None:
    grid = MeshTri.init_tensor(*2 * [np.linspace(0, 2, 5)])
    sides = {"low": lambda x: np.isclose(x[1], 0), "high": lambda x: np.isclose(x[1], 2)}
    line = np.flatnonzero(np.all(np.isclose(grid.p[1, grid.facets], 1), axis=0))
    mesh = grid.with_boundaries(sides | {"joint": line, "left-0": lambda x: np.isclose(x[0], 0)})
    load = rm.Traction("high", (0.0, -1.0))
    rollers = rm.Dirichlet("low", (None, 0.0)), rm.Dirichlet("left-0", (0.0, None))
    ends = [
        rm.solve(rm.ContactProblem(mesh, STEEL, rollers, obstacle, tractions=load), "fixed").energy
        for obstacle in (rm.Obstacle.interface("joint"), ())
    ]
    assert ends[0] == pytest.approx(ends[1], rel=1e-12)


def test_nodes_that_do_not_coincide_are_refused_with_their_distance() -> None:
    mesh = stacked()
    p = np.array(mesh.p)
    p[1, p.shape[1] // 2 :] += 0.01
    apart = MeshTri(p, mesh.t).with_boundaries(mesh.boundaries)
    with pytest.raises(ProblemError, match=r"the largest distance is 0\.01"):
        pressed(apart)


def test_nodes_of_a_pair_are_not_merged_and_all_others_are() -> None:
    mesh = stacked()
    arrays = mesh.p.T, mesh.t.T, {name: mesh.facets[:, f].T for name, f in mesh.boundaries.items()}
    with pytest.warns(rm.meshes.MeshRepairWarning, match="merged 5 duplicate"):
        assert from_arrays(*arrays).p.shape[1] == mesh.p.shape[1] - 5
    assert from_arrays(*arrays, pairs=[("top-0", "bottom-1")]).p.shape == mesh.p.shape


FRICTION = {"none": {}, "tresca": {"friction": 0.5}, "coulomb": {"coulomb": 0.3}}


def bent(order: int = 2, **laws: Any) -> rm.ContactProblem:
    """Two blocks under a pressure that falls to the right, so that a part of the pair opens."""
    load = rm.Traction("top-1", (0.0, lambda x, y: -10 * (1.5 - x)))
    given = "bottom-0", rm.Dirichlet("left-1", (0.0, None))
    pair, motion = rm.Obstacle.pair("bottom-1", "top-0", **laws), rm.Motion(delta=rm.Relative(0.3))
    return pressed(stacked(2, (6, 2)), pair, dirichlet=given, tractions=load, motion=motion, order=order)


@pytest.mark.parametrize("kind", FRICTION)
@pytest.mark.parametrize("order", [1, 2])
def test_derivatives_along_moves_of_both_nodes(kind: str, order: int) -> None:
    outer = Outer.of(bent(order, interference=lambda x, y: 1e-3 * x * (2 - x), **FRICTION[kind]))
    rng = np.random.default_rng(2)
    q, d = 0.3 * rng.uniform(-1, 1, outer.n), 1e-5 * rng.uniform(-1, 1, outer.n)
    partner = outer.problem.partners[0]
    own = np.flatnonzero(partner >= 0)
    X = outer.nodes(q)
    np.testing.assert_array_equal(X[:, own], X[:, partner[own]])
    assert np.max(np.abs(X[0, own] - outer.problem.mesh.p[0, own])) > 0.01
    function = outer.energy
    if kind == "coulomb":
        function = ReducedObjective(function, parse_objective("resultant(bottom-1)"))
    change = (function(q + d).value - function(q - d).value) / 2
    assert function(q).gradient @ d == pytest.approx(change, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["none", "tresca"])
def test_formulations_agree_on_relocated_pairs(kind: str) -> None:
    ends = [rm.solve(bent(**FRICTION[kind]), name) for name in ("joint", "nested", "mpcc")]
    energies = np.array([end.energy for end in ends])
    assert {end.status.value for end in ends} == {"converged"}
    assert np.ptp(energies) < 1e-6 * (ends[0].energy_initial - energies.min())
    assert 0 < ends[0].contact["bottom-1"]["contact_length"] < 2


def test_refinement_halves_the_edges_of_a_pair_on_both_sides() -> None:
    problem = bent()
    below = np.flatnonzero(np.any(problem.mesh.p[1, problem.mesh.t] > 0.99, axis=0))[:1]
    finer = locally_refined(problem, below)
    assert finer.mesh.p.shape[1] > problem.mesh.p.shape[1]
    assert len(finer.contact_sets[0].nodes) > len(problem.contact_sets[0].nodes)
