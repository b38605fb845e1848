"""What runs while a solver runs: the monitor of its iterations, and Ctrl-C."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.budget import signals_to

Monitor = Callable[[int, Array, float, Array], bool | None]
"""Called as ``monitor(iteration, x, f, lam_g)`` after each accepted iteration, with the multipliers (n_g,) of
the constraints; True stops the solver."""


class PythonFunction(ca.Callback):
    """A CasADi Function in Python; its subclass has a method ``eval``, or ``eval_buffer``.

    CasADi does not own Python callbacks: they must live as long as what is made of them.
    """

    def __init__(
        self,
        name: str,
        inputs: Sequence[ca.Sparsity],
        outputs: Sequence[ca.Sparsity],
        options: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__()
        self._inputs, self._outputs = inputs, outputs
        self.construct(name, dict(options or {}))

    def get_n_in(self) -> int:
        """Number of inputs."""
        return len(self._inputs)

    def get_n_out(self) -> int:
        """Number of outputs."""
        return len(self._outputs)

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """As given."""
        return self._inputs[i]

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        """As given."""
        return self._outputs[i]


class IterationCallback(PythonFunction):
    """Adapter from CasADi's iteration callback, whose inputs are the outputs of nlpsol, to a Monitor."""

    def __init__(self, n_x: int, n_g: int, n_p: int) -> None:
        sizes = {"x": n_x, "f": 1, "g": n_g, "lam_x": n_x, "lam_g": n_g, "lam_p": n_p}
        self._monitor: Monitor | None = None
        self._error: BaseException | None = None
        inputs = [ca.Sparsity.dense(sizes[name]) for name in ca.nlpsol_out()]
        super().__init__("monitor", inputs, [ca.Sparsity.dense(1)])

    def has_eval_buffer(self) -> bool:
        """Evaluation in place: copies to CasADi's matrices would take longer than a small iteration."""
        return True

    def eval_buffer(self, arg: list[memoryview | None], res: list[memoryview]) -> int:
        """Pass the iterate on; an argument None is zero."""
        x, f, lam_g = (
            np.zeros(self.nnz_in(k)) if (given := arg[k]) is None else np.frombuffer(given).copy()
            for k in (0, 1, 4)
        )
        try:
            if self._monitor is not None and self._monitor(self._iteration, x, float(f[0]), lam_g):
                self._stop = True
        except BaseException as error:  # CasADi would take it for a failed evaluation: raised after the solve
            self._stop, self._error = True, error
        self._iteration += 1
        np.frombuffer(res[0])[:] = self._stop
        return 0

    def _interrupt(self, *_: object) -> None:
        self._stop, self._error = True, KeyboardInterrupt()

    @contextmanager
    def watched(self, monitor: Monitor | None) -> Iterator[None]:
        """A solve that ``monitor`` sees; raises what the monitor raised, KeyboardInterrupt after Ctrl-C.

        CasADi swallows the KeyboardInterrupt that Python raises inside it: the solver stops, and reports an
        ordinary failure. So the signal asks the callback to stop the solver at the next iteration.
        """
        self._monitor, self._iteration, self._stop, self._error = monitor, 0, False, None
        try:
            with signals_to(self._interrupt):
                yield
        finally:
            self._monitor = None
            if self._error is not None:
                raise self._error from None
