"""The fields of a solution that figures are made from, and reading them back from VTU files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.errors import BadInputError, one_line
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.sampling import edges_of, points_of
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.models.residual import Multipliers
from rmesh_nlp.problem.coefficients import on_points
from rmesh_nlp.solving.solution import Solution

CELLS = {3: "triangle", 6: "triangle6"}  # what VTU files call elements, by their number of nodes


@dataclass(frozen=True)
class Fields:
    """What a VTU file holds, at the nodes of the displacement and on the elements.

    Fields of nodes are values at their points. Of quadratic displacements these are the vertices and the
    middles of edges; a triangle has the former first.
    """

    nodes: Array  # (2, nodes) positions after the relocation
    initial: Array  # (2, nodes) positions before
    triangles: NDArray[np.int64]  # (nodes per element, elements), the vertices first
    displacement: Array  # (components, nodes)
    pressure: Array  # (nodes,) in N/m^2, zero off the contact nodes, as are the next two
    tangential_stress: Array
    friction_bound: Array
    contact: NDArray[np.bool_]  # (nodes,) whether a node may come in contact
    foundation: Array  # (2, nodes) point that a contact node would meet; elsewhere, and if scalar, the node
    error_bound: Array | None = None  # (elements,) parts of the bound of half the squared error, if certified
    error_bound_initial: Array | None = None
    multipliers: Multipliers | None = None  # as read from a file; those of move limits are at the nodes

    @property
    def n_vertices(self) -> int:
        """Number of nodes that are vertices of the mesh, or belong to no element."""
        return int(self.nodes.shape[1] - np.unique(self.triangles[3:]).size)

    @property
    def boundary(self) -> NDArray[np.int64]:
        """(2 or 3, edges) nodes of the edges on the boundary: the ends, then the middle."""
        return edges_of(self.triangles, outer=True)

    def point_data(self) -> dict[str, NDArray]:
        """The fields of the nodes as VTU files have them, by name."""
        u = self.displacement
        return {
            "displacement": u[0] if u.shape[0] == 1 else np.ascontiguousarray(u.T),
            "initial_position": three(self.initial),
            "pressure": self.pressure,
            "tangential_stress": self.tangential_stress,
            "friction_bound": self.friction_bound,
            "contact": self.contact.astype(np.int32),
            "foundation": three(self.foundation),
        }


def three(points: Array) -> Array:
    """(nodes, 3) coordinates, as VTU files want them, of (2, nodes) ones."""
    return np.ascontiguousarray(np.vstack([points, np.zeros(points.shape[1])]).T)


def file_mesh(
    points: Array,
    elements: NDArray[np.int64],
    point_data: Mapping[str, Array],
    cell_data: Mapping[str, Array] | None = None,
) -> meshio.Mesh:
    """What meshio writes: nodes (2, nodes), elements (nodes per element, elements) and their fields."""
    cells = [(CELLS[len(elements)], elements.T)]
    of_cells = {name: [values] for name, values in (cell_data or {}).items()}
    return meshio.Mesh(three(points), cells, point_data=dict(point_data), cell_data=of_cells)


def fields_of(solution: Solution) -> Fields:
    """The fields of a solution."""
    space = DisplacementSpace(solution.problem)
    nodes = points_of(space, np.asarray(solution.mesh.p))
    contact, bound, foundation = np.zeros(space.n_nodes, dtype=bool), np.zeros(space.n_nodes), nodes.copy()
    for part in space.contact_sets:
        points = nodes[:, part.nodes]
        contact[part.nodes] = True
        pressing = np.maximum(solution.pressure[part.nodes], 0.0)
        bound[part.nodes] = on_points(part.obstacle.friction, points)
        bound[part.nodes] += on_points(part.obstacle.coulomb, points) * pressing
        if solution.problem.components == 2:
            foundation[:, part.nodes] = part.obstacle.feet(points)
    return Fields(
        nodes=nodes,
        initial=points_of(space, solution.initial_nodes),
        triangles=space.elements,
        displacement=solution.displacement,
        pressure=solution.pressure,
        tangential_stress=solution.tangential_stress,
        friction_bound=bound,
        contact=contact,
        foundation=foundation,
    )


def read_vtu(path: Path) -> Fields:
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
        if "box_multiplier" in data and {"area_multiplier", "angle_multiplier"} <= of_cells.keys():
            of_elements = of_cells["area_multiplier"], of_cells["angle_multiplier"]
            multipliers = Multipliers(data["box_multiplier"], *of_elements)
        fields = Fields(
            nodes=mesh.points[:, :2].T,
            initial=data["initial_position"][:, :2].T,
            triangles=next(block.data.T for block in mesh.cells if block.type in CELLS.values()),
            displacement=np.atleast_2d(data["displacement"].T),
            pressure=data["pressure"],
            tangential_stress=data["tangential_stress"],
            friction_bound=data["friction_bound"],
            contact=data["contact"].astype(bool),
            foundation=data["foundation"][:, :2].T,
            error_bound=of_cells.get("error_bound"),
            error_bound_initial=of_cells.get("error_bound_initial"),
            multipliers=multipliers,
        )
        _check(fields)
    except Exception as error:  # meshio lets through whatever its parsers meet
        reason = f"{type(error).__name__}: {one_line(error)}".removesuffix(": ")
        raise BadInputError(f"cannot read the fields of a solution from {path}: {reason}") from error
    return fields


def _check(fields: Fields) -> None:
    """Refuse what would only be noticed when it is drawn."""
    count = fields.nodes.shape[1]
    for name in ("nodes", "initial", "displacement", "pressure", "foundation"):
        values = getattr(fields, name)
        if values.shape[-1] != count or not np.all(np.isfinite(values)):
            raise ValueError(f"{name} has not a finite value at each of {count} nodes")
    if fields.triangles.size == 0 or fields.triangles.min() < 0 or fields.triangles.max() >= count:
        raise ValueError("a triangle has a node that is not there")
