"""The contact pressure at a node as a function of positions and displacements around it.

At a contact node equilibrium gives the contact force: it is the force with which the elements at the
node pull at it, less their load. Divided by the node's share omega_i of the boundary (5.9) it is
the pressure that solutions report. Stresses of the elements would be another, less accurate one,
which an optimiser lowers while the forces grow.
"""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import casadi as ca
import numpy as np

from rmesh_nlp.fem.contact_terms import contact_edges
from rmesh_nlp.fem.element import plain
from rmesh_nlp.fem.energy import load_energy, objective_group, strain_energy
from rmesh_nlp.fem.fields import ElementGroup, Field
from rmesh_nlp.fem.objective import Objective, Term
from rmesh_nlp.problem import ContactProblem, Law
from rmesh_nlp.problem.coefficients import is_nonzero


def peak_pressure(
    boundary: str, reference: float, *, exponent: int = 8, name: str = "peak pressure"
) -> Objective:
    """The peak of the contact pressure, smoothed: the mean of ``(pressure / reference)^exponent``.

    The mean is over the length of the contact boundary on the initial mesh, by the trapezoidal
    rule. ``reference * value**(1 / exponent)`` lies between the mean and the peak; it is not taken as the
    objective itself, because its second derivatives would couple all nodes of the boundary,
    while the minimisers are the same. Tractions and point loads at contact nodes are not taken off.

    Parameters
    ----------
    boundary : str
        A contact boundary.
    reference : float
        A pressure of the size that is expected, in units of stress.
    exponent : int
        At least 3, so that second derivatives are continuous; the larger, the closer to the peak.
    name : str
    """
    if not (np.isfinite(reference) and reference > 0):
        raise ValueError(f"{name}: the reference pressure must be positive, got {reference}")
    if not exponent >= 3:
        raise ValueError(f"{name}: the exponent must be at least 3, got {exponent}")

    def groups(
        problem: ContactProblem, positions: Field, displacement: Field, _: Field
    ) -> list[ElementGroup]:
        obstacle, contact = _contact_on(problem, boundary)
        forces = [_force(law, problem.rule) for law, _elements in problem.regions]
        p, edges = problem.mesh.p, contact_edges(problem, obstacle)
        length = float(np.linalg.norm(p[:, edges[1]] - p[:, edges[0]], axis=0).sum())
        result = []
        for (laws, ends), patches in _patches(problem, contact, edges).items():
            nodes = np.array(patches).T
            n = nodes.shape[0]
            X, u = ca.SX.sym("X", 2 * n), ca.SX.sym("u", problem.components * n)
            at, by = ca.reshape(X, 2, n), ca.reshape(u, problem.components, n)
            force = ca.SX.zeros(problem.components)
            for k, law in enumerate(laws):
                corners = slice(3 * k, 3 * k + 3)
                force += forces[law](ca.vec(at[:, corners]), ca.vec(by[:, corners]))
            share = sum(ca.norm_2(at[:, n - 1 - k] - at[:, 0]) for k in range(ends)) / 2
            normal = obstacle.direction(at[0, 0], at[1, 0])
            pressure = ca.fmax(ca.dot(normal, force) / share, 0)
            value = share / length * (pressure / reference) ** exponent
            function = ca.Function("peak_pressure", [X, u], [value, ca.SX(0, 1)])
            result.append(objective_group(function, (positions.at(nodes), displacement.at(nodes))))
        return result

    return Objective(((1.0, Term(name, groups)),))


def _contact_on(problem: ContactProblem, boundary: str) -> tuple[Any, Any]:
    """The obstacle of a contact boundary and its contact nodes."""
    for part in problem.contact_sets:
        if part.obstacle.boundary == boundary:
            return part.obstacle, part.nodes
    known = [str(obstacle.boundary) for obstacle in problem.obstacles if isinstance(obstacle.boundary, str)]
    raise ValueError(f"{boundary!r} is not a contact boundary: choose from {', '.join(known) or 'none'}")


def _force(law: Law, quadrature: str | int) -> ca.Function:
    """``(X_e, u_e) ->`` what a triangle pulls with at its first vertex, its load taken off (components,)."""
    X, u = ca.SX.sym("X", 6), ca.SX.sym("u", 3 * law.components)
    energy = strain_energy(law)(X, u)[0]
    if any(is_nonzero(component) for component in law.load):
        energy += plain(*load_energy(law, quadrature))(X, u)[0]
    return ca.Function("force", [X, u], [ca.gradient(energy, u)[: law.components]])


def _patches(
    problem: ContactProblem, contact: Any, edges: Any
) -> dict[tuple[tuple[int, ...], int], list[list[int]]]:
    """Nodes around each contact node, by the laws of its triangles and the number of its edges.

    The vertices of its triangles, itself first in each, then the other ends of its contact edges.
    """
    law_of = np.empty(problem.mesh.t.shape[1], dtype=int)
    for number, (_, elements) in enumerate(problem.regions):
        law_of[elements] = number
    patches: dict[tuple[tuple[int, ...], int], list[list[int]]] = defaultdict(list)
    triangles = problem.triangles
    for node in contact:
        corner, element = np.nonzero(triangles == node)
        order = np.argsort(law_of[element], kind="stable")
        around = [np.roll(triangles[:, element[i]], -corner[i]) for i in order]
        ends = [int(pair[1 - pair.tolist().index(node)]) for pair in edges.T if node in pair]
        key = tuple(int(law_of[element[i]]) for i in order), len(ends)
        patches[key].append([*(int(vertex) for vertex in np.concatenate(around)), *ends])
    return patches
