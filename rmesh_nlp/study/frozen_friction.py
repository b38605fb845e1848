"""The energy of Example 6.3 with friction weights wrongly held fixed, to see whether the paper did that."""

from __future__ import annotations

from itertools import pairwise

import casadi as ca
import numpy as np

from rmesh_nlp.models.energy_nlp import Relocation
from rmesh_nlp.optimize.solver import Solver
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.outer import Outer

OPTIONS = {
    "max_iter": 3000,
    "nlp_scaling_method": "none",
    "obj_scaling_factor": 100.0,
    "tol": 1e-8,
    "acceptable_tol": 1e-6,
    "mu_init": 1e-2,
}
"""Ipopt options; with this factor the energies of 6.3 are large against its barrier."""


def least_energy(problem: ContactProblem, seed: int | None = None) -> float:
    """Local minimum over moves and displacement of J with omega_i those of the given mesh.

    NaN if none is found. Only for contact along a straight horizontal boundary and a constant
    friction bound, as in 6.3.
    """
    outer = Outer(problem)
    program = outer.relocation
    nlp = program.nlp.extended(f=_difference(problem, program))
    q = outer.moves(seed=seed)
    solver = Solver(nlp, options=OPTIONS)
    result = solver(outer.energy.point(q, outer.energy(q).equilibrium))
    return result.f if result.converged else float("nan")


def _difference(problem: ContactProblem, program: Relocation) -> ca.MX:
    """Friction with the weights of the given mesh less friction with those of the moved one."""
    (part,) = problem.contact_sets
    bound = float(part.obstacle.friction)  # type: ignore[arg-type]
    nodes = problem.boundary_nodes((str(part.obstacle.boundary),))  # held ends too: edges end there
    order = nodes[np.argsort(problem.mesh.p[0, nodes])]
    positions, slip, x = program.mesh_map.positions, program.slip, program.nlp.x
    difference = ca.MX(0)
    for a, b in pairwise(order):
        ends = []
        for node in (a, b):
            index = int(positions.index[0, node])
            move = positions.scale[0, node] * x[index] if index >= 0 else 0.0
            ends.append(positions.offset[0, node] + move)
        given = problem.mesh.p[0, b] - problem.mesh.p[0, a]
        for node in (a, b):
            index = int(slip.index[part.number, node])
            if index >= 0:
                difference += 0.5 * bound * (given - (ends[1] - ends[0])) * x[index]
    return difference
