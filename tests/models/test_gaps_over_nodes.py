"""Gaps that depend on two nodes each, as those between two bodies do, in every model."""

from dataclasses import replace
from functools import cached_property

import numpy as np
import pytest

import rmesh_nlp as rm
from formulations.joint import Joint
from formulations.mpcc import AllAtOnce
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.models.reduced_model import ReducedObjective
from rmesh_nlp.models.reduced_nlp import reduced_nlp
from rmesh_nlp.problem.data import ContactSet
from support.orders import slow_but
from support.problems import sloped_block
from support.taylor import difference_order, taylor_order


def near() -> rm.ContactProblem:
    """Example 6.2, whose foundation is so near that some nodes touch it."""
    problem = rm.EXAMPLES["6.2"]((4, 2))
    return replace(problem, obstacle=replace(problem.obstacles[0], offset=2e-3))


PROBLEMS = {"frictionless": near, "friction": lambda: sloped_block(n=(6, 2))}


@pytest.fixture(params=PROBLEMS)
def outer(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> rm.Outer:
    alone = DisplacementSpace.__dict__["contact_sets"].func

    def coupled(space: DisplacementSpace) -> tuple[ContactSet, ...]:
        x, y = space.problem.mesh.p
        above = [np.argmin(np.abs(x - x[node]) - 1e-3 * y) for node in space.problem.contact_sets[0].nodes]
        (part,), partner = alone(space), np.full(x.size, -1)
        partner[part.nodes] = above
        return (replace(part, partner=partner),)

    table = cached_property(coupled)
    table.__set_name__(DisplacementSpace, "contact_sets")
    monkeypatch.setattr(DisplacementSpace, "contact_sets", table)
    return rm.Outer.of(PROBLEMS[request.param]())


def at_random(outer: rm.Outer) -> tuple[Array, Array]:
    rng = np.random.default_rng(1)
    return 0.3 * rng.uniform(-1, 1, outer.n), rng.uniform(-1, 1, outer.n)


def test_contact_solve_has_the_gap_of_both_nodes(outer: rm.Outer) -> None:
    q, _ = at_random(outer)
    point, (part,) = outer.energy.solved(q), outer.discretisation.space.contact_sets
    system, state = point.system, point.equilibrium
    u, X = outer.discretisation.displacement.values(state.u), outer.nodes(q)[:, part.nodes]
    own, above = part.carriers(part.nodes)
    gap = (u[:, own] - u[:, above])[1] + part.obstacle.distances(X)
    size = np.max(np.abs(gap))
    assert np.min(gap) > -1e-12 * size
    np.testing.assert_allclose(gap[state.active.touching], 0, atol=1e-12 * size)
    assert 0 < np.sum(state.active.touching) < own.size
    forces = system.normals.T @ state.normal_force + system.tangents.T @ state.tangential_force
    residual = system.stiffness @ state.u - system.load - forces
    np.testing.assert_allclose(residual, 0, atol=1e-9 * system.force_scale)


@pytest.mark.parametrize("objective", ["energy", *slow_but(["compliance"])])
def test_derivatives(outer: rm.Outer, objective: str) -> None:
    energy, (q, d) = outer.energy, at_random(outer)
    function = energy if objective == "energy" else ReducedObjective(energy, parse_objective(objective))
    assert taylor_order(function, q, d) > 1.9
    product = function.hessian(function(q))(d)
    assert difference_order(lambda x: function(x).gradient, product, q, d, 2e-3) > 1.9
    nlp = reduced_nlp(function)
    matrix = nlp.derivatives.hess_lag(np.append(q, np.zeros(nlp.n_x - q.size)), [], 1.0, np.zeros(nlp.n_g))
    assert np.all(np.isfinite(matrix.nonzeros()))  # its pattern has room for all of it


@pytest.mark.slow
def test_joint_and_mpcc_end_alike(outer: rm.Outer) -> None:
    start, ends = outer.energy(np.zeros(outer.n)).value, []
    for formulation in (Joint(), AllAtOnce()):
        outcome = rm.Monitor().run(formulation, outer, np.zeros(outer.n))
        assert outcome.status.value == "converged"
        found, u = outer.energy(outcome.q), outcome.own.u
        np.testing.assert_allclose(u, found.equilibrium.u, atol=1e-6 * np.max(np.abs(u)))
        ends.append(found.value)
    assert ends[1] == pytest.approx(ends[0], rel=1e-4)
    assert ends[0] < start - 1e-3 * abs(start)
