"""The field in equilibrium whose dual energy is largest, by one sparse positive definite system.

Stresses (or fluxes) live on the elements; traces of the displacement on the edges are the
multipliers of equilibrium between them. Eliminating the stresses leaves

    min 1/2 W^T S W - F^T W + sum b |T W|   with   N W + gamma >= 0

in the traces W alone, a contact problem of the same form as that of the nodes, whose minimum is
the largest dual energy. Its multipliers are the contact forces. Any non-negative ones, with
friction within its bound, give a lower bound of the energy, the best ones the highest. So the
system is factorised once, without contact, and the forces, which begin with those of the
computed solution, are improved by projected Newton steps that cost back-substitutions only.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rmesh_nlp.certificate.conditions import Conditions, linear_values
from rmesh_nlp.certificate.raviart_thomas import RaviartThomas
from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.contact.first_guess import DualEnergy
from rmesh_nlp.contact.model import solve
from rmesh_nlp.contact.system import ActiveSet, ContactSystem
from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.newton import minimise

Numbers = NDArray[np.int64]

GAIN = 1e-3
"""Part of the gain so far below which better contact forces are not looked for."""


@dataclass(frozen=True)
class Balance:
    """The field in equilibrium, as far as edges see it.

    Attributes
    ----------
    traces : (elements, local traces) array
        Of each element, in Cartesian components, counted from those of the base.
    pressure, friction : (moments, contact edges) arrays
        At the ends of the contact edges; means for a scalar problem.
    reaction_work : float
        Work of the reactions on the given displacements.
    """

    traces: Array
    pressure: Array
    friction: Array
    reaction_work: float


@dataclass(frozen=True)
class TraceSpace:
    """Unknowns of the hybridised problem: moments of the displacement on the edges.

    A scalar problem has the mean over each edge. An elastic one has, for each end of an edge, the
    moments of two components against the linear function of that end, divided by the length. On
    contact edges components are those along the obstacle's tangent and normal, elsewhere x and y.
    """

    skeleton: Skeleton
    conditions: Conditions

    @property
    def n(self) -> int:
        """Components, and moments of each on an edge."""
        return int(self.conditions.held.shape[0])

    @property
    def size(self) -> int:
        """Number of traces."""
        return int(self.skeleton.ends.shape[1] * self.n**2)

    @cached_property
    def of_elements(self) -> Numbers:
        """(elements, local traces) numbers: edge by edge, ends counter-clockwise."""
        n = self.n
        first = self.skeleton.edges * n * n
        if n == 1:
            return np.ascontiguousarray(first.T)
        numbers = first[:, None, None] + n * self.skeleton.place[:, :, None] + np.arange(n)[:, None]
        return np.ascontiguousarray(numbers.reshape(12, -1).T)

    def of_contact(self, axis: int) -> Numbers:
        """(moments, contact edges) numbers along a row of ``conditions.axes``."""
        n = self.n
        return np.asarray((self.conditions.contact * n + np.arange(n)[:, None]) * n + axis, dtype=np.int64)

    def vector(self, field: NDArray) -> Array:
        """A field (components, moments, edges), Cartesian, as a vector of traces or forces."""
        contact, axes = self.conditions.contact, self.conditions.axes
        turned = field.astype(float)
        turned[:, :, contact] = np.einsum("eij,jme->ime", axes, turned[:, :, contact])
        return np.ascontiguousarray(turned.transpose(2, 1, 0)).ravel()

    def rotations(self) -> tuple[NDArray, Array]:
        """Elements with turned traces, and their matrices (these, k, k) from Cartesian to turned ones."""
        n, conditions = self.n, self.conditions
        oblique = np.any(np.abs(conditions.axes - np.eye(n)) > 0, axis=(1, 2))
        position = np.full(self.skeleton.ends.shape[1], -1)
        position[conditions.contact[oblique]] = np.flatnonzero(oblique)
        which = position[self.skeleton.edges]
        elements = np.flatnonzero(np.any(which >= 0, axis=0))
        result = np.tile(np.eye(3 * n * n), (elements.size, 1, 1))
        for i in range(3):
            has = np.flatnonzero(which[i, elements] >= 0)
            for end in range(n):
                at = slice((i * n + end) * n, (i * n + end + 1) * n)
                result[has, at, at] = conditions.axes[which[i, elements[has]]]
        return elements, result


def balance(
    space: TraceSpace,
    stiffness: Array,
    source: Array,
    base: Array,
    pressure: Array,
    friction: Array,
    max_steps: int,
) -> Balance:
    """Equilibrate the elements with each other and with the contact forces.

    Traces are counted from those of a given displacement: where it is close to the solution they are small,
    and so is the rounding of stresses, which would else be differences of large numbers.

    Parameters
    ----------
    space : TraceSpace
    stiffness, source : (elements, k, k) and (elements, k) arrays
        Forces through the edges of an element are ``stiffness @ traces - source``.
    base : (components, moments, edges) array
        Moments of the displacement that traces are counted from; its forces are part of ``-source``.
    pressure, friction : (moments, contact edges) arrays
        Where to begin; cut to what contact and friction allow.
    max_steps : int
        Newton steps that improve the contact forces.
    """
    conditions, lengths = space.conditions, space.skeleton.lengths
    numbers, n = space.of_elements, space.n
    turned, rotation = space.rotations()
    S, b = stiffness, source
    if turned.size:
        S, b = S.copy(), b.copy()
        S[turned] = rotation @ S[turned] @ rotation.transpose(0, 2, 1)
        b[turned] = np.einsum("eij,ej->ei", rotation, b[turned])
    held = np.repeat(conditions.held[:, None], n, axis=1)
    held = np.abs(space.vector(held)) > 0.5
    given = conditions.given if n == 2 else conditions.given.sum(axis=1, keepdims=True)
    start = space.vector(base)
    W = np.where(held, space.vector(given) - start, 0.0)
    applied = space.vector(edge_loads(conditions.traction) * lengths)

    def through(traces: Array) -> Array:
        """Sum of the forces through each edge."""
        forces = np.einsum("eij,ej->ei", S, traces[numbers]) - b
        return np.asarray(np.bincount(numbers.ravel(), forces.ravel(), space.size), dtype=float)

    free = np.flatnonzero(~held)
    index = np.full(space.size, -1, dtype=np.int64)
    index[free] = np.arange(free.size)
    normal = index[space.of_contact(n - 1)]
    tangent = index[space.of_contact(0)] if n == 2 else np.zeros((0, normal.shape[1]), dtype=np.int64)
    edge = lengths[conditions.contact]
    bound = np.where(tangent >= 0, conditions.friction[: len(tangent)] * edge, 0.0)
    offset = conditions.offset if n == 2 else conditions.offset.sum(axis=0, keepdims=True)
    system = ContactSystem(
        assembled(index[numbers], S, free.size),
        (applied - through(W))[free],
        0.0,
        _rows(normal.ravel(), free.size),
        _rows(tangent.ravel(), free.size),
        offset.ravel() + start[space.of_contact(n - 1)].ravel(),
        bound.ravel() if np.any(bound > 0) else np.zeros(0),
    )
    force = (pressure * edge).ravel(), (friction[: len(tangent)] * edge).ravel()
    slip = start[space.of_contact(0)].ravel()
    W[free], force = improved(system, slip, *force, max_steps)
    reaction = (through(W) - applied)[held] @ (W + start)[held]
    traces = W[numbers]
    if turned.size:
        traces[turned] = np.einsum("eji,ej->ei", rotation, traces[turned])
    drawn = np.zeros(normal.shape)
    if force[1].size:
        drawn = force[1].reshape(tangent.shape) / edge
    return Balance(traces, force[0].reshape(normal.shape) / edge, drawn, float(reaction))


def obstacle_balance(
    space: TraceSpace, elements: RaviartThomas, sign: float, offset: Array, touching: NDArray[np.bool_]
) -> tuple[Balance, Array]:
    """The same for a scalar problem with an obstacle in the interior.

    Its reaction is constant on each element. The mean displacement U of each element is one more
    unknown, ``1/2 kappa (U - mean trace)^2`` its energy, and ``sign U + offset >= 0``.

    Parameters
    ----------
    space : TraceSpace
    elements : RaviartThomas
    sign : float
        1 for an obstacle below, -1 above.
    offset, touching : (elements,) arrays
        Mean initial gap, and the elements that touch at first.

    Returns
    -------
    balance : Balance
    force : (elements,) array
        The reaction per area, not negative.
    """
    conditions, count = space.conditions, space.size
    area = elements.skeleton.areas
    numbers = np.hstack([space.of_elements, count + np.arange(area.size)[:, None]])
    kappa = 4 * elements.conductivity * area**2 / elements.mean_square_radius
    average = np.array([1 / 3, 1 / 3, 1 / 3, -sign])
    S = np.multiply.outer(kappa, np.outer(average, average))
    S[:, :3, :3] += elements.stiffness
    load = np.zeros(count + area.size)
    load[:count] = space.vector(edge_loads(conditions.traction) * elements.skeleton.lengths)
    load[count:] = sign * elements.load * area
    W, held = np.zeros(load.size), np.zeros(load.size, dtype=bool)
    held[:count] = conditions.held[0]
    W[:count] = np.where(held[:count], conditions.given.sum(axis=1)[0], 0.0)
    known = np.bincount(numbers.ravel(), np.einsum("eij,ej->ei", S, W[numbers]).ravel(), load.size)
    free = np.flatnonzero(~held)
    index = np.full(load.size, -1, dtype=np.int64)
    index[free] = np.arange(free.size)
    system = ContactSystem(
        assembled(index[numbers], S, free.size),
        (load - known)[free],
        0.0,
        _rows(index[count:], free.size),
        sp.csr_array((0, free.size)),
        offset,
        np.zeros(0),
    )
    found = solve(system, ActiveSet(touching, np.zeros(0, dtype=np.int8)))
    W[free] = found.u
    force = np.maximum(found.normal_force, 0.0) / area
    traces = W[space.of_elements]
    balanced = elements.load + sign * force
    through = np.einsum("eij,ej->ei", elements.stiffness, traces) - (balanced * area / 3)[:, None]
    total = np.bincount(space.of_elements.ravel(), through.ravel(), count)
    reaction = (total - load[:count])[held[:count]] @ W[:count][held[:count]]
    none = np.zeros((1, 0))
    return Balance(traces, none, none, float(reaction)), force


def moments_on_edges(displacement: Array, space: TraceSpace) -> Array:
    """(components, moments, edges) moments of a piecewise linear displacement (components, nodes)."""
    ends = displacement[:, space.skeleton.ends]
    if space.n == 1:
        return np.asarray(ends.mean(axis=1, keepdims=True))
    return np.asarray((2 * ends + ends[:, ::-1]) / 6)


def edge_loads(moments: Array) -> Array:
    """Values at the ends of edges (components, moments, edges) of the best polynomial for some moments."""
    if len(moments) == 1:
        return np.asarray(moments.sum(axis=1, keepdims=True))
    return np.stack([linear_values(part) for part in moments])


def improved(
    system: ContactSystem, slip: Array, pressure: Array, friction: Array, max_steps: int
) -> tuple[Array, tuple[Array, Array]]:
    """Feasible contact forces better than the given ones, and the unknowns of the system under them."""
    dual = DualEnergy(system, slip)
    bound = system.slip_bound
    y = np.concatenate([pressure, friction[: bound.size]])
    lower = np.concatenate([np.zeros(pressure.size), -bound])
    upper = np.concatenate([np.full(pressure.size, np.inf), bound])
    y = np.clip(y, lower, upper)
    if y.size and max_steps:
        y = minimise(
            dual.evaluate, y, lower, upper, tolerance=np.inf, gain_tolerance=GAIN, max_iterations=max_steps
        ).x
    return dual.displacement(y), (y[: pressure.size], y[pressure.size :])


def assembled(numbers: Numbers, S: Array, size: int) -> sp.csc_array:
    """Sum of element matrices (elements, k, k) over their numbers (elements, k); -1 drops a row."""
    k = numbers.shape[1]
    row = np.broadcast_to(numbers[:, :, None], S.shape).ravel()
    column = np.broadcast_to(numbers[:, None, :], S.shape).ravel()
    keep = (row >= 0) & (column >= 0) if np.any(numbers < 0) else slice(None)
    entries = sp.coo_array(
        (S.reshape(-1, k * k).ravel()[keep], (row[keep], column[keep])), shape=(size, size)
    )
    return sp.csc_array(entries)


def _rows(numbers: Numbers, size: int) -> sp.csr_array:
    """One row per entry, with a one at its number; an empty one for -1."""
    used = numbers >= 0
    place = (np.flatnonzero(used), numbers[used])
    return sp.csr_array((np.ones(int(used.sum())), place), shape=(numbers.size, size))
