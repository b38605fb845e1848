"""What runs while a solver runs: the monitor of its iterations, and Ctrl-C."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

import casadi as ca

from rmesh_nlp.evaluation import Array, flat
from rmesh_nlp.optimize.budget import signals_to

Monitor = Callable[[int, Array, float, Array], bool | None]
"""Called as ``monitor(iteration, x, f, lam_g)`` after each accepted iteration, with the multipliers (n_g,) of
the constraints; True stops the solver."""


class PythonFunction(ca.Callback):
    """A CasADi Function in Python; its subclass has a method ``eval``, or ``eval_buffer``.

    CasADi does not own Python callbacks: they must live as long as what is made of them.
    """

    def __init__(self, name: str, inputs: Sequence[ca.Sparsity], outputs: Sequence[ca.Sparsity]) -> None:
        super().__init__()
        self._inputs, self._outputs = inputs, outputs
        self.construct(name, {})

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

    def __init__(self, n_x: int, n_g: int, n_p: int, monitor: Monitor) -> None:
        sizes = {"x": n_x, "f": 1, "g": n_g, "lam_x": n_x, "lam_g": n_g, "lam_p": n_p}
        self._monitor, self._iteration = monitor, 0
        self.stop = self.interrupted = False
        inputs = [ca.Sparsity.dense(sizes[name]) for name in ca.nlpsol_out()]
        super().__init__("monitor", inputs, [ca.Sparsity.dense(1)])

    def eval(self, arg: list[ca.DM]) -> list[int]:
        """Pass the iterate on."""
        try:
            at = dict(zip(ca.nlpsol_out(), arg, strict=True))
            enough = self._monitor(self._iteration, flat(at["x"]), float(at["f"]), flat(at["lam_g"]))
        except KeyboardInterrupt:  # CasADi would take it for a failed evaluation
            enough = self.interrupted = True
        self._iteration += 1
        self.stop = self.stop or bool(enough)
        return [int(self.stop)]


@contextmanager
def interruptible(callback: IterationCallback | None) -> Iterator[None]:
    """Raise KeyboardInterrupt when the solver that was interrupted by Ctrl-C has returned.

    CasADi swallows the KeyboardInterrupt that Python raises inside it: the solver stops, and reports an
    ordinary failure. Where there is a callback the signal asks it to stop the solver at the next iteration
    instead, because an exception inside a Python function would only be a failed evaluation.
    """
    interrupted = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal interrupted
        interrupted = True
        if callback is None:
            signal.default_int_handler(number, frame)
        else:
            callback.stop = True

    try:
        with signals_to(note):
            yield
    finally:
        if callback is not None:
            interrupted = interrupted or callback.interrupted
            callback.stop = callback.interrupted = False  # it may serve another solve
        if interrupted:
            raise KeyboardInterrupt from None
