"""Reference solutions: local refinement along the true curves, three levels, the energy extrapolated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from skfem import MeshTri

from truth.body import Body
from truth.contact import Equilibrium, equilibrium
from truth.data import Data

UNIFORM, CONTACT_EDGES = 400, 80
"""Nodes up to which refinement is uniform, and edges that contact boundaries have at least."""


@dataclass(frozen=True)
class Reference:
    """``energy`` extrapolates J*, ``bar`` is the doubt; ``state`` is the finest of the solutions."""

    state: Equilibrium
    energy: float
    bar: float
    converged: bool


def reference(data: Data, nodes: int) -> Reference:
    """Local refinement to a quarter of ``nodes``, then two uniform ones.

    On locally refined meshes errors of the energy fall like one over the number of nodes to the power of the
    order: J* is a third of the last decrease below the last energy (of order 2 a fifteenth). Gaps hold at
    nodes: what passes between them is of the same order, and extrapolated with the rest.
    """
    mesh, levels = data.mesh, []
    while (size := Body(data, mesh).size) < nodes / 4:
        marks = None
        if size >= min(UNIFORM, nodes / 8):
            body = Body(data, mesh)
            marks = marked(body, equilibrium(body, body.loads(3)).u)
        mesh = refined(data, mesh, marks)
    for _ in range(3):
        body = Body(data, mesh)
        levels.append(equilibrium(body, body.loads(4)))
        mesh = refined(data, mesh)
    first, second, energy = (level.energy for level in levels)
    bar = max(doubt(first - second, second - energy, 4**data.order), 1e-8 * abs(energy))
    J = energy - (second - energy) / (4**data.order - 1)
    return Reference(levels[-1], J, bar, all(level.converged for level in levels))


def doubt(first: float, second: float, fall: float) -> float:
    """How far an energy is from its limit, by its last two decreases, of which each is to be 1 / ``fall``.

    A second decrease that is smaller than that may be one of two errors that cancel, and does not count. One
    that is less than halved, or changes its sign, says nothing of the rest.
    """
    if first * second <= 0 or 2 * abs(second) > abs(first):
        return max(abs(first), abs(second))
    rate = min(first / second, 4.0)
    return max(abs(second), abs(first) / fall) / (rate - 1)


def refined(data: Data, mesh: MeshTri, elements: np.ndarray | None = None) -> MeshTri:
    """The mesh refined in all or in marked elements, with its names, and new nodes on the curves."""
    bare = replace(mesh, _boundaries=None, _subdomains=None)
    fine = bare.refined() if elements is None else bare.refined(elements)
    p, rim, names = np.array(fine.p), fine.boundary_facets(), {}
    middle = p[:, fine.facets[:, rim]].mean(axis=1)[..., None]
    for name, facets in mesh.boundaries.items():
        a, b = mesh.p[:, mesh.facets[:, np.asarray(facets)]].transpose(1, 0, 2)[:, :, None]
        to_a, to_b, length = (np.linalg.norm(way, axis=0) for way in (middle - a, middle - b, a - b))
        names[name] = rim[np.any(to_a + to_b < (1 + 1e-9) * length, axis=1)]
    for name, (x, y, radius) in data.circles.items():
        nodes, centre = np.unique(fine.facets[:, names[name]]), np.array([[x], [y]])
        out = p[:, nodes] - centre
        p[:, nodes] = centre + radius * out / np.linalg.norm(out, axis=0)
    return replace(fine, doflocs=p, _boundaries=names)


def marked(body: Body, u: np.ndarray) -> np.ndarray:
    """Elements with half of the error that averaged gradients show, and those of long contact edges."""
    gradient, nodes = (
        body.gradients(u, np.arange(body.t.shape[1]), body.p[:, body.t].transpose(0, 2, 1)),
        body.p.shape[1],
    )
    places = body.t + nodes * body.material  # gradients jump between materials
    weight = np.bincount(places.ravel(), np.tile(body.area, 3), nodes * len(body.tensor)) + 1e-300
    mean = np.zeros((weight.size, *gradient.shape[2:]))
    for k, corner in enumerate(places):
        np.add.at(mean, corner, gradient[:, k] * body.area[:, None, None])
    away = [mean[corner] / weight[corner, None, None] - gradient[:, k] for k, corner in enumerate(places)]
    error = body.area * sum(body.density(part) for part in [*away, sum(away)])
    order = np.argsort(-error)
    half = np.searchsorted(np.cumsum(error[order]), 0.5 * np.sum(error)) + 1
    chosen = order[: min(half, body.t.shape[1] // 3)]
    if body.data.foundation.kind != "interior":
        facets = body.facets(body.data.foundation.boundary)
        length = np.linalg.norm(body.ends[:, 1, facets] - body.ends[:, 0, facets], axis=0)
        chosen = np.union1d(chosen, body.mesh.f2t[0, facets[length > np.sum(length) / CONTACT_EDGES]])
    return chosen


def distance(one: Body, u: np.ndarray, fine: Equilibrium) -> float:
    """Energy norm of the difference to a finer solution; displacements continue to the curve."""
    body, total = fine.body, 0.0
    for spot in np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4]]) / 6:
        points = np.einsum("iae,a->ie", body.p[:, body.t], spot)[..., None]
        own = body.gradients(fine.u, np.arange(body.t.shape[1]), points)[:, 0]
        coarse = one.gradients(u, one.locate(points[..., 0]), points)[:, 0]
        total += body.density(coarse - own) @ body.area / 3
    return float(np.sqrt(max(total, 0.0)))
