"""Least squares of the displacement to measured values, an outer objective for identification.

    sum_k w_k |u(x_k) - m_k|^2

over the components that are measured. A point x_k is one in space: where nodes move its barycentric
coordinates change, and the sum has derivatives as long as it stays in its triangle. So it must stay there for
all positions within the move limits, which is tested on the corners of these, since the area of a triangle is
affine in each coordinate by itself.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.errors import BadInputError, located
from rmesh_nlp.evaluation import Array, Index, is_finite
from rmesh_nlp.fem.cells import Straight, affine, shape_functions
from rmesh_nlp.fem.element import NO_ROWS
from rmesh_nlp.fem.fields import ElementGroup, Fields, constant_field
from rmesh_nlp.fem.objective import Objective, Term
from rmesh_nlp.fem.reach import corners, least_areas
from rmesh_nlp.meshes.geometry import SEVEN_DIGITS, signed_areas

DISPLACEMENTS = {1: ("u",), 2: ("ux", "uy")}


@dataclass(frozen=True)
class Measurements:
    """Points (2, n), values (components, n), not a number where not measured, and weights (n,)."""

    points: Array
    values: Array
    weights: Array

    def __post_init__(self) -> None:
        n = self.points.shape[-1]
        if self.points.shape != (2, n) or self.values.shape[1:] != (n,) or self.weights.shape != (n,):
            shapes = f"{self.points.shape}, {self.values.shape} and {self.weights.shape}"
            raise BadInputError(
                f"expected points (2, n), values (components, n) and weights (n,), got {shapes}"
            )
        if not is_finite(self.points) or np.any(np.isinf(self.values)):
            raise BadInputError("points and measured values must be finite")
        if not np.all((self.weights > 0) & np.isfinite(self.weights)):
            raise BadInputError("weights must be positive and finite")
        if np.all(np.isnan(self.values)):
            raise BadInputError("nothing is measured")


def fit(
    points: ArrayLike, values: ArrayLike, weights: ArrayLike | None = None, *, name: str = "fit"
) -> Objective:
    """Weighted least squares of the displacement to measured values at points in space.

    Parameters
    ----------
    points : (2, n) array
        In the body of the mesh as given. If nodes near a point may carry it into another triangle the
        problem is refused.
    values : (components, n) array
        Measured displacements, NaN where a component is not measured.
    weights : (n,) array, optional
        Of the squares; 1 by default.
    name : str
        What tables and messages call it.
    """
    places, displacements = np.asarray(points, dtype=float), np.atleast_2d(np.asarray(values, dtype=float))
    sizes = np.ones(places.shape[-1]) if weights is None else np.asarray(weights, dtype=float)
    measured = Measurements(places, displacements, sizes)
    return _objective(lambda: measured, name)


def fit_file(path: str | Path, *, name: str | None = None) -> Objective:
    """The same of a CSV file with a header and the columns x, y, and u or ux and uy; weight is optional.

    Empty cells are not measured. The file is read when the objective meets a problem.
    """
    return _objective(cache(lambda: read_measurements(Path(path))), name or f"fit({path})")


def read_measurements(path: Path) -> Measurements:
    """Read a file of measurements; a ValueError names the line and the cell that is wrong."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            lines = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BadInputError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    with located(path):
        names = [cell.strip() for cell in lines[0][1]] if lines else []
        own = ("u",) if "u" in names else ("ux", "uy")
        if set(names) - {"weight"} != {"x", "y", *own} or len(set(names)) < len(names):
            raise ValueError(f"expected the columns x, y, u or ux, uy, and perhaps weight, got {names}")
        table = {name: np.full(len(lines) - 1, np.nan) for name in names}
        for k, (line, row) in enumerate(lines[1:]):
            if len(row) != len(names):
                raise ValueError(f"line {line} has {len(row)} cells, expected {len(names)}")
            for name, cell in zip(names, row, strict=True):
                try:
                    table[name][k] = float(cell) if cell.strip() or name not in own else np.nan
                except ValueError:
                    raise ValueError(f"line {line}: {name} = {cell.strip()!r} is not a number") from None
        weights = table.get("weight", np.ones(len(lines) - 1))
        values = np.stack([table[name] for name in own])
        return Measurements(np.stack([table["x"], table["y"]]), values, weights)


