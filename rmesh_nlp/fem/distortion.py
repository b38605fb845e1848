"""How far a relocated mesh is from the initial one, element by element: the regularisations of relocation.

With A the affine map from an initial element (or a reference that the problem gives) to the relocated one,
each density is zero where A is a rotation, infinite as the element degenerates, and not defined for
``det A <= 0``: it is its own barrier, and a solver refuses a step there. The regularisation is the mean of
the density over the initial area, so that a map of the domain has the same value on every mesh up to
discretisation.

``quality``
    ``|A|^2 / (2 det A) - 1``, shape alone: the inverse mean ratio (P. M. Knupp, Algebraic mesh quality
    metrics, SIAM J. Sci. Comput. 23 (2001) 193-218). Rotated and scaled copies cost nothing.
``shape-size``
    The same and ``1/2 (det A + 1 / det A - 2)``: size too, elements grow and shrink alike.
``elastic``
    ``1/4 (|A|^2 + |A^-1|^2) - 1``: the symmetric Dirichlet energy of the map, a rubber sheet that resists
    compression as it resists stretching (J. Schreiner et al., Inter-surface mapping, ACM Trans. Graph. 23
    (2004)).
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Array, Expression, cross
from rmesh_nlp.fem.cells import affine
from rmesh_nlp.fem.element import NO_ROWS
from rmesh_nlp.fem.fields import ElementGroup, Fields, constant_field
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.body import determinants

Density = Callable[[Expression, Expression], Expression]


DISTORTIONS: dict[str, Density] = {
    "quality": lambda s, det: s / (2 * det) - 1,
    "shape-size": lambda s, det: s / (2 * det) - 1 + (det + 1 / det - 2) / 2,
    "elastic": lambda s, det: s * (1 + 1 / det**2) / 4 - 1,
}
"""Densities by the name that they have in objectives, as functions of ``|A|^2`` and ``det A``.

They are linear in the first one.
"""


def reference_shapes(problem: ContactProblem) -> Array:
    """(2, 3, elements) vertices of the triangles that the elements are compared with."""
    if problem.reference is None:
        return problem.mesh.p[:, problem.triangles]
    if problem.reference.shape != (2, 3, problem.mesh.nelements):
        raise BadInputError(
            f"the reference has the shape {problem.reference.shape}, and the mesh "
            f"{problem.mesh.nelements} elements"
        )
    return problem.reference


def distortion(name: str, on: Fields) -> list[ElementGroup]:
    """Mean over the initial area of a density in :data:`DISTORTIONS`; NaN where an element is inverted."""
    shapes, triangles = reference_shapes(on.problem), on.problem.triangles
    X, X0, total = ca.SX.sym("X", 2, 3), ca.SX.sym("X0", 2, 3), ca.SX.sym("total")
    det0, scaled = affine(X0, X)
    A = scaled / det0  # the gradient of the map
    det = cross(A[:, 0], A[:, 1])
    value = ca.if_else(det > 0, DISTORTIONS[name](ca.sumsqr(A), det), float("nan")) * det0 / (2 * total)
    area = float(np.sum(determinants(shapes)) / 2)
    local = (
        on.positions.at(triangles),
        constant_field(shapes.transpose(1, 0, 2).reshape(6, -1)),
        constant_field(np.full((1, triangles.shape[1]), area)),
    )
    function = ca.Function("distortion", [ca.vec(X), ca.vec(X0), total], [value, NO_ROWS])
    return [on.group(function, local)]
