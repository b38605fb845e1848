"""The better parts of two solutions, block by block of the mesh.

On a fine mesh the best moves are patterns of neighbouring nodes at opposite ends of their boxes.
Two descents end in different domains of such patterns, each with its own flaws. The energy is a
sum over elements, so what a block of nodes gains or loses by taking its moves and displacements
from the other solution is known exactly from the elements at the block: no contact is solved.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.discretisation.validity import area_ratios
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.assembly import element_values
from rmesh_nlp.fem.fields import CONSTANT, Field
from rmesh_nlp.problem import signed_areas
from rmesh_nlp.programs.energy_program import Relocation

COLOURS = 4
"""Of the blocks, in a chequerboard of two by two: blocks of one colour do not touch."""


class Recombination:
    """Recombines unknowns ``x = (q, u, s)`` of one energy program.

    Parameters
    ----------
    relocation : Relocation
    """

    def __init__(self, relocation: Relocation) -> None:
        self.relocation = relocation
        problem = relocation.problem
        fields = (relocation.freedoms.positions, relocation.displacement, relocation.slip)
        groups = relocation.discretisation.energy(*fields)
        self._values = element_values(groups)
        self._unknowns = [np.concatenate([field.index for field in g.arguments]) for g in groups]
        self._node = np.zeros(relocation.n_x, dtype=np.int64)
        for field in fields:
            _name_owners(self._node, field)
        self._area = signed_areas(problem.mesh.p, problem.triangles)

    def __call__(self, x: Array, other: Array, across: int, shift: float) -> Array:
        """``x`` with the blocks that are better in ``other``; its energy is not higher.

        Parameters
        ----------
        x, other : (n_q + n_u + n_s,) arrays
        across : int
            Nodes across a block.
        shift : float
            Of the blocks against the mesh, as a part of their size.
        """
        block, colour = self._blocks(across, shift)
        block, colour = block[self._node], colour[self._node]
        for c in range(COLOURS):
            mine = colour == c
            trial = np.where(mine, other, x)
            change = self._change(x, trial, np.where(mine, block, -1), int(block.max(initial=-1)) + 1)
            x = np.where(mine & (change[block] < 0), other, x)
        return x

    def _blocks(self, across: int, shift: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The block of each node, and the colour of that block."""
        p = self.relocation.problem.mesh.p
        size = across * np.sqrt(self._area.sum() / p.shape[1])
        cell = np.floor((p - p.min(axis=1, keepdims=True)) / size + shift).astype(np.int64)
        block = np.unique(cell, axis=1, return_inverse=True)[1].ravel()
        return block, cell[0] % 2 + 2 * (cell[1] % 2)

    def _change(self, x: Array, trial: Array, block: NDArray[np.int64], n_blocks: int) -> Array:
        """What each block adds to the energy by the exchange; infinite if an element gets too small."""
        total = np.zeros(n_blocks + 1)  # the last one is for no block
        for before, after, unknowns in zip(self._values(x), self._values(trial), self._unknowns, strict=True):
            owner = np.max(np.where(unknowns == CONSTANT, -1, block[unknowns]), axis=0)
            total += np.bincount(owner % total.size, after - before, total.size)
        rel = self.relocation
        triangles = rel.problem.triangles
        small = area_ratios(rel.problem, rel.nodes(trial[: rel.n_q])) < rel.problem.motion.min_area_fraction
        if np.any(small):
            of_node = np.full(rel.problem.mesh.p.shape[1], -1)
            np.maximum.at(of_node, self._node, block)
            total[np.max(of_node[triangles[:, small]], axis=0)] = np.inf
        return total


def _name_owners(node: NDArray[np.int64], field: Field) -> None:
    """Write to ``node[k]`` a node whose value depends on the unknown k."""
    used = field.index != CONSTANT
    node[field.index[used]] = np.broadcast_to(np.arange(field.index.shape[1]), field.index.shape)[used]
