"""Sums of element results into sparse matrices, as CasADi Functions that run in numpy.

CasADi's own expressions for it (:mod:`rmesh_nlp.assembly`) take twice the time on a large mesh: the
results of an element lie side by side there, so that each operation strides through the memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.vectorised import Columns


@dataclass(frozen=True)
class Gather:
    """One argument of a kernel, ``scale * w[index] + offset`` of one input w; (length, elements) arrays."""

    source: int
    index: NDArray[np.int64]
    scale: Array
    offset: Array

    def __call__(self, inputs: Sequence[Array | None]) -> Array:
        """Its values."""
        w = inputs[self.source]
        if w is None or w.size == 0:
            return self.offset
        values = w[self.index]
        values *= self.scale
        values += self.offset
        return values


@dataclass(frozen=True)
class Part:
    """One element group.

    Attributes
    ----------
    kernel : Columns
    arguments : tuple of Gather
    scatter : tuple of sparse arrays
        For each result of the kernel the matrix that takes its values, row by row, to the
        nonzeros of the output of the same number.
    """

    kernel: Columns
    arguments: tuple[Gather, ...]
    scatter: tuple[sp.csr_array, ...]


class Summed(ca.Callback):
    """The sum over element groups.

    CasADi does not own Python callbacks: whoever keeps a Function made of this one must keep
    this one too.

    Parameters
    ----------
    name : str
    inputs, outputs : sequences of casadi.Sparsity
        Inputs are dense columns.
    parts : sequence of Part
    """

    def __init__(
        self, name: str, inputs: Sequence[ca.Sparsity], outputs: Sequence[ca.Sparsity], parts: Sequence[Part]
    ) -> None:
        super().__init__()
        self._inputs, self._outputs, self._parts = inputs, outputs, parts
        self.construct(name, {})

    def get_n_in(self) -> int:
        """As given."""
        return len(self._inputs)

    def get_n_out(self) -> int:
        """As given."""
        return len(self._outputs)

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """As given."""
        return self._inputs[i]

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        """As given."""
        return self._outputs[i]

    def has_eval_buffer(self) -> bool:
        """Evaluation in place, without copies to CasADi's own matrices."""
        return True

    def eval_buffer(self, arg: list[memoryview | None], res: list[memoryview | None]) -> int:
        """Evaluate on flat buffers of all nonzeros; an argument None is zero, a result None is not wanted."""
        inputs = [None if a is None else np.frombuffer(a) for a in arg]
        outputs = [None if r is None else np.frombuffer(r) for r in res]
        for output in outputs:
            if output is not None:
                output.fill(0.0)
        for part in self._parts:
            results = part.kernel([gather(inputs) for gather in part.arguments])
            for output, result, matrix in zip(outputs, results, part.scatter, strict=True):
                if output is not None and matrix.nnz:
                    output += matrix @ result.ravel()
        return 0
