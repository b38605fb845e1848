"""The table ``[curves]`` of a problem file: what each boundary is a part of."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from skfem import MeshTri

from rmesh_nlp.expressions import value_of
from rmesh_nlp.io.problem_schema import CurveTable
from rmesh_nlp.meshes.curves import Circle, Curve, Parametrised, Spline, fitted_circle, spline_through
from rmesh_nlp.problem.on_curves import nodes_of


class OfParameter:
    """An expression of t, as a function that takes symbols and numbers."""

    def __init__(self, text: str) -> None:
        self.text = text
        t = ca.SX.sym("t")
        self._function = ca.Function("expression", [t], [value_of(text, {"t": t})])

    def __call__(self, t: Any) -> Any:
        """Its value."""
        return self._function(t)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, OfParameter) and other.text == self.text

    def __hash__(self) -> int:
        return hash(self.text)


def curve_of(table: CurveTable | str, mesh: MeshTri, name: str) -> Curve:
    """The curve that the file gives the boundary ``name``.

    Raises
    ------
    ValueError
        If it cannot be made, or not fitted to the nodes.
    """
    if table == "circle":
        return fitted_circle(np.asarray(mesh.p[:, nodes_of(mesh, name)]))
    if table == "spline":
        return spline_through(np.asarray(mesh.p), mesh.facets[:, np.asarray(mesh.boundaries[name])])
    assert not isinstance(table, str)
    if table.circle is not None:
        x, y, radius = table.circle
        return Circle((x, y), radius)
    if table.spline is not None:
        return Spline(tuple(table.spline), table.closed)
    return Parametrised(
        OfParameter(str(table.x)), OfParameter(str(table.y)), table.t or (0.0, 1.0), table.closed
    )
