"""Displacement and pressure that solutions give users, against a solution of Signorini's problem."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Dirichlet, Laplace, Motion, Obstacle
from rmesh_nlp.solving.solution import Solution
from support.formulations import fixed
from support.orders import ORDERS


def exact(x: Any, y: Any) -> Any:
    """r^(3/2) cos(3 theta / 2): touches for x < 0 with the pressure 3/2 sqrt(-x), and is free for x > 0."""
    r = ca.sqrt(x * x + y * y + 1e-30)
    return r * ca.sqrt(r) * ca.cos(1.5 * ca.atan2(y, x))


def solved(n: int, order: int) -> tuple[Solution, DisplacementSpace]:
    """On squares of width 2 / (2 n + 1), so that contact ends within an edge."""
    problem = ContactProblem(
        rectangle(2 * n + 1, n, x=(-1, 1)),
        Laplace(),
        tuple(Dirichlet(side, (exact,)) for side in ("left", "right", "top")),
        Obstacle("bottom", (1.0,)),
        Motion(0.01),
        order=order,
    )
    return fixed.solve(problem), DisplacementSpace.of(problem)


@pytest.mark.parametrize("order", ORDERS)
def test_fields_are_values_at_the_points_of_nodes_and_approach_the_solution(order: int) -> None:
    errors = []
    for n in (4, 9):
        solution, space = solved(n, order)
        assert solution.success
        x, y = space.points(np.asarray(solution.mesh.p))
        wanted = np.array([float(exact(*at)) for at in zip(x, y, strict=True)])
        assert solution.displacement.shape == (1, space.n_nodes)
        assert solution.pressure.shape == solution.tangential_stress.shape == (space.n_nodes,)
        off = np.abs(solution.displacement[0] - wanted)
        given = (np.abs(x) > 1 - 1e-9) | (y > 1 - 1e-9)
        assert np.max(off[given]) < 1e-12  # at middles of edges as at vertices
        assert np.min(solution.pressure) >= 0
        assert not np.any(solution.pressure[(y > 0) | (x > 0.2)])
        # away from the end of contact
        contact = (y == 0) & (x > -1 + 1e-9) & (x < -0.25)
        force = np.abs(solution.pressure - 1.5 * np.sqrt(np.abs(x)))
        errors.append((np.max(off), np.max(force[contact])))
    assert np.all(np.array(errors[1]) < np.array(errors[0]) / 2.5)
    assert errors[1][1] < 0.005


def test_contact_forces_are_pressures_times_weights() -> None:
    solution, space = solved(4, 2)
    (part,) = space.contact_sets
    assert solution.assessment.final.quantities is not None
    total = solution.pressure[part.nodes] @ space.weights(np.asarray(solution.mesh.p))
    assert total == pytest.approx(solution.assessment.final.quantities.resultant)
