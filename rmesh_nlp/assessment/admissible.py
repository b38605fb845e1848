"""The energy of the continuous problem on a mesh: that of a displacement which is admissible everywhere.

It is a polynomial on each triangle and keeps off the foundations by as much as gaps along whole edges (in
whole triangles) need. With loads and friction integrated until two rules agree, on the domain of the true
curves, its energy is never below the least one. By Theorem 4.1 it falls if and only if the error does.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.assessment.energy import friction_energy, load_vector, shape_integrals, stiffness
from rmesh_nlp.contact.active_set import solve
from rmesh_nlp.contact.interior_point import BarrierProgram
from rmesh_nlp.contact.solver import coefficients, contact_rows
from rmesh_nlp.contact.standoff import Cells, cells_of
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.discretisation import Discretisation, discretise
from rmesh_nlp.evaluation import PROVED, ROUNDING, Array, Index, magnitude, numbers_of, summed
from rmesh_nlp.meshes.geometry import relocated_mesh
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.coefficients import Coefficient, at, on_points
from rmesh_nlp.problem.contact_problem import locally_refined
from rmesh_nlp.problem.data import ContactSet

REPEATS = 12
"""Times that nodes are raised by what is missing, more than once where normals vary along an edge; and meshes
on which triangles are cut all of whose nodes are held, where the foundation rises through them."""


@dataclass(frozen=True)
class Admissible:
    """A displacement that is admissible for the continuous problem, and its energy."""

    continuous: Continuous  # on a mesh that is locally refined where given displacements left no room
    system: ContactSystem  # with the stand-offs, and friction bounded from above
    state: Equilibrium
    displacement: Array  # (components, nodes), at the nodes of the displacement space
    energy: float  # J of the continuous problem: strain - work + friction
    strain: float
    friction: float
    doubt: float  # what quadrature and rounding may have changed in the energy
    penetration: float  # what is left of it; positive only if the repeats did not suffice

    @property
    def body(self) -> Body:
        """The body with that mesh."""
        return self.continuous.body

    @property
    def problem(self) -> ContactProblem:
        """The problem on that mesh."""
        return self.continuous.problem

    @property
    def status(self) -> Status:
        """CONVERGED if it is admissible and in equilibrium."""
        own = self.state.status
        return Status.INACCURATE if self.penetration > 0 and own is Status.CONVERGED else own


class Continuous:
    """The continuous problem, restricted to the displacements of one mesh.

    ``nodes`` (2, vertices) are the positions of the vertices; those of the mesh by default.
    """

    def __init__(self, problem: ContactProblem | Discretisation, nodes: Array | None = None) -> None:
        self.parts = parts = discretise(problem)
        self.problem, self.space, self.field = parts.problem, parts.space, parts.displacement
        self.body = body = Body(self.problem, self.problem.mesh.p if nodes is None else nodes)
        self.stiffness, self._stiffness_doubt = stiffness(body, self.space)
        self.load, self._load_doubt = load_vector(body, self.space)
        self.given = self.field.values(np.zeros(parts.n_u))  # (components, nodes)
        sets = self.space.contact_sets
        self.cells = [cells for part in sets for cells in cells_of(body, self.space, part)]
        rubbing = [part for part in sets if part.obstacle.friction_law.has_given]
        self._rubbing = [(part, body.edges_of(part.obstacle)) for part in rubbing]

    def __reduce__(self) -> tuple[Any, ...]:
        """Symbols and factors can't be pickled: it is made anew."""
        return Continuous, (self.problem, self.body.nodes)

    @cached_property
    def _bare(self) -> ContactSystem:
        """The quadratic program without stand-offs."""
        nodes, space, index = self.body.nodes, self.space, self.field.index
        free, given = np.flatnonzero(index.T.ravel() >= 0), self.given.T.ravel()
        pull = self.stiffness @ given
        normals, tangents, along = contact_rows(self.parts, nodes)
        offset, bounds = np.zeros((2, along.size))
        for cells in self.cells:  # coefficients, on the arc if there is one
            offset[cells.rows[cells.rows >= 0]] = cells.at_nodes[cells.rows >= 0]
        for part, edges in self._rubbing:
            friction = np.zeros(space.n_nodes)
            shares = shape_integrals(edges, part.obstacle.friction_law.given, space.order).value
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
            frictional=space.frictional,
            rigid=self.parts.rigid_motions(nodes),
            coulomb=coefficients(space, nodes),
        )

    def system(self, standoff: Array) -> ContactSystem:
        """The quadratic program with gaps shortened by a stand-off (gaps,)."""
        return self._bare.with_offset(self._bare.offset - standoff)

    def shifted(self, contact: ContactSet, by: Coefficient) -> Continuous:
        """The same with the foundation of a contact set raised along its normals by a length."""
        other, offset, gap = copy(self), self._bare.offset.copy(), contact.obstacle.offset
        offset[contact.rows] -= self.space.interpolant(by, self.body.nodes)[0, contact.nodes]
        vars(other).update(_bare=self._bare.with_offset(offset), _reduced=self._reduced)
        raised = replace(contact.obstacle, offset=lambda x, y: at(gap, x, y) - at(by, x, y))
        other.cells = [cells for cells in self.cells if cells.contact.number != contact.number]
        other.cells += cells_of(self.body, self.space, replace(contact, obstacle=raised))
        return other

    @property
    def is_open(self) -> bool:
        """Whether foundations are below the body wherever given displacements alone move it."""
        for cells in self.cells:
            gaps = cells.at_points(self.given)
            held = (cells.rows >= 0).T @ cells.shares == 0
            if np.min(gaps[held], initial=0.0) < -PROVED * magnitude(gaps):
                return False
        return True

    @cached_property
    def _reduced(self) -> tuple[ContactSystem, Callable[[Array], Array], Index]:
        """The program without stand-offs in the unknowns of contact, all unknowns by these, and these.

        The whole one where its factors have no more entries.
        """
        bare, acted = self._bare, [self._bare.normals.indices, self._bare.tangents.indices]
        for cells in self.cells:
            acts = self.problem.frictional | np.any(cells.normals != 0, axis=(1, 2))
            acted.append(self.field.index[acts][:, cells.contact.carriers(cells.nodes)].ravel())
        last = np.unique(numbers_of(acted))
        last = last[last >= 0]
        if (condensed := bare.condensed(last)) is None:
            return bare, lambda u: u, np.arange(bare.load.size)
        return *condensed, last

    def solve(self, start: ActiveSet | None = None) -> Admissible:
        """The admissible displacement of least energy.

        With Coulomb friction, where no energy is least, that in equilibrium.
        """
        has_program = bool(self.cells) and self.problem.has_energy
        if self.space.order == 1 or not has_program:
            system = self._bare if has_program else self.system(self.first_standoff())
            state = solve(system, start)
            if not has_program or not (
                np.any(self._missing(self.field.values(state.u))) or self._turns(state)
            ):
                return self._made(system, state)
        program, whole, last = self._reduced
        program = program.with_offset(self._bare.offset)  # of a shifted foundation
        x = self._lowest(program, last, solve(program, start))
        state = _in_contact(program, x)
        gap = program.normals @ x + self._bare.offset
        standoff = np.where(state.active.touching & (gap > PROVED * magnitude(x)), gap, 0.0)
        return self._made(self.system(standoff), replace(state, u=whole(x)))

    def _lowest(self, program: ContactSystem, last: Index, state: Equilibrium) -> Array:
        """The unknowns ``last`` of least energy with gaps and friction at the points of cells.

        ``state`` is the solution with both at nodes. Cells matter where it presses or is not admissible; at
        order 1 a quarter of the points in triangles gives an energy as low to a hundredth of its error. What
        a gap falls by between points depends on the displacement a little.
        """

        def displacement(x: Array) -> Array:
            u = np.zeros(self._bare.load.size)
            u[last] = x
            return self.field.values(u)

        pressing = np.append(state.normal_force > 0, False)  # the last is that of given ones
        near = [
            cells.only(np.any(pressing[cells.rows], axis=0) | (cells.missing(displacement(state.u)) > 0))
            for cells in self.cells
        ]
        N = sp.vstack([self._rows(cells, cells.normals) for cells in near], "csr")[:, last]
        acts = np.diff(N.indptr) > 0
        rubbing = [cells for cells in self.cells if cells.contact.obstacle.friction_law.has_given]
        tangents = (np.stack([cells.normals[1], -cells.normals[0]]) for cells in rubbing)
        T = sp.vstack([self._bare.normals[:0], *map(self._rows, rubbing, tangents)], "csr")[:, last]
        bound = np.zeros(0)
        for each in rubbing:
            own = on_points(each.contact.obstacle.friction_law.given, each.points, "the friction bound")
            bound = np.append(bound, own * each.measures(self.problem))
        rubs = (np.diff(T.indptr) > 0) & (bound > 0)

        at_rest = np.concatenate([each.at_points(self.given).ravel() for each in near])

        def offset(x: Array) -> Array:
            u = displacement(x)
            return (at_rest - np.concatenate([each.dips(u).ravel() for each in near]))[acts]

        rows = N[acts], T[rubs], bound[rubs]
        return BarrierProgram(program.stiffness, program.load, *rows, offset).minimised(state.u)

    def _rows(self, cells: Cells, vectors: Array) -> sp.csr_array:
        """(m k, unknowns) what takes unknowns to components along ``vectors`` (components, m, k)."""
        contact, number = cells.contact, np.arange(cells.distance.size).reshape(cells.distance.shape)
        values = np.einsum("f,cmk,vk->cfvmk", contact.factors, vectors, cells.shares)
        column = self.field.index[:, contact.carriers(cells.nodes)][..., None]
        row, column = (np.broadcast_to(each, values.shape) for each in (number, column))
        used = (column >= 0) & (values != 0)
        shape = number.size, self._bare.load.size
        return summed(values[used], row[used], column[used], shape)

    def _turns(self, state: Equilibrium) -> bool:
        """Whether a slip may change its sign within an edge, where friction is less than at nodes."""
        for part, edges in self._rubbing:
            sliding = np.full(self.space.n_nodes, np.nan)  # that of nodes whose displacement is given
            sliding[part.nodes] = state.active.sliding[part.rows]
            if np.any(np.abs(np.diff(sliding[edges.ends], axis=0)) > 0):
                return True
        return False

    def _made(self, system: ContactSystem, state: Equilibrium) -> Admissible:
        """The displacement, its nodes raised by what it lacks to be admissible, and its energy."""
        u = state.u
        rounding = 8 * np.finfo(float).eps * (magnitude(u) + magnitude(self._bare.offset))
        for _ in range(REPEATS):
            displacement = self.field.values(u)
            missing = self._missing(displacement)
            penetration = float(np.max(missing, initial=0.0))
            if penetration <= rounding:
                penetration = 0.0
                break
            step = np.where(missing > 0, 1.1 * missing + rounding, 0.0)
            u = u + self._raising @ step
        state, full = replace(state, u=u, energy=system.energy(u)), displacement.T.ravel()
        strain, work = 0.5 * float(full @ (self.stiffness @ full)), float(self.load @ full)
        friction, doubt = self.friction(displacement)
        rounding = np.finfo(float).eps * (abs(self.stiffness) @ np.abs(full) + np.abs(self.load))
        rounding += self._stiffness_doubt @ np.abs(full) / 2
        doubt += float((self._load_doubt + rounding) @ np.abs(full))
        energy = strain - work + friction
        return Admissible(self, system, state, displacement, energy, strain, friction, doubt, penetration)

    @cached_property
    def _raising(self) -> sp.csr_array:
        """(unknowns, gaps) what raises gaps by one each, without tools where anything else does."""
        normals, of_tools = self._bare.normals, self.field.index[:, self.space.n_nodes :]
        own = normals * ~np.isin(np.arange(normals.shape[1]), of_tools)
        own += normals * (own.power(2).sum(axis=1) == 0)[:, None]
        return sp.csr_array(own.T / own.power(2).sum(axis=1))

    def friction(self, displacement: Array) -> tuple[float, float]:
        """The integral of friction bound times slip of a displacement (components, nodes), and its doubt."""
        slip = displacement if self.problem.origin is None else displacement - self.problem.origin
        total = np.zeros(2)
        for part, edges in self._rubbing:
            slips = part.relative(slip)[:, self.space.nodes_of(edges.ends)]
            total += np.sum(friction_energy(edges, part.obstacle, slips), axis=1)
        return float(total[0]), float(total[1])

    def first_standoff(self) -> Array:
        """(gaps,) how far nodes keep off by what is missing where their gaps are closed."""
        return self._missing(self.field.values(-self._raising @ self._bare.offset))

    def _missing(self, displacement: Array) -> Array:
        """(gaps,) by how much each free node must keep off more for a displacement (components, nodes)."""
        standoff = np.zeros(self.space.contact_nodes.size + 1)  # the last is that of given ones
        for cells in self.cells:
            # ufunc.at gives wrong maxima for values that it has to broadcast
            np.maximum.at(standoff, cells.rows, np.tile(cells.missing(displacement), (len(cells.rows), 1)))
        return standoff[:-1]


