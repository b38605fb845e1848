"""From element Functions to a global objective, constraints and their sparse derivatives.

Each is a sum over elements of one small function of a few local values, which is differentiated once.
In numpy (:mod:`rmesh_nlp.fem.numeric`) it runs over all elements at a time. CasADi's expressions of the same
sums can be differentiated further and cost least on a small mesh; its Functions are what solvers take.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.element import RESULTS, plain
from rmesh_nlp.fem.fields import CONSTANT, ElementGroup, Values
from rmesh_nlp.fem.numeric import AXES, Kernel, LocalKernels, Mapped, Numeric, merged
from rmesh_nlp.fem.space import Index
from rmesh_nlp.fem.straightened import straightened
from rmesh_nlp.fem.sums import Shape, Sums, sparse
from rmesh_nlp.optimize.callbacks import PythonFunction
from rmesh_nlp.optimize.nlp import Derivatives
from rmesh_nlp.vectorised import USUAL, AssemblySettings, columnwise


class _InCasadi:
    """Sums as expressions of the inputs, each argument gathered once."""

    def __init__(self, inputs: list[ca.MX]) -> None:
        self._inputs = inputs
        self._gathered: dict[int, tuple[Values, ca.MX]] = {}

    def __call__(self, shapes: list[Shape], kernels: list[Kernel]) -> list[ca.MX]:
        """One expression for each output."""
        local = [k.function.map(k.size).call([self._gather(*a) for a in k.arguments]) for k in kernels]
        outputs = []
        for number, shape in enumerate(shapes):
            parts = [kernel.results[number] for kernel in kernels]
            sums = Sums(shape, parts)
            nonzeros = ca.MX.zeros(sums.pattern.nnz(), 1)
            for part, results in enumerate(local):
                matrix = sums.by_element(part, parts[part].row.shape)
                if matrix.nnz():
                    nonzeros += matrix @ ca.vec(results[number])
            outputs.append(ca.MX(sums.pattern, nonzeros))
        return outputs

    def _gather(self, source: int, field: Values) -> ca.MX:
        """Local values (length, elements) of a field of one input."""
        if id(field) not in self._gathered:
            w, index = self._inputs[source], field.index
            moving = index != CONSTANT
            shape = (moving.size, int(w.shape[0]))
            pick = sparse(shape, _by_element(moving.shape)[moving], index[moving], field.scale[moving])
            local = pick @ w + ca.DM(field.offset.ravel(order="F"))
            # the field is kept too, for its id to stay its own
            self._gathered[id(field)] = field, ca.reshape(local, *moving.shape)
        return self._gathered[id(field)][1]


class Summed(PythonFunction):
    """The same sums as a Function of dense columns."""

    def __init__(self, name: str, inputs: list[ca.MX], numeric: Numeric) -> None:
        self._numeric = numeric
        outputs = [sums.pattern for sums in numeric.sums]
        super().__init__(name, [symbol.sparsity() for symbol in inputs], outputs)

    def has_eval_buffer(self) -> bool:
        """Evaluation in place, without copies to CasADi's own matrices."""
        return True

    def eval_buffer(self, arg: list[memoryview | None], res: list[memoryview | None]) -> int:
        """Evaluate on flat buffers of all nonzeros; an argument None is zero, a result None is not wanted."""
        nonzeros = self._numeric(*(None if a is None else np.frombuffer(a) for a in arg))
        for result, values in zip(res, nonzeros, strict=True):
            if result is not None:
                np.frombuffer(result)[:] = values
        return 0


def _by_element(shape: Shape) -> Index:
    """Where CasADi stores the entries of a (length, elements) array: one element after the other."""
    return np.arange(shape[0] * shape[1]).reshape(shape, order="F")


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
        self._groups = merged([part for group in present for part in straightened(group)])
        self._large = any(group.size >= settings.numpy_from for group in groups)
        self._settings = settings
        self._inputs = [x, p, ca.MX.sym("lam_f"), ca.MX.sym("lam_g", n_rows)]
        self._lengths = {"one": 1, "rows": n_rows, "x": int(x.shape[0])}
        self._in_casadi = _InCasadi(self._inputs)
        self.kernels: list[ca.Function] = []

    @cached_property
    def _local(self) -> list[LocalKernels]:
        return [LocalKernels(group) for group in self._groups]

    @property
    def values(self) -> Numeric:
        """``(x, p) -> (f, g)`` on arrays."""
        return self._numeric("values")

    @property
    def gradient(self) -> Numeric:
        """``(x, p) -> (f, gradient)`` on arrays."""
        return self._numeric("gradient")

    @property
    def jacobian(self) -> Numeric:
        """``(x, p) -> (g, nonzeros of the Jacobian)`` on arrays."""
        return self._numeric("jacobian")

    def hessian(self, leading: int | None = None) -> Numeric:
        """``(x, p, lam_f, lam_g) -> (nonzeros of the Hessian of the Lagrangian,)`` on arrays, upper triangle.

        With ``leading`` only the rows of as many unknowns.
        """
        return self._numeric("hessian", leading)

    def _numeric(self, which: str, leading: int | None = None) -> Numeric:
        kernels = [part.kernel(which, leading, whole=False) for part in self._local]
        return Numeric(self._shapes(which), [Mapped(kernel, self._settings) for kernel in kernels])

    @cached_property
    def _expressions(self) -> list[ca.MX]:
        return self._in_casadi(*self._sums("values"))

    @property
    def f(self) -> ca.MX:
        """The objective."""
        return self._expressions[0]

    @property
    def g(self) -> ca.MX:
        """The constraints."""
        return self._expressions[1]

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

    def _shapes(self, which: str) -> list[Shape]:
        axes = [AXES[name] for name in RESULTS[which]]
        return [(self._lengths[rows], self._lengths[columns]) for rows, columns in axes]

    def _sums(self, which: str) -> tuple[list[Shape], list[Kernel]]:
        return self._shapes(which), [part.kernel(which) for part in self._local]

    def _function(self, name: str, n_in: int, which: str) -> ca.Function:
        inputs = self._inputs[:n_in]
        if not self._large:
            return ca.Function(name, inputs, self._in_casadi(*self._sums(which)))
        self.kernels.append(Summed(name, inputs, self._numeric(which)))
        return ca.Function(name, inputs, self.kernels[-1].call(inputs))


def element_values(groups: Sequence[ElementGroup]) -> Callable[[Array], list[Array]]:
    """A function of the unknowns ``x``: what each element of each group adds to the objective."""
    evaluate = [columnwise(plain(group.function, group.at_points), group.size) for group in groups]

    def values(x: Array) -> list[Array]:
        by_group = []
        for columns, group in zip(evaluate, groups, strict=True):
            by_group.append(columns([field.values(x) for field in group.arguments])[0].ravel())
        return by_group

    return values
