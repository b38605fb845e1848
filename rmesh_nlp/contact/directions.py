"""Normals and tangents of contact nodes, as rows that take components of the displacement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.fields import Field
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.statement import NO_NORMAL


@dataclass(frozen=True)
class Directions:
    """Normals and tangents at the contact nodes of a problem.

    Attributes
    ----------
    problem : ContactProblem
    displacement : Field
        (components, nodes), the displacement as a function of the unknowns u.
    n_u : int
    """

    problem: ContactProblem
    displacement: Field
    n_u: int

    def normals(self, nodes: Array) -> Array:
        """Unit normals (components, gaps) at node positions (2, nodes)."""
        parts = [part.obstacle.normals(nodes[:, part.nodes]) for part in self.problem.contact_sets]
        return np.hstack([np.zeros((self.problem.components, 0)), *parts])

    def rows(self, nodes: Array) -> tuple[sp.csr_array, sp.csr_array]:
        """Sparse rows (gaps, n_u) of normals and tangents; a scalar problem has no tangents."""
        normals = self.normals(nodes)
        return self._rows(normals), self._tangents(normals)

    def _tangents(self, normals: Array) -> sp.csr_array:
        if self.problem.components == 1:
            return sp.csr_array((0, self.n_u))
        return self._rows(np.stack([normals[1], -normals[0]]))

    def _rows(self, vectors: Array) -> sp.csr_array:
        """Rows that take the component of the displacement along ``vectors`` (components, gaps)."""
        nodes = self.problem.contact_nodes
        if nodes.size == 0:
            return sp.csr_array((0, self.n_u))
        index = self.displacement.index[:, nodes]
        row = np.broadcast_to(np.arange(index.shape[1]), index.shape)
        used = (np.abs(vectors) > NO_NORMAL) & (index >= 0)
        return sp.csr_array((vectors[used], (row[used], index[used])), shape=(index.shape[1], self.n_u))
