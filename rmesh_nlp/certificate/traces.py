"""Unknowns of the hybridised problem: traces of the displacement on the edges."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.certificate.conditions import Conditions
from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.evaluation import Array

Numbers = NDArray[np.int64]


@dataclass(frozen=True)
class TraceSpace:
    """Moments of the displacement on the edges, numbered.

    For each end of an edge the moments of each component against the linear function of that end,
    divided by the length. On contact edges the components are those along the obstacle's tangent and
    normal, elsewhere x and y.
    """

    skeleton: Skeleton
    conditions: Conditions

    @property
    def components(self) -> int:
        """Displacement components."""
        return int(self.conditions.held.shape[0])

    @property
    def size(self) -> int:
        """Number of traces."""
        return int(self.skeleton.ends.shape[1] * 2 * self.components)

    @cached_property
    def of_elements(self) -> Numbers:
        """(elements, local traces) numbers: edge by edge, ends counter-clockwise, component by component."""
        n = self.components
        at_ends = (2 * self.skeleton.edges[:, None] + self.skeleton.place) * n
        numbers = at_ends[:, :, None] + np.arange(n)[:, None]
        return np.ascontiguousarray(numbers.reshape(6 * n, -1).T)

    def of_contact(self, axis: int) -> Numbers:
        """(2, contact edges) numbers along a row of ``conditions.axes``."""
        at_ends = 2 * self.conditions.contact + np.arange(2)[:, None]
        return np.asarray(at_ends * self.components + axis, dtype=np.int64)

    def vector(self, field: NDArray) -> Array:
        """A field (components, 2, edges), Cartesian, as a vector of traces or forces."""
        contact, axes = self.conditions.contact, self.conditions.axes
        turned = field.astype(float)
        turned[:, :, contact] = np.einsum("eij,jme->ime", axes, turned[:, :, contact])
        return np.ascontiguousarray(turned.transpose(2, 1, 0)).ravel()

    @cached_property
    def held(self) -> NDArray[np.bool_]:
        """Which traces are given."""
        both = np.repeat(self.conditions.held[:, None], 2, axis=1)
        return np.asarray(np.abs(self.vector(both)) > 0.5)

    def rotations(self) -> tuple[NDArray[np.int64], Array]:
        """Elements with turned traces, and their matrices (these, k, k) from Cartesian to turned ones."""
        n, conditions = self.components, self.conditions
        oblique = np.any(np.abs(conditions.axes - np.eye(n)) > 0, axis=(1, 2))
        position = np.full(self.skeleton.ends.shape[1], -1)
        position[conditions.contact[oblique]] = np.flatnonzero(oblique)
        which = position[self.skeleton.edges]
        elements = np.flatnonzero(np.any(which >= 0, axis=0))
        result = np.tile(np.eye(6 * n), (elements.size, 1, 1))
        for i in range(3):
            has = np.flatnonzero(which[i, elements] >= 0)
            for end in range(2):
                at = slice((2 * i + end) * n, (2 * i + end + 1) * n)
                result[has, at, at] = conditions.axes[which[i, elements[has]]]
        return elements, result

    def base(self, displacement: Array) -> Array:
        """(components, 2, edges) moments of a piecewise linear displacement (components, nodes)."""
        ends = displacement[:, self.skeleton.ends]
        return np.asarray((2 * ends + ends[:, ::-1]) / 6)
