"""Sums of element results into sparse matrices, as CasADi expressions or as Functions that run in numpy.

CasADi's expressions can be differentiated further and cost least on a small mesh. On a large one they
take twice the time: the results of an element lie side by side, so that each operation strides
through the memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.fields import CONSTANT, Field, Index
from rmesh_nlp.fem.kernels import Entries, Kernel
from rmesh_nlp.vectorised import AssemblySettings, Columns, columnwise


class _Sums:
    """The nonzeros of a sparse matrix, each the sum of some local results; a column is dense."""

    def __init__(self, shape: tuple[int, int], parts: list[Entries]) -> None:
        self._parts = parts
        self._kept = [(part.row >= 0) & (part.column >= 0) for part in parts]
        keys = [
            part.column[keep].astype(np.int64) * shape[0] + part.row[keep]
            for part, keep in zip(parts, self._kept, strict=True)
        ]
        if shape[1] == 1:
            self.pattern, self._targets = ca.Sparsity.dense(*shape), keys
            return
        unique, place = np.unique(np.concatenate([np.zeros(0, np.int64), *keys]), return_inverse=True)
        self._targets = np.split(place, np.cumsum([key.size for key in keys])[:-1]) if keys else []
        starts = np.searchsorted(unique, np.arange(shape[1] + 1) * shape[0])
        self.pattern = ca.Sparsity(*shape, starts.tolist(), (unique % max(shape[0], 1)).tolist())

    def in_casadi(self, part: int) -> ca.DM:
        """The matrix that takes the local results of one part, element by element, to the nonzeros."""
        keep = self._kept[part]
        shape = (self.pattern.nnz(), keep.size)
        return sparse(shape, self._targets[part], by_element(keep.shape)[keep], self._parts[part].scale[keep])

    def in_scipy(self, part: int) -> sp.csr_array:
        """The same for local results that come row by row, as numpy has them."""
        keep = self._kept[part]
        where = (self._targets[part], np.flatnonzero(keep))
        return sp.csr_array((self._parts[part].scale[keep], where), (self.pattern.nnz(), keep.size))


class InCasadi:
    """Sums as expressions of the inputs, each argument gathered once."""

    def __init__(self, inputs: list[ca.MX]) -> None:
        self._inputs = inputs
        self._gathered: dict[int, tuple[Field, ca.MX]] = {}

    def __call__(self, shapes: list[tuple[int, int]], kernels: list[Kernel]) -> list[ca.MX]:
        """One expression for each output."""
        local = [
            kernel.function.map(kernel.size).call([self._gather(*argument) for argument in kernel.arguments])
            for kernel in kernels
        ]
        outputs = []
        for number, shape in enumerate(shapes):
            sums = _Sums(shape, [kernel.results[number] for kernel in kernels])
            nonzeros = ca.MX.zeros(sums.pattern.nnz(), 1)
            for part, results in enumerate(local):
                matrix = sums.in_casadi(part)
                if matrix.nnz():
                    nonzeros += matrix @ ca.vec(results[number])
            outputs.append(ca.MX(sums.pattern, nonzeros))
        return outputs

    def _gather(self, source: int, field: Field) -> ca.MX:
        """Local values (length, elements) of a field of one input."""
        if id(field) not in self._gathered:
            w, moving = self._inputs[source], field.index != CONSTANT
            shape = (moving.size, int(w.shape[0]))
            pick = sparse(shape, by_element(moving.shape)[moving], field.index[moving], field.scale[moving])
            local = pick @ w + ca.DM(field.offset.ravel(order="F"))
            # the field is kept too, for its id to stay its own
            self._gathered[id(field)] = field, ca.reshape(local, *moving.shape)
        return self._gathered[id(field)][1]


@dataclass(frozen=True)
class Gather:
    """One argument of a kernel, ``scale * w[index] + offset`` of one input w; (length, elements) arrays."""

    source: int
    index: Index
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


def in_numpy(
    name: str,
    inputs: list[ca.MX],
    shapes: list[tuple[int, int]],
    kernels: list[Kernel],
    settings: AssemblySettings,
) -> Summed:
    """The same sums as a Function that runs in numpy."""
    sums = [
        _Sums(shape, [kernel.results[number] for kernel in kernels]) for number, shape in enumerate(shapes)
    ]
    parts = []
    for part, kernel in enumerate(kernels):
        matrices = [s.in_scipy(part) for s in sums]
        if any(matrix.nnz for matrix in matrices):
            gathers = tuple(_gather(source, field) for source, field in kernel.arguments)
            parts.append(Part(columnwise(kernel.function, kernel.size, settings), gathers, tuple(matrices)))
    sparsities = [symbol.sparsity() for symbol in inputs]
    return Summed(name, sparsities, [s.pattern for s in sums], parts)


def _gather(source: int, field: Field) -> Gather:
    moving = field.index != CONSTANT
    return Gather(source, np.where(moving, field.index, 0), np.where(moving, field.scale, 0.0), field.offset)


def by_element(shape: tuple[int, int]) -> Index:
    """Where CasADi stores the entries of a (length, elements) array: one element after the other."""
    return np.arange(shape[0] * shape[1]).reshape(shape, order="F")


def sparse(shape: tuple[int, int], row: Index, column: Index, value: Array) -> ca.DM:
    """A sparse matrix by its entries, each given once; zeros among them are kept.

    ``scipy.sparse`` would check and convert its indices four times on the way, which took a fifth of the time
    of stating a small problem.
    """
    order = np.lexsort((row, column))
    starts = np.searchsorted(column[order], np.arange(shape[1] + 1))
    return ca.DM(ca.Sparsity(*shape, starts.tolist(), row[order].tolist()), value[order])