def _objective(measured: Callable[[], Measurements], name: str) -> Objective:
    def quantity(on: Fields) -> list[ElementGroup]:
        measurements, components = measured(), on.problem.components
        if len(measurements.values) != components:
            wanted = " and ".join(DISPLACEMENTS[components])
            raise BadInputError(f"{name}: the displacement of {on.problem.name!r} is {wanted}")
        triangles = _located(on, measurements.points, name)
        is_measured = ~np.isnan(measurements.values)
        data = np.vstack(
            [
                measurements.points,
                np.where(is_measured, measurements.values, 0.0),
                is_measured * measurements.weights,
            ]
        )
        local = on.positions.at(triangles), on.displacement.at(on.space.nodes_of(triangles))
        function = _misfit(components, on.space.order)
        return [on.group(function, [*local, constant_field(data)])]

    return Term(name, quantity, minimised_only=True).alone


def _misfit(components: int, order: int) -> ca.Function:
    """``(X_e, u_e, (x, y, values, weights)) ->`` the weighted square at one point."""
    cell = Straight(3, components, order)
    point, value, weight = ca.SX.sym("x", 2), ca.SX.sym("m", components), ca.SX.sym("w", components)
    # the coordinates 1 and 2 are those of the linear functions with the values (0, 1, 0) and (0, 0, 1)
    det, slopes = affine(cell.X, ca.DM([[0, 1, 0], [0, 0, 1]]))
    second = slopes @ (point - cell.X[:, 0]) / det
    error = cell.u @ shape_functions(order, ca.vertcat(1 - ca.sum1(second), second)) - value
    columns = [*cell.columns, ca.vertcat(point, value, weight)]
    return ca.Function("misfit", columns, [ca.dot(weight, error**2), NO_ROWS])


def _located(on: Fields, points: Array, name: str) -> Index:
    """(3, points) vertices of the triangles that the points are in, whatever the outer variables are."""
    positions, triangles, design = on.positions, on.problem.triangles, on.positions.design
    unknowns = [positions.index, *([] if design is None else [design.values.index])]
    nodes = positions.values(np.zeros(1 + max(int(index.max(initial=0)) for index in unknowns)))
    limits, vertices = corners(on.problem, positions, nodes), []
    least = -SEVEN_DIGITS * signed_areas(nodes, triangles)
    for x in points.T:
        in_place = _least_parts(np.broadcast_to(nodes[:, None], limits.shape), triangles, x) >= least
        inside = triangles[:, in_place]
        at = f"{name}: the point ({x[0]:.6g}, {x[1]:.6g})"
        if inside.size == 0:
            raise BadInputError(f"{at} lies outside of the mesh")
        kept = inside[:, _least_parts(limits, inside, x) >= least[in_place]]
        if kept.size == 0:
            raise BadInputError(
                f"{at} may pass into another triangle: pin the nodes beside it, or lower their move limits"
            )
        vertices.append(kept[:, 0])
    return np.array(vertices).T


def _least_parts(limits: Array, triangles: Index, x: Array) -> Array:
    """(triangles,) the least area of the three parts into which a point cuts a triangle, within limits."""
    own, (a, b, c) = np.full(triangles.shape[1], limits.shape[2]), triangles
    limits = np.concatenate([limits, np.broadcast_to(x[:, None, None], (2, 4, 1))], axis=2)
    parts = (least_areas(limits, np.stack(part)) for part in ((own, b, c), (a, own, c), (a, b, own)))
    return np.min(list(parts), axis=0)
