"""From element Functions to a global objective, constraints and their sparse derivatives.

Each is a sum over elements of one small function of a few local values, which is differentiated once, mapped
over all elements, and summed into the nonzeros of the global derivatives by one constant sparse matrix.
CasADi's expressions of these sums can be differentiated further and cost least on a small mesh; on a large
one they take twice the time of Functions that run in numpy, for the results of an element lie side by side.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.element import RESULTS, differentiated, plain
from rmesh_nlp.fem.fields import CONSTANT, ElementGroup, Field, straightened
from rmesh_nlp.fem.space import Index
from rmesh_nlp.optimize.callbacks import PythonFunction
from rmesh_nlp.optimize.nlp import Derivatives
from rmesh_nlp.vectorised import USUAL, AssemblySettings, Columns, columnwise

Shape = tuple[int, int]


class Entries(NamedTuple):
    """Where each local result goes: ``matrix[row, column] += scale * result``; -1 drops it."""

    row: Index
    column: Index
    scale: Array


class Kernel(NamedTuple):
    """A function of one element, the inputs that its arguments come from, and where its results go.

    Inputs are x, p, lam_f and lam_g. Result number k is summed into output number k.
    """

    function: ca.Function
    arguments: tuple[tuple[int, Field], ...]
    results: tuple[Entries, ...]
    size: int


AXES = {
    "f": ("one", "one"),
    "g": ("rows", "one"),
    "gradient": ("x", "one"),
    "jacobian": ("rows", "x"),
    "hessian": ("x", "x"),
}
"""What numbers the rows and columns of each result."""


class LocalKernels:
    """The kernels of one element group whose fields are affine."""

    def __init__(self, group: ElementGroup) -> None:
        self._group, fields = group, group.arguments
        variable = [i for i, f in enumerate(fields) if not f.parameter and np.any(f.index != CONSTANT)]
        self._local = differentiated(group.function, group.at_points, variable)
        none = np.zeros((0, group.size))
        self._axes = {
            "one": _plain(np.zeros((1, group.size), int)),
            "rows": _plain(group.rows),
            "x": Field(
                np.concatenate([none.astype(int), *(fields[i].index for i in variable)]),
                np.concatenate([none, *(fields[i].scale for i in variable)]),
                none,
            ),
        }

    def kernel(self, which: str) -> Kernel:
        """The kernel with the results ``RESULTS[which]``."""
        arguments = tuple((int(field.parameter), field) for field in self._group.arguments)
        if which == "hessian":
            arguments += (2, self._axes["one"]), (3, self._axes["rows"])
        results = tuple(self._entries(name) for name in RESULTS[which])
        return Kernel(self._local.function(which), arguments, results, self._group.size)

    def _entries(self, name: str) -> Entries:
        a, b = (np.asarray(k, dtype=int) for k in self._local.patterns[name].get_triplet()[:2])
        row, column = (self._axes[axis] for axis in AXES[name])
        i, j, scale = row.index[a], column.index[b], row.scale[a] * column.scale[b]
        if name != "hessian":
            return Entries(i, j, scale)
        # two local values of one unknown: the lower triangle folds onto the diagonal too
        twice = np.where((i == j) & (a != b)[:, None], 2.0, 1.0)
        return Entries(np.minimum(i, j), np.maximum(i, j), twice * scale)


def _plain(index: Index) -> Field:
    return Field(index, np.ones(index.shape), np.zeros(index.shape))


class _Sums:
    """The nonzeros of a sparse matrix, each the sum of some local results; a column is dense."""

    def __init__(self, shape: Shape, parts: list[Entries]) -> None:
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
        column, scale = _by_element(keep.shape)[keep], self._parts[part].scale[keep]
        return _sparse((self.pattern.nnz(), keep.size), self._targets[part], column, scale)

    def in_scipy(self, part: int) -> sp.csr_array:
        """The same for local results that come row by row, as numpy has them."""
        keep = self._kept[part]
        where = (self._targets[part], np.flatnonzero(keep))
        return sp.csr_array((self._parts[part].scale[keep], where), (self.pattern.nnz(), keep.size))


class _InCasadi:
    """Sums as expressions of the inputs, each argument gathered once."""

    def __init__(self, inputs: list[ca.MX]) -> None:
        self._inputs = inputs
        self._gathered: dict[int, tuple[Field, ca.MX]] = {}

    def __call__(self, shapes: list[Shape], kernels: list[Kernel]) -> list[ca.MX]:
        """One expression for each output."""
        local = [k.function.map(k.size).call([self._gather(*a) for a in k.arguments]) for k in kernels]
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
            pick = _sparse(shape, _by_element(moving.shape)[moving], field.index[moving], field.scale[moving])
            local = pick @ w + ca.DM(field.offset.ravel(order="F"))
            # the field is kept too, for its id to stay its own
            self._gathered[id(field)] = field, ca.reshape(local, *moving.shape)
        return self._gathered[id(field)][1]


class Summed(PythonFunction):
    """The sums over element groups as a Function of dense columns that runs in numpy."""

    def __init__(
        self,
        name: str,
        inputs: list[ca.MX],
        shapes: list[Shape],
        kernels: list[Kernel],
        settings: AssemblySettings,
    ) -> None:
        sums = [_Sums(shape, [k.results[number] for k in kernels]) for number, shape in enumerate(shapes)]
        # for each group its function, its arguments, and per output the matrix that takes the results there
        self._parts: list[tuple[Columns, list[_Gather], list[sp.csr_array]]] = []
        for part, kernel in enumerate(kernels):
            matrices = [s.in_scipy(part) for s in sums]
            if any(matrix.nnz for matrix in matrices):
                columns = columnwise(kernel.function, kernel.size, settings)
                self._parts.append((columns, [_Gather(*a) for a in kernel.arguments], matrices))
        super().__init__(name, [symbol.sparsity() for symbol in inputs], [s.pattern for s in sums])

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
        for columns, gathers, matrices in self._parts:
            results = columns([gather(inputs) for gather in gathers])
            for output, result, matrix in zip(outputs, results, matrices, strict=True):
                if output is not None and matrix.nnz:
                    output += matrix @ result.ravel()
        return 0


class _Gather:
    """One argument of a kernel from one input w: ``scale * w[index] + offset``, (length, elements)."""

    def __init__(self, source: int, field: Field) -> None:
        moving = field.index != CONSTANT
        self._source, self._offset = source, field.offset
        self._index, self._scale = np.where(moving, field.index, 0), np.where(moving, field.scale, 0.0)

    def __call__(self, inputs: Sequence[Array | None]) -> Array:
        w = inputs[self._source]
        if w is None or w.size == 0:
            return self._offset
        values = w[self._index]
        values *= self._scale
        values += self._offset
        return values


def _by_element(shape: Shape) -> Index:
    """Where CasADi stores the entries of a (length, elements) array: one element after the other."""
    return np.arange(shape[0] * shape[1]).reshape(shape, order="F")


def _sparse(shape: Shape, row: Index, column: Index, value: Array) -> ca.DM:
    """A sparse matrix by its entries, each given once; zeros among them are kept.

    ``scipy.sparse`` would check and convert its indices four times on the way: a fifth of the time to build
    the model of a small problem.
    """
    order = np.lexsort((row, column))
    starts = np.searchsorted(column[order], np.arange(shape[1] + 1))
    return ca.DM(ca.Sparsity(*shape, starts.tolist(), row[order].tolist()), value[order])


class Assembled:
    """Global objective and constraints as MX expressions, and their derivatives, each built when asked for.

    The fields of the groups index the columns ``x`` or ``p``; of ``n_rows`` constraints those that no group
    touches are zero. This object must live as long as any Function made of the derivatives: some are Python
    callbacks, ``kernels``, which CasADi does not own.
    """

    def __init__(
        self,
        groups: Sequence[ElementGroup],
        x: ca.MX,
        p: ca.MX,
        n_rows: int,
        settings: AssemblySettings = USUAL,
    ) -> None:
        present = [group for group in groups if group.size > 0]
        self._local = [LocalKernels(part) for group in present for part in straightened(group)]
        self._large = any(group.size >= settings.numpy_from for group in groups)
        self._settings = settings
        self._inputs = [x, p, ca.MX.sym("lam_f"), ca.MX.sym("lam_g", n_rows)]
        self._lengths = {"one": 1, "rows": n_rows, "x": int(x.shape[0])}
        self._in_casadi = _InCasadi(self._inputs)
        self.kernels: list[ca.Function] = []

    @cached_property
    def _values(self) -> list[ca.MX]:
        return self._in_casadi(*self._sums("values"))

    @property
    def f(self) -> ca.MX:
        """The objective."""
        return self._values[0]

    @property
    def g(self) -> ca.MX:
        """The constraints."""
        return self._values[1]

    @cached_property
    def grad_f(self) -> ca.Function:
        """``(x, p) -> (f, gradient)``."""
        return self._function("nlp_grad_f", 2, "gradient")

    @cached_property
    def jac_g(self) -> ca.Function:
        """``(x, p) -> (g, Jacobian)``."""
        return self._function("nlp_jac_g", 2, "jacobian")

    @cached_property
    def hess_lag(self) -> ca.Function:
        """``(x, p, lam_f, lam_g) ->`` upper triangle of the Hessian of the Lagrangian."""
        return self._function("nlp_hess_l", 4, "hessian")

    @property
    def derivatives(self) -> Derivatives:
        """The derivative Functions in the form that nlpsol takes."""
        return Derivatives(self.grad_f, self.jac_g, self.hess_lag, tuple(self.kernels))

    def _sums(self, which: str) -> tuple[list[Shape], list[Kernel]]:
        axes = [AXES[name] for name in RESULTS[which]]
        shapes = [(self._lengths[rows], self._lengths[columns]) for rows, columns in axes]
        return shapes, [part.kernel(which) for part in self._local]

    def _function(self, name: str, n_in: int, which: str) -> ca.Function:
        inputs = self._inputs[:n_in]
        if not self._large:
            return ca.Function(name, inputs, self._in_casadi(*self._sums(which)))
        self.kernels.append(Summed(name, inputs, *self._sums(which), self._settings))
        return ca.Function(name, inputs, self.kernels[-1].call(inputs))


def element_values(groups: Sequence[ElementGroup]) -> Callable[[Array], list[Array]]:
    """A function of the unknowns ``x``: what each element of each group adds to the objective."""
    evaluate = [columnwise(plain(group.function, group.at_points), group.size) for group in groups]

    def values(x: Array) -> list[Array]:
        return [
            columns([field.values(x) for field in group.arguments])[0].ravel()
            for columns, group in zip(evaluate, groups, strict=True)
        ]

    return values
