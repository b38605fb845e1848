"""The fields of a solution before and after relocation, as VTU files have them and figures are made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import meshio
import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.errors import BadInputError, one_line
from rmesh_nlp.evaluation import Array, Index, is_finite
from rmesh_nlp.fem.contact_pressure import contact_stresses
from rmesh_nlp.fem.space import DisplacementSpace, contact_edges
from rmesh_nlp.fem.stress import size_of_stress
from rmesh_nlp.mapping import MeshMap
from rmesh_nlp.models.residual import OuterMultipliers
from rmesh_nlp.problem import ContactProblem, Place
from rmesh_nlp.solving.solution import Solution
from rmesh_nlp.solving.state import State

CELLS = {3: "triangle", 6: "triangle6"}  # what VTU files call elements, by their number of nodes
SCALARS = ("pressure", "tangential_stress", "friction_bound", "gap")  # at nodes, of either mesh
GIVEN, FINAL = "initial_", ""  # heads of the names of fields on either mesh
FOUNDATION = "foundation "  # of the fields of each contact boundary, before its name


@dataclass(frozen=True)
class MeshState:
    """A mesh with its equilibrium, as values at the points of the nodes of the displacement.

    Of quadratic displacements these are the vertices and the middles of edges.
    """

    nodes: Array  # (2, nodes) positions
    displacement: Array  # (components, nodes)
    pressure: Array  # (nodes,) stress, on both sides of a pair; zero off contact nodes, as are the next two
    tangential_stress: Array
    friction_bound: Array
    gap: Array  # (nodes,) along the contact normal after the displacement; NaN off the contact nodes
    feet: Mapping[str, Array]  # (2, nodes) by contact boundary: what it would meet; NaN off it
    stress: Array  # (elements, pieces) von Mises stress, or length of the flux, as it is drawn


def state_of(
    problem: ContactProblem, X: Array, u: Array, pressure: Array, tangential_stress: Array
) -> MeshState:
    """The state of a problem with its vertices at X (2, vertices), from values at the nodes."""
    space = DisplacementSpace(problem)
    nodes = space.points_on_body(X)
    pressure, tangential = np.array(pressure), np.array(tangential_stress)
    bound, gap, feet = np.zeros(space.n_nodes), np.full(space.n_nodes, np.nan), dict[str, Array]()
    for part in space.contact_sets:
        which, obstacle = part.nodes, part.obstacle
        points = nodes[:, which]
        along = np.sum(obstacle.normals(points) * part.relative(u)[:, which], axis=0)
        # of two foundations that a node may meet the nearer one
        gap[which] = np.fmin(gap[which], along + obstacle.distances(points))
        if obstacle.boundary is Place.INTERIOR:
            continue
        name, own = obstacle.place, np.unique(space.nodes_of(contact_edges(problem, obstacle)))
        bound[own] = obstacle.friction_law.bound(nodes[:, own], pressure[own])  # at the ends of cracks too
        if obstacle.other and part.partner is not None:
            for values in (pressure, tangential, bound, gap):
                values[part.partner[which]] = values[which]
        while name in feet:  # another foundation of the same boundary
            name += "'"
        feet[name] = np.full_like(nodes, np.nan)
        feet[name][:, own] = obstacle.feet(nodes[:, own]) if problem.components == 2 else nodes[:, own]
    return MeshState(nodes, u, pressure, tangential, bound, gap, feet, size_of_stress(problem, X, u))


@dataclass(frozen=True)
class SolutionFields:
    """What a VTU file holds: the states before and after relocation, and what limits the motion."""

    triangles: Index  # (nodes per element, elements), the vertices first
    given: MeshState  # of a design the first one
    final: MeshState
    mobility: NDArray[np.int32]  # (nodes,) of vertices, -1 at middles of edges
    error_bound: Array | None = None  # (elements,) parts of the bound of half the squared error, if certified
    error_bound_initial: Array | None = None
    multipliers: OuterMultipliers | None = None  # those of move limits are at the nodes

    @property
    def _states(self) -> tuple[tuple[str, MeshState], ...]:
        return (GIVEN, self.given), (FINAL, self.final)

    def point_data(self) -> dict[str, NDArray]:
        """The fields of the nodes as files have them, by name."""
        data: dict[str, NDArray] = {}
        for head, state in self._states:
            u = state.displacement
            data[f"{head}displacement"] = u[0] if u.shape[0] == 1 else np.ascontiguousarray(u.T)
            data |= {head + name: getattr(state, name) for name in SCALARS}
        data["initial_position"] = three(self.given.nodes)
        data["motion"] = three(self.final.nodes - self.given.nodes)
        data["contact"] = np.isfinite(self.final.gap).astype(np.int32)
        data["mobility"] = self.mobility
        if self.multipliers is not None:
            data["limit_multiplier"] = self.multipliers.limit
        return data

    def foundations(self) -> dict[str, NDArray]:
        """Further ones of VTU files, whose names may be any."""
        return {
            f"{head}{FOUNDATION}{name}": three(feet)
            for head, state in self._states
            for name, feet in state.feet.items()
        }

    def drawn_stresses(self) -> dict[str, NDArray]:
        """Those of the elements, likewise."""
        return {f"{head}drawn_stress": state.stress for head, state in self._states}


def three(points: Array) -> Array:
    """(nodes, 3) coordinates, as VTU files want them, of (2, nodes) ones."""
    return np.ascontiguousarray(np.vstack([points, np.zeros(points.shape[1])]).T)


def file_mesh(
    points: Array,
    elements: Index,
    point_data: Mapping[str, Array],
    cell_data: Mapping[str, Array] | None = None,
) -> meshio.Mesh:
    """What meshio writes: nodes (2, nodes), elements (nodes per element, elements) and their fields."""
    cells = [(CELLS[len(elements)], elements.T)]
    of_cells = {name: [values] for name, values in (cell_data or {}).items()}
    return meshio.Mesh(three(points), cells, point_data=dict(point_data), cell_data=of_cells)


def fields_of(solution: Solution) -> SolutionFields:
    """The fields of a solution."""
    problem, final, multipliers = solution.problem, solution.final, solution.multipliers
    space, X = DisplacementSpace(problem), problem.mesh.p
    vertices = slice(space.n_vertices)
    mobility = np.full(space.n_nodes, -1, np.int32)
    mobility[vertices] = MeshMap.of(problem).mobility
    if multipliers is not None:
        limit = np.zeros(space.n_nodes)
        limit[vertices] = multipliers.limit
        multipliers = replace(multipliers, limit=limit)
    given = solution.given
    if solution.assessment.is_same_mesh:
        before = _of_state(given)
    else:  # another mesh was made for the solution
        solver = ContactSolver(problem)
        solved = solver.solve(X)
        stresses = contact_stresses(space, X, solved.normal_force, solved.tangential_force)
        u = solver.displacement.values(solved.u)
        before = state_of(problem.placed(space.tools(u)), X, space.values(u), *stresses)
    return SolutionFields(space.elements, before, _of_state(final), mobility, multipliers=multipliers)


def _of_state(state: State) -> MeshState:
    stresses = state.pressure, state.tangential_stress
    return state_of(state.placed, state.mesh.p, state.displacement, *stresses)


def read_vtu(path: Path) -> SolutionFields:
    """Read what :func:`rmesh_nlp.io.export.write_solution` wrote.

    Raises
    ------
    BadInputError
        If the file is missing or damaged, or is not of a solution.
    """
    try:
        mesh = meshio.vtu.read(str(path))  # meshio.read ends the process where it cannot read
        data, of_cells = mesh.point_data, {name: blocks[0] for name, blocks in mesh.cell_data.items()}
        multipliers = None
        if "limit_multiplier" in data and {"area_multiplier", "angle_multiplier"} <= of_cells.keys():
            of_elements = of_cells["area_multiplier"], of_cells["angle_multiplier"]
            multipliers = OuterMultipliers(data["limit_multiplier"], *of_elements)

        def state(head: str, points: Array) -> MeshState:
            begin, stress = head + FOUNDATION, of_cells[f"{head}drawn_stress"]
            feet = {
                name.removeprefix(begin): values[:, :2].T
                for name, values in data.items()
                if name.startswith(begin)
            }
            return MeshState(
                nodes=points[:, :2].T,
                displacement=np.atleast_2d(data[f"{head}displacement"].T),
                feet=feet,
                stress=stress.reshape(len(stress), -1),
                **{name: data[head + name] for name in SCALARS},
            )

        fields = SolutionFields(
            triangles=next(block.data.T for block in mesh.cells if block.type in CELLS.values()),
            given=state(GIVEN, data["initial_position"]),
            final=state(FINAL, mesh.points),
            mobility=data["mobility"],
            error_bound=of_cells.get("error_bound"),
            error_bound_initial=of_cells.get("error_bound_initial"),
            multipliers=multipliers,
        )
        _check(fields)
    except Exception as error:  # meshio lets through whatever its parsers meet
        reason = f"{type(error).__name__}: {one_line(error)}".removesuffix(": ")
        raise BadInputError(f"cannot read the fields of a solution from {path}: {reason}") from error
    return fields


def _check(fields: SolutionFields) -> None:
    """Refuse what would only be noticed when it is drawn."""
    count = fields.final.nodes.shape[1]
    for state in (fields.given, fields.final):
        for name in ("nodes", "displacement", "pressure"):
            values = getattr(state, name)
            if values.shape[-1] != count or not is_finite(values):
                raise ValueError(f"{name} has not a finite value at each of {count} nodes")
    if fields.triangles.size == 0 or fields.triangles.min() < 0 or fields.triangles.max() >= count:
        raise ValueError("a triangle has a node that is not there")
