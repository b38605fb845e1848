"""Energies of triangles and their derivatives in closed form, over many triangles at a time.

With the corners x_m of a triangle, d = det its doubled area, b_m = d(det)/dx_m (d times the gradient of the
shape function of the corner) and P = sum_a u_a b_a^T (d times the gradient of the displacement), every
quadratic law has the strain energy

    E = |T|^2 / (4 d),      T = L P,

T being linear in the u_a and in the x_m. With r = T' - (T/d) d' its second derivative is

    E'' = r^T r / (2 d) + T . T'' / (2 d) - |T|^2 / (4 d^2) d'',

and the first derivative by x_m the configurational force area (W I - grad(u)^T S) grad(phi_m) up to its sign.
That of a quadratic displacement is the mean of those of three linear ones
(:func:`rmesh_nlp.fem.bernstein.corner_fields`).
Loads are in :mod:`rmesh_nlp.fem.load_moments`, distortions in :mod:`rmesh_nlp.fem.distortion`.

Local unknowns are the six positions, if they vary, then the displacements, node by node. Upper triangles of
second derivatives are stored column by column.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.bernstein import corner_fields, size
from rmesh_nlp.fem.space import Index
from rmesh_nlp.problem.laws import Laplace, Law

CHUNK = 2048
"""Triangles at a time, so that what is being worked on stays in the cache."""

AFTER, BEFORE = [1, 2, 0], [2, 0, 1]
"""The corners that follow and precede each corner."""

PAIRS = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
"""Pairs of corners, an upper triangle column by column."""

PAIR = np.array([[0, 1, 3], [1, 2, 4], [3, 4, 5]])
"""The number of each pair."""


@dataclass(frozen=True)
class Layout:
    """Which local unknowns there are.

    With ``corner`` there are second derivatives by displacements alone.
    """

    positions: bool
    displacements: int
    corner: bool = True

    @property
    def n_x(self) -> int:
        """Number of positions."""
        return 6 if self.positions else 0

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.n_x + self.displacements

    def rows(self, column: int) -> int:
        """How many rows a column of the second derivatives has."""
        return column + 1 if column < self.n_x or self.corner else self.n_x

    @cached_property
    def starts(self) -> list[int]:
        """Where each column begins, and at last the number of second derivatives."""
        return np.cumsum([0, *(self.rows(k) for k in range(self.size))]).tolist()

    @property
    def entries(self) -> tuple[Index, Index]:
        """Row and column of each second derivative."""
        rows = [np.arange(self.rows(k)) for k in range(self.size)]
        column = np.repeat(np.arange(self.size), [row.size for row in rows])
        return np.concatenate([np.zeros(0, np.int64), *rows]), column


class Triangles:
    """Some triangles, and sums of what energies of them have in common.

    Attributes
    ----------
    x : (3, 2, n) array
        Corners.
    u : (nodes, components, n) array or None
    b, det : (3, 2, n) and (n,) arrays
        Doubled areas and their derivatives by the corners.
    by_det : (n,) array
        Derivative of the sum by ``det``, at fixed all else.
    beside : (3, 2, n) array
        w, of which the second derivative has the part ``b w^T + w b^T``.
    """

    def __init__(self, positions: Array, displacements: Array | None, part: slice, nodes: int) -> None:
        n = positions.shape[1]
        self.part, self.n = part, n
        self.x = positions.reshape(3, 2, n)
        self.u = None if displacements is None else displacements.reshape(nodes, -1, n)
        opposite = self.x[AFTER] - self.x[BEFORE]
        self.b = np.stack([opposite[:, 1], -opposite[:, 0]], axis=1)
        self.det = self.b[2, 1] * self.b[1, 0] - self.b[2, 0] * self.b[1, 1]
        self.by_det, self.beside = np.zeros(n), np.zeros((3, 2, n))


class ClosedForm(Protocol):
    """An energy of triangles, as a sum of which each method adds its part.

    It takes one argument, the positions of the corners, or two, the displacements of ``nodes`` as well.
    """

    arguments: int

    @property
    def nodes(self) -> int:
        """Displacement nodes of a triangle."""

    def value(self, at: Triangles) -> Array:
        """The energy (n,)."""

    def first(self, at: Triangles, by_x: Array | None, by_u: Array | None) -> None:
        """Add derivatives to ``by_x`` (3, 2, n) and ``by_u`` (nodes, components, n), and to ``at.by_det``."""

    def second(self, at: Triangles, layout: Layout, out: Array) -> None:
        """Add second derivatives to ``out``, ``at.beside`` and, as the first ones, ``at.by_det``."""

    def prepare(self, X: Array) -> None:
        """What first derivatives at positions (6, all triangles) need and displacements do not change."""

    def some(self, chosen: Index) -> ClosedForm:
        """That of some of the triangles."""

    def scaled(self, weight: float) -> ClosedForm:
        """The same times a weight."""


def evaluated(
    forms: Sequence[ClosedForm], which: str, layout: Layout, X: Array, u: Array | None, out: list[Array]
) -> None:
    """Results of the sum of some energies: ``values`` and ``gradient`` as (f, ...), or ``hessian``.

    ``out`` has an array (length, triangles) for each result.
    """
    n, nodes = X.shape[1], max(form.nodes for form in forms)
    with np.errstate(all="ignore"):  # an inverted triangle shows in the result
        if which != "hessian":
            for form in forms:
                form.prepare(X)
        for begin in range(0, n, CHUNK):
            part = slice(begin, min(begin + CHUNK, n))
            at = Triangles(X[:, part], None if u is None else u[:, part], part, nodes)
            if which == "hessian":
                _second(forms, at, layout, out[0][:, part])
                continue
            out[0][0, part] = sum(form.value(at) for form in forms)
            if which == "gradient":
                by_x, by_u = _split(out[1][:, part], layout, nodes)
                out[1][:, part] = 0.0
                _first(forms, at, by_x, by_u)


def energies(form: ClosedForm, X: Array, u: Array | None = None) -> Array:
    """The energy of each triangle."""
    found = [np.empty((1, X.shape[1]))]
    evaluated([form], "values", Layout(False, 0), X, u, found)
    return found[0][0]


def _split(out: Array, layout: Layout, nodes: int) -> tuple[Array | None, Array | None]:
    x, u = out[: layout.n_x], out[layout.n_x :]
    shaped = [p.reshape(k, -1, p.shape[1]) if p.size else None for p, k in ((x, 3), (u, nodes))]
    return shaped[0], shaped[1]


def _first(forms: Sequence[ClosedForm], at: Triangles, by_x: Array | None, by_u: Array | None) -> None:
    for form in forms:
        form.first(at, by_x, by_u)
    if by_x is not None:
        by_x += at.by_det * at.b


def _second(forms: Sequence[ClosedForm], at: Triangles, layout: Layout, out: Array) -> None:
    out[:] = 0.0
    for form in forms:
        form.second(at, layout, out)
    if layout.positions:
        b, w = at.b.reshape(6, -1), at.beside.reshape(6, -1)
        for k in range(6):
            rows, start = slice(0, k + 1), layout.starts[k]
            out[start : start + k + 1] += b[rows] * w[k] + w[rows] * b[k]
        for m, n in enumerate(AFTER):  # the second derivative of det
            for i, j, sign in ((2 * m, 2 * n + 1, 1), (2 * m + 1, 2 * n, -1)):
                low, high = min(i, j), max(i, j)
                out[layout.starts[high] + low] += sign * at.by_det


def _law_rows(law: Law) -> Array:
    """L (rows, components, 2) of the energy per area ``|L grad u|^2 / 2`` of a law."""
    if isinstance(law, Laplace):
        return np.sqrt(law.conductivity) * np.eye(2)[:, None, :]
    bulk, shear = np.sqrt(law.in_plane_lambda + law.lame_mu), np.sqrt(law.lame_mu)
    return np.array(
        [[[bulk, 0], [0, bulk]], [[shear, 0], [0, -shear]], [[0, shear], [shear, 0]]], dtype=float
    )


class Strain:
    """Strain energy of a quadratic law by displacements of an order, times a weight."""

    arguments = 2

    def __init__(self, law: Law, order: int = 1, weight: float = 1.0) -> None:
        self._law, self._order, self._weight = law, order, weight
        self._L = _law_rows(law)
        self._terms = [(row, i, j, self._L[row, i, j]) for row, i, j in np.argwhere(self._L)]
        # in each linear displacement: nodes and corners, the node's value counting there
        fields = corner_fields(order)
        self._fields = [[(int(a), int(m)) for m, a in np.argwhere(field)] for field in fields]
        self._share = weight / len(fields)

    @property
    def nodes(self) -> int:
        """See :class:`ClosedForm`."""
        return size(self._order, 3)

    def value(self, at: Triangles) -> Array:
        """See :class:`ClosedForm`."""
        total = np.zeros(at.n)
        for field in self._fields:
            T = self._scaled_gradient(at, _of_corners(at, field))
            total += np.sum(T * T, axis=0)
        return self._share * total / (4 * at.det)

    def first(self, at: Triangles, by_x: Array | None, by_u: Array | None) -> None:
        """See :class:`ClosedForm`."""
        for field in self._fields:
            u = _of_corners(at, field)
            T = self._scaled_gradient(at, u)
            force = T * (self._share / (2 * at.det))
            at.by_det -= np.sum(T * force, axis=0) / (2 * at.det)
            if by_x is not None or by_u is not None:
                V = self._pulled(force)
            if by_u is not None:
                for i in range(V.shape[0]):
                    of_corners = V[i, 0] * at.b[:, 0] + V[i, 1] * at.b[:, 1]
                    for node, corner in field:
                        by_u[node, i] += of_corners[corner]
            if by_x is not None:
                e = u[BEFORE] - u[AFTER]
                for i in range(V.shape[0]):
                    by_x[:, 0] -= V[i, 1] * e[:, i]
                    by_x[:, 1] += V[i, 0] * e[:, i]

    def second(self, at: Triangles, layout: Layout, out: Array) -> None:
        """See :class:`ClosedForm`."""
        for field in self._fields:
            self._second(field, at, layout, out)

    def _second(self, field: Field, at: Triangles, layout: Layout, out: Array) -> None:
        n_x, n, components = layout.n_x, at.n, self._L.shape[1]
        u = _of_corners(at, field)
        T = self._scaled_gradient(at, u)
        force = T * (self._share / (2 * at.det))
        at.by_det -= np.sum(T * force, axis=0) / (2 * at.det)
        r = np.zeros((len(T), layout.size, n))
        if layout.displacements:
            of_u = r[:, n_x:].reshape(len(T), self.nodes, components, n)
            for row, i, j, factor in self._terms:
                for node, corner in field:
                    of_u[row, node, i] += factor * at.b[corner, j]
        if layout.positions:
            of_x, e = r[:, :6].reshape(len(T), 3, 2, n), u[BEFORE] - u[AFTER]
            for row, i, j, factor in self._terms:
                of_x[row, :, 1 - j] += (factor if j == 0 else -factor) * e[:, i]
            of_x -= (T / at.det)[:, None, None] * at.b
        scaled = r * (self._share / (2 * at.det))
        work = np.empty((layout.size, n))
        for column, start in enumerate(layout.starts[:-1]):
            rows = layout.rows(column)
            for one, other in zip(scaled, r, strict=True):
                np.multiply(one[:rows], other[column], out=work[:rows])
                out[start : start + rows] += work[:rows]
        if layout.positions and layout.displacements:
            V = self._pulled(force)
            for node, corner in field:
                for i in range(components):
                    start = layout.starts[n_x + components * node + i]
                    for m, sign in ((AFTER[corner], 1), (BEFORE[corner], -1)):
                        out[start + 2 * m] -= sign * V[i, 1]
                        out[start + 2 * m + 1] += sign * V[i, 0]

    def prepare(self, X: Array) -> None:
        """See :class:`ClosedForm`."""

    def some(self, chosen: Index) -> Strain:
        """See :class:`ClosedForm`."""
        return self

    def scaled(self, weight: float) -> Strain:
        """See :class:`ClosedForm`."""
        return Strain(self._law, self._order, weight * self._weight)

    def _scaled_gradient(self, at: Triangles, u: Array) -> Array:
        first, second = u[1] - u[0], u[2] - u[0]
        P = first[:, None] * at.b[1] + second[:, None] * at.b[2]
        T = np.zeros((len(self._L), at.n))
        for row, i, j, factor in self._terms:
            T[row] += factor * P[i, j]
        return T

    def _pulled(self, force: Array) -> Array:
        """L^T force, (components, 2, n)."""
        V = np.zeros((*self._L.shape[1:], force.shape[1]))
        for row, i, j, factor in self._terms:
            V[i, j] += factor * force[row]
        return V


Field = list[tuple[int, int]]
"""A linear displacement of a triangle: which nodes' values add up to that at each corner, (node, corner)."""


def _of_corners(at: Triangles, field: Field) -> Array:
    """(3, components, n) a linear displacement."""
    assert at.u is not None
    if len(field) == 3:
        return at.u
    result = np.zeros((3, *at.u.shape[1:]))
    for node, corner in field:
        result[corner] += at.u[node]
    return result