def admissible(
    problem: ContactProblem | Discretisation, nodes: Array | None = None, start: ActiveSet | None = None
) -> Admissible:
    """The energy of the continuous problem on a mesh, by an admissible displacement.

    ``nodes`` (2, vertices) are the positions of the vertices, by default those of the mesh; ``start`` is the
    contact to begin with.
    """
    for _ in range(REPEATS):
        continuous = Continuous(problem, nodes)
        inside = [cells for cells in continuous.cells if cells.are_triangles]
        elements = numbers_of(cells.number[cells.unreachable(continuous.given)] for cells in inside)
        if elements.size == 0:
            break
        moved = continuous.problem
        if nodes is not None:
            moved = replace(moved, mesh=relocated_mesh(moved.mesh, nodes))
        problem, nodes, start = locally_refined(moved, elements), None, None
    return continuous.solve(start)


def _in_contact(program: ContactSystem, x: Array) -> Equilibrium:
    """Unknowns with the forces at nodes that hold them.

    A node touches where its force is positive, and slides where friction has its bound, up to rounding.
    """
    rotated, bound = program.rotated, program.slip_bound
    residual = rotated.basis.T @ (program.stiffness @ x - program.load)
    normal = np.maximum(residual[rotated.normal], 0.0)
    along = np.where(rotated.slips, residual[rotated.tangent], 0.0)
    sliding = np.where(np.abs(along) < bound * (1 - 1e-6), 0, -np.sign(along)).astype(np.int8)
    active = ActiveSet(normal > ROUNDING * max(program.force_scale, magnitude(normal)), sliding)
    return Equilibrium(x, np.nan, normal, along, active, Status.CONVERGED, 1)
