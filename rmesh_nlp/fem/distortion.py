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
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.closed_forms import PAIRS, Layout, Triangles
from rmesh_nlp.fem.element import NO_ROWS, affine, corners
from rmesh_nlp.fem.fields import ElementGroup, Field, constant_field, element_group
from rmesh_nlp.fem.space import Index
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.vectorised import Columns, columnwise

Density = Callable[[Any, Any], Any]


def _shape(s: Any, det: Any) -> Any:
    return s / (2 * det) - 1


def _shape_and_size(s: Any, det: Any) -> Any:
    return _shape(s, det) + (det + 1 / det - 2) / 2


def _elastic(s: Any, det: Any) -> Any:
    return s * (1 + 1 / det**2) / 4 - 1


DISTORTIONS: dict[str, Density] = {"quality": _shape, "shape-size": _shape_and_size, "elastic": _elastic}
"""Densities by the name that they have in objectives, as functions of ``|A|^2`` and ``det A``.

They are linear in the first one.
"""


@lru_cache(maxsize=16)
def differentiated_density(density: Density) -> ca.Function:
    """``(s, det) -> h`` and its derivatives by s, det, s and det, det twice."""
    s, det = ca.SX.sym("s"), ca.SX.sym("det")
    h = density(s, det)
    first = ca.gradient(h, ca.vertcat(s, det))
    results = [h, first[0], first[1], ca.jacobian(first[0], det), ca.jacobian(first[1], det)]
    return ca.Function("density", [s, det], ca.cse([ca.densify(part) for part in results]))


class Distortion:
    """A density ``(s, det A) -> h`` that is linear in s, times ``weight`` (n,), on reference triangles.

    ``shapes`` (2, 3, n) are their corners.
    """

    arguments, nodes = 1, 3

    def __init__(self, density: ca.Function, shapes: Array, weight: Array) -> None:
        self._density, self._shapes, self._weight = density, shapes, weight
        reference = Triangles(shapes.transpose(1, 0, 2).reshape(6, -1), None, slice(0), 3)
        self._det, self._c = reference.det, reference.b / reference.det
        self._columns: dict[int, Columns] = {}

    def prepare(self, X: Array) -> None:
        """See :class:`ClosedForm`."""

    def value(self, at: Triangles) -> Array:
        """See :class:`ClosedForm`."""
        return self._weight[at.part] * self._at(at)[2][0]

    def first(self, at: Triangles, by_x: Array | None, by_u: Array | None) -> None:
        """See :class:`ClosedForm`."""
        _, by_s, (_, h_s, h_det, _, _) = self._at(at)
        weight = self._weight[at.part]
        at.by_det += weight / self._det[at.part] * h_det
        if by_x is not None:
            by_x += weight * h_s * by_s

    def second(self, at: Triangles, layout: Layout, out: Array) -> None:
        """See :class:`ClosedForm`."""
        c, by_s, (_, h_s, h_det, h_mixed, h_second) = self._at(at)
        weight, det = self._weight[at.part], self._det[at.part]
        at.by_det += weight / det * h_det
        at.beside += weight / det * (h_mixed * by_s + 0.5 * h_second / det * at.b)
        for a, b in PAIRS:
            along = 2 * weight * h_s * (c[a, 0] * c[b, 0] + c[a, 1] * c[b, 1])
            for i in range(2):
                out[layout.starts[2 * b + i] + 2 * a + i] += along

    def some(self, chosen: Index) -> Distortion:
        """See :class:`ClosedForm`."""
        return Distortion(self._density, self._shapes[..., chosen], self._weight[chosen])

    def scaled(self, weight: float) -> Distortion:
        """See :class:`ClosedForm`."""
        return Distortion(self._density, self._shapes, weight * self._weight)

    def _at(self, at: Triangles) -> tuple[Array, Array, list[Array]]:
        """Reference gradients, the derivative of s by the corners, and h with its derivatives."""
        c, det = self._c[..., at.part], at.det / self._det[at.part]
        A = sum(at.x[a][:, None] * c[a] for a in (1, 2)) + at.x[0][:, None] * c[0]
        by_s = np.stack([2 * (A[:, 0] * c[a, 0] + A[:, 1] * c[a, 1]) for a in range(3)])
        s = np.sum(A * A, axis=(0, 1))
        if at.n not in self._columns:
            self._columns[at.n] = columnwise(self._density, at.n)
        upright = np.where(det > 0, det, np.nan)
        found = self._columns[at.n]([s[None], upright[None]])
        return c, by_s, [part[0] for part in found]


def reference_shapes(problem: ContactProblem) -> Array:
    """(2, 3, elements) vertices of the triangles that the elements are compared with."""
    if problem.reference is None:
        return np.asarray(problem.mesh.p[:, problem.triangles])
    if problem.reference.shape != (2, 3, problem.mesh.t.shape[1]):
        raise ValueError(
            f"the reference has the shape {problem.reference.shape}, and the mesh "
            f"{problem.mesh.t.shape[1]} elements"
        )
    return problem.reference


def distortion_group(problem: ContactProblem, positions: Field, name: str) -> ElementGroup:
    """Mean over the initial area of a density in :data:`DISTORTIONS`; NaN where an element is inverted."""
    shapes = reference_shapes(problem)
    (X, X0), total = corners(3, 2), ca.SX.sym("total")
    det0, scaled = affine(X0, X)
    A = scaled / det0  # the gradient of the map
    det = A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
    value = ca.if_else(det > 0, DISTORTIONS[name](ca.sumsqr(A), det), float("nan")) * det0 / (2 * total)
    a, b = shapes[:, 1] - shapes[:, 0], shapes[:, 2] - shapes[:, 0]
    det_e = a[0] * b[1] - a[1] * b[0]
    area = float(np.sum(det_e) / 2)
    local = (
        positions.at(problem.triangles),
        constant_field(shapes.transpose(1, 0, 2).reshape(6, -1)),
        constant_field(np.broadcast_to(area, (1, problem.triangles.shape[1]))),
    )
    function = ca.Function("distortion", [ca.vec(X), ca.vec(X0), total], [value, NO_ROWS])
    closed = Distortion(differentiated_density(DISTORTIONS[name]), shapes, det_e / (2 * area))
    return element_group(function, positions, local, closed=closed)
