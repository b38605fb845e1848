"""Descent directions at a contact solution by brute force over the states of its weakly active nodes.

A node whose gap and force both vanish may open or press; one whose slip vanishes at the bound of friction may
stick or slide. Every combination is a branch: its displacement and forces are those of an active set that is
held, without a look at signs, and smooth functions of the outer variables q. On each branch the objective, by
the adjoint of the contact solver, is minimised to first order,

    min  g . d    subject to    |d|_1 <= 1,   active move limits, element areas and constraints,

and the gaps, forces, slips and reserves of friction of the weakly active nodes, whose derivatives are
differences of contact solves, keep the signs of the branch. Nothing here uses the KKT model or an LPEC.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.evaluation import Array
from rmesh_nlp.models.kkt_model import ContactPoint
from rmesh_nlp.models.reduced_model import ReducedObjective, ReducedPoint
from rmesh_nlp.optimize.activity import ZERO
from rmesh_nlp.solving.outer import Outer

STEP = 1e-4
"""Of the central differences, in outer variables."""

Systems = Callable[[Array], ContactSystem]

State = tuple[bool, int]
"""Whether a node touches, and how it slides."""


@dataclass(frozen=True)
class Steepest:
    """The steepest descent over the branches.

    ``rate`` is the change of the objective per unit of ``|d|_1``, in units of the first-order residual: not
    positive, and 0 at a B-stationary point; ``direction`` (n,) has it. ``branches`` were searched.
    """

    rate: float
    direction: Array
    branches: int


def steepest(outer: Outer, q: Array) -> Steepest:
    """Search all branches at ``q``."""
    point = outer.function(q)
    nodes = _Nodes(point.system, point.equilibrium)
    every = list(nodes.combinations())
    best, systems = Steepest(0.0, np.zeros(q.size), len(every)), _systems(outer)
    for active in every:
        rate, direction = _on_branch(outer, point, nodes, active, systems)
        if rate < best.rate:
            best = replace(best, rate=rate, direction=direction)
    return best


class _Nodes:
    """The contact nodes whose state is not determined to first order."""

    def __init__(self, system: ContactSystem, state: Equilibrium) -> None:
        self.active, n = state.active, system.offset.size
        length, force = float(np.max(np.abs(state.u))), system.force_scale
        gap = (system.normals @ state.u + system.offset) / length
        normal = state.normal_force / force
        self.opens = (np.abs(gap) < ZERO) & (np.abs(normal) < ZERO)
        self.slides = self.bare = self.still = np.zeros(n, bool)
        self.sign = np.zeros(n, np.int8)
        if system.slip_bound.size:
            acts = system.rotated.slips & (True if system.frictional is None else system.frictional)
            slip = np.where(acts, system.tangents @ state.u, 0.0) / length
            bound, tangential = system.bound(state.normal_force) / force, state.tangential_force / force
            self.still = acts & (np.abs(slip) < ZERO)
            self.bare = bound < ZERO
            self.slides = self.still & ~self.bare & (bound - np.abs(tangential) < ZERO)
            self.slides |= self.still & self.bare & self.opens
            self.sign = np.where(self.still, -np.sign(tangential), np.sign(slip)).astype(np.int8)

    def _states(self, node: int) -> list[State]:
        """Those that a node may take."""
        now = (bool(self.active.touching[node]), int(self.active.sliding[node]) if self.sliding else 0)
        touches = (True, False) if self.opens[node] else (now[0],)
        if not self.slides[node]:
            # friction sets in with the contact force at a node that slides
            sign = int(self.sign[node]) if self.opens[node] and self.bare[node] else now[1]
            return [(touch, sign) for touch in touches]
        if self.bare[node]:
            return [(False, 1), (True, 0), (True, 1), (True, -1)]
        return [(touch, slide) for touch in touches for slide in (0, int(self.sign[node]))]

    @property
    def weak(self) -> NDArray[np.intp]:
        """Their places among the contact nodes."""
        return np.flatnonzero(self.opens | self.slides)

    @property
    def sliding(self) -> bool:
        """Whether there is friction at all."""
        return self.active.sliding.size > 0

    def combinations(self) -> Iterator[ActiveSet]:
        """The active sets of all branches."""
        for states in product(*(self._states(int(node)) for node in self.weak)):
            touching, sliding = self.active.touching.copy(), self.active.sliding.copy()
            for node, (touch, slide) in zip(self.weak, states, strict=True):
                touching[node] = touch
                if self.sliding:
                    sliding[node] = slide
            yield ActiveSet(touching, sliding)

    def signs(self, system: ContactSystem, state: Equilibrium) -> Array:
        """What must not be negative on the branch of a state: linearly for the signs of this solution."""
        touching, rows = state.active.touching, []
        gap = system.normals @ state.u + system.offset
        rows.append(np.where(touching, state.normal_force, gap)[self.opens])
        if self.sliding:
            slip, sliding = system.tangents @ state.u, state.active.sliding
            coulomb = 0.0 if system.coulomb is None else system.coulomb
            bound = system.slip_bound + coulomb * state.normal_force
            holds = self.slides & touching if system.coulomb is not None else self.slides
            along, against = bound + state.tangential_force, bound - state.tangential_force
            first = np.where(sliding != 0, sliding * slip, np.where(self.sign > 0, along, against))
            second = np.where(self.bare & (sliding == 0), np.where(self.sign > 0, against, along), first)
            rows += [np.where(holds, part, 0.0)[self.slides] for part in (first, second)]
        return np.concatenate(rows)


def _systems(outer: Outer) -> Systems:
    """Contact systems by outer variables: those of the differences are the same on every branch."""
    kept = cache(lambda key: outer.contact.system_at(np.frombuffer(key)))
    return lambda q: kept(q.tobytes())


def _on_branch(
    outer: Outer, point: ReducedPoint, nodes: _Nodes, active: ActiveSet, systems: Systems
) -> tuple[float, Array]:
    function, energy, q, free = outer.function, outer.energy, point.q, outer.discretisation.mesh_map
    assert isinstance(function, ReducedObjective)

    def at(trial: Array) -> tuple[ContactSystem, Equilibrium]:
        system = systems(trial)
        return system, system.equilibrium(active)

    end = function.of(ContactPoint(q, *at(q)))
    gradient = end.gradient / outer.residual.unit
    rows = [np.zeros((0, q.size))]
    if nodes.weak.size:
        rows.append(-_unit_rows(_differences(lambda trial: nodes.signs(*at(trial)), q)))
    if outer.relocation.n_valid:
        areas = energy.validity.at(q)
        rows.append(-areas.jacobian[areas.slack <= outer.tolerance].toarray())
    if outer.constraints is not None:
        bounds = outer.constraints.linearised(end)
        active = bounds.slack <= outer.tolerance
        rows.append(-_unit_rows(bounds.jacobian[active].toarray()))
    stacked = np.vstack(rows)
    n = q.size
    # d = up - down
    up = np.where(free.upper - q <= outer.tolerance, 0.0, 1.0)
    down = np.where(q - free.lower <= outer.tolerance, 0.0, 1.0)
    both = np.vstack([np.hstack([stacked, -stacked]), np.ones(2 * n)])
    answer = linprog(
        np.append(gradient, -gradient),
        A_ub=both,
        b_ub=np.append(np.zeros(len(stacked)), 1.0),
        bounds=np.column_stack([np.zeros(2 * n), np.append(up, down)]),
        method="highs",
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )
    if answer.status != 0:
        raise RuntimeError(answer.message)
    return float(answer.fun), answer.x[:n] - answer.x[n:]


def _unit_rows(rows: Array) -> Array:
    """The rows that are not zero, each divided by its largest component."""
    size = np.max(np.abs(rows), axis=1, initial=0.0)
    return np.asarray(rows[size > 0] / size[size > 0, None])


def _differences(function: Callable[[Array], Array], q: Array) -> Array:
    """Derivatives (rows, n) by central differences of the fourth order."""
    columns: list[NDArray[np.float64]] = []
    for step in STEP * np.eye(q.size):
        first, second = (
            function(q + step) - function(q - step),
            function(q + 2 * step) - function(q - 2 * step),
        )
        columns.append((8 * first - second) / (12 * STEP))
    return np.array(columns).T.reshape(-1, q.size)
