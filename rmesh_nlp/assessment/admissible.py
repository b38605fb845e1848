"""The energy of the continuous problem on a mesh: that of a displacement which is admissible everywhere.

It is a polynomial on each triangle and keeps off the foundations by as much as gaps along whole edges (in
whole triangles) need. With loads and friction integrated until two rules agree, on the domain of the true
curves, its energy is never below the least one. By Theorem 4.1 it falls if and only if the error does.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rmesh_nlp.assessment.energy import friction_energy, load_vector, shape_integrals, stiffness
from rmesh_nlp.assessment.parts import PROVED
from rmesh_nlp.assessment.tightening import tightened
from rmesh_nlp.contact.active_set import solve
from rmesh_nlp.contact.solver import Directions, coefficients
from rmesh_nlp.contact.standoff import Cells, cells_of
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.discretisation import Discretisation, discretise
from rmesh_nlp.evaluation import ROUNDING, Array, magnitude, numbers_of
from rmesh_nlp.meshes.geometry import relocated_mesh
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, Place
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.contact_problem import locally_refined
from rmesh_nlp.problem.data import ContactSet

REPEATS = 12
"""Contact solves with larger stand-offs, where normals vary along an edge, and meshes on which triangles are
cut all of whose nodes are held, where the foundation rises through them."""


@dataclass(frozen=True)
class Admissible:
    """A displacement that is admissible for the continuous problem, and its energy."""

    parts: Discretisation  # of the mesh, locally refined where given displacements left no room
    body: Body
    system: ContactSystem  # with the stand-offs, and friction bounded from above
    state: Equilibrium
    displacement: Array  # (components, nodes), at the nodes of the displacement space
    energy: float  # J of the continuous problem: strain - work + friction
    strain: float
    friction: float
    doubt: float  # what quadrature may have changed in the energy
    penetration: float  # what is left of it; positive only if the repeats did not suffice

    @property
    def problem(self) -> ContactProblem:
        """That of the discretisation."""
        return self.parts.problem

    @property
    def status(self) -> Status:
        """CONVERGED if it is admissible and in equilibrium."""
        if self.state.status is not Status.CONVERGED:
            return self.state.status
        return Status.INACCURATE if self.penetration > 0 else Status.CONVERGED


class Continuous:
    """The continuous problem, restricted to the displacements of one mesh.

    ``nodes`` (2, vertices) are the positions of the vertices; those of the mesh by default.
    """

    def __init__(self, problem: ContactProblem | Discretisation, nodes: Array | None = None) -> None:
        self.parts = parts = discretise(problem)
        self.problem, self.space, self.field = parts.problem, parts.space, parts.displacement
        self.body = body = Body(self.problem, self.problem.mesh.p if nodes is None else nodes)
        self.stiffness = stiffness(body, self.space)
        self.load, self._load_doubt = load_vector(body, self.space)
        self.given = self.field.values(np.zeros(parts.n_u))  # (components, nodes)
        sets = self.space.contact_sets
        self.cells = [cells for part in sets for cells in cells_of(body, self.space, part)]
        rubbing = [part for part in sets if part.obstacle.has_bound]
        self._rubbing = [(part, body.edges(str(part.obstacle.boundary))) for part in rubbing]

    @cached_property
    def _bare(self) -> ContactSystem:
        """The quadratic program without stand-offs."""
        nodes, space, index = self.body.nodes, self.space, self.field.index
        free, given, points = np.flatnonzero(index.T.ravel() >= 0), self.given.T.ravel(), space.points(nodes)
        pull = self.stiffness @ given
        directions = Directions(space, self.field, self.parts.n_u)
        normals, tangents = directions.rows(nodes)
        gaps = [part.obstacle.distances(points[:, part.nodes]) for part in space.contact_sets]
        offset = np.concatenate([np.zeros(0), *gaps])
        for cells in self.cells:  # at edges coefficients, on the arc if there is one
            rows, at_nodes = (values[cells.vertices :] for values in (cells.rows, cells.at_nodes))
            offset[rows[rows >= 0]] = at_nodes[rows >= 0]
        along = np.sum(directions.normals(nodes) * self.given[:, space.contact_nodes], axis=0)
        frictional = np.zeros(along.size, dtype=bool)
        frictional[space.friction_rows] = True
        bounds = np.zeros(along.size if self.problem.frictional else 0)
        for part, edges in self._rubbing:
            friction = np.zeros(space.n_nodes)
            shares = shape_integrals(edges, part.obstacle.friction, space.order).value
            np.add.at(friction, space.nodes_of(edges.ends), shares)
            bounds[part.rows] = friction[part.nodes]
        return ContactSystem(
            stiffness=self.stiffness[free][:, free],
            load=(self.load - pull)[free],
            constant=float(0.5 * given @ pull - self.load @ given),
            normals=normals,
            tangents=tangents,
            offset=offset + along,
            slip_bound=bounds,
            frictional=frictional,
            rigid=self.parts.rigid_motions(nodes),
            coulomb=coefficients(space, nodes),
        )

    def system(self, standoff: Array) -> ContactSystem:
        """The quadratic program with gaps shortened by a stand-off (gaps,)."""
        return self._bare.with_offset(self._bare.offset - standoff)

    def shifted(self, contact: ContactSet, by: float) -> Continuous:
        """The same with the foundation of a contact set raised along its normal, everywhere by a length."""
        other, offset = copy(self), self._bare.offset.copy()
        offset[contact.rows] -= by
        vars(other)["_bare"] = self._bare.with_offset(offset)
        other.cells = [
            replace(cells, distance=cells.distance - by, low=cells.low - by, at_nodes=cells.at_nodes - by)
            if cells.contact.number == contact.number
            else cells
            for cells in self.cells
        ]
        return other

    def room(self, contact: ContactSet) -> float:
        """How far that foundation can be raised before it meets nodes or cells that are held."""
        room = np.inf
        for cells in self.cells:
            if cells.contact.number == contact.number:
                held = cells.rows < 0
                gaps = cells.at_nodes + self.given_along(cells)[cells.nodes]
                between = cells.gaps(self.given)[np.all(held, axis=0)]
                room = min(room, np.min(gaps[held], initial=np.inf), np.min(between, initial=np.inf))
        return float(room)

    def solve(self, start: ActiveSet | None = None, *, tighten: bool = True) -> Admissible:
        """The admissible displacement of least energy, friction bounded from above.

        Without ``tighten`` nodes keep off as far as they must by themselves, at a tenth of the cost.
        """
        standoff, violation = self.first_standoff(), 0.0
        system = self.system(standoff)
        state = _solved(system, start)
        rises = np.any(standoff) or any(part.obstacle.level is not None for part in self.space.contact_sets)
        if rises:
            state, standoff, violation = self._safe(system, state, standoff)
        # coefficients that are not negative are more than a gap of order 2 needs
        tighten &= violation == 0 and not self.problem.has_coulomb
        if tighten and (rises or (self.cells and self.space.order == 2)):
            closer = tightened(system, state, self.cells, self.field)
            if closer is not None and closer.energy < state.energy:
                gap = self._bare.normals @ closer.u + self._bare.offset
                state, standoff = closer, np.where(closer.active.touching, gap, 0.0)
        system = self.system(standoff)
        displacement = self.field.values(state.u)
        u = displacement.T.ravel()
        strain, work = 0.5 * float(u @ (self.stiffness @ u)), float(self.load @ u)
        friction, doubt = 0.0, float(self._load_doubt @ np.abs(u))
        for part, edges in self._rubbing:
            ends = displacement[:, self.space.nodes_of(edges.ends)]
            values, wrong = friction_energy(edges, part.obstacle, ends)
            friction, doubt = friction + float(np.sum(values)), doubt + float(np.sum(wrong))
        energies = strain - work + friction, strain, friction, doubt
        return Admissible(self.parts, self.body, system, state, displacement, *energies, violation)

    def _safe(
        self, system: ContactSystem, state: Equilibrium, standoff: Array
    ) -> tuple[Equilibrium, Array, float]:
        """Stand-offs raised until no violation is left where normals vary; what is left else."""
        for _ in range(REPEATS):
            displacement = self.field.values(state.u)
            raised = self._raised([cells.missing(displacement) for cells in self.cells])
            violation = float(np.max(raised, initial=0.0))
            size = magnitude(state.u) + magnitude(system.offset)
            if violation <= ROUNDING * size:
                return state, standoff, 0.0
            standoff = standoff + 1.1 * raised
            system = system.with_offset(system.offset - 1.1 * raised)
            state = _solved(system, state.active)
        return state, standoff, violation

    def given_along(self, cells: Cells) -> Array:
        """(nodes,) given displacement along the normal of the foundation of some cells."""
        normals = cells.contact.obstacle.normals(self.space.points(self.body.nodes))
        return np.sum(normals * self.given, axis=0)

    def first_standoff(self) -> Array:
        """(gaps,) how far nodes keep off by the height of the foundations without displacement."""
        heights = []
        for cells in self.cells:
            off, size = cells.off(self.given_along(cells)), magnitude(cells.distance)
            heights.append(np.where(off > PROVED * size, off, 0.0))
        return self._raised(heights)

    def _raised(self, off: Sequence[Array]) -> Array:
        """(gaps,) the largest ``off`` (m,) of the cells at each free node."""
        standoff = np.zeros(self.space.contact_nodes.size)
        for cells, height in zip(self.cells, off, strict=True):
            for rows in cells.rows:
                np.maximum.at(standoff, rows[rows >= 0], height[rows >= 0])
        return standoff


def admissible(
    problem: ContactProblem | Discretisation, nodes: Array | None = None, start: ActiveSet | None = None
) -> Admissible:
    """The energy of the continuous problem on a mesh, by an admissible displacement.

    ``nodes`` (2, vertices) are the positions of the vertices, by default those of the mesh; ``start`` is the
    contact to begin with.
    """
    for _ in range(REPEATS):
        continuous = Continuous(problem, nodes)
        inside = [cells for cells in continuous.cells if cells.contact.obstacle.boundary is Place.INTERIOR]
        cut = [cells.number[cells.unreachable(continuous.given_along(cells))] for cells in inside]
        elements = numbers_of(cut)
        if elements.size == 0:
            break
        moved = continuous.problem
        if nodes is not None:
            moved = replace(moved, mesh=relocated_mesh(moved.mesh, nodes))
        problem, nodes, start = locally_refined(moved, elements), None, None
    return continuous.solve(start)


def _solved(system: ContactSystem, start: ActiveSet | None) -> Equilibrium:
    """From a set that touched on this mesh or on a similar one; from a guess if that fails."""
    state = solve(system, start)
    return state if state.status is Status.CONVERGED or start is None else solve(system)
