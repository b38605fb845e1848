"""How far a solution is from Coulomb's law along whole contact edges; the solver imposes it at nodes.

Let p and tau be the nodal forces over the weights of their nodes, v the slip and b = g + F max(p, 0) the
bound. The law ``|tau| <= b``, slip against tau, and only where ``|tau| = b``, is one equation,

    r(tau, v) = tau + proj_[-b, b](c v - tau) = 0    for any c > 0

(P. Alart, A. Curnier, A mixed formulation for frictional contact problems prone to Newton like solution
methods, Comput. Methods Appl. Mech. Engrg. 92 (1991) 353-375). Where the law fails, |r| is the smaller of the
stress that the friction lacks and of c times the slip that should not be, or the stress above the bound.
"""

from __future__ import annotations

import numpy as np

from rmesh_nlp.assessment.contact_results import CLEAR
from rmesh_nlp.assessment.integrals import over_edges
from rmesh_nlp.evaluation import ROUNDING, Array, Index, cross
from rmesh_nlp.fem.bernstein import functions
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.data import ContactSet


def coulomb_residual(
    space: DisplacementSpace, nodes: Array, displacement: Array, normal: Array, tangential: Array
) -> float | None:
    """The integral of |r| along the edges with Coulomb friction, in parts of the contact force there.

    So it is the mean of |r| in units of the mean contact stress: dimensionless, independent of the load's
    size, and on smooth solutions it falls with the edges' lengths. c is the mean contact stress over the
    largest displacement. None without Coulomb friction.

    Parameters
    ----------
    nodes : (2, vertices) array
        Positions.
    displacement : (2, nodes) array
        Coefficients.
    normal, tangential : (gaps,) arrays
        Contact forces.
    """
    parts = [part for part in space.contact_sets if not part.obstacle.friction_law.has_energy]
    if not parts:
        return None
    weights, forces = space.weights(nodes), np.stack([normal, tangential])
    rows = np.concatenate([part.rows for part in parts])
    force, size = np.hypot(*forces[:, rows]), float(np.max(np.hypot(*displacement)))
    total = float(np.sum(force))
    if total == 0 or size == 0:
        return 0.0
    length = float(np.sum(weights[rows][force > ROUNDING * np.max(force)]))
    body, integral, origin = Body(space.problem, nodes), 0.0, space.problem.origin
    moved = displacement if origin is None else displacement - origin
    for part in parts:
        stresses = np.zeros((2, space.n_nodes))
        stresses[:, part.nodes] = forces[:, part.rows] / weights[part.rows]
        relative = part.relative(moved)[:, : space.n_nodes]
        fields = np.vstack([space.coefficients(stresses), relative])
        integral += _integral(body, space, part, fields, total / length / size)
    return integral / total


def _integral(
    body: Body, space: DisplacementSpace, part: ContactSet, fields: Array, stiffness: float
) -> float:
    """The integral of |r|, of coefficients (4, nodes) of pressure, tangential stress and displacement."""
    obstacle, edges = part.obstacle, body.edges_of(part.obstacle)
    on_edges = fields[:, space.nodes_of(edges.ends)]

    def sums(rows: Index, shares: Array, where: Array, weights: Array) -> Array:
        values = np.einsum("cvm,vmk->cmk", on_edges[:, :, rows], functions(space.order, shares))
        pressure, tau, *u = values
        bound = obstacle.friction_law.bound(where, pressure)
        slip = cross(u, obstacle.normals(where))
        off = np.abs(tau + np.clip(stiffness * slip - tau, -bound, bound))
        return np.sum(off * weights, axis=1)[None]

    return float(np.sum(over_edges(edges, sums, (obstacle.friction_law.given,)).value))


def growth(before: float | None, after: float | None) -> str | None:
    """A sentence for a residual that relocation has more than doubled; None for others."""
    if before is None or after is None or after <= max(2 * before, CLEAR):
        return None
    return (
        f"Coulomb's law along edges holds less well than on the given mesh: {after:.1e} of the contact force "
        f"violates it, {before:.1e} before relocation"
    )
