"""The field in equilibrium whose dual energy is largest, by one sparse positive definite system.

Stresses (or fluxes) live on the elements; traces of the displacement on the edges are the
multipliers of equilibrium between them. Eliminating the stresses leaves

    min 1/2 W^T S W - F^T W + sum b |T W|   with   N W + gamma >= 0

in the traces W alone, a contact problem of the same form as that of the nodes, whose minimum is
the largest dual energy. Its multipliers are the contact forces. Any non-negative ones, with
friction within its bound, give a lower bound of the energy, the best ones the highest. So the
system is factorised once, without contact, and the forces, which begin with those of the
computed solution, are improved by projected conjugate gradients that cost back-substitutions only.

Traces are counted from those of the computed displacement: where it is close to the solution they are
small, and so is the rounding of stresses, which would else be differences of large numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rmesh_nlp.certificate.conditions import linear_values
from rmesh_nlp.certificate.traces import Numbers, TraceSpace
from rmesh_nlp.contact.first_guess import DualEnergy
from rmesh_nlp.contact.model import solve
from rmesh_nlp.contact.system import ActiveSet, ContactSystem
from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.newton_step import BoxStep

FORCING = 0.1
"""Part of the residual at which conjugate gradients stop."""


@dataclass(frozen=True)
class LocalSystems:
    """The elements after their stresses are eliminated.

    Attributes
    ----------
    stiffness : (elements, k, k) array
    source : (elements, k) array
        Forces through the edges are ``stiffness @ traces - source``, traces counted from the base.
    base : (components, 2, edges) array
        Moments of the displacement from which traces are counted.
    """

    stiffness: Array
    source: Array
    base: Array


@dataclass(frozen=True)
class InteriorObstacle:
    """An obstacle in the interior; moments of the displacement of each element are further unknowns.

    Arrays run over the vertices of each element; moments are against their linear functions and
    divided by the area.

    Attributes
    ----------
    sign : float
        1 for an obstacle below, -1 above.
    gap : (elements, 3) array
        Moments of the gap of the base.
    load : (elements, 3) array
        Values of the source, times the area.
    touching : (elements, 3) bool array
        Where the elements touch at first.
    """

    sign: float
    gap: Array
    load: Array
    touching: NDArray[np.bool_]


@dataclass(frozen=True)
class Balance:
    """The field in equilibrium, as far as edges see it.

    Attributes
    ----------
    traces : (elements, k) array
        Of each element, in Cartesian components, counted from the base.
    pressure, friction : (2, contact edges) arrays
        At the ends of the contact edges; no friction in a scalar problem.
    reaction_work : float
        Work of the reactions on the given displacements.
    obstacle_force : (elements, 3) array
        Values at the vertices of the reaction of an obstacle in the interior, times the area.
    """

    traces: Array
    pressure: Array
    friction: Array
    reaction_work: float
    obstacle_force: Array


def balance(
    space: TraceSpace,
    local: LocalSystems,
    pressure: Array,
    friction: Array,
    products: int,
    interior: InteriorObstacle | None = None,
) -> Balance:
    """Equilibrate the elements with each other and with the contact forces.

    Parameters
    ----------
    space : TraceSpace
    local : LocalSystems
    pressure, friction : (2, contact edges) arrays
        Where to begin; cut to what contact and friction allow.
    products : int
        Back-substitutions spent on better contact forces.
    interior : InteriorObstacle, optional
        Its problem is solved exactly, for its forces are as many as the elements.
    """
    conditions, lengths = space.conditions, space.skeleton.lengths
    S, b, turned, rotation = _turned(space, local)
    numbers, size = space.of_elements, space.size
    start = space.vector(local.base)
    applied = space.vector(edge_loads(conditions.traction) * lengths)
    held = space.held
    if interior is not None:
        added = size + np.arange(3 * len(numbers))
        numbers, size = np.hstack([numbers, added.reshape(-1, 3)]), size + added.size
        start, applied = np.append(start, np.zeros(added.size)), np.append(applied, interior.load.ravel())
        held = np.append(held, np.zeros(added.size, dtype=bool))

    def through(traces: Array) -> Array:
        """Sum of the forces through each edge."""
        forces = np.einsum("eij,ej->ei", S, traces[numbers]) - b
        return np.asarray(np.bincount(numbers.ravel(), forces.ravel(), size), dtype=float)

    W, given = np.zeros(size), np.flatnonzero(held)
    W[given] = space.vector(conditions.given)[given] - start[given]
    free = np.flatnonzero(~held)
    index = np.full(size, -1, dtype=np.int64)
    index[free] = np.arange(free.size)
    K, load = assembled(index[numbers], S, free.size), (applied - through(W))[free]
    if interior is None:
        contact = _boundary_contact(space, index, start, free.size)
        system = ContactSystem(K, load, 0.0, *contact)
        slip = start[space.of_contact(0)].ravel()
        edge = lengths[conditions.contact]
        guess = (pressure * edge).ravel(), (friction * edge).ravel()
        W[free], (y, z) = improved(system, slip, *guess, products)
        shape = (2, conditions.contact.size)
        pressure = y.reshape(shape) / edge
        friction = z.reshape(shape) / edge if z.size else np.zeros(shape)
        force = np.zeros((len(numbers), 3))
    else:
        on_edges, tangents, gap, _ = _boundary_contact(space, index, start, free.size)
        rows = sp.csr_array(sp.vstack([_rows(index[added], free.size) * interior.sign, on_edges]))
        gaps = np.concatenate([interior.gap.ravel(), gap])
        touching = np.concatenate([interior.touching.ravel(), pressure.ravel() > 0])
        system = ContactSystem(K, load, 0.0, rows, tangents, gaps, np.zeros(0))
        found = solve(system, ActiveSet(touching, np.zeros(0, dtype=np.int8)))
        W[free], forces = found.u, np.maximum(found.normal_force, 0.0)
        force = forces[: added.size].reshape(-1, 3)
        pressure = forces[added.size :].reshape(pressure.shape) / lengths[conditions.contact]
        friction = np.zeros(pressure.shape)
    reaction = (through(W) - applied)[held] @ (W + start)[held]
    traces = W[numbers]
    if turned.size:
        traces[turned] = np.einsum("eji,ej->ei", rotation, traces[turned])
    return Balance(traces, pressure, friction, float(reaction), force)


def _turned(space: TraceSpace, local: LocalSystems) -> tuple[Array, Array, NDArray[np.int64], Array]:
    """Matrices and sources along the axes of the contact edges, which elements that concerns, and how."""
    S, b = local.stiffness, local.source
    turned, rotation = space.rotations()
    if turned.size:
        S, b = S.copy(), b.copy()
        S[turned] = rotation @ S[turned] @ rotation.transpose(0, 2, 1)
        b[turned] = np.einsum("eij,ej->ei", rotation, b[turned])
    return S, b, turned, rotation


def _boundary_contact(
    space: TraceSpace, index: Numbers, start: Array, size: int
) -> tuple[sp.csr_array, sp.csr_array, Array, Array]:
    """Normals, tangents, gaps and friction bounds of the contact edges, end by end."""
    conditions = space.conditions
    edge = space.skeleton.lengths[conditions.contact]
    along_normal = space.of_contact(space.components - 1)
    gap = (conditions.offset + start[along_normal]).ravel()
    normals = _rows(index[along_normal].ravel(), size)
    if not np.any(conditions.friction > 0):
        return normals, sp.csr_array((0, size)), gap, np.zeros(0)
    tangent = index[space.of_contact(0)].ravel()
    bound = np.where(tangent >= 0, (conditions.friction * edge).ravel(), 0.0)
    return normals, _rows(tangent, size), gap, bound


def edge_loads(moments: Array) -> Array:
    """Values at the ends of edges (components, 2, edges) of the linear functions with these moments."""
    return np.stack([linear_values(part) for part in moments])


def improved(
    system: ContactSystem, slip: Array, pressure: Array, friction: Array, products: int
) -> tuple[Array, tuple[Array, Array]]:
    """Feasible contact forces better than the given ones, and the unknowns of the system under them.

    One step of projected conjugate gradients: the dual function is quadratic.
    """
    dual = DualEnergy(system, slip)
    bound = system.slip_bound
    y = np.concatenate([pressure, friction[: bound.size]])
    lower = np.concatenate([np.zeros(pressure.size), -bound])
    upper = np.concatenate([np.full(pressure.size, np.inf), bound])
    y = np.clip(y, lower, upper)
    if y.size and products:
        step = BoxStep(dual, dual.evaluate(y).gradient)
        step.max_products = products
        s, _ = step.solve(lower - y, upper - y, FORCING)
        y = np.clip(y + s, lower, upper)
    return dual.refined(y), (y[: pressure.size], y[pressure.size :])


def assembled(numbers: Numbers, S: Array, size: int) -> sp.csc_array:
    """Sum of element matrices (elements, k, k) over their numbers (elements, k); -1 drops a row."""
    k = numbers.shape[1]
    row = np.broadcast_to(numbers[:, :, None], S.shape).ravel()
    column = np.broadcast_to(numbers[:, None, :], S.shape).ravel()
    keep = (row >= 0) & (column >= 0) if np.any(numbers < 0) else slice(None)
    place = (row[keep], column[keep])
    return sp.csc_array(sp.coo_array((S.reshape(-1, k * k).ravel()[keep], place), shape=(size, size)))


def _rows(numbers: Numbers, size: int) -> sp.csr_array:
    """One row per entry, with a one at its number; an empty one for -1."""
    used = numbers >= 0
    place = (np.flatnonzero(used), numbers[used])
    return sp.csr_array((np.ones(int(used.sum())), place), shape=(numbers.size, size))
